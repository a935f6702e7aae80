"""What a run is told: the run spec, read from YAML, TOML, JSON, a dict or a Mechanism, and checked to the last key."""

from mbdkit.spec.loading import example_names, example_text, load_spec
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.sections import Limits, Output, Time

__all__ = ["Limits", "Output", "RunSpec", "Time", "example_names", "example_text", "load_spec"]
