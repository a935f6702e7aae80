"""`python -m tests.benchmarks.knee_challenge FOLDER`: a knee force against that of an instrumented implant.

The Grand Challenge Competition to Predict In Vivo Knee Loads (B. J. Fregly et al., J. Orthop. Res. 30 (2012) 503-513)
published markers, force plates and the force in the knee implant of persons who walk. FOLDER is a copy of
https://github.com/AnyBody/knee-grand-challenge-4th, or a folder with the files of one trial: `TRIAL.c3d` and
`TRIAL_knee_forces.csv`. The table of forces has the loads of four cells below the plate on the tibia in pounds, the
angle of a goniometer (GON) in degrees, and the vertical force of the plate under the left foot (GRFz). Its rows are the
frames of the C3D file. Without the column GON, the angle is not compared; without GRFz, the frames are not checked.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import mbdkit
from mbdkit.plugin import MbdkitError, SpecError, show
from mbdkit_biomech.inverse_dynamics.files.table_files import read_table
from mbdkit_biomech.inverse_dynamics.signals.chi_square import quantile
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec
from mbdkit_biomech.persons.landmarks import LEFT
from mbdkit_biomech.persons.person import Person
from mbdkit_biomech.persons.plate_contacts import later
from mbdkit_biomech.uncertainty.contributions import contributions, has_contributions

TRIAL = "jw_ngait_og3"
"""The trial whose forces were open to the participants of the competition."""

POUND = 4.4482216152605
"""One pound-force [N]."""

CELLS = ("PM", "AM", "AL", "PL")
"""Columns of the load cells: posterior or anterior, medial or lateral."""

GRF_UNIT = 1995.0
"""One unit of the column GRFz [N]."""

LARGEST_MISMATCH = 30.0
"""Root mean square difference of GRFz and the plates [N] from which the rows are not the frames of the C3D file;
in the open trial it is 8 N."""

GONIOMETER = 3.6
"""Standard deviation of the angle of a goniometer at the knee in walking [deg]: T. Ishida and M. Samukawa, Sensors 23
(2023) 3266, found absolute errors of 3.3 degrees with a standard deviation of 1.5 degrees."""

MASS = 64.6
"""Mass of the person [kg]."""
WEIGHT = 9.81 * MASS
_LEG = {"thigh": ("ThighSuperior", "ThighInferior", "ThighLateral"),
        "shank": ("ShankSuperior", "ShankInferior", "ShankLateral"),
        "foot": ("Heel", "Toe", "MidfootMedial", "MidfootLateral", "Hindfoot")}  # fmt: skip


MARGIN = 0.15
"""Time before and after the stances in which forces are computed [s], so that the ends of the record have no effect."""


class Phase(NamedTuple):
    """A stance of the right leg or the swing between two, by its first frame and the frame after its last one."""

    name: str
    first: int
    end: int


def spec_of(markers: Path, **sections: Any) -> dict[str, Any]:
    """Return the spec of inverse dynamics of a trial; `sections` replace or add sections."""
    clusters = {"trunk": ["RAsis", "LAsis", "RPsis", "LPsis", "Sacral"]}
    for leg, side in (("", "R"), (LEFT, "L")):
        clusters |= {body + leg: [side + name for name in names] for body, names in _LEG.items()}
    muscles = {"muscles": "walking-two-legs", "symmetric_muscles": True}
    return {
        "mbdkit": 1,
        "title": f"Knee challenge: {markers.stem}",
        "subject": {"mass": MASS, "height": 1.66, "sex": "male", "age": 83, "replacement": {"right": "knee"}},
        "model": {"name": "leg", "legs": 2, "root": "trunk", **muscles},
        "motion": {
            "file": str(markers.resolve()),
            "clusters": clusters,
            "smooth": {"name": "butterworth", "cutoff": 8},
            "gaps": {"longest": 0.2},
        },
        "recruitment": {"exponent": 3, "minimum": 0.01, "reserves": 1.0},  # Crowninshield and Brand (1981)
        **sections,
    }


def file_of(folder: Path, name: str) -> Path:
    """Return the file of a name in a folder or below it; raise SpecError if there is none."""
    if not folder.is_dir():
        raise SpecError(f"{folder} is not a folder; give a copy of github.com/AnyBody/knee-grand-challenge-4th")
    found = sorted(path for path in folder.rglob(name) if path.is_file())
    if not found:
        raise SpecError(
            f"{folder} has no file {name}; it is part of github.com/AnyBody/knee-grand-challenge-4th (branch master, "
            "folder TKA_AnyMoCap_MultiTrials/Trials)"
        )
    return found[0]


def measured_of(file: Path, markers: Path) -> dict[str, np.ndarray]:
    """Return the columns of a table of forces, (T,) each: ``force`` [N], and those it has of ``GON`` [deg] and ``GRFz``
    [N]; raise SpecError if a load cell is missing, or the rows are not the frames of the C3D file.
    """
    try:
        lines = [line.strip().rstrip(",") for line in file.read_text(encoding="utf-8").splitlines() if line.strip()]
        names, rows = lines[0].split(","), np.array([line.split(",") for line in lines[1:]], dtype=float)
        own = {name: rows[:, column] for column, name in enumerate(names)}
        force = POUND * np.sum([own[name] for name in CELLS], axis=0)
        units = {"GON": 1.0, "GRFz": GRF_UNIT}
        found = {"force": force} | {name: unit * own[name] for name, unit in units.items() if name in own}
    except (UnicodeDecodeError, ValueError, IndexError, KeyError):
        needed = ", ".join(CELLS)
        raise SpecError(f"should be a table of numbers with the columns {needed}", file=file) from None
    table = read_table(markers, "motion.file")
    if len(rows) != len(table.cells):
        raise SpecError(f"has {len(rows)} rows, but {markers.name} has {len(table.cells)} frames", file=file)
    if "GRFz" not in found:
        return found
    vertical = (name for name in table.headings if name.endswith(".force.z"))
    forces = (np.abs(table.column(name, "motion.file")) for name in vertical)
    mismatches = [float(np.sqrt(np.mean((one - found["GRFz"]) ** 2))) for one in forces]
    if not min(mismatches, default=np.inf) < LARGEST_MISMATCH:
        raise SpecError(f"its rows are not the frames of {markers.name}: GRFz is the force of no plate", file=file)
    return found


def phases_of(person: Person) -> list[Phase]:
    """Return the stances of the right foot, and the swings between them; raise SpecError if it is on no plate."""
    own = sorted((one for one in person.plates.contacts if one.body == "foot"), key=lambda one: one.first)
    if not own:
        raise SpecError("the right foot stands on no force plate in this trial")
    found: list[Phase] = []
    for number, one in enumerate(own, 1):
        if found:
            found.append(Phase("swing", found[-1].end, one.first))
        found.append(Phase(f"stance {number}", one.first, one.end))
    return found


class Comparison(NamedTuple):
    """Computed and measured values (T,), and how far the true ones may lie below and above the computed ones (T,)."""

    computed: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    measured: np.ndarray

    def rows(self, own: slice) -> Comparison:
        """Return the values in some frames."""
        return Comparison(*(values[own] for values in self))

    @property
    def bar(self) -> np.ndarray:
        """Half widths of the bars (T,)."""
        return np.asarray(0.5 * (self.lower + self.upper))

    @property
    def is_inside(self) -> np.ndarray:
        """Whether the bars contain the measured values (T,)."""
        return (-self.upper <= self.error) & (self.error <= self.lower)

    @property
    def error(self) -> np.ndarray:
        """Computed minus measured values."""
        return np.asarray(self.computed - self.measured)

    @property
    def covered(self) -> float:
        """Share of the frames in which the bar contains the measured value."""
        return float(np.mean(self.is_inside))

    @property
    def rms(self) -> float:
        """Root mean square error."""
        return float(np.sqrt(np.mean(self.error * self.error)))


def compared(run: mbdkit.Run, measured: Mapping[str, np.ndarray], rows: slice) -> tuple[Comparison, Comparison]:
    """Return the compressive force of the right knee along the shank [N], and the angle of the knee [deg], in some rows
    of a run.

    The cells measure the force along the axis of the tibia. The bar of the angle
    contains those of both segments as if they were independent, but not `GONIOMETER`.
    """
    bodies, knee, accuracy = list(run.bodies), run.knees["knee"], run.accuracy
    assert accuracy is not None
    thigh, shank = (run.bodies[name].angle[rows] for name in ("thigh", "shank"))
    force = (one[rows] for one in (knee.compression, knee.compression_lower, knee.compression_upper))
    errors = [accuracy.position_error[rows, bodies.index(name), 2] for name in ("thigh", "shank")]
    bar = np.degrees(np.sqrt(sum(one * one for one in errors)))
    return (
        Comparison(*force, measured["force"]),
        Comparison(np.degrees(thigh - shank), bar, bar, measured.get("GON", np.full(len(bar), np.nan))),
    )


def score_of(comparison: Comparison) -> float:
    """Return the mean logarithm of the density of the measured values [1/N], up to a constant, if errors are Gaussian
    on both sides of the computed ones, with the deviations that the bars state.
    """
    side = np.where(comparison.error > 0, comparison.lower, comparison.upper) / 1.96
    mean = np.maximum(comparison.bar / 1.96, 1.0)
    return float(np.mean(-0.5 * (comparison.error / np.maximum(side, 1.0)) ** 2 - np.log(mean)))


def fifths_of(phases: Sequence[Phase], force: Comparison) -> list[str]:
    """Return a table of the errors in each fifth of all stances."""
    start, stances = phases[0].first, [one for one in phases if one.name.startswith("stance")]
    lines = ["", f"{'fifth of stance':<18}{'bias [N]':>10}{'bias [BW]':>11}{'covered':>9}{'log score':>11}"]
    for number in range(5):
        inside = np.concatenate([
            np.arange(one.end - one.first)[slice(*(k * (one.end - one.first) // 5 for k in (number, number + 1)))]
            + one.first - start for one in stances
        ])  # fmt: skip
        own = Comparison(*(values[inside] for values in force))
        bias = float(np.mean(own.error))
        lines.append(f"{number + 1:<18}{bias:>10.0f}{bias / WEIGHT:>11.2f}{own.covered:>9.0%}{score_of(own):>11.2f}")
    return lines


def largest_peak(values: np.ndarray, half: slice) -> int:
    """Return the index of the largest local maximum of values (T,) in a half of a stance; without one, of the largest.

    At the end of a half, values may still increase to the peak of the other half.
    """
    own = np.arange(len(values))[half]
    inner = own[(own > 0) & (own < len(values) - 1)]
    peaks = inner[(values[inner] >= values[inner - 1]) & (values[inner] > values[inner + 1])]
    chosen = peaks if len(peaks) else own
    return int(chosen[np.argmax(values[chosen])])


def report_of(phases: Sequence[Phase], force: Comparison, angle: Comparison, run: mbdkit.Run, rows: slice) -> list[str]:
    """Return the lines of the table, and the sources of error at the peaks."""
    start = phases[0].first
    lines = [
        f"body weight {WEIGHT:.0f} N; knee force: compression along the shank; bars of 95 %",
        "",
        f"{'':<12}{'frames':>7}{'rms [N]':>9}{'rms [BW]':>10}{'bias [N]':>10}{'covered':>9}{'half width [BW]':>17}",
    ]
    for phase in (*phases, Phase("all", start, phases[-1].end)):
        own = force.rows(slice(phase.first - start, phase.end - start))
        lines.append(
            f"{phase.name:<12}{len(own.error):>7}{own.rms:>9.0f}{own.rms / WEIGHT:>10.3f}{np.mean(own.error):>10.0f}"
            f"{own.covered:>9.0%}{np.nanmedian(own.bar) / WEIGHT:>17.2f}"
        )
    lines += fifths_of(phases, force)
    heads = f"{'peak':<22}{'measured [N] at [s]':>21}{'computed [N] at [s]':>21}{'then measured':>15}{'bar [N]':>9}"
    lines += ["", f"{heads}{'bar [BW]':>10}  inside then"]
    sources = []
    for stance in (one for one in phases if one.name.startswith("stance")):
        first, middle, end = (frame - start for frame in (stance.first, (stance.first + stance.end) // 2, stance.end))
        for name, half in {"first": slice(first, middle), "second": slice(middle, end)}.items():
            label, at = f"{stance.name}, {name}", largest_peak(force.computed, half)
            other, time, bar = largest_peak(force.measured, half), run.time[rows], force.bar[at]
            lines.append(
                f"{label:<22}{force.measured[other]:>13.0f}{time[other]:>8.3f}{force.computed[at]:>13.0f}{time[at]:>8.3f}"
                f"{force.measured[at]:>15.0f}{bar:>9.0f}{bar / WEIGHT:>10.2f}  "
                f"{'yes' if force.is_inside[at] else 'no'}"
            )
            if has_contributions(run):
                sources.append(f"{label:<22}{contributions(run, 'knee', float(run.time[rows][at])).sentence}")
    if np.isnan(angle.measured).all():
        return [*(*lines, "", *sources)]
    wide = np.hypot(angle.bar, quantile(1.0) ** 0.5 * GONIOMETER)
    both = angle._replace(lower=wide, upper=wide)
    return [
        *(*lines, "", *sources, ""),
        f"knee angle minus goniometer: {np.mean(angle.error):.1f} deg, standard deviation {np.std(angle.error):.1f}",
        f"bar of the angle: {np.median(angle.bar):.1f} deg; the goniometer is inside in {angle.covered:.0%} of frames",
        f"with the error of a goniometer: {np.median(both.bar):.1f} deg, {both.covered:.0%}",
    ]


def compare(folder: Path, trial: str = TRIAL, *, archive: Path | None = None, **sections: Any) -> list[str]:
    """Compute a trial and return the lines of the report.

    Parameters
    ----------
    archive
        File for the results; by default, nothing is written.
    sections
        Sections of the spec that replace those of `spec_of`, or are added.

    Raises
    ------
    SpecError
        If a file is missing or has other contents.
    """
    markers, table = (file_of(folder, f"{trial}{end}") for end in (".c3d", "_knee_forces.csv"))
    measured = measured_of(table, markers)
    data = spec_of(markers, **sections)
    person = load_inverse_spec(data).person
    phases = phases_of(person)
    own = slice(phases[0].first, phases[-1].end)
    data["time"] = {"start": float(max(person.time[own][0] - MARGIN, person.time[0])),
                    "end": float(min(person.time[own][-1] + MARGIN, person.time[-1]))}  # fmt: skip
    with mbdkit.inverse(data, archive=archive) as run:
        rows = slice(first := int(np.argmin(np.abs(run.time - person.time[own][0]))), first + own.stop - own.start)
        late = 0.0 if person.plates.offset is None else person.plates.offset.corrected  # cells are as late as plates
        measured = {name: later(person.time, values, late)[own] for name, values in measured.items()}
        force, angle = compared(run, measured, rows)
        span = f"from {run.time[rows][0]:.3f} to {run.time[rows][-1]:.3f} s"
        summary = [f"{label:<12} {text}" for label, text in person.lines().items()]
        lines = report_of(phases, force, angle, run, rows)
    return [f"{trial}: {own.stop - own.start} frames {span}", "", *summary, "", *lines]


def main(words: Sequence[str] | None = None) -> None:
    """Print the comparison of a trial."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.knee_challenge",
        description="Compare the computed force of a knee with the one that an instrumented implant measured, in the "
        "data of the Grand Challenge Competition to Predict In Vivo Knee Loads. The data are not part of mbdkit: clone "
        "https://github.com/AnyBody/knee-grand-challenge-4th. Nothing is written without --archive.",
    )
    parser.add_argument("folder", type=Path, help="the clone, or a folder with TRIAL.c3d and TRIAL_knee_forces.csv")
    parser.add_argument("--trial", default=TRIAL, help="name of the trial (default: %(default)s)")
    parser.add_argument("--archive", type=Path, metavar="FILE.h5", help="keep the results, for `mbdkit report FILE.h5`")
    asked = parser.parse_args(words)
    try:
        for line in compare(asked.folder, asked.trial, archive=asked.archive):
            show(line)
    except MbdkitError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
