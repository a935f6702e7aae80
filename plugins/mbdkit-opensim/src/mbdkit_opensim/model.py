"""The model `opensim`: its options, and the mechanism of the file."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from pydantic import BaseModel, ConfigDict, Field

import mbdkit
from mbdkit.plugin.seams import model_builder
from mbdkit_opensim.building import build_mechanism

REFERENCES = tuple(Path(__file__).with_name("references.bib").read_text("utf-8").strip().split("\n\n"))


class OpenSimOptions(BaseModel):
    """Path of the file, initial values and speeds, and whether muscles are read."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", use_attribute_docstrings=True)

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("muscles",)

    file: str = Field(examples=[str(Path(__file__).with_name("example.osim"))])
    """Path of the `.osim` file, in the format of OpenSim 4; relative to the current folder."""
    initial: dict[str, float] = Field(default_factory=dict)
    """Initial values of coordinates by name [rad or m]; by default, those in the file."""
    speeds: dict[str, float] = Field(default_factory=dict)
    """Initial speeds of coordinates by name [rad/s or m/s]; by default, those in the file."""
    muscles: bool = False
    """Whether muscles are read, for inverse dynamics with `recruitment`; otherwise, they are ignored."""


@model_builder
def build(options: OpenSimOptions) -> mbdkit.Mechanism:
    """Return the mechanism of the file. Its bodies, joints, markers and coordinates have their names in the file."""
    return build_mechanism(options.file, options.initial, options.speeds, muscles=options.muscles)
