"""Specs of runs: reading from YAML, TOML, JSON, a dict or a Mechanism, and strict validation."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    from mbdkit.spec.loading import example_names as example_names
    from mbdkit.spec.loading import example_text as example_text
    from mbdkit.spec.loading import load_spec as load_spec
    from mbdkit.spec.run_spec import RunSpec as RunSpec
    from mbdkit.spec.sections import Limits as Limits
    from mbdkit.spec.sections import Output as Output
    from mbdkit.spec.sections import Time as Time
else:
    __getattr__, __dir__ = door(globals())
