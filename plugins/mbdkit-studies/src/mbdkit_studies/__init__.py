"""Families of runs: axes, samples and ensembles, their execution by processes and clusters, and their folders.

This module is a door: the names that authors of verdicts on studies, of commands that compute many runs, and of folders
of their results import, from `mbdkit_studies`. Each is imported when it is first used.
"""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit_studies.commands import Cluster as Cluster, Workers as Workers
    from mbdkit_studies.compute.batch import Batches as Batches
    from mbdkit_studies.compute.executor_pool import Engine as Engine
    from mbdkit_studies.compute.tasks import Message as Message, PASSING as PASSING, Task as Task
    from mbdkit_studies.folder.owned_folder import OwnedFolder as OwnedFolder
    from mbdkit_studies.lanes.prepared_run import PreparedRun as PreparedRun
    from mbdkit_studies.points.varied_values import start_warnings_of_study as start_warnings_of_study
    from mbdkit_studies.results.cost_at_error import at_equal_work as at_equal_work, work_for as work_for
    from mbdkit_studies.results.point_selection import (
        family as family, IN_TOLERANCES as IN_TOLERANCES, METHOD as METHOD, MODEL as MODEL, OPERATIONS as OPERATIONS,
        Points as Points, STEP as STEP, value as value,
    )
    from mbdkit_studies.spec.method_claims import claims_of as claims_of
    from mbdkit_studies.spec.study_loading import base_document as base_document, document_of as document_of
    from mbdkit_studies.spec.study_spec import Overrides as Overrides
    from mbdkit_studies.store.storage import storage_in as storage_in
    from mbdkit_studies.store.study_point import StudyPoint as StudyPoint
    from mbdkit_studies.study import Study as Study
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
