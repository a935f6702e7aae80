"""The report of an identification: estimates, data against fit, residuals, profiles, doubts, next experiment."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.special import ndtri

from mbdkit.plugin import counted, listed, plus_minus
from mbdkit.plugin.reports import (
    TONES,
    Axis,
    Band,
    Figure,
    Guide,
    Line,
    Mark,
    ReportPage,
    Section,
    Table,
    Verdict,
    View,
    band_over_time,
    bands,
    columns_of,
    environment,
    glance,
    methods,
    object_view,
    report_of_folder,
)
from mbdkit.plugin.specs import write_yaml
from mbdkit_identify.archive import FILE, load_identification
from mbdkit_identify.identification import Identification, Profile, Residuals

POINTS = 1_000  #: Largest number of points of a curve.
LAGS = 40  #: Largest lag of autocorrelations [samples].
SHOWN = 6  #: Largest number of estimates in the headline.
PLUS_MINUS = "\u00b1"
_TIME = Axis("time", "s")
_METHOD = (
    "Parameters, initial values and noise are estimated together by maximum likelihood. Noise is normal; if it is "
    "correlated in time, an autoregressive model of order 1 whitens the residuals. Bands contain the errors of the "
    "estimates and the noise."
)
_PROFILES = (
    "Limits of intervals are the values at which the sum of squares of the whitened residuals, minimized over all "
    "other unknowns, exceeds its minimum by the threshold (profile likelihood)."
)
_SOURCES = Path(__file__).with_name("references.bib").read_text(encoding="utf-8")


@report_of_folder
@contextmanager
def identification_report(path: Path, workers: int = 1) -> Iterator[ReportPage]:
    """Context manager that provides the report of an identification, which is read from its file."""
    result = load_identification(path)
    settings = (
        counted(len(result.parameters), "parameter"),
        counted(len({one.experiment for one in result.residuals}), "experiment"),
        f"{100 * result.level:g} % intervals",
        counted(result.evaluations[0], "run"),
    )
    own = methods([result.base], [_SOURCES])
    yield ReportPage(
        title=result.title or path.stem,
        settings=" \u00b7 ".join(settings),
        headline=(("verdict", result.verdict), *_headlines(result)),
        tone=TONES.get(result.verdict, ""),
        alarm=f"VERDICT: {result.verdict.upper()}" if result.verdict in ("doubtful", "bad") else "",
        verdict=_verdict(result),
        begins_with_verdict=True,
        glance=_glance(result),
        beside_verdict=("doubts", "estimates", "signals"),
        sections=_sections(result),
        methods=replace(own, paragraphs=(_METHOD, *[_PROFILES] * bool(result.profiles), *own.paragraphs)),
        environment=environment(FILE.origin(path), {}),
        reproduce="Save the spec below as identify.yaml, in a folder with its base and the files of the measured data.",
        commands="mbdkit identify identify.yaml --report",
        spec=write_yaml(dict(result.spec)),
        spec_file="identify.yaml",
    )


@object_view
def identification_view(result: Identification) -> View:
    """Return what notebooks show of an identification."""
    sentences = (f"Verdict {result.verdict}", *(doubt.text for doubt in result.doubts), *result.combinations)
    tables = (_estimates(result), _signals(result))
    title = f"Identification: {result.title}" if result.title else "Identification"
    return View(title, sentences, TONES.get(result.verdict, ""), tables=tables)


def _glance(result: Identification) -> Section:
    signals = dict.fromkeys(one.quantity for one in result.residuals)
    asked = f"{listed(list(result.estimates), 'and')}, from measured {listed(list(signals), 'and')}"
    return glance(asked, result.verdict, [doubt.text for doubt in result.doubts], result.base)


def _verdict(result: Identification) -> Verdict:
    reasons = counted(len(result.doubts), "finding")
    sentence = f"The result is {result.verdict}{f', because of {reasons}' if result.doubts else ''}."
    doubts = tuple((doubt.text, doubt.place, *doubt.strength) for doubt in result.doubts)
    tables = (Table("doubts", "Reasons", columns_of("finding; place; statistic; limit"), doubts),) if doubts else ()
    figures = (*_charts(result), *_profiles(result))
    tables = (*tables, _estimates(result), _signals(result))
    return Verdict("identification", "Identification", sentence, (), tables, figures, result.notes)


def _headlines(result: Identification) -> Iterator[tuple[str, str]]:
    for one in [*result.estimates.values()][:SHOWN]:
        value = plus_minus(one.value, one.deviation) if np.isfinite(one.deviation) else f"{one.value:.6g}"
        text = f"{value.replace('+-', PLUS_MINUS)} {one.unit}".rstrip()
        yield one.name, text if one.identifiable else "not determined by the data"


def _estimates(result: Identification) -> Table:
    level = f"{100 * result.level:g} %"
    columns = columns_of(f"name; value and standard deviation; {level} from; to; unit")
    rows = tuple(tuple(cell.replace("+-", PLUS_MINUS) for cell in row) for row in result.rows())
    return Table("estimates", "Estimates", columns, rows)


def _signals(result: Identification) -> Table:
    headings = "experiment; quantity; used for; rms error; unit; share in the band; noise; correlation of noise"
    rows = tuple(
        (
            *(one.experiment, one.quantity, "prediction" if one.is_hold_out else "fit"),
            *(one.rms, one.unit, one.covered, one.deviation, one.correlation),
        )
        for one in result.residuals
    )
    note = "Noise: its standard deviation, and its correlation from sample to sample."
    return Table("signals", "Signals", columns_of(headings), rows, note)


def _sections(result: Identification) -> tuple[Section, ...]:
    sections = [Section("determined", "What the data determine", result.combinations)] if result.combinations else []
    if (following := result.next_experiment) is not None:
        known = result.estimates
        names = [f"{name} [{known[name].unit}]" if name in known else name for name in following.half_widths[""]]
        headings = "; ".join(["candidate", *names])
        rows = tuple(
            (name or "present", *(width if np.isfinite(width) else "no limit" for width in widths.values()))
            for name, widths in following.half_widths.items()
        )
        table = Table("next", "Expected half widths of the intervals", columns_of(headings), rows)
        sentence = f"The experiment '{following.best}' narrows the interval of {following.narrows} most."
        sections.append(Section("following", "The next experiment", (sentence,), tables=(table,)))
    return tuple(sections)


def _charts(result: Identification) -> Iterator[Figure]:
    """Yield data against fit beside the whitened residuals for each signal, then autocorrelations of all signals."""
    level = f"{100 * result.level:g} %"
    limit = float(ndtri(0.5 + result.level / 2))
    signals = [f"{one.quantity} in {one.experiment}" for one in result.residuals]
    for number, (one, signal) in enumerate(zip(result.residuals, signals, strict=True), 1):
        told = "predicted" if one.is_hold_out else "fitted"
        yield Figure(
            f"fit-{number}", f"Measured and {told}: {signal}",
            f"Shaded: band of {level}, in which {100 * one.covered:.0f} % of the measured values lie."
            f"{' These data did not affect the parameters.' * one.is_hold_out}",
            _TIME, Axis(one.quantity, one.unit), tuple(_fit_lines(one, told)),
        )  # fmt: skip
        yield Figure(
            f"residuals-{number}", f"Whitened residuals: {signal}",
            f"If model and noise are right, {level} of them lie in the shaded band, without a pattern.",
            _TIME, Axis("whitened residual"), (_curve("whitened residual", one.time, one.white, "points"),),
            bands=(Band(f"{level} of white noise", -limit, limit),),
        )  # fmt: skip
    for number, (one, signal) in enumerate(zip(result.residuals, signals, strict=True), 1):
        correlation = autocorrelation(one.white)
        bound = limit / np.sqrt(len(one.white))
        yield Figure(
            f"autocorrelation-{number}", f"Autocorrelation of the whitened residuals: {signal}",
            f"If model and noise are right, {level} of the points lie in the shaded band.",
            Axis("lag", "samples"), Axis("autocorrelation"),
            (Line("autocorrelation", np.arange(1.0, len(correlation) + 1), correlation, "both"),),
            bands=(Band(f"{level} of white noise", -bound, bound),),
        )  # fmt: skip


def _fit_lines(one: Residuals, label: str) -> Iterator[Line]:
    fitted = bands(one.time, one.fitted[:, None], points=POINTS)
    width = np.interp(fitted.time, one.time, one.band)
    outline = band_over_time(fitted.time, fitted.low[:, 0], fitted.high[:, 0], width)
    yield _curve("measured", one.time, one.measured, "points")
    yield Line(label, *fitted.curve(0), band=outline)


def _curve(label: str, time: np.ndarray, values: np.ndarray, kind: str) -> Line:
    return Line(label, *bands(time, values[:, None], points=POINTS).curve(0), kind)  # type: ignore[arg-type]


def autocorrelation(values: np.ndarray) -> np.ndarray:
    """Return the autocorrelation of values (T,) at the lags 1, 2, ... up to a quarter of them, at most `LAGS`."""
    centred = values - np.mean(values)
    total = float(centred @ centred) or 1.0
    return np.array([centred[:-lag] @ centred[lag:] / total for lag in range(1, min(LAGS, len(values) // 4) + 1)])


def _profiles(result: Identification) -> Iterator[Figure]:
    level = f"{100 * result.level:g} %"
    for number, one in enumerate(result.profiles.values(), 1):
        estimate = result.estimates[one.name]
        x, y = smooth_profile(one, estimate.value)
        marks = [Mark("", at) for at in (estimate.lower, estimate.value, estimate.upper) if np.isfinite(at)]
        yield Figure(
            f"profile-{number}", f"Profile of {one.name}",
            "Increase of the sum of squares of the whitened residuals, minimized over all other unknowns. Points were "
            f"computed. Vertical lines: estimate and limits of {level}, which the integration error moves outwards.",
            Axis(one.name, estimate.unit), Axis("increase"),
            (Line("profile", x, y), Line("computed", one.values, one.costs, "points", group="profile")),
            marks=tuple(marks), guides=(Guide("threshold", x[[0, -1]], np.full(2, one.threshold)),),
        )  # fmt: skip


def smooth_profile(profile: Profile, best: float) -> tuple[np.ndarray, np.ndarray]:
    """Return values and increases of a profile with an estimate, interpolated between those that were computed.

    The signed root of the increase is interpolated, which is a straight line for a linear model; see D. M. Bates,
    D. G. Watts, Nonlinear Regression Analysis and Its Applications (1988), 6.1.
    """
    known = np.isfinite(profile.costs)
    values, costs = profile.values[known], profile.costs[known]
    if len(values) < 2:
        return values, costs
    x = np.linspace(values[0], values[-1], 201)
    root = PchipInterpolator(values, np.sign(values - best) * np.sqrt(np.maximum(costs, 0.0)))(x)
    return x, root**2
