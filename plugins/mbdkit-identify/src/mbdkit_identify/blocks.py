"""Intervals from blocks of the data, which hold for residuals with any correlation within blocks.

The jackknife leaves out one block of successive residuals after another, to first order; see H. R. Kuensch, Annals of
Statistics 17 (1989) 1217-1241. Its degrees of freedom are those of R. M. Bell, D. F. McCaffrey, Survey Methodology 28
(2002) 169-181.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from mbdkit_identify.estimation import Fit
from mbdkit_identify.intervals import freedom_of, quantile
from mbdkit_identify.misfit import whiteness
from mbdkit_identify.noise import solve
from mbdkit_identify.problem import Problem

#: Number of blocks; with fewer, intervals are wide, and with more, correlation reaches over their ends.
BLOCKS = 7
LEAST = 8  #: Smallest number of residuals in a block.
CHANCE = 0.05  #: Probability with which tests of white residuals prefer blocks to the model of the noise.


def growth_by_blocks(problem: Problem, fit: Fit, level: float) -> np.ndarray:
    """Return the factors (n,) by which the intervals of parameters at a `level` grow if they follow from blocks.

    A factor is 1 for initial values, and if the whitened residuals are white and the blocks vary no more than noise
    explains, or if blocks vary less; all are 1 for a few residuals and for robust losses.
    """
    growth, count = np.ones(len(fit.x)), len(problem.measured)
    if count < LEAST * BLOCKS or fit.loss != "linear":
        return growth
    signals = list(zip(problem.pieces, problem.noises, problem.signals, strict=True))
    tests = [whiteness(fit.white[piece.places], int(noise.correlation != 0.0))[1] for piece, noise, _ in signals]
    names, experiments = [key.experiment for key in problem.signals], np.zeros(count)
    for piece, _, key in signals:
        experiments[piece.places] = names.index(key.experiment)
    jacobian, blocks = (
        np.where(fit.free, fit.jacobian, 0.0),
        np.array_split(np.lexsort((problem.times, experiments)), BLOCKS),
    )
    parts = [jacobian[some] for some in blocks]
    scores = [part.T @ fit.white[some] for part, some in zip(parts, blocks, strict=True)]
    normals, whole, unit = [part.T @ part for part in parts], jacobian.T @ jacobian, np.eye(len(growth))
    inverse, without = solve(whole, unit), np.array([solve(whole - normal, unit) for normal in normals])
    is_parameter = np.array([not one.is_initial for one in problem.unknowns])
    for place in np.flatnonzero(is_parameter & fit.free & (np.diagonal(inverse) > 0.0)):
        rows = without[:, place]
        along = np.array([row @ normal for row, normal in zip(rows, normals, strict=True)])
        form = np.diag(np.sum(along * rows, axis=1)) - along @ inverse @ along.T  # of white residuals
        freedom = max(float(np.trace(form) ** 2 / np.sum(form**2)), 1.0)
        ratio = float(np.sum(np.sum(rows * scores, axis=1) ** 2) / np.trace(form))  # 1 on average for white residuals
        if ratio > (1.0 if min(tests) < CHANCE / len(tests) else chi2.isf(CHANCE, freedom) / freedom):
            usual = quantile(level, freedom_of(problem, fit, unit[place]))
            growth[place] = float(np.sqrt(ratio)) * quantile(level, freedom) / usual
    return np.maximum(growth, 1.0)
