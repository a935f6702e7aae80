"""The verdict on one run and its claims: trust, estimated errors, completion, misalignment, and energy balance."""

from __future__ import annotations

import math

import numpy as np

from mbdkit.archive.layout import EVIDENCE
from mbdkit.archive.run import Run
from mbdkit.trust.criteria import ENERGY, MISALIGNMENT, ROUND_OFF, Level, rounding
from mbdkit.trust.energy_record import gravity_level
from mbdkit_report.analysis.growth import growth_law
from mbdkit_report.analysis.verdict import Answer, Claim, Verdict
from mbdkit_report.figures.curves import bands, take
from mbdkit_report.figures.drawing_geometry import draw_run, mechanism_of
from mbdkit_report.figures.quantity_text import count, duration, length, proportion
from mbdkit_report.pages.run_charts import run_charts
from mbdkit_report.pages.run_tables import run_tables
from mbdkit_report.plot.element_quantity import ElementQuantity, misalignment

_LAWS = {
    "bounded": "it does not grow",
    "linear": "it grows in proportion to time",
    "quadratic": "it grows with the square of time",
    "exponential": "it grows exponentially",
}

MOST_LAWS = 3  #: The growth is not described if this many laws of growth, or more, fit the data.


def run_verdict(run: Run) -> Verdict:
    """Return the verdict on a run, with its charts and tables."""
    claims = [_trust(run), *_accuracy(run), _completion(run), *_evidence(run)]
    if run.records("joints/misalignment") and run.joint_names:
        claims.append(_joints(run))
        claims += _angles(run)
    if run.records("energy/balance"):
        claims.append(_energy(run))
    noise = _rounding_errors(run)
    return Verdict(
        name="run",
        title="Verdict",
        sentence=" ".join(claim.sentence for claim in claims),
        claims=tuple(claims),
        tables=tuple(table for table in run_tables(run) if table.name not in noise),
        figures=tuple(chart for chart in run_charts(run) if chart.name not in noise),
        notes=_notes(run),
    )


def _rounding_errors(run: Run) -> set[str]:
    """Return the names of the charts and tables that would show nothing but rounding errors."""
    found: set[str] = set()
    has_gaps = run.records("joints/misalignment") and run.joint_names
    if has_gaps and run.misalignment_max <= ROUND_OFF * mechanism_size(run):
        found |= {"misalignment", "velocity-misalignment"}
    if run.records("energy/balance"):
        off, kinetic = (float(np.max(np.abs(run.dataset(f"energy/{name}")[:]))) for name in ("balance", "kinetic"))
        if off <= max(rounding(max(kinetic, _largest_energy(run))), ROUND_OFF * kinetic):
            found.add("balance")
    return found


def _notes(run: Run) -> tuple[str, ...]:
    if not run.redundancy:
        return ()
    shared = ""
    if run.records("joints/reaction_force"):
        names = str(run.file["joints/reaction_force"].attrs.get("not_unique", ""))
        shared = f" The reactions of {names} are not unique; the reactions of least norm are shown."
    return (f"The mechanism is overconstrained: {run.redundancy}.{shared}",)


_ANSWERS: dict[Level | None, Answer] = {
    None: Answer.YES,
    "good": Answer.YES,
    "unknown": Answer.OPEN,
    "doubtful": Answer.PARTLY,
    "bad": Answer.NO,
}


def _trust(run: Run) -> Claim:
    sentence = f"The verdict is {run.verdict}."
    if run.verdict_reasons:
        sentence += " " + " ".join(run.verdict_reasons)
    elif not run.is_judged:
        sentence += " The archive contains no verdict, as after a crash of the run."
    elif run.verdict == "unknown":
        sentence = f"The verdict is unknown: {run.errors.without_suspicion}."
    if run.verdict == "unknown" and run.errors.never_good:
        sentence += f" {run.errors.never_good}"
    return Claim("trust", "The results can be trusted", "", run.verdict, _ANSWERS[run.verdict], sentence)


def _accuracy(run: Run) -> list[Claim]:
    accuracy = run.accuracy
    told = run.errors.sentence(with_force=False)
    if accuracy is None or not told:
        return []
    answer = Answer.YES if accuracy.is_complete else Answer.PARTLY if accuracy.rows_known else Answer.NO
    return [Claim("accuracy", "The errors are known", "", told, answer, f"{told[0].upper()}{told[1:]}.")]


def _evidence(run: Run) -> list[Claim]:
    word, _, why = (text := str(run.provenance.get(EVIDENCE, ""))).partition(": ")
    if not text:
        return []
    answer = {"verified": Answer.YES, "never": Answer.OPEN, "checkout": Answer.OPEN}.get(word, Answer.NO)
    sentence = f"The evidence of the integrator {run.provenance.get('integrator', '')} is \u2018{word}\u2019: {why}."
    return [Claim("evidence", "The method is verified", "", word, answer, sentence)]


def _completion(run: Run) -> Claim:
    start, end, steps = float(run.time[0]), float(run.time[-1]), run.stats.get("steps")
    motion = f"{end - start:.4g} s of motion"
    taken = f" in {count(int(steps), 'step')}" if steps else ""
    cost = f" and {duration(float(run.stats['wall_s']))} of computing" if "wall_s" in run.stats else ""
    if run.status == "complete":
        sentence = f"The run completed: {motion}{taken}{cost}."
        if run.status_reason:
            sentence += f" It ended at an event: {run.status_reason.removeprefix('event: ')}"
    elif run.status == "running":
        sentence = f"The run has not finished: it crashed or is still running, after {motion}."
    else:
        reason = run.status_reason.removeprefix("interrupted: ").rstrip(".")
        word = "failed" if run.status == "failed" else "was interrupted"
        sentence = f"The run {word} at t = {end:.6g} s, after {motion}{taken}: {reason}."
    answer = Answer.YES if run.status == "complete" else Answer.NO
    return Claim("completion", "The run completed", "", f"{end:.6g} s", answer, sentence)


def _joints(run: Run) -> Claim:
    quantity = misalignment(run)
    worst = max(run.joints.values(), key=lambda joint: np.nan_to_num(joint.misalignment_max, nan=math.inf))
    most, size = worst.misalignment_max, mechanism_size(run)
    if not math.isfinite(most):
        sentence = f"The misalignment of joint {worst.name} is not finite."
        return Claim("misalignment", "The joints stay together", "", "not finite", Answer.NO, sentence)
    share = most / size if size > 0 else math.nan
    parts = [f"The largest misalignment is {length(most)}, of joint {worst.name}"]
    if most == 0.0:
        parts = ["All joints stay closed exactly"]
    elif share <= ROUND_OFF:
        parts.append("which is round-off of double precision")
    elif math.isfinite(share):
        parts.append(f"{proportion(share)} of the mechanism's size")
        parts += _growth_words(quantity, list(run.joint_names).index(worst.name))
    answer = Answer.OPEN if not math.isfinite(share) else _ANSWERS[MISALIGNMENT.level(share)]
    advice = " This is too large for reliable forces: use a smaller step or a method of higher order."
    sentence = ", ".join(parts) + "." + (advice if answer in (Answer.NO, Answer.PARTLY) else "")
    return Claim("misalignment", "The joints stay together", "", f"{most:.3g} m ({worst.name})", answer, sentence)


def _growth_words(quantity: ElementQuantity, column: int) -> list[str]:
    try:
        growth = growth_law(quantity.data.time, quantity.data.high[:, column])
    except ValueError:  # too few rows, or not finite
        return []
    laws = [_LAWS[law] for law in growth.candidates if law in _LAWS]
    if not 0 < len(laws) < MOST_LAWS:  # no law fits, or too many do
        return []
    return ["and " + " or ".join([laws[0], *(law.removeprefix("it ") for law in laws[1:])])]


def _angles(run: Run) -> list[Claim]:
    quantity = misalignment(run, "angle")
    if quantity.zero:
        return []
    column, most = quantity.largest
    name = quantity.elements[column]
    sentence = f"The largest error of a prescribed angle is {most:.2g} rad, of joint {name}."
    answer = _ANSWERS[MISALIGNMENT.level(most)]
    return [Claim("angles", "Prescribed angles are met", "", f"{most:.3g} rad ({name})", answer, sentence)]


def _energy(run: Run) -> Claim:
    balance, kinetic = (bands(run.time, run.dataset(f"energy/{name}")[:][:, None]) for name in ("balance", "kinetic"))
    off, most = float(balance.peaks[0]), float(kinetic.peaks[0])
    share = off / most if most > 0 else math.nan
    if not math.isfinite(off) or not np.all(np.isfinite(balance.high)):
        return Claim("energy", "Energy is balanced", "", "not finite", Answer.NO, "The energy is not finite.")
    sentence = f"Energy is balanced to {off:.2g} J"
    smallest = rounding(max(most, _largest_energy(run)))
    sentence += f", {proportion(share)} of the largest kinetic energy." if most > smallest else "."
    is_rounding = off <= smallest
    answer = Answer.YES if is_rounding else Answer.OPEN if not math.isfinite(share) else _ANSWERS[ENERGY.level(share)]
    if answer in (Answer.NO, Answer.PARTLY):
        sentence += (
            " This is too large: smooth the motion, and cut off its ends, where derivatives are least accurate."
            if run.kind == "inverse"
            else " This is too large: use a smaller step or a method of higher order."
        )
    return Claim("energy", "Energy is balanced", "", f"{off:.3g} J", answer, sentence)


def _largest_energy(run: Run) -> float:
    """Return the largest absolute value of the energies whose rounding errors the energy balance contains [J]."""
    names = ("potential", "work", "dissipated")
    largest = max(float(np.max(np.abs(run.dataset(f"energy/{name}")[:]), initial=0.0)) for name in names)
    if run.records("joints/reaction_torque"):  # which hold what does not move, and then turn by rounding errors
        largest = max(largest, float(np.max(np.abs(run.dataset("joints/reaction_torque")[:]), initial=0.0)))
    if (model := mechanism_of(run)) is None:
        return largest
    mass, inertia = np.array([(body.mass, body.inertia or 0.0) for body in model.bodies.values()]).T
    return max(largest, gravity_level(mass, inertia, np.asarray(model.gravity)))


def mechanism_size(run: Run) -> float:
    """Return the size of the mechanism at the start [m]: the width or height of its drawing, whichever is larger."""
    drawing = draw_run(run)
    pose = take(run.dataset("trajectory/position"), np.array([0], dtype=np.intp))
    return float(np.max(np.ptp(drawing.world(pose)[0], axis=0), initial=0.0))
