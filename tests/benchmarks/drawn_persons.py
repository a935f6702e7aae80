"""`python -m tests.benchmarks persons --count N [--doubled]`: do error bars of persons from markers contain the truth?

Persons are drawn around one who walks with known joints (`person_markers`) from the distributions that the guide page
`persons` states: markers with artefacts of the skin, one by one, all of a segment together, and in step with joints,
hips beside the place of the regression, landmarks of knees and ankles beside the centres, plates with an offset in
time, wrong gains and wrong points, an unknown zero of the trunk, and masses, muscles, their timing and recruitment
unlike those of the model. Extensors and flexors of the knee act together around the beginning of the stance and in its
second half, and the lever arm of the quadriceps is that of another person. The force of the ground acts `MEDIAL` beside
the knees, whose compartments cannot pull. The forces of the right leg of the drawn person, computed from its own
motion, are the truth. The generic model, the markers and the plates are what mbdkit gets. The draws do not use its own
ones.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stderr
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any, Protocol

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import spearmanr

import mbdkit
from mbdkit import Run
from mbdkit.base.errors import MbdkitError
from mbdkit_biomech.inverse_dynamics.compute import InverseProblem, compute
from mbdkit_biomech.inverse_dynamics.muscles.soft_targets import Compartments
from mbdkit_biomech.inverse_dynamics.results.record import run_of
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec, load_inverse_spec
from mbdkit_biomech.persons.plate_contacts import later
from mbdkit_biomech.persons.strength import UNKNOWN_AGE

from .person_markers import CLUSTERS, SHANK, THIGH, Array, Walker, columns_of

SUBJECT = {"mass": 75, "height": 1.8, "sex": "male"}
HIP, LANDMARK, PRESSURE, POINTS = 0.01, 0.007, 0.005, 0.005
"""Standard deviations: hips, landmarks, points of application and points of muscles, along each axis [m]."""
MEDIAL, COMPARTMENTS, HARD = 0.03, 0.046, 0.001
"""Distances of the ground's force from the knee and of its compartments, and the deviation of this bound of nature [m].
"""
TOGETHER = {"thigh": (0.002, 0.02), "shank": (0.002, 0.015)}
"""Standard deviations of the motion of all markers of a segment together: along and about each axis [m, rad]. They are
a third of those that fluoroscopy shows, with which markers of thigh and shank move apart at the knee as in measured
walking, by 10 mm; the rest is in step with the joint."""
CUTOFF = 6.0
"""Cutoff of the motion and of the loads of the person, and of the smoothing of the data [Hz]. The source of the motion
has no impact at heel strike; loads that have it would contradict Newton's law."""
GAIN, STRENGTH, FIBER, TENDON = 0.01, 0.2, 0.05, 0.02
"""Standard deviations of logarithms; `STRENGTH` is that of a common factor and that of one for each muscle."""
AGES, LOSS = (20.0, 80.0), 0.093
"""Ages, and the loss of strength in a decade, as a share of that of the young: knees of women (S. K. Hunter, M. W.
Thompson and R. D. Adams, J. Gerontol. A 55 (2000) B264-B273). The bars follow another source."""
MASS = {"trunk": 0.1, "thigh": 0.2, "shank": 0.1, "foot": 0.3}
INERTIA = {"trunk": 0.2, "thigh": 0.2, "shank": 0.3, "foot": 0.6}
"""Standard deviations of the logarithms of masses, and of moments of inertia at these masses."""
DELAY = 0.02
"""Standard deviation of the time by which the forces of all muscles are late [s]."""
TRUNK_ZERO, FOOT_ZERO = 0.05, 0.06
"""Standard deviations of the zeros of the angles of trunk and foot [rad]; the second is found for the flat foot."""
EXPONENT, MINIMUM = (2.0, 4.0), (0.01, 0.05)
"""Ranges of the exponent of recruitment and the least activation."""
TOGETHER_ACTIVE = {0.15: ((-0.15, -0.05, 0.15, 0.35), (0, 1, 1, 0)), 0.08: ((0.25, 0.4, 0.8, 1.0), (0, 1, 1, 0))}
"""Largest common activations of extensors and flexors of the knee, and when, as shares of the stance."""
OF_KNEE = ("rectus_femoris", "vasti", "hamstrings", "biceps_femoris_short")
RECRUITMENT = {"exponent": 3, "minimum": 0.02, "reserves": 1.0}
JOINTS = ("hip", "knee", "ankle")
LANDMARKS = {"thigh": ("RKNE", "RKNM"), "shank": ("RANK", "RANM")}
"""Landmarks of the joint at the end of a segment."""
DRAWS = 20
"""Largest number of bodies that are drawn for the motion of a person until the muscles of one can produce it."""
LEVEL = 0.95
SHOWN = 50
"""Number of persons after which the table is printed."""


@dataclass(frozen=True)
class Drawn:
    """A person: spec of what was measured, and spec of the truth."""

    measured: dict[str, Any]
    truth: InverseSpec
    forces: Run
    """The forces without the time by which muscles are late."""
    late: float
    """Time by which the forces of the muscles are late [s]."""


@dataclass
class Tally:
    """Errors and bars of persons, and what failed."""

    count: int = 0
    named: int = 0
    """Number of persons, and of those whose contradictions are named."""
    failed: list[str] = field(default_factory=list)
    errors: dict[str, list[Array]] = field(default_factory=dict)
    bars: dict[str, list[Array]] = field(default_factory=dict)
    excess: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    """Excess of the largest force over the true one by joint, before and after the correction of its bias [N]."""
    knee: list[Array] = field(default_factory=list)
    """Errors of the compression of the knee, both sides of its bars, and shares of the stance (T, 4), by person."""
    seconds: float = 0.0

    def add(self, name: str, error: Array, bar: Array) -> None:
        """Add magnitudes of errors and bars of a quantity."""
        self.errors.setdefault(name, []).append(np.atleast_1d(np.abs(error)))
        self.bars.setdefault(name, []).append(np.atleast_1d(bar))

    def merge(self, other: Tally) -> None:
        """Add the persons of another tally."""
        for name in ("count", "named", "failed", "seconds", "knee"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        for name in ("errors", "bars", "excess"):
            for key, rows in getattr(other, name).items():
                getattr(self, name).setdefault(key, []).extend(rows)

    def show(self, console: Console, deviations: str) -> None:
        """Print the table of persons whose deviations are as stated or other ones."""
        count = self.count
        table = Table(
            title=f"deviations {deviations}: {count - len(self.failed)} of {count} persons, "
            f"{self.seconds / count:.1f} s of processor time each; contradictions named for {self.named}"
        )
        for heading in ("quantity", "covered [%]", "+- [%]", "bar / 95 % quantile of errors"):
            table.add_column(heading)
        for name in self.errors:
            covered, scatter, ratio = self.row(name)
            table.add_row(name, f"{100 * covered:.1f}", f"{100 * scatter:.1f}", f"{ratio:.2f}")
        console.print(table)
        for joint, pairs in self.excess.items():
            before, after = np.nanmean(pairs, axis=0)
            console.print(f"largest force of the {joint}: mean excess {before:.0f} N, corrected {after:.0f} N")
        self.show_knee(console)
        console.file.flush()

    def show_knee(self, console: Console) -> None:
        """Print how often bars of the compression of the knee contain the truth, by fifths of the stance, and whether
        they tell more than constant ones.
        """
        error, lower, upper, share = np.moveaxis(np.array(self.knee), -1, 0)
        side = np.where(error > 0, upper, lower)
        bins = {f"{k / 5:.0%} to {(k + 1) / 5:.0%}": (share >= k / 5) & (share < (k + 1) / 5) for k in range(5)}
        stance = (share >= 0) & (share < 1)
        for name, own in {**bins, "stance": stance, "swing": ~stance}.items():
            rms = float(np.sqrt(np.mean(error[own] ** 2)))
            told = f"covered {np.mean((np.abs(error) <= side)[own]):.1%}, median error {np.median(error[own]):.0f} N"
            console.print(f"compression, {name}: {told}, rms {rms:.0f} N, half width {np.median(side[own]):.0f} N")
        half = 0.5 * (lower + upper)
        ranks = spearmanr(half[stance], np.abs(error)[stance]).statistic
        count, scores = len(error) // 2, np.zeros(2)
        for own, other in ((slice(count), slice(count, None)), (slice(count, None), slice(count))):
            size = np.zeros_like(error[own])
            for where in (stance, ~stance):
                size[where[own]] = np.sqrt(np.mean(error[other][where[other]] ** 2))
            sides = ((side / 1.96, half / 1.96), (size, size))
            scores += [
                float(np.mean(-0.5 * (error[own] / one[: len(size)]) ** 2 - np.log(mean[: len(size)]))) / 2
                for one, mean in ((sides[0][0][own], sides[0][1][own]), sides[1])
            ]
        console.print(
            f"compression: rank correlation in stance {ranks:.2f}, log score {scores[0]:.3f}, constants {scores[1]:.3f}"
        )

    def row(self, name: str) -> tuple[float, float, float]:
        """Return the share of covered values, its standard error over persons, and the ratio of the median bar to the
        quantile of the errors of all persons.
        """
        error, bar = np.array(self.errors[name]), np.array(self.bars[name])
        known = np.isfinite(error) & np.isfinite(bar)
        each = np.sum((error <= bar) & known, axis=1) / np.maximum(np.sum(known, axis=1), 1)
        large = np.nanquantile(np.where(known, error, np.nan), LEVEL, axis=0)
        ratio = np.nanmedian(np.where(known, bar, np.nan), axis=0) / large
        return float(np.mean(each)), float(np.std(each) / np.sqrt(len(each))), float(np.nanmedian(ratio))


@lru_cache(maxsize=1)
def page_walker() -> Walker:
    walker = Walker.of_example(2, slice(24, 230))
    walker.loads = walker.filtered(CUTOFF)
    return walker


@lru_cache(maxsize=1)
def _expanded() -> tuple[dict[str, Any], float]:
    """Return the spec of the model that is scaled to exact markers, as plain data, and the angle of its flat foot less
    that of the walker.
    """
    walker = page_walker()
    spec = load_inverse_spec(spec_of_columns(columns_of(walker, walker.markers())))
    assert spec.person is not None
    data: dict[str, Any] = json.loads(spec.expanded.canonical_json())
    data["model"] |= {"thigh_length": THIGH, "shank_length": SHANK}
    flat = float(np.median(spec.person.columns["bodies.foot.angle"] - walker.angles["foot"]))
    return data, flat


def stance_share() -> Array:
    """Return the shares (T,) of the nearest stance of the right foot that have passed."""
    walker = page_walker()
    time, found = walker.time, np.full(len(walker.time), np.inf)
    length = max(end - first for foot, first, end in walker.contacts() if foot == "foot")
    for foot, first, end in walker.contacts():
        if foot == "foot":
            begin = end - length if first == 0 else first
            share = (time - time[0]) / (time[1] - time[0]) / length - begin / length
            found = np.where(np.abs(share - 0.5) < np.abs(found - 0.5), share, found)
    return found


def forces_of(truth: InverseSpec, together: Sequence[float] = (0.0, 0.0), moment: Array | None = None) -> Run:
    """Return the forces of a drawn person, whose knee has compartments that cannot pull, with activations of extensors
    and flexors of the knee together, and a moment (T,) about its forward axis [N m].
    """
    problem = InverseProblem.of(truth)
    names, recruiter, walker = problem.names, problem.recruiter, page_walker()
    assert recruiter is not None
    load, joint = walker.loads["foot"][0][:, 1], list(names.mechanism.joints).index("knee")
    moment = MEDIAL * load if moment is None else moment
    knee = Compartments("knee", joint, names.body("shank", "model"), COMPARTMENTS, HARD, moment, load)
    recruiter.targets = replace(recruiter.targets, knees=(knee,))
    windows = (np.interp(stance_share(), *one) for one in TOGETHER_ACTIVE.values())
    both = sum(size * own for size, own in zip(together, windows, strict=True))
    recruiter.floor = np.outer(both, [any(word in name for word in OF_KNEE) for name in recruiter.muscles])
    return run_of(compute(problem))


def spec_of_columns(columns: Mapping[str, Array], **sections: Any) -> dict[str, Any]:
    """Return the spec of a person with one leg and eleven muscles, from columns (T, 3) of markers and plates."""
    data = {"time": page_walker().time} | {f"{n}.{a}": x[:, k] for n, x in columns.items() for k, a in enumerate("xyz")}
    clusters = {body: names for body, names in CLUSTERS.items() if not body.endswith("_left")}
    smooth = {"name": "butterworth", "cutoff": CUTOFF}
    return {
        "mbdkit": 1,
        "subject": SUBJECT,
        "model": {"name": "leg", "root": "trunk", "muscles": "walking-two-legs"},
        "motion": {"data": data, "clusters": clusters, "smooth": smooth},
        "recruitment": RECRUITMENT,
        **sections,
    }


class Wider:
    """Random numbers whose deviations are multiplied by a factor."""

    def __init__(self, random: np.random.Generator, factor: float):
        self.random, self.factor = random, factor

    def standard_normal(self, size: Any = None) -> Any:
        """Return Gaussian numbers with a mean of 0."""
        return self.factor * self.random.standard_normal(size)

    def uniform(self, low: float, high: float) -> float:
        """Return a number that is uniform in a range."""
        middle, half = (low + high) / 2, self.factor * (high - low) / 2
        return float(self.random.uniform(middle - half, middle + half))


class Across(Protocol):
    """The frontal plane of a person: what it makes of columns, and the moment (T,) about the axis of the knee [N m]."""

    def columns(self, columns: Mapping[str, Array]) -> dict[str, Array]:
        """Return columns of markers and plates with other places across."""

    @property
    def moment(self) -> Array:
        """The moment."""


def drawn_person(
    random: np.random.Generator, factor: float = 1.0, plane: Across | None = None, **sections: Any
) -> Drawn:
    """Return a person drawn at random, whose deviations are `factor` times those that are stated; `sections` are added
    to the spec of what was measured.
    """
    wider = Wider(random, factor)
    columns = drawn_columns(wider)
    measured = spec_of_columns(plane.columns(columns) if plane else columns, **sections)
    for left in reversed(range(DRAWS)):
        truth = _truth(wider)
        together = [max(0.0, wider.uniform(0.0, most)) for most in TOGETHER_ACTIVE]
        try:
            forces = forces_of(truth, together, plane.moment if plane else None)
            return Drawn(measured, truth, forces, DELAY * wider.standard_normal())
        except MbdkitError:
            if not left:
                raise
    raise AssertionError


def drawn_columns(random: Wider) -> dict[str, Array]:
    """Return the columns of markers and plates."""
    walker = page_walker()
    markers = walker.markers(random.random)  # artefacts are estimated from the markers, not stated
    shift = HIP * random.standard_normal(3)
    for name in CLUSTERS["trunk"]:
        markers[name] = markers[name] + walker.turned("trunk", tuple(shift))
    for body, names in LANDMARKS.items():
        shift = LANDMARK * random.standard_normal(3)
        for name in names:
            markers[name] = markers[name] + walker.turned(body, tuple(shift))
    for joint in JOINTS:
        walker.move_in_step(markers, joint, random)
    for body, (along, about) in TOGETHER.items():
        slide, turn = along * walker.skin(random.random), about * walker.skin(random.random)
        middle = np.mean([markers[name] for name in CLUSTERS[body]], axis=0)
        for name in (*CLUSTERS[body], *LANDMARKS[body]):
            markers[name] = markers[name] + slide + np.cross(turn, markers[name] - middle)
    columns = columns_of(walker, markers)
    late = random.uniform(-0.5, 0.5) * float(walker.time[1] - walker.time[0])  # 0.29 frames
    gain, press = np.exp(GAIN * random.standard_normal()), PRESSURE * random.standard_normal()
    for number, (foot, *_) in enumerate(walker.contacts(), 1):
        plate = [f"plate{number}.{one}" for one in ("force", "point", "torque")]
        force, point, torque = (columns[name] for name in plate)
        moment = np.where(np.isnan(point), 0.0, point) * force[:, 2:]
        force, moment, torque = (_later(walker.time, x, late) for x in (gain * force, gain * moment, torque))
        acts = force[:, 2] > 10.0
        beside = np.array([press, MEDIAL if foot == "foot" else -MEDIAL, 0.0])
        with np.errstate(divide="ignore", invalid="ignore"):
            point = np.where(acts[:, None], moment / force[:, 2:], np.nan) + beside
        columns |= dict(zip(plate, (force * acts[:, None], point, torque), strict=True))
    return columns


def _later(at: Array, values: Array, late: float) -> Array:
    """Return values (T, 3) of plates that are late by a time [s]."""
    return np.stack([np.interp(at - late, at, column) for column in values.T], axis=1)


def _truth(random: Wider) -> InverseSpec:
    """Return the spec of the drawn person with its own motion, loads and muscles."""
    walker, (data, flat) = page_walker(), json.loads(json.dumps(_expanded()))
    muscles = data["model"]["muscles"]
    common, longer = STRENGTH * random.standard_normal(), float(random.standard_normal())
    common += np.log(1.0 - LOSS * (random.uniform(*AGES) - AGES[0]) / 10.0) - UNKNOWN_AGE[0]
    for muscle in muscles.values():
        if "patella" in muscle:
            muscle["patella"] = muscle["patella"] | {"deviations": longer}
        muscle["max_force"] *= float(np.exp(common + STRENGTH * random.standard_normal()))
        muscle["optimal_length"] *= float(np.exp(FIBER * random.standard_normal()))
        muscle["tendon_length"] *= float(np.exp(TENDON * random.standard_normal()))
        for body in dict.fromkeys(item["body"] for item in muscle["path"]):
            move = (POINTS * random.standard_normal(2)).tolist()
            for item in muscle["path"]:
                if item["body"] == body:
                    item["point"] = [*map(_moved, item["point"], move), *item["point"][2:]]
    zero = TRUNK_ZERO * random.standard_normal()
    tilt = walker.angles["trunk"] - np.mean(walker.angles["trunk"]) + zero
    angles = [tilt, *(walker.angles[name] for name in ("thigh", "shank", "foot"))]
    angles[-1] = angles[-1] + flat + FOOT_ZERO * random.standard_normal()
    columns = {"hip_x": walker.hip[:, 0], "hip_y": walker.hip[:, 1], "trunk_tilt": tilt}
    names = ("hip_flexion", "knee_flexion", "ankle_dorsiflexion")
    for name, sign, above, below in zip(names, (1, -1, 1), angles, angles[1:], strict=False):
        columns[name] = sign * (below - above)
    force, point = walker.loads["foot"]
    point = np.where(force[:, 1:] > 0, point, np.nan)
    load = {"time": walker.time, "fx": force[:, 0], "fy": force[:, 1], "px": point[:, 0], "py": point[:, 1]}
    data |= {
        "motion": {"data": {"time": walker.time, **columns}, "smooth": "quintic", "errors": "none"},
        "loads": {"ground": {"body": "foot", "force": ["fx", "fy"], "point": ["px", "py"], "data": load}},
        "recruitment": RECRUITMENT | {"minimum": max(0.0, random.uniform(*MINIMUM))},
    }
    data["model"] = _weighed(data, random)
    spec = load_inverse_spec(data)
    assert spec.recruitment is not None
    recruitment = spec.recruitment.model_copy(update={"exponent": max(2.0, random.uniform(*EXPONENT))})
    return spec.model_copy(update={"recruitment": recruitment})


def _moved(value: Any, by: float) -> Any:
    """Return a coordinate of a point, a number or an expression, moved by a length."""
    return f"{value} + ({by!r})" if isinstance(value, str) else value + by


def _weighed(data: Mapping[str, Any], random: Wider) -> dict[str, Any]:
    """Return the model with other masses and moments of inertia, as a model of its elements."""
    own = load_inverse_spec(dict(data)).mechanism()
    whole = {name: getattr(own, name) for name in ("bodies", "joints", "markers", "muscles", "coordinates")}
    model: dict[str, Any] = {
        key: {name: json.loads(one.model_dump_json(exclude_none=True)) for name, one in group.items()}
        for key, group in whole.items()
    }
    for name, body in model["bodies"].items():
        mass, inertia = np.exp(MASS[name] * random.standard_normal()), np.exp(INERTIA[name] * random.standard_normal())
        body["mass"], body["inertia"] = float(mass) * body["mass"], float(mass * inertia) * body["inertia"]
    return {"name": "mechanism", "gravity": list(own.gravity), **model}


def persons(console: Console, count: int = 20, seed: int = 0, samples: int = 200, *, doubled: bool = False) -> None:
    """Print the shares of values that the bars contain, for `count` drawn persons and after each `SHOWN` of them.

    If `doubled`, the deviations of every second person are twice those that are stated.
    """
    tallies = [Tally(), Tally()] if doubled else [Tally()]
    tally_of = partial(_tally, seed=seed, samples=samples, halves=len(tallies))
    with ProcessPoolExecutor() as pool:
        for number, own in enumerate(pool.map(tally_of, range(count))):
            tallies[number % len(tallies)].merge(own)
            if number + 1 == count or (number + 1) % SHOWN == 0:
                for of, factor in zip(tallies, ("as stated", "doubled"), strict=False):
                    of.show(console, factor)
    for text in (text for tally in tallies for text in tally.failed):
        console.print(f"failed: {text}")


def _tally(number: int, seed: int, samples: int, halves: int) -> Tally:
    """Return the tally of one person."""
    tally, begin = Tally(count=1), time.process_time()
    try:
        add_person(tally, np.random.default_rng([seed, number]), samples, 1.0 + number % halves)
    except MbdkitError as error:
        tally.failed.append(f"{number}: {error}")
    tally.seconds = time.process_time() - begin
    return tally


def add_person(tally: Tally, random: np.random.Generator, samples: int, factor: float = 1.0) -> None:
    """Add a person, whose deviations are `factor` times those that are stated; raise MbdkitError if there is no
    result.
    """
    person = drawn_person(random, factor, uncertainty={"samples": samples})
    with redirect_stderr(io.StringIO()):
        found = mbdkit.inverse(person.measured)
    assert found.accuracy is not None
    parts, truth = found.accuracy.parts, person.forces
    at_time = np.asarray(truth.time)
    tally.named += any("misfit:" in text for text in found.warnings)
    without = truth.array("muscles/reaction_force_without")
    for joint in JOINTS:
        place = list(found.joint_names).index(joint)
        own, other = found.joints[joint].reaction_force, truth.joints[joint].reaction_force
        other = without[:, place] + later(at_time, other - without[:, place], -person.late)
        error, bars = np.linalg.norm(own - other, axis=1), found.accuracy.reaction_error[:, place]
        tally.add(f"force of the {joint}", error, bars)
        sizes = [np.linalg.norm(one, axis=1) for one in (own, other)]
        at = int(np.argmax(sizes[0]))
        tally.add(f"{joint}, at the instant of the computed peak", error[at], bars[at])
        bar = np.hypot(parts["reaction_error_data"][at, place], parts["reaction_peak_error"][place])
        excess = sizes[0][at] - np.max(sizes[1])
        tally.add(f"peak of the {joint}", excess, bar)
        corrected = excess - parts["reaction_peak_bias"][place]
        tally.add(f"peak of the {joint}, corrected", corrected, bar)
        tally.excess.setdefault(joint, []).append((excess, corrected))
    tally.knee.append(errors_of_knee(found, person))
    errors, peaks, wide, wide_at_peaks = [], [], [], []
    for name, muscle in found.muscles.items():
        tension = later(at_time, truth.muscles[name].force, -person.late)
        at = int(np.argmax(muscle.force))
        errors.append(muscle.force - tension)
        peaks.append(muscle.force[at] - np.max(tension))
        wide.append(muscle.force_error)
        wide_at_peaks.append(muscle.force_error[at])
    tally.add("forces of muscles", np.concatenate(errors), np.concatenate(wide))
    tally.add("peaks of muscles", np.array(peaks), np.array(wide_at_peaks))


def errors_of_knee(run: Run, person: Drawn) -> Array:
    """Return how much larger the true compression of the knee is, both sides of its bars, and shares of the stance
    (T, 4).
    """
    knee, truth = run.knees["knee"], person.forces
    alone, at = truth.array("muscles/reaction_force_without"), list(truth.joint_names).index("knee")
    angle = truth["shank"].angle
    least = np.sin(angle) * alone[:, at, 0] - np.cos(angle) * alone[:, at, 1]
    true = least + later(np.asarray(truth.time), truth.knees["knee"].compression - least, -person.late)
    return np.stack([true - knee.compression, knee.compression_lower, knee.compression_upper, stance_share()], axis=1)
