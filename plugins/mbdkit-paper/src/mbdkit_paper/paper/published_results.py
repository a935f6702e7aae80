"""Published results of the paper: paths of the end point (Fig. 3) and misalignment over the steps (Fig. 4)."""

from __future__ import annotations

import math

import numpy as np

from mbdkit.archive.run import Run
from mbdkit_paper.wording import Words
from mbdkit_report import Answer, Cell, Claim, Column, Figure, Line, Range, Table, columns_of, exceeds, together
from mbdkit_studies import METHOD, MODEL, STEP, Points, Study, StudyPoint, family, value

GILL, GAUSS2, GAUSS3 = "RK-Gill", "Gauss 2", "Gauss 3"
#: The methods of the paper. Methods that were added to the study appear in its tables and figures, not in claims.
METHODS = (GILL, GAUSS2, GAUSS3)

#: Misalignment stated in the paper [m], by model and method.
PUBLISHED = {("single", GAUSS2): 1e-6, ("double", GAUSS2): 1e-5, ("single", GAUSS3): 1e-10, ("double", GAUSS3): 1e-8}
FACTOR = 3.0
OVERFLOWED = ("fell-apart", "not-finite")  #: Codes of failure of runs whose joints fell apart or numbers overflowed.
PAPER_STEP = 0.1

VISIBLE = 0.01
#: Distances between two paths above this share of the length of the pendulum are visible in a figure.
WORDS = Words(__file__)


def methods_of(points: Points) -> tuple[str, ...]:
    """Return the methods of the paper, and then others that points have."""
    return tuple(dict.fromkeys((*METHODS, *map(str, points.labels(METHOD)))))


def magnitudes(study: Study) -> tuple[Claim, Table]:
    """Compare the four published misalignments with the computed ones."""
    points = family(study, "published")
    rows: list[tuple[Cell, ...]] = []
    answers, computed = [], []
    for (model, method), published in PUBLISHED.items():
        result = points.at({MODEL: model, METHOD: method}).value("misalignment_max")
        answers.append(Range.around(published, FACTOR).holds(result))
        computed.append(f"{result:.1e} m ({model} pendulum, {method})")
        rows.append((model, method, published, result, result / published, str(answers[-1])))
    number = sum(answer is Answer.YES for answer in answers)
    claim = WORDS.claim("magnitudes", together(answers), computed=", ".join(computed), number=number, factor=FACTOR)
    return claim, WORDS.table("magnitudes", rows)


def ranking(study: Study) -> tuple[Claim, Claim, Table]:
    """Test for every model and step whether RK-Gill is the worst method, and whether Gauss 3 is better than Gauss 2."""
    groups: dict[tuple[str, float], dict[str, StudyPoint]] = {}
    for name in ("published", "joints", "knee", "steps", "precision", "one-metre"):
        for point in family(study, name):
            method = str(point.axes[METHOD])
            if method in METHODS:
                groups.setdefault((_model(point), float(point.axes.get(STEP, PAPER_STEP))), {})[method] = point
    rows: list[tuple[Cell, ...]] = []
    worst, best, exceptions = [], [], []
    for model in dict.fromkeys(model for model, _ in groups):
        for step in sorted((step for name, step in groups if name == model), reverse=True):
            cell = groups[model, step]
            values = [value(cell[method], "misalignment_max") if method in cell else math.nan for method in METHODS]
            gill, two, three = values
            is_worst = together([exceeds(gill, two), exceeds(gill, three)])
            if GILL in cell and cell[GILL].reason.startswith(OVERFLOWED) and not math.isnan(max(two, three)):
                is_worst = Answer.YES
            worst.append(is_worst)
            best.append(exceeds(two, three))
            if is_worst in (Answer.NO, Answer.PARTLY):
                exceptions.append(
                    f"{model}, step {step:g} s, with a misalignment of at least {min(values):.1g} m with all methods"
                )
            rows.append((model, step, *values, str(is_worst), str(best[-1])))
    columns = (Column("model"), Column("step", "s"), *(Column(method, "m") for method in METHODS))
    columns += columns_of("RK-Gill worst; Gauss 3 better than Gauss 2")
    but = f" Exceptions: {'; '.join(exceptions)}." if exceptions else ""
    gill_worst = _counted("gill-worst", worst, exceptions=but)
    return gill_worst, _counted("gauss3-better", best), WORDS.table("ranking", rows, columns)


def _counted(name: str, answers: list[Answer], **values: object) -> Claim:
    """Return a claim on pairs of model and step with one answer for each."""
    yes, decided = answers.count(Answer.YES), len(answers) - answers.count(Answer.OPEN)
    rest = f" ({len(answers) - decided} more are undecided because runs failed)" if decided < len(answers) else ""
    answer = together([answer for answer in answers if answer is not Answer.OPEN])
    return WORDS.claim(name, answer, yes=yes, decided=decided, undecided=rest, **values)


def _model(point: StudyPoint) -> str:
    if "model.n" in point.axes:
        rods = int(point.axes["model.n"])
        return f"{rods} rods of 20 m" if rods > 1 else "1 rod of 20 m"
    if "model.springs" in point.axes:
        return f"knee, {point.axes['model.springs']}"
    rods = {"single": 1, "double": 2}.get(str(point.axes.get(MODEL)), 1 if point.family == "steps" else 2)
    length = 1 if point.family == "one-metre" else 20
    return f"{rods} rod{'s' if rods > 1 else ''} of {length} m" + (", from the horizontal" if length == 1 else "")


def end_point(run: Run) -> np.ndarray:
    """Return the path (T, 2) [m] of the free end of the last rod of a chain."""
    model = run.spec["model"]
    length = model["length"] if "length" in model else model["lengths"][-1]
    rod = run[list(run.bodies)[-1]]
    return np.asarray(rod.position + 0.5 * length * np.stack([np.cos(rod.angle), np.sin(rod.angle)], axis=1))


def trajectories(study: Study) -> tuple[Claim, tuple[Figure, ...], tuple[Figure, ...]]:
    """Return the claim that the paths depend on the method, and the figures of the paths and of the misalignments."""
    paths, drifts = [], []
    apart: dict[str, float] = {}
    for name, model in (("published", "single"), ("published", "double"), ("one-metre", "double")):
        points = family(study, name).at({MODEL: model} | ({STEP: 0.1} if name == "one-metre" else {}))
        path: dict[str, np.ndarray] = {}
        histories: dict[str, dict[str, np.ndarray]] = {}
        for point in points:
            run = study.run(point)
            if run is not None:
                with run:
                    method, joints = str(point.axes[METHOD]), run.joints.items()
                    path[method], histories[method] = end_point(run), {name: one.misalignment for name, one in joints}
        size = 1.0 if name == "one-metre" else 20.0
        size *= 2 if model == "double" else 1
        apart[f"{name} {model}"] = _apart({method: path[method] for method in METHODS if method in path}) / size
        label = model if name == "published" else f"{model}-one-metre"
        paths.append(_path_figure(label, path, size))
        if name == "published":
            drifts.append(_drift_figure(model, histories))
    single, double, metre = apart.values()
    answers = [exceeds(double, VISIBLE), exceeds(metre, VISIBLE)]
    claim = WORDS.claim("paths", together(answers), double=double, metre=metre, single=single)
    return claim, tuple(paths), tuple(drifts)


def _apart(path: dict[str, np.ndarray]) -> float:
    """Return the largest distance between the paths of two methods at equal times, up to the end of a failed run.

    The distance is nan unless there is a path for each of the three methods.
    """
    paths = list(path.values())
    distances = [0.0]
    for i, one in enumerate(paths):
        for other in paths[:i]:
            rows = min(len(one), len(other))
            distance = np.linalg.norm(one[:rows] - other[:rows], axis=1)
            distances.append(float(np.max(distance[np.isfinite(distance)], initial=0.0)))
    return max(distances) if len(paths) == len(METHODS) else math.nan


def _path_figure(label: str, path: dict[str, np.ndarray], size: float) -> Figure:
    lines = []
    for method, points in path.items():
        shown = np.where(np.abs(points) <= 1.5 * size, points, np.nan)  # points out of reach are not drawn
        lines.append(Line(method, shown[:, 0], shown[:, 1], "line", method))
    model = label.removesuffix("-one-metre")
    what = (
        "rods of 1 m, released from the horizontal" if label != model else "rods of 20 m, released 40 degrees below it"
    )
    return WORDS.figure("trajectory", lines, f"trajectory-{label}", equal=True, model=model, what=what)


def _drift_figure(model: str, histories: dict[str, dict[str, np.ndarray]]) -> Figure:
    lines = [
        Line(f"{method}, {joint}", np.arange(len(history)), np.where(history > 0, history, np.nan), "line", method)
        for method, joints in histories.items()
        for joint, history in joints.items()
    ]
    return WORDS.figure("drift", lines, f"drift-{model}", model=model)
