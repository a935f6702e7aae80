"""Studies and other computations of many runs: verdicts, bases, derivatives of prepared runs."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit_gradients.sensitivities import is_smooth as is_smooth, PreparedSensitivities as PreparedSensitivities
    from mbdkit_studies.lanes.prepared_run import prepare as prepare
    from mbdkit_studies.results.judge import study_verdict as study_verdict
    from mbdkit_studies.spec.sample_section import frozen as frozen
    from mbdkit_studies.spec.study_loading import base_document as base_document, document_of as document_of
    from mbdkit_studies.spec.study_spec import Overrides as Overrides
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
