"""Sources of uncertainty: independent scalars, each with its distribution and with what it changes.

A scalar changes one or several places of a problem, such as ``("masses", "thigh")``; see
`mbdkit_biomech.uncertainty.changed_problem`. Changes of several scalars in a place are added. Shares are changes of
logarithms, so that factors are log-normal.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal, TypeAlias

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.text import did_you_mean
from mbdkit_biomech.persons.calibration import require_known
from mbdkit_biomech.uncertainty.cocontraction import PHASES, shared_activations
from mbdkit_biomech.uncertainty.uncertainty_section import Uncertainty

#: `mbdkit_biomech.inverse_dynamics.compute.InverseProblem`, whose module imports this one.
InverseProblem: TypeAlias = Any

#: What is changed: the key of `uncertainty`, the element, and the axis or the body if there are several.
Place: TypeAlias = tuple[str, ...]

Kind: TypeAlias = Literal["person", "muscles", "devices"]

#: Values of keys that are left out with `subject`; the page `persons` of the guide gives the source of each.
DEFAULTS: Mapping[str, Any] = {
    "masses": {"trunk": 0.1, "thigh": 0.2, "shank": 0.1, "foot": 0.3},
    "inertias": {"trunk": 0.2, "thigh": 0.2, "shank": 0.3, "foot": 0.6}, "pressure": 0.005, "plate_gain": 0.01,
    "max_force": 0.2, "optimal_length": 0.05, "tendon_length": 0.02, "muscle_points": 0.005, "muscle_delay": 0.02,
    "exponent": (2.0, 4.0), "minimum": (0.01, 0.05), "extensor_arm": 1.0, "cocontraction": (0.15, 0.08),
}  # fmt: skip

TRUNK_ZERO = 0.05  #: Standard deviation of the zero of the angle of a trunk without static trial [rad].

#: Number of values of a scalar that is distributed uniformly over a range: the middles of as many parts.
LEVELS = 4

WORDS = {
    "masses": "mass of the {}",
    "inertias": "inertia of the {}",
    "lengths": "lengths of the {}",
    "max_force": "strength of {}",
    "optimal_length": "fibre length of {}",
    "tendon_length": "tendon length of {}",
    "pressure": "pressure point of {}",
    "plate_gain": "gain of {}",
}

#: What reduces the uncertainty of a source, by the first word of its name.
ADVICE = {
    "centre": "measure medial and lateral landmarks of the joint, or calibrate its centre by a motion",
    "mass": "measure the segments, or use a scan",
    "inertia": "measure the segments, or use a scan",
    "lengths": "measure the segments",
    "strength": "measure the strength of the joint or the volume of the muscle",
    "fibre": "measure the fibres, for example by ultrasound",
    "tendon": "measure the tendon, for example by ultrasound",
    "extensor": "measure the lever arm, for example in images",
    "co-contraction": "compare activations with EMG",
    "points": "take the attachments from images",
    "timing": "compare activations with EMG",
    "pressure": "calibrate the positions of the plates",
    "gain": "calibrate the plates",
    "zero": "record a static trial",
    "offset": "synchronise plates and markers",
    "exponent": "compare activations with EMG",
    "least": "compare activations with EMG",
    "misfit": "measure where the device is on the limbs, for example with markers",
    "tissue": "measure the stiffness under the cuffs",
    "place": "measure medial and lateral landmarks of the knee",
    "EMG": "measure maximal contractions",
}


@dataclass(frozen=True)
class UncertainScalar:
    """A scalar that is not known exactly."""

    group: str  #: Name of the source in tables, which several scalars may share.
    kind: Kind  #: ``person``, ``muscles`` or ``devices``.
    moves: Mapping[Place, float]  #: Changes of places for a change of the scalar by 1.
    #: None if the scalar is normal with the standard deviation 1; otherwise it is uniform between these two.
    span: tuple[float, float] | None = None

    @property
    def levels(self) -> np.ndarray:
        """(L,) values of a scalar in a range."""
        assert self.span is not None
        low, high = self.span
        return np.asarray(low + (high - low) * (np.arange(LEVELS) + 0.5) / LEVELS)

    @property
    def nodes(self) -> list[tuple[float, float]]:
        """Values and weights of a quadrature of a function of this scalar whose value at 0 is known.

        For a normal scalar, these are the outer nodes of the Gauss-Hermite rule of three nodes; the inner one is 0.
        """
        if self.span is None:
            return [(-np.sqrt(3.0), 1 / 6), (np.sqrt(3.0), 1 / 6)]
        return [(float(value), 1 / LEVELS) for value in self.levels]


def asked_uncertainty(problem: InverseProblem) -> Uncertainty | None:
    """Return the uncertainty of a problem; None if there is none."""
    spec = problem.source
    if spec.uncertainty == "none" or (spec.uncertainty is None and spec.subject is None and spec.follows is None):
        return None
    return spec.uncertainty or Uncertainty()


def sources_of(problem: InverseProblem) -> list[UncertainScalar]:
    """Return the sources of uncertainty of a problem; empty if it has none. Raise SpecError if the spec states the
    uncertainty of something that it does not have.
    """
    asked = asked_uncertainty(problem)
    return [] if asked is None else [*_Sources(problem, asked).all()]


def change_of(sources: Sequence[UncertainScalar], values: np.ndarray) -> dict[Place, float]:
    """Return the changes of places for values (K,) of the scalars."""
    results: dict[Place, float] = {}
    for source, value in zip(sources, values.tolist(), strict=True):
        for place, size in source.moves.items():
            results[place] = results.get(place, 0.0) + value * size
    return results


class _Sources:
    """Builds the sources of a problem."""

    def __init__(self, problem: InverseProblem, asked: Uncertainty):
        self.problem, self.asked = problem, asked
        self.person = problem.source.person

    def all(self) -> Iterator[UncertainScalar]:
        yield from self._centers()
        segments = dict.fromkeys(segment_of(name, self.person) for name in self.problem.names.mechanism.bodies)
        for key in ("lengths", "masses", "inertias"):
            size = self._size(key)
            sizes = size if isinstance(size, dict) else dict.fromkeys(segments, size)
            require_known(sizes, segments, f"uncertainty.{key}", "segment")
            yield from (self._scalar(key, segment, size) for segment, size in sizes.items() if size)
        yield from self._of_loads()
        yield from self._angles()
        if self.person is not None and self.person.plates.offset is not None and self.person.plates.loads:
            yield UncertainScalar(
                "offset in time of the plates", "person", {("offset",): self.person.plates.offset.deviation}
            )
        yield from self._of_muscles()
        yield from self._of_followers()

    def _size(self, key: str) -> Any:
        """Return the value of a key: that of the spec, or the default of a person."""
        given = getattr(self.asked, key)
        if isinstance(given, dict) and self.person is not None:
            return DEFAULTS[key] | given
        return given if given is not None or self.person is None else DEFAULTS.get(key)

    def _scalar(self, key: str, element: str, size: float, kind: Kind = "person") -> UncertainScalar:
        return UncertainScalar(WORDS[key].format(element.replace("_", " ")), kind, {(key, element): size})

    def _require(self, key: str, reason: str) -> None:
        """Raise SpecError if the spec itself has a key that needs something else."""
        if getattr(self.asked, key):
            raise SpecError(reason, key=f"uncertainty.{key}")

    def _centers(self) -> Iterator[UncertainScalar]:
        if self.person is None:
            self._require("centers", "needs `subject`: only a person from markers has joint centres that are measured")
            return
        centers = self.asked.centers
        sizes = centers if isinstance(centers, dict) else dict.fromkeys(self.person.centers, centers)
        require_known(sizes, self.person.centers, "uncertainty.centers")
        alike: dict[tuple[str, bool], dict[Place, float]] = {}
        for joint, center in self.person.centers.items():
            size = sizes.get(joint)
            (xx, xy), (_, yy) = (center.covariance[:2, :2] if size is None else size * size * np.eye(2)).tolist()
            first = np.sqrt(xx)
            shared = xy / first if first > 0 else 0.0
            name = "hip" if joint.startswith("hip") else joint  # both hips are wrong alike: they share a pelvis
            for x, y in ((first, shared), (0.0, np.sqrt(max(0.0, yy - shared * shared)))):
                if x or y:
                    own = alike.setdefault((name, bool(x)), {})
                    own |= {("centers", joint, "x"): x, ("centers", joint, "y"): y}
        for (name, _), moves in alike.items():
            yield UncertainScalar(f"centre of the {name.replace('_', ' ')}", "person", moves)

    def _of_loads(self) -> Iterator[UncertainScalar]:
        loads = self.problem.loads
        pressed = [name for name, load in loads.items() if load.point is not None and load.frame < 0]
        forced = [name for name, load in loads.items() if np.any(load.force != 0)]
        for key, names, what in (("pressure", pressed, "point in the global frame"), ("plate_gain", forced, "force")):
            if not names:
                self._require(key, f"needs a load with a {what}, but `loads` has none")
            elif size := self._size(key):
                yield from (self._scalar(key, name, size) for name in names)

    def _angles(self) -> Iterator[UncertainScalar]:
        size, measured = self.asked.angles, self.problem.measured
        angles = [name for name, one in zip(measured.names, measured.quantities.is_angle, strict=True) if one]
        if not angles:
            self._require("angles", "needs an observed angle, but the motion has none")
        for name in angles:
            zero = self.person.zeros[name.split(".")[1]] if size is None and self.person is not None else size
            if zero:
                zero = TRUNK_ZERO if np.isnan(zero) else zero
                yield UncertainScalar(f"zero of {name}", "person", {("angles", name): zero})

    def _of_muscles(self) -> Iterator[UncertainScalar]:
        recruiter = self.problem.recruiter
        keys = (
            *("max_force", "optimal_length", "tendon_length", "muscle_points", "muscle_delay", "exponent", "minimum"),
            *("extensor_arm", "cocontraction"),
        )
        if recruiter is None:
            for key in keys:
                self._require(key, "needs `recruitment`: without it, muscles exert no force")
            return
        if size := self._size("max_force"):
            moves: dict[Place, float] = {("max_force", name): size for name in recruiter.muscles}
            yield UncertainScalar("strength of all muscles", "muscles", moves)
        for key in keys[:3]:
            if size := self._size(key):
                yield from (self._scalar(key, name, size, "muscles") for name in recruiter.muscles)
        names = list(recruiter.muscles)
        for knee in recruiter.targets.knees:
            group, moved = f"place across of the {knee.joint.replace('_', ' ')}", ("across", knee.joint)
            yield UncertainScalar(group, "person", {moved: knee.deviation})
        for channel in recruiter.targets.emg:
            name = names[channel.muscle]
            yield UncertainScalar(f"EMG of {name.replace('_', ' ')}", "muscles", {("emg", name): channel.deviation})
        if size := self._size("muscle_points"):
            for name, muscle in recruiter.muscles.items():
                group = f"points of {name.replace('_', ' ')}"
                for place in product(["muscle_points"], [name], dict.fromkeys(item.on for item in muscle.path), "xy"):
                    yield UncertainScalar(group, "muscles", {place: size})
        for joint in dict.fromkeys(one.joint for one in recruiter.patellas.values()):
            if size := self._size("extensor_arm"):
                name = f"extensor arm of the {joint.replace('_', ' ')}"
                yield UncertainScalar(name, "muscles", {("extensor_arm", joint): size})
        largest = dict(zip(PHASES, self._size("cocontraction") or (0.0, 0.0), strict=True))
        for knee, phase, _ in shared_activations(self.problem):
            if size := largest[phase]:
                name = f"co-contraction at the {knee.replace('_', ' ')}, {phase}"
                yield UncertainScalar(name, "muscles", {("cocontraction", knee, phase): 1.0}, (0.0, size))
        if size := self._size("muscle_delay"):
            yield UncertainScalar("timing of muscles", "muscles", {("muscle_delay",): size})
        for key, name, value in (
            ("exponent", "exponent of recruitment", recruiter.exponent),
            ("minimum", "least activation", recruiter.asked.minimum),
        ):
            own = self._size(key)
            if own is None or (getattr(self.asked, key) is None and not own[0] <= value <= own[1]):
                continue
            if not np.isfinite(value) or (key == "exponent" and value < 2):
                raise SpecError(f"needs `recruitment.exponent` of 2 or more, not {recruiter.asked.exponent}",
                                key=f"uncertainty.{key}")  # fmt: skip
            if own[0] < own[1] or own[0] != value:
                yield UncertainScalar(name, "muscles", {(key,): 1.0}, (own[0] - value, own[1] - value))

    def _of_followers(self) -> Iterator[UncertainScalar]:
        followers, devices = self.problem.followers, self.asked.devices or {}
        known = dict.fromkeys(number for follower in followers.values() for number in follower.deviations)
        for number in devices:
            if number not in known:
                what = f"there is no uncertain number '{number}'{did_you_mean(number, known)}"
                raise SpecError(what if known else "needs `follows: dynamics`", key=f"uncertainty.devices.{number}")
        for name, follower in followers.items():
            for number, size in (follower.deviations | devices).items():
                if size:
                    place = ("followers", name, number)
                    yield UncertainScalar(f"{number.replace('_', ' ')} of {name}", "devices", {place: size})


def segment_of(body: str, person: object) -> str:
    """Return the name of a segment; those of both legs of a person follow from the same tables."""
    return body if person is None else body.removesuffix("_left")
