"""Summarizes a run in a few lines of plain text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, cast

import numpy as np

from mbdkit.archive import layout, result_seams
from mbdkit.archive.accuracy_summary import asked_sentence, limit_sentence
from mbdkit.archive.headlines import JOINTS_NAMED, ROUND_OFF, headlines, joint_loads, measured
from mbdkit.archive.run import Run
from mbdkit.base.errors import PluginError
from mbdkit.base.text import counted, plus_minus, shown
from mbdkit.mechanism.beams import beam_of
from mbdkit.mechanism.mechanism import gravity_text
from mbdkit.registry.catalogue import Registered
from mbdkit.registry.feature_items import SummaryLine
from mbdkit.registry.manager import registry, use
from mbdkit.spec.formulation_choice import name_of
from mbdkit.trust.criteria import rounding

#: Largest number of events listed.
EVENTS_NAMED = 4
#: The summary reports the distance from a singular position if it is below this value.
SINGULAR = 0.1

_LEAST_NORM = "; reactions are not unique; those of least norm are recorded"

_COUNTERS = {
    "rhs_evaluations": "right-hand sides",
    "jacobian_evaluations": "Jacobians",
    "factorizations": "factorizations",
    "newton_iterations": "iterations",
    "projections": "projections",
    "rejected": "rejections",
    "host_evaluations": "right-hand sides by mbdkit for work and integrals",
}


def summary(run: Run) -> str:
    """Return the summary of a run, from its verdict and measures to its counters and the path of its archive."""
    return "\n".join(f"{label:<13} {shown(text)}" for label, text in summary_lines(run))


def summary_lines(run: Run) -> list[tuple[str, str]]:
    """Return the lines of the summary of a run, each with its label; continuation lines have none."""
    spec = run.spec
    first = [
        *verdict_lines(run),
        ("run", " ".join(str(spec.get("title") or "").split())),
        *answer_lines(run),
        ("accuracy", run.errors.sentence(with_force=not _states_forces(run))),
        ("limited", limit_sentence(run)),
        ("asked", asked_sentence(run)),
        ("status", ": ".join(filter(None, (run.status, run.status_reason.removeprefix("interrupted: "))))),
        ("model", ", ".join((_named(spec, "model"), *_elements(run)))),
        ("gravity", _gravity(spec)),
        ("redundancy", run.redundancy and f"{run.redundancy}{_LEAST_NORM}"),
        ("start", _start(run)),
        ("integrator", _method(spec) if "integrator" in spec else ""),
        ("evidence", str(run.provenance.get(layout.EVIDENCE, ""))),
        ("stabilization", _stabilization(run)),
        *(("warning", warning) for warning in run.warnings if warning not in run.verdict_reasons),
        ("time", _time(run)),
        ("speed", _speed(run.stats)),
        ("misalignment", _misalignment(run)),
        ("singularity", _singularity(run)),
        ("energy", _energy(run)),
        ("drivers", _drivers(run)),
    ]
    last = [
        ("impacts", _impacts(run)),
        ("events", _events(run)),
        *_gradients(run),
        ("counters", _counters(run.stats)),
        ("archive", "in memory" if run.path is None else str(run.path)),
    ]
    added = [line for item in registry().of_kind("summary-line") for line in _added_lines(run, item)]
    return [(label, text) for label, text in [*first, *added, *last] if text]


def _states_forces(run: Run) -> bool:
    """Return whether the headlines state the largest force as the sentence on the errors would."""
    return not run.measures and run.spec_kind.is_integrated and run.accuracy is not None and run.accuracy.is_complete


def _added_lines(run: Run, item: Registered) -> list[tuple[str, str]]:
    """Return the lines of an item; if it fails, a line says so, because the run itself is not affected."""
    own = cast(SummaryLine, item.plugin)
    if (own.of and run.spec_kind.name not in own.of) or (own.group and own.group not in run.kinds):
        return []
    try:
        lines = use(item, lambda: list(result_seams.summary_lines.of(own.text)(run)))
        if all(isinstance(line, tuple) and [type(text) for text in line] == [str, str] for line in lines):
            return lines
        raise PluginError(f"the summary line '{item.id}' returned lines that are not pairs of label and text")
    except PluginError as error:
        return [(item.name, f"not available: {error}")]


def verdict_lines(run: Run) -> list[tuple[str, str]]:
    """Return the verdict on a run and its reasons as labelled lines; reasons after the first have no label."""
    if not run.is_judged:
        why = "the run did not end" if run.status == "running" else "the archive has none"
        return [("verdict", f"unknown: {why}")]
    first, *others = run.verdict_reasons or [run.errors.without_suspicion]
    if run.verdict == "unknown":
        others = [*others, run.errors.never_good]
    return [("verdict", f"{run.verdict}: {first}"), *(("", other) for other in others if other)]


def few(texts: Sequence[str], separator: str = "; ", most: int = JOINTS_NAMED) -> str:
    """Return the first texts, and how many others there are."""
    more = [f"{len(texts) - most} more"] if len(texts) > most else []
    return separator.join([*texts[:most], *more])


def ranked(parts: Iterable[tuple[float, str]]) -> list[str]:
    """Return texts in the descending order of the numbers before them."""
    return [text for _, text in sorted(parts, key=lambda part: -part[0])]


def _named(spec: Mapping[str, Any], kind: str) -> str:
    return str(spec.get(kind, {}).get("name", "unknown"))


def _gravity(spec: Mapping[str, Any]) -> str:
    if (gravity := spec.get("model", {}).get("gravity")) is None:
        return ""
    is_number = all(isinstance(part, int | float) for part in gravity)
    return gravity_text(gravity) if is_number else f"({', '.join(map(str, gravity))}), as in the spec"


def _start(run: Run) -> str:
    assembly = str(run.provenance.get("assembly", ""))
    moved = assembly.removeprefix("The start was made consistent; ")
    return moved.rstrip(".") if moved != assembly else ""


def _method(spec: Mapping[str, Any]) -> str:
    step, formulation = spec.get("time", {}).get("step"), spec.get("formulation")
    parts = [_named(spec, "integrator"), *_options(spec.get("integrator", {}))]
    parts += [] if step is None else [f"step {step:g} s"]
    return ", ".join([*parts, *([] if formulation is None else [name_of(formulation)])])


def _options(chosen: Mapping[str, object]) -> list[str]:
    """Return the options of an item as text; those of an item that it names are in parentheses."""
    given = {key: value for key, value in chosen.items() if key != "name" and value is not None}
    return [f"{key} {_nested(value) if isinstance(value, Mapping) else value}" for key, value in given.items()]


def _nested(chosen: Mapping[str, object]) -> str:
    options = ", ".join(_options(chosen))
    return f"{chosen.get('name')} ({options})" if options else f"{chosen.get('name')}"


def _stabilization(run: Run) -> str:
    chosen = run.spec.get("stabilization") or "none"
    if not isinstance(chosen, Mapping):
        return "" if chosen == "none" else str(chosen)
    options = {key: value for key, value in chosen.items() if key != "name" and value not in (None, False)}
    words = [str(chosen.get("name"))]
    words += [key if value is True else f"{key} {value}" for key, value in options.items()]
    return "; ".join(filter(None, (", ".join(words), corrections(run))))


def corrections(run: Run) -> str:
    """Describe the number and the largest size of the corrections of a stabilized run; empty if none were recorded."""
    parts = []
    if run.records("steps/projections"):
        steps = run.steps
        parts.append(counted(int(np.sum(steps.projections)), "projection"))
        most = (np.max(x, initial=0.0) for x in (steps.position_correction, steps.velocity_correction))
        parts.append("moved by at most {:.3g} m and {:.3g} m/s".format(*most))
    if run.records("steps/acceleration_correction"):
        parts.append(f"terms of at most {np.max(run.steps.acceleration_correction, initial=0.0):.3g} m/s^2")
    return ", ".join(parts)


def _time(run: Run) -> str:
    rows = len(run.time)
    if rows == 0:
        return "no row recorded"
    steps = run.stats.get("steps")
    taken = "" if steps is None or not run.spec_kind.is_integrated else f", {counted(int(steps), 'step')}"
    return f"{run.time[0]:g} to {run.time[-1]:g} s{taken}, {counted(rows, 'row')}"


def _speed(stats: Mapping[str, int | float]) -> str:
    """Return the time of the steps, without that of integrals and extrema, and the times of the other parts."""
    if "wall_s" not in stats:
        return ""
    steps, spent = stats.get("steps", 0), stats["wall_s"] - stats.get("integrals_s", 0.0)
    each = f" ({_seconds(spent / steps)} a step)" if steps else ""
    others = (("setup_s", "setup"), ("integrals_s", "integrals and extrema"), ("check_s", "check"))
    return f"{_seconds(spent)}{each}" + "".join(f", {word} {_seconds(stats[x])}" for x, word in others if x in stats)


def _seconds(value: float) -> str:
    unit, factor = ("s", 1.0) if value >= 1.0 else ("ms", 1e3) if value >= 1e-3 else ("us", 1e6)
    return f"{value * factor:.3g} {unit}"


def _misalignment(run: Run) -> str:
    if not run.joints or math.isnan(run.misalignment_max):
        return ""
    worst = sorted(run.joints.values(), key=lambda joint: -joint.misalignment_max)
    named = few([f"{joint.name} {joint.misalignment_max:.2g}" for joint in worst], ", ")
    return f"{run.misalignment_max:.3g} m at most ({named}){_angles(run)}"


def _angles(run: Run) -> str:
    if not run.records("joints/angle_misalignment") or len(run.time) == 0:
        return ""
    largest = np.max(np.abs(run.array("joints/angle_misalignment")), axis=0)
    worst = int(np.argmax(largest))
    return f"; {largest[worst]:.3g} rad ({run.joint_names[worst]})" if largest[worst] > 0 else ""


def _singularity(run: Run) -> str:
    """Return the smallest distance from a singular position; empty if it is not small, or hardly below the largest."""
    path = "constraints/singularity_distance"
    if not run.records(path) or len(run.time) == 0:
        return ""
    distance = run.array(path)
    row = int(np.argmin(distance))
    if distance[row] > SINGULAR or distance[row] > 0.5 * float(np.max(distance)):
        return ""
    return f"distance {distance[row]:.2g} at {run.time[row]:g} s, maximum {float(np.max(distance)):.2g}"


def _energy(run: Run) -> str:
    if not run.records("energy/balance") or len(run.time) == 0:
        return ""
    drift = float(np.max(np.abs(run.energy.balance)))
    most = float(np.max(run.energy.kinetic))
    largest = max(drift, *(float(np.max(np.abs(run.array(f"energy/{kind}")))) for kind in ("potential", "work")))
    # The verdict also uses the kinetic energy in steps that are not recorded, and states the share if it is large.
    recorded = "" if len(run.time) > run.stats.get("steps", 0) else "recorded "
    is_stated = recorded and any("of the largest kinetic energy" in reason for reason in run.verdict_reasons)
    share = f", {drift / most:.2g} of the largest {recorded}kinetic energy" if most > 0.0 else ""
    return f"balance within {drift:.3g} J{share if most > rounding(largest) and not is_stated else ''}"


def _drivers(run: Run) -> str:
    if not run.drivers or not run.records("joints/reaction_torque") or len(run.time) == 0:
        return ""
    forces, torques = (joint_loads(run, kind) for kind in ("force", "torque"))
    floor = ROUND_OFF * max((headline.value for headline in (*forces, *torques)), default=0.0)
    parts = []
    for largest in (torques, forces):
        own = [headline for headline in largest if headline.element in run.drivers and headline.value > floor]
        parts += [
            f"{headline.label} {headline.text()}{'' if headline.misses else f' at {headline.time:.4g} s'}"
            for headline in own[:1]
        ]
    return "; ".join(parts)


class ImpactSummary(NamedTuple):
    """Which impacts (I,) are meant, and two texts: their numbers, in total and for each name, and the lost energy."""

    chosen: np.ndarray
    numbers: str
    energy: str


def summarize_impacts(run: Run, *, of_drivers: bool) -> ImpactSummary | None:
    """Return a summary of the impulses of drivers, which have no impulses of their own, or else of the other impacts of
    a run; None if there are none.
    """
    impacts = run.impacts
    has_none = (impacts.normal_impulse == 0.0) & (impacts.tangential_impulse == 0.0)
    some = (has_none & np.isin(impacts.contact.astype(str), list(run.drivers))) == of_drivers
    if not np.any(some):
        return None
    names, counts = np.unique(impacts.contact[some].astype(str), return_counts=True)
    each = few([f"{name} {count}" for name, count in zip(names, counts, strict=True)], ", ")
    # all impacts at one time have the same entry, the energy lost by all of them
    lost = impacts.energy_lost[some][np.unique(impacts.time[some], return_index=True)[1]].sum()
    change = f"{lost:.4g} J lost" if lost >= 0.0 else f"{-lost:.4g} J supplied"
    return ImpactSummary(some, f"{np.count_nonzero(some)} ({each})", change)


def _impacts(run: Run) -> str:
    impacts, summary_of = run.impacts, summarize_impacts(run, of_drivers=True)
    if summary_of is None:
        return ""
    some, who, change = summary_of
    force = np.max(np.linalg.norm(impacts.reaction_impulse[some], axis=2))
    torque = np.max(np.abs(impacts.reaction_torque_impulse[some]))
    size = f"{force:.4g} N s and {torque:.4g} N m s"
    return f"{who}, impulses of joints up to {size}, {change}; their forces do not include impulses"


def _events(run: Run) -> str:
    parts = []
    for name in run.spec.get("events") or ():
        times = run.events.of_name(name).time
        often = f"{len(times)} times from {times[0]:.10g} s on" if len(times) else "never"
        parts.append(f"{name} {f'once at {times[0]:.10g} s' if len(times) == 1 else often}")
    return few(parts, ", ", EVENTS_NAMED)


def answer_lines(run: Run) -> list[tuple[str, str]]:
    """Return a line for each measure, with its value and unit or the reason why it has none; without measures, the
    headlines. Further lines name an error that the error bars do not include, and say when a run stopped early.
    """
    lines: list[tuple[str, str]] = []
    for one in measured(run):
        name = one.label
        text = one.text() if math.isfinite(one.value) else run.measures.reasons.get(name, "undefined")
        remark = f" ({run.measures.remarks[name]})" if name in run.measures.remarks else ""
        lines.append(("" if lines else "measures", f"{name} {text}{remark}"))
    answer = "; ".join(f"{headline.label} {headline.answer()}" for headline in headlines(run)) if not lines else ""
    lines = lines or ([("answer", answer)] if answer else [])
    if (excluded := run.errors.excluded) and any(" +- " in text for _, text in lines):
        lines.append(("", f"error bars do not include {excluded}"))
    if lines and len(run.time) and run.status in ("failed", "interrupted"):
        lines.append(("", f"these values cover the motion until t = {run.time[-1]:.6g} s, at which the run stopped"))
    return lines


def _elements(run: Run) -> list[str]:
    """Return the numbers of bodies, beams, joints and drivers, counted as by `mbdkit validate`.

    Nodes of recorded beams do not count as bodies, and drivers do not count as joints.
    """
    nodes = [beam for beam in map(beam_of, run.bodies) if beam and beam in run.beams]
    beams, bodies = set(nodes), len(run.bodies) - len(nodes)
    return [
        *([counted(bodies, "body", "bodies")] if bodies or not beams else []),
        *([counted(len(beams), "beam")] if beams else []),
        counted(len(run.joints) - len(run.drivers), "joint"),
        *([counted(len(run.drivers), "driver")] if run.drivers else []),
    ]


def derivative_texts(gradient: Mapping[str, Any], sign: str = "+-") -> Iterator[tuple[str, str]]:
    """Yield each parameter of an entry of `Run.gradients`, and the derivative with its error as text."""
    errors = gradient.get("errors", {})
    for parameter, value in gradient.get("derivatives", {}).items():
        error = errors.get(parameter)
        error = math.nan if error is None else error
        yield parameter, "undefined" if value is None else plus_minus(value, error, sign)


def _gradients(run: Run) -> list[tuple[str, str]]:
    lines: list[tuple[str, str]] = []
    for name, gradient in run.gradients.items():
        texts = [gradient["reason"]] if "reason" in gradient else []
        texts += [f"by {parameter}: {text}" for parameter, text in derivative_texts(gradient)]
        lines += [("" if lines or i else "gradients", f"{name} {text}") for i, text in enumerate(texts)]
    doubts = dict.fromkeys(doubt for gradient in run.gradients.values() for doubt in gradient.get("doubts", ()))
    return [*lines, *(("", doubt) for doubt in doubts)]


def _counters(stats: Mapping[str, int | float]) -> str:
    return ", ".join(f"{stats[name]} {words}" for name, words in _COUNTERS.items() if stats.get(name))
