"""The door of report: each of its names is what it says, whichever modules were imported before."""

from __future__ import annotations

import types
from pathlib import Path

import mbdkit_report


def test_no_name_of_the_door_is_that_of_a_module() -> None:
    modules = {path.stem for path in Path(mbdkit_report.__file__).parent.iterdir()}
    assert not modules & set(mbdkit_report.__all__)
    assert not [name for name in dir(mbdkit_report) if isinstance(getattr(mbdkit_report, name), types.ModuleType)]
