"""Sources of uncertainty: independent scalars, each with its distribution and with what it changes.

A scalar changes one or several places of a problem, such as ``("masses", "thigh")``; see
`mbdkit_biomech.uncertainty.changed_problem`. Changes of several scalars in a place are added. Shares are changes of
logarithms, so that factors are log-normal.

Muscles on both sides of a knee that act together are a source, because recruitment leaves them out. Persons differ:
some of nine patients with instrumented knees had up to one body weight more force in late stance than others (A.
Trepczynski et al., J. Neuroeng. Rehabil. 15 (2018) 101). One half of the persons has none here (an assumption); in the
other half, extensors and flexors have a larger least activation than recruitment needs, at two times of the stance:

- from the end of the swing to the loading response, both groups act in all strides of 14 persons (Dynamic knee muscle
  co-contraction quantified during walking, IEEE 2016), with mean peaks of 5 to 15 % of a maximal contraction at heel
  strike (M. O. Ericson, R. Nisell and J. Ekholm, Scand. J. Rehabil. Med. 18 (1986) 159-163);
- from midstance to the end of the stance, in a third of the strides (PubMed 26198265, 30 persons); that they then are
  half as active is an assumption.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
import yaml

from mbdkit.base.errors import SpecError
from mbdkit.base.text import did_you_mean
from mbdkit_biomech.persons.calibration import require_known
from mbdkit_biomech.persons.landmarks import LEFT
from mbdkit_biomech.persons.person_sections import Uncertainty
from mbdkit_biomech.persons.scaled_model import moves_knee, replaced_legs
from mbdkit_biomech.persons.strength import REPLACED_DEVIATION, UNKNOWN_AGE

#: `mbdkit_biomech.inverse_dynamics.compute.InverseProblem`, whose module imports this one.
InverseProblem: TypeAlias = Any

#: What is changed: the key of `uncertainty`, the element, and the axis or the body if there are several.
Place: TypeAlias = tuple[str, ...]

Kind: TypeAlias = Literal["person", "muscles", "devices"]

_TABLES = yaml.safe_load(Path(__file__).with_name("sources.yaml").read_text("utf-8"))
DEFAULTS: Mapping[str, Any] = _TABLES["defaults"]
WORDS: Mapping[str, str] = _TABLES["words"]
ADVICE: Mapping[str, str] = _TABLES["advice"]

TRUNK_ZERO = 0.05  #: Standard deviation of the zero of the angle of a trunk without static trial [rad].

#: Number of values of a scalar that is distributed uniformly over a range: the middles of as many parts.
LEVELS = 4


@dataclass(frozen=True)
class UncertainScalar:
    """A scalar that is not known exactly."""

    group: str  #: Name of the source in tables, which several scalars may share.
    kind: Kind  #: ``person``, ``muscles`` or ``devices``.
    moves: Mapping[Place, float]  #: Changes of places for a change of the scalar by 1.
    #: None if the scalar is normal with the standard deviation 1; otherwise it is uniform between these two, with this
    #: probability, or otherwise 0.
    span: tuple[float, float] | None = None
    share: float = 1.0

    @property
    def levels(self) -> np.ndarray:
        """(L,) values of a scalar in a range."""
        assert self.span is not None
        low, high = self.span
        places = (np.arange(LEVELS) + 0.5) / LEVELS  # those below 1 - share stand for 0
        inside = (places - 1.0 + self.share) / self.share
        return np.where(inside > 0, low + (high - low) * inside, 0.0)

    @property
    def nodes(self) -> list[tuple[float, float]]:
        """Values and weights of a quadrature of a function of this scalar whose value at 0 is known.

        For a normal scalar, these are the outer nodes of the Gauss-Hermite rule of three nodes; the inner one is 0.
        """
        if self.span is None:
            return [(-np.sqrt(3.0), 1 / 6), (np.sqrt(3.0), 1 / 6)]
        return [(float(value), 1 / LEVELS) for value in self.levels]


def _scalar(
    size: float, *place: str, kind: Kind = "person", span: tuple[float, float] | None = None, share: float = 1.0
) -> UncertainScalar:
    """Return the scalar that changes a place by a size, named by the words of its key."""
    key, *elements = place
    group = WORDS[key].format(*(element.replace("_", " ") for element in elements))
    return UncertainScalar(group, kind, {place: size}, span, share)


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
            yield from (_scalar(size, key, segment) for segment, size in sizes.items() if size)
        yield from self._of_loads()
        yield from self._angles()
        if self.person is not None and self.person.plates.offset is not None and self.person.plates.loads:
            yield _scalar(self.person.plates.offset.deviation, "offset")
        yield from self._of_muscles()
        yield from self._of_followers()

    def _size(self, key: str) -> Any:
        """Return the value of a key: that of the spec, or the default of a person."""
        given = getattr(self.asked, key)
        if isinstance(given, dict) and self.person is not None:
            return DEFAULTS[key] | given
        return given if given is not None or self.person is None else DEFAULTS.get(key)

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
                yield from (_scalar(size, key, name) for name in names)

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
            subject = self.problem.source.subject
            known = subject is None or subject.age is not None or self.asked.max_force is not None
            groups = {"strength of all muscles": (recruiter.muscles, size if known else np.hypot(size, UNKNOWN_AGE[1]))}
            for leg in [] if subject is None else replaced_legs(self.problem.source, subject):
                own = [name for name, muscle in recruiter.muscles.items() if moves_knee(muscle, leg)]
                groups[f"strength after replacement of knee{leg}".replace("_", " ")] = own, REPLACED_DEVIATION
            for group, (names, deviation) in groups.items():
                yield UncertainScalar(group, "muscles", {("max_force", name): float(deviation) for name in names})
        for key in keys[:3]:
            if size := self._size(key):
                yield from (_scalar(size, key, name, kind="muscles") for name in recruiter.muscles)
        names = list(recruiter.muscles)
        yield from (_scalar(knee.deviation, "across", knee.joint) for knee in recruiter.targets.knees)
        for channel in recruiter.targets.emg:
            yield _scalar(channel.deviation, "emg", names[channel.muscle], kind="muscles")
        if size := self._size("muscle_points"):
            for name, muscle in recruiter.muscles.items():
                for body, axis in product(dict.fromkeys(item.on for item in muscle.path), "xy"):
                    yield _scalar(size, "muscle_points", name, body, axis, kind="muscles")
        for joint in dict.fromkeys(one.joint for one in recruiter.patellas.values()):
            if size := self._size("extensor_arm"):
                yield _scalar(size, "extensor_arm", joint, kind="muscles")
        largest = dict(zip(PHASES, self._size("cocontraction") or (0.0, 0.0), strict=True))
        for knee, phase, _ in shared_activations(self.problem):
            if size := largest[phase]:
                yield _scalar(1.0, "cocontraction", knee, phase, kind="muscles", span=(0.0, size), share=0.5)
        if size := self._size("muscle_delay"):
            yield _scalar(size, "muscle_delay", kind="muscles")
        for key, value in (("exponent", recruiter.exponent), ("minimum", recruiter.asked.minimum)):
            own = self._size(key)
            if own is None or (getattr(self.asked, key) is None and not own[0] <= value <= own[1]):
                continue
            if not np.isfinite(value) or (key == "exponent" and value < 2):
                raise SpecError(f"needs `recruitment.exponent` of 2 or more, not {recruiter.asked.exponent}",
                                key=f"uncertainty.{key}")  # fmt: skip
            if own[0] < own[1] or own[0] != value:
                yield _scalar(1.0, key, kind="muscles", span=(own[0] - value, own[1] - value))

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


#: Shares of the stance between which the activation rises from 0 and falls to 0 again, by phase.
PHASES = {"loading": ((-0.15, -0.05, 0.15, 0.35), (0.0, 1.0, 1.0, 0.0)),
          "late stance": ((0.25, 0.4, 0.8, 1.0), (0.0, 1.0, 1.0, 0.0))}  # fmt: skip

CONTACT = 20.0  #: Force of the ground from which a foot stands [N].

USUAL = 0.65  #: Duration of a stance of which both ends are cut [s].


def stance_shares(time: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Return the shares (T,) of the stance that have passed: from 0 to 1 in a stance, and continued to both sides of
    it; of several stances, that of the nearest one.

    Parameters
    ----------
    force
        (T,) magnitude of the force of the ground.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], force > CONTACT, [False]]))).reshape(-1, 2).tolist()
    spans = [[time[first], time[end - 1], first > 0, end < len(time)] for first, end in edges]
    usual = max((end - first for first, end, *whole in spans if all(whole)), default=USUAL)
    found = np.full(len(time), np.inf)
    for first, end, has_start, has_end in spans:
        first = first if has_start else end - max(usual, end - first)
        end = end if has_end else first + max(usual, end - first)
        share = (time - first) / (end - first)
        found = np.where(np.abs(share - 0.5) < np.abs(found - 0.5), share, found)
    return found


def shared_activations(problem: InverseProblem) -> Iterator[tuple[str, str, np.ndarray]]:
    """Yield knee, phase, and the shares (T, M) of the largest common activation that the muscles then have, for knees
    of legs whose foot has a load, and whose muscles are on both sides.
    """
    muscles, time = problem.recruiter.muscles, problem.measured.time
    names = [*problem.names.mechanism.bodies]
    for leg in ("", LEFT):
        loads = [one for one in problem.loads.values() if names[one.body] == f"foot{leg}"]
        bodies = [{item.on for item in muscle.path} for muscle in muscles.values()]
        extends = np.array([m.patella is not None and m.patella.joint == f"knee{leg}" for m in muscles.values()])
        bends = np.array([{f"shank{leg}"} < on and f"foot{leg}" not in on for on in bodies]) & ~extends
        if not loads or not extends.any() or not bends.any():
            continue
        share = stance_shares(time, np.linalg.norm(sum(one.at(time, one.force) for one in loads), axis=1))
        for phase, (at, values) in PHASES.items():
            yield f"knee{leg}", phase, np.interp(share, at, values)[:, None] * (extends | bends)
