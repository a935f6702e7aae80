"""`compare`: the same quantity of several runs in one pair of axes."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from mbdkit.archive.result_seams import run_attribute
from mbdkit.archive.run import Run
from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.plain_data import Path as SpecPath
from mbdkit.base.plain_data import path_text
from mbdkit.base.text import did_you_mean, listed
from mbdkit.spec.run_spec import RunSpec
from mbdkit_report.figures.curves import require_rows
from mbdkit_report.figures.page_model import Figure, Line
from mbdkit_report.figures.quantity_text import count
from mbdkit_report.plot.caption import method, plain_name
from mbdkit_report.plot.charts import draw_on
from mbdkit_report.plot.plot_kinds import plot_module
from mbdkit_report.spec_words import key_unit, key_words, leaves

#: Largest number of lines in a comparison if no elements are named; each run has at least one line even if this number
#: is exceeded.
_LINES = 6
_ALL = 1_000_000
#: Largest number of differences in a label; if there are more, titles and file names are used instead.
_DIFFERENCES = 3


def compare(
    runs: Iterable[Run],
    *chosen: str | Axes,
    kind: str | None = None,
    ax: Axes | None = None,
    labels: Sequence[str] | None = None,
    **options: object,
) -> Axes:
    """Draw the same quantity of several runs in one pair of axes.

    Lines of the same joint, element, point or energy have the same colour; the dashes differ between runs. If there is
    only one joint, element, point or energy, each run has its own colour.

    Parameters
    ----------
    runs
        The runs.
    *chosen
        `kind` and `ax` may also be given without their names, in any order.
    kind
        ``trajectory`` (the default), ``drift``, ``energy``, ``reactions``, ``torques``, ``forces`` or ``beams``.
    ax
        Axes to draw on; by default those of a new figure.
    labels
        Names of the runs in the legend. By default, they show up to three differences: integrator, formulation,
        stabilization, step or other keys of the spec. Otherwise they are titles, names of files, identifiers or numbers
        of the runs.
    **options
        Options of the method of `Run.plot` of this kind, such as ``joints`` and ``components``. Unless elements are
        named, the few with the largest values in any of the runs are drawn.

    Returns
    -------
    matplotlib.axes.Axes
        `ax`, or the new axes.

    Raises
    ------
    SpecError
        If the kind, a name or an option is unknown, there is no run, one has no rows, or there are not as many labels
        as runs.
    TypeError
        If an argument is neither a kind nor axes, or one is given twice.
    NotRecordedError
        If a run did not record the quantity.

    Examples
    --------
    >>> import mbdkit
    >>> coarse, fine = (mbdkit.run("pendulum", time={"end": 1.0, "step": step}) for step in (0.02, 0.01))
    >>> axes = mbdkit.plot.compare([coarse, fine], kind="drift")
    >>> [text.get_text() for text in axes.get_legend().get_texts()]
    ['step 0.02 s', 'step 0.01 s']
    """
    for argument in chosen:
        if isinstance(argument, str) and kind is None:
            kind = argument
        elif isinstance(argument, Axes) and ax is None:
            ax = argument
        else:
            raise TypeError(
                f"compare takes one kind of plot and one pair of axes, such as compare(runs, kind='drift', ax=ax), "
                f"but not this {type(argument).__name__}"
            )
    found = list(runs)
    chart, heading = comparison(found, kind or "trajectory", labels, **options)
    return draw_on(ax, chart, heading, vary_dashes=len(found) > 1)


@run_attribute
def drawing(run: Run) -> Callable[..., Axes]:
    """Return the function that draws a plot of a run, of the given kind, on axes or on those of a new figure, and
    returns the axes; see `Run.plot`.
    """
    return lambda kind, ax=None, **options: draw_on(ax, comparison([run], kind, **options)[0])


def comparison(
    runs: Sequence[Run], kind: str, labels: Sequence[str] | None = None, **options: object
) -> tuple[Figure, str]:
    """Return the chart of several runs, and the title of its legend; see `compare`."""
    if not runs:
        raise SpecError("there is no run to draw")
    module = plot_module(kind)
    known = options_of(kind)
    for name in options:
        if name not in known:
            hint = did_you_mean(name, known)
            raise SpecError(f"the plot {kind!r} has no option {name!r}{hint}; its options are {listed(known)}")
    for run in runs:
        require_rows(run)
    names = list(labels) if labels is not None else differences(runs)
    if len(names) != len(runs):
        raise SpecError(f"there are {count(len(runs), 'run')}, but {count(len(names), 'label')}")
    if len(runs) == 1:
        return module.chart(runs[0], **options), ""
    few = max(1, _LINES // len(runs))
    limits = [{"most": most} if "most" in _parameters(kind) else {} for most in (few, _ALL)]
    wanted = {_group(line) for run in runs for line in module.chart(run, **options, **limits[0]).lines}
    charts = [module.chart(run, **options, **limits[1]) for run in runs]
    size = dict.fromkeys((_group(line) for line in charts[0].lines if _group(line) in wanted), 0.0)
    for line in (line for chart in charts for line in chart.lines if _group(line) in size):
        size[_group(line)] = max(size[_group(line)], float(np.max(np.nan_to_num(np.abs(line.y)), initial=0.0)))
    largest = sorted(size, key=lambda group: -size[group])[:few] if "joints" not in options else list(size)
    groups = [group for group in size if group in largest]
    first = next((one for one in charts if one.y.log), charts[0])  # if all values of a run are zero, its axis is linear
    lines = [
        _labelled(line, name, alone=len(groups) == 1)
        for name, chart in zip(names, charts, strict=True)
        for line in chart.lines
        if _group(line) in groups
    ]
    marks = tuple(dict.fromkeys(mark for chart in charts for mark in chart.marks))
    return replace(first, lines=tuple(lines), marks=marks), groups[0] if len(groups) == 1 else ""


def differences(runs: Sequence[Run]) -> list[str]:
    """Return a label for each run: the settings that distinguish it from the others.

    If no settings differ, more than three do, or the labels would not be unique, return the titles of the runs; if
    these are not unique either, the names of the files, the identifiers of the runs, or numbers.
    """
    settings = [_settings(run) for run in runs]
    keys = [*dict.fromkeys(key for setting in settings for key in setting)]
    keys = [key for key in keys if len({setting.get(key, _NONE).text for setting in settings}) > 1]
    if 0 < len(keys) <= _DIFFERENCES:
        found = [
            ", ".join(filter(None, _with_units([one.get(key, _NONE) for key in keys], run)))
            for one, run in zip(settings, runs, strict=True)
        ]
        if len(set(found)) == len(found):
            return found
    titles = [" ".join(str(run.spec.get("title") or "").split()) for run in runs]
    for found in (titles, [Path(run.path).stem if run.path else "" for run in runs], [run.run_id for run in runs]):
        if all(found) and len(set(found)) == len(found):
            return found
    return [f"run {number}" for number in range(1, len(runs) + 1)]


def options_of(kind: str) -> list[str]:
    """Return the names of the options of a kind of plot."""
    return [name for name in _parameters(kind) if name != "most"]


def _parameters(kind: str) -> list[str]:
    return list(inspect.signature(plot_module(kind).chart).parameters)[1:]


def _group(line: Line) -> str:
    return line.group or line.label


def _labelled(line: Line, name: str, *, alone: bool) -> Line:
    """Return a line whose label contains `name`, the name of its run.

    The label also contains the name of the element, unless all lines belong to the same element (`alone`).
    """
    if not alone:
        return replace(line, label=f"{line.label}, {name}")
    part = line.label.removeprefix(_group(line)).lstrip(", ")  # for example, a component
    return replace(line, label=f"{part}, {name}", group=part) if part else replace(line, label=name, group=name)


class _Setting(NamedTuple):
    """A setting of a run in words. If the setting is a number, `path` is its key in the spec, which gives the unit."""

    text: str
    path: SpecPath = ()


_NONE = _Setting("")


def _settings(run: Run) -> dict[str, _Setting]:
    """Return the settings of a run by key: first the method and the step in words, then all other keys of the spec
    except the title, the output, the limits and the check.
    """
    spec = run.spec
    step = spec.get("time", {}).get("step")
    found = {
        "integrator": _Setting(method(spec)),
        "formulation": _Setting(plain_name(spec.get("formulation"), "")),
        "stabilization": _Setting(plain_name(spec.get("stabilization"), "")),
        "step": _NONE if step is None else _Setting(f"step {step:g} s"),
    }
    told = ("integrator", "formulation", "stabilization", "title", "output", "limits", "check")
    for path, value in leaves({key: value for key, value in spec.items() if key not in told}):
        if path != ("time", "step"):
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            text = f"{value:g}" if is_number else str(value)
            found[path_text(path)] = _Setting(f"{key_words(path)} {text}", path if is_number else ())
    return found


def _with_units(settings: Sequence[_Setting], run: Run) -> list[str]:
    """Return settings of a run in words, in which numbers have units; units are left out if plugins are missing."""
    texts = [setting.text for setting in settings]
    if not any(setting.path for setting in settings):
        return texts
    try:
        spec = RunSpec(**run.spec)
    except MbdkitError:
        return texts
    units = [key_unit(setting.path, [spec]) if setting.path else "" for setting in settings]
    return [" ".join(filter(None, pair)) for pair in zip(texts, units, strict=True)]
