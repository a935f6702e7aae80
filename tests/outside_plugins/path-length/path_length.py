"""A measure: the length of the path of the centre of mass of a body."""

import numpy as np
from pydantic import BaseModel, Field

import mbdkit


class Options(BaseModel):
    body: str = Field("", description="Name of the body; the first body of the model if left out.")


def length(run: mbdkit.Run, options: Options) -> float:
    way = np.diff(run[options.body or next(iter(run.bodies))].position[:, :2], axis=0)
    return float(np.hypot(*way.T).sum())


@mbdkit.hookimpl
def mbdkit_measures():
    return [mbdkit.MeasurePlugin("path-length", "Length of the path of a body.", Options, "m", length)]
