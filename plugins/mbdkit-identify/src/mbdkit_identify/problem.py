"""An identification as a problem of least squares: residuals of all signals, whitened by their noise, and priors."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mbdkit.plugin import MbdkitError
from mbdkit_identify.measured_data import SignalData
from mbdkit_identify.noise import LEAST_DEVIATION, Likelihood, Noise, Pieces
from mbdkit_identify.segments import KinematicSegment, Segment, Unknown

FAILED = 1e3  #: Whitened residuals of runs that fail, so large that no search ends there.
#: Changes of unknowns, as shares of their magnitudes, that are too small to compute derivatives again.
SAME = 1e-9
MOST_HALVINGS = 60  #: Number of halvings by which the edge beyond which runs fail is located.
KEPT = 3  #: Number of points at which derivatives are kept.


class SignalKey(NamedTuple):
    """A signal: experiment and quantity."""

    experiment: str
    quantity: str


class Problem:
    """Residuals of the windows of some experiments, as functions of the unknowns.

    Parameters
    ----------
    unknowns
        All n unknowns.
    names
        Places of those that are parameters, by name.
    segments
        The windows.

    Attributes
    ----------
    measured
        (R,) measured values of all signals, without gaps.
    times
        (R,) their times [s].
    signals, data
        The S signals, and the data of each in its first window.
    pieces
        Samples of each signal among the residuals.
    noises
        Present noise of each signal.
    valid
        (S, T) of each window: whether a value was measured.
    first, sizes
        First values (n,) and magnitudes (n,) of the unknowns.
    bounds
        Lower and upper bounds (n,) of the unknowns.
    edges
        Sentences on the bounds beyond which runs fail, by place of the unknown.
    runs, derived
        Numbers of runs, and of runs with derivatives.
    """

    def __init__(self, unknowns: Sequence[Unknown], names: dict[str, int], segments: Sequence[Segment]):
        self.unknowns, self.names, self.segments = list(unknowns), names, list(segments)
        self.first, self.sizes, low, high = (
            np.array([getattr(unknown, name) for unknown in self.unknowns]) for name in ("start", "size", "low", "high")
        )
        self.bounds = low, high
        self.edges: dict[int, str] = {}
        self._priors = {place: one.prior for place, one in enumerate(self.unknowns) if one.prior is not None}
        self.runs = self.derived = 0
        self._values: dict[bytes, np.ndarray] = {}
        self._slopes: list[tuple[np.ndarray, np.ndarray]] = []  # the latest ones, last used at the end
        self._is_jacobian_next = True
        self._index()

    def _index(self) -> None:
        """Find the places of the samples of each signal."""
        keys: dict[SignalKey, list[tuple[np.ndarray, np.ndarray]]] = {}
        first: dict[SignalKey, SignalData] = {}
        measured, times, self.valid, count = [], [], [], 0
        for segment in self.segments:
            interval = float(np.median(np.diff(segment.time)))
            some = np.array([np.isfinite(signal.values) for signal in segment.signals])
            self.valid.append(some)
            for row, signal in enumerate(segment.signals):
                known = np.flatnonzero(some[row])
                gaps = np.concatenate([[0.0], np.diff(segment.time[known]) / interval])[: len(known)]
                gaps = np.where(np.abs(gaps - np.round(gaps)) < 0.05, np.round(gaps), gaps)
                key = SignalKey(segment.experiment, signal.quantity)
                keys.setdefault(key, []).append((count + np.arange(len(known)), gaps))
                first.setdefault(key, signal)
                measured.append(signal.values[known])
                times.append(segment.time[known])
                count += len(known)
        self.measured, self.times = np.concatenate(measured), np.concatenate(times)
        self.signals = tuple(keys)
        self.pieces = [Pieces(*map(np.concatenate, zip(*parts, strict=True))) for parts in keys.values()]
        self.data = list(first.values())
        self.known = [one.deviation for one in self.data]
        self.may_correlate = [one.may_correlate for one in self.data]
        self.measure(self.measured)

    def measure(self, values: np.ndarray) -> None:
        """Take (R,) measured values in place of those of the windows, and a first guess of their noise."""
        self.measured = values
        self.scales = [float(np.max(np.abs(values[piece.places]), initial=0.0)) or 1.0 for piece in self.pieces]
        noises = [
            Noise(known or max(_roughness(values[piece.places]), LEAST_DEVIATION * scale))
            for known, piece, scale in zip(self.known, self.pieces, self.scales, strict=True)
        ]
        self.noises = self.pooled(noises)

    def estimated_noises(self, residuals: np.ndarray, x: np.ndarray) -> list[Noise]:
        """Return the noise of the signals with these residuals (R,) for unknowns (n,), by restricted likelihood, one
        signal after another.
        """
        jacobian, found = self.slopes(x), list(self.noises)
        parts = [piece.normal(jacobian, noise) for piece, noise in zip(self.pieces, found, strict=True)]
        for s, piece in enumerate(self.pieces):
            others = self.information + sum(part for k, part in enumerate(parts) if k != s)
            own, least = (residuals[piece.places], jacobian[piece.places]), LEAST_DEVIATION * self.scales[s]
            likelihood = Likelihood(piece, *own, others, self.known[s], found[s].deviation, least)
            found[s] = likelihood.noise(may_correlate=self.may_correlate[s])
            parts[s] = piece.normal(jacobian, found[s])
        return self.pooled(found)

    def pooled(self, noises: Sequence[Noise]) -> list[Noise]:
        """Return the noise of the signals, with equal estimated deviations if the positions of all samples are unknown.

        The ratio of the deviations is then not determined: any of them might be zero.
        """
        some = [row for row, known in enumerate(self.known) if known is None]
        if not some or not any(isinstance(segment, KinematicSegment) for segment in self.segments):
            return list(noises)
        weights = [noises[row].freedom if np.isfinite(noises[row].freedom) else 1.0 for row in some]
        deviation = float(np.sqrt(np.average([noises[row].deviation ** 2 for row in some], weights=weights)))
        own = [replace(one, deviation=deviation) for one in noises]
        return [own[row] if known is None else noises[row] for row, known in enumerate(self.known)]

    @property
    def differences(self) -> str:
        """Why derivatives are differences; empty if they are exact."""
        return next((segment.prepared.differences for segment in self.segments if segment.prepared.differences), "")

    def predicted(self, x: np.ndarray) -> np.ndarray:
        """Return what the sensors show (R,) for unknowns (n,); nan where a run fails."""
        key = x.tobytes()
        if key not in self._values:
            parts = []
            for segment, some in zip(self.segments, self.valid, strict=True):
                self.runs += 1
                try:
                    shown, _ = segment.shown(segment.prepared.values(*segment.given(x)), None, x, self.names)
                    parts.append(shown[some])
                except MbdkitError:
                    parts.append(np.full(int(np.sum(some)), np.nan))
            self._values = {key: np.concatenate(parts)}
        return self._values[key]

    def fails(self, x: np.ndarray) -> bool:
        """Return whether a run fails for unknowns (n,)."""
        return not np.all(np.isfinite(self.predicted(x)))

    def bound_at_edge(self, x: np.ndarray, beyond: np.ndarray, more: float = np.inf) -> np.ndarray | None:
        """Bound the unknown that makes runs fail on the way from unknowns x (n,) to those `beyond` (n,), and return the
        last ones (n,) before.

        Return None if runs do not fail there, no single unknown is the reason, or the sum of squares grows by `more` on
        the way to the edge.
        """
        if self.fails(x) or not self.fails(beyond):
            return None
        inside, outside = x, beyond
        for _ in range(MOST_HALVINGS):
            middle = 0.5 * (inside + outside)
            inside, outside = (inside, middle) if self.fails(middle) else (middle, outside)
        growth = np.sum(self.residuals(inside) ** 2) - np.sum(self.residuals(x) ** 2)
        for place in np.flatnonzero(inside != outside).tolist() if growth <= more else ():
            if self.fails(np.where(np.arange(len(x)) == place, outside, inside)):
                unknown, value, is_low = self.unknowns[place], float(inside[place]), beyond[place] < x[place]
                told = value if abs(value) > SAME * self.sizes[place] else 0.0
                self.unknowns[place] = replace(unknown, low=value) if is_low else replace(unknown, high=value)
                self.bounds[0 if is_low else 1][place] = value
                self.edges[place] = f"runs fail if {unknown.name} is {'less' if is_low else 'more'} than {told:.6g}"
                return inside
        return None

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Return the derivatives (R, n) of `predicted`; raise an `MbdkitError` if a run fails."""
        known = next((one for one in self._slopes if np.all(np.abs(x - one[0]) <= SAME * self.sizes)), None)
        if known is None:
            parts, values = [], []
            for segment, some in zip(self.segments, self.valid, strict=True):
                self.derived += 1
                result = segment.prepared.at(*segment.given(x))
                shown, every = segment.shown(result.values, result.derivatives, x, self.names)
                assert every is not None
                parts.append(every[some])
                values.append(shown[some])
            known = x.copy(), np.concatenate(parts)
            self._values = {x.tobytes(): np.concatenate(values)}
        if np.all(np.isfinite(known[1])):  # those of a run that fails are not reused for its neighbours
            self._slopes = [*(one for one in self._slopes if one is not known), known][-KEPT:]
        return known[1]

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Return the whitened residuals (R + P,): prediction minus measurement in deviations, and P priors.

        Searches ask for derivatives next, at the same unknowns, unless they refuse a step. One run yields both, so that
        derivatives are computed at once as long as they were asked for the last time.
        """
        if self._is_jacobian_next and not self.differences:
            with suppress(MbdkitError):
                self.slopes(x)
        self._is_jacobian_next = False
        raw = self.predicted(x) - self.measured
        priors = [(x[place] - mean) / deviation for place, (mean, deviation) in self._priors.items()]
        white = np.concatenate([self.white(raw), priors])
        return np.asarray(np.nan_to_num(white, nan=FAILED, posinf=FAILED, neginf=-FAILED))

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Return the derivatives (R + P, n) of `residuals`."""
        self._is_jacobian_next = True
        rows = [np.eye(len(x))[place] / deviation for place, (_, deviation) in self._priors.items()]
        try:
            slopes = self.white(self.slopes(x))
        except MbdkitError:
            slopes = np.zeros((len(self.measured), len(x)))
        slopes = np.nan_to_num(slopes, copy=False)
        return np.concatenate([slopes, rows]) if rows else slopes

    @property
    def information(self) -> np.ndarray:
        """(n, n) what the priors know."""
        return np.diag([0.0 if unknown.prior is None else unknown.prior[1] ** -2 for unknown in self.unknowns])

    def white(self, raw: np.ndarray) -> np.ndarray:
        """Return residuals (R,), or their derivatives (R, n), whitened by the noise of their signals."""
        values = np.empty_like(raw)
        for piece, noise in zip(self.pieces, self.noises, strict=True):
            values[piece.places] = piece.white(raw, noise)
        return values

    def log_likelihood(self, white: np.ndarray) -> float:
        """Return the logarithm of the likelihood of the data for whitened residuals (R,)."""
        logs = sum(piece.log_deviations(noise) for piece, noise in zip(self.pieces, self.noises, strict=True))
        return float(-0.5 * white @ white - logs - 0.5 * len(white) * np.log(2.0 * np.pi))


def _roughness(values: np.ndarray) -> float:
    """Return a first guess of the deviation of noise, from second differences."""
    return float(np.std(np.diff(values, 2)) / np.sqrt(6.0)) if len(values) >= 4 else 0.0
