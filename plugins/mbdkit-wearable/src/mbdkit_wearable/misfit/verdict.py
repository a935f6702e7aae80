"""Verdict on the packaged study `misfit`: which misfit matters, where self-alignment pays, and what tissue costs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml

from mbdkit import Study
from mbdkit.plugin import MbdkitError
from mbdkit.plugin.reports import Answer, Axis, Claim, Figure, Line, Table, Verdict, columns_of
from mbdkit.plugin.studies import study_verdict
from mbdkit_wearable.misfit.study import DEVICES, MOTIONS, VARIABLES

#: Words for the variables.
WORDS = dict(zip(VARIABLES, ("forward", "upward", "rotation", "tissue"), strict=True))
#: Texts of the claims by name.
TEXTS: dict[str, dict[str, str]] = yaml.safe_load(Path(__file__).with_name("words.yaml").read_text("utf-8"))
BINS = 8  #: Number of intervals of a variable in which figures show the median of a measure.

#: Offsets [m] count as large above the first distance, and as small below the second one.
LARGE, SMALL = 0.02, 0.01


@study_verdict
def verdict(study: Study) -> Verdict:
    """Return the verdict on the packaged study `misfit`, complete or not."""
    samples = {(motion, device): Sample(study, f"{motion}-{device}") for motion in MOTIONS for device in DEVICES}
    rows = [(motion, device, *sample.row()) for (motion, device), sample in samples.items()]
    heads = "motion; device; median added force [N]; 95 % quantile [N]; median shear [N]; median help transmitted [%]"
    columns = columns_of("; ".join([heads, *(f"S_T {word}" for word in WORDS.values())]))
    note = (
        "Added force: the largest force in the knee that the device causes. Help transmitted: the moment that reaches "
        "the knee, relative to that of the spring of the device at the angle of the knee. S_T: total Sobol indices of "
        "the added force; empty where unknown."
    )
    table = Table("misfit", "Misfit by motion and device", columns, tuple(rows), note, headline=True)
    compared = (_growth(samples), _direction(samples), _self_alignment(samples), _tissue(samples))
    claims = tuple(map(_claim, TEXTS, compared))
    summary = " ".join(claim.sentence for claim in claims if claim.answer is not Answer.OPEN)
    return Verdict("misfit", "Misfit of orthoses of the knee", summary, claims, (table,), tuple(_figures(samples)), ())


class Sample:
    """The runs of one device in one motion."""

    def __init__(self, study: Study, family: str):
        self.study, self.family = study, family
        columns = study.columns()
        own = (columns["family"] == family) & (columns["status"] == "complete")
        self.values = {name: np.asarray(columns[name], float)[own] for name in (*VARIABLES, "added", "transmitted")}
        shears = [np.asarray(columns[f"shear_{limb}"], float)[own] for limb in ("thigh", "shank")]
        self.values["shear"] = np.maximum(*shears) if np.any(own) else np.zeros(0)

    @property
    def count(self) -> int:
        """Number of complete runs."""
        return len(self.values["added"])

    def median(self, measure: str, rows: np.ndarray | None = None) -> float:
        """Return the median of a measure in a selection of runs, nan without runs."""
        values = self.values[measure] if rows is None else self.values[measure][rows]
        return float(np.median(values)) if len(values) else np.nan

    @property
    def offset(self) -> np.ndarray:
        """Distance of the device from where it fits [m]."""
        return np.asarray(np.hypot(self.values["parameters.forward"], self.values["parameters.upward"]))

    def totals(self) -> dict[str, float]:
        """Return the total Sobol indices of the added force by variable; nan where unknown."""
        try:
            found = self.study.sensitivity("added", where={"family": self.family})
        except MbdkitError:
            return dict.fromkeys(VARIABLES, np.nan)
        return dict(zip(found.variables, found.total.tolist(), strict=True))

    def row(self) -> tuple[float | None, ...]:
        """Return the cells of the table."""
        if not self.count:
            return (None,) * (4 + len(WORDS))
        totals = [self.totals()[name] for name in WORDS]
        added, high = self.median("added"), np.quantile(self.values["added"], 0.95)
        measures = (added, high, self.median("shear"), 100 * self.median("transmitted"))
        rounded = (None if np.isnan(one) else float(f"{one:.2f}") for one in totals)
        return (*(float(f"{one:.3g}") for one in measures), *rounded)


Samples = Mapping[tuple[str, str], Sample]


def _claim(name: str, pairs: Mapping[str, tuple[float, float]]) -> Claim:
    """Return a claim of `words.yaml`: that the first of two numbers is smaller than the second in all cases."""
    words = {key: text.format(small=1e3 * SMALL, large=1e3 * LARGE) for key, text in TEXTS[name].items()}
    known = {case: pair for case, pair in pairs.items() if np.isfinite(pair).all()}
    holding = sum(low < high for low, high in known.values())
    answers = {0: Answer.NO, len(known): Answer.YES}
    answer = answers.get(holding, Answer.PARTLY) if known else Answer.OPEN
    computed = "; ".join(f"{low:.3g} and {high:.3g} ({case})" for case, (low, high) in known.items()) or "unknown"
    sentence = f"{words['computed']}: {computed}."
    return Claim(name, words["statement"], words["published"], computed, answer, sentence)


Pairs = dict[str, tuple[float, float]]


def _growth(samples: Samples) -> Pairs:
    pairs: Pairs = {}
    for motion in MOTIONS:
        one = samples[motion, "hinge"]
        pairs[f"{motion}, hinge"] = one.median("added", one.offset < SMALL), one.median("added", one.offset > LARGE)
    return pairs


def _direction(samples: Samples) -> Pairs:
    pairs: Pairs = {}
    for motion in MOTIONS:
        totals = samples[motion, "hinge"].totals()
        others = max(totals["parameters.forward"], totals["parameters.turn"])
        pairs[f"{motion}, hinge"] = others, totals["parameters.upward"]
    return pairs


def _self_alignment(samples: Samples) -> Pairs:
    pairs: Pairs = {}
    for motion in MOTIONS:
        hinge, own = samples[motion, "hinge"], samples[motion, "self-aligning"]
        for words, most in (("all offsets", np.inf), ("small offsets", SMALL)):
            aligning, hinged = (one.median("added", one.offset < most) for one in (own, hinge))
            pairs[f"{motion}, {words}"] = aligning, hinged
    return pairs


def _tissue(samples: Samples) -> Pairs:
    pairs: Pairs = {}
    for (motion, device), sample in samples.items():
        tissue = sample.values["parameters.tissue"]
        soft, stiff = tissue < 0.6, tissue > 1.6
        pairs[f"{motion}, {device}"] = sample.median("transmitted", soft), sample.median("transmitted", stiff)
    return pairs


def _figures(samples: Samples) -> list[Figure]:
    axes = {
        "parameters.forward": ("offset forward", "mm", 1e3),
        "parameters.upward": ("offset upward", "mm", 1e3),
        "parameters.turn": ("rotation", "deg", 180 / np.pi),
        "parameters.tissue": ("stiffness of tissue relative to the usual one", "1", 1.0),
    }
    measures = {
        "added": ("added knee force", "N", 1.0),
        "shear": ("shear of a cuff", "N", 1.0),
        "transmitted": ("help transmitted", "%", 100.0),
    }
    figures = []
    for motion in MOTIONS:
        for measure, (what, unit, scale) in measures.items():
            for variable, (word, own_unit, factor) in axes.items():
                lines = []
                for device in DEVICES:
                    sample = samples[motion, device]
                    if sample.count:
                        x, y = _medians(factor * sample.values[variable], scale * sample.values[measure])
                        lines.append(Line(device, x, y, "both"))
                name = f"{measure}-{WORDS[variable]}-{motion}"
                caption = f"Medians of {BINS} intervals of equal numbers of runs; the other misfits vary as well."
                title = f"{what[0].upper()}{what[1:]} in {motion} against {word}"
                figures.append(Figure(name, title, caption, Axis(word, own_unit), Axis(what, unit), tuple(lines)))
    return figures


def _medians(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return medians of x and y in intervals of x with equal numbers of values."""
    parts = np.array_split(np.argsort(x, kind="stable"), min(BINS, len(x)))
    return tuple(np.array([float(np.median(one[part])) for part in parts]) for one in (x, y))  # type: ignore[return-value]
