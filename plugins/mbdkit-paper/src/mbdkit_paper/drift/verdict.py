"""Verdict on the packaged study `drift`: order, drift, energy and cost by formulation and stabilization."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from mbdkit_paper.drift.combination import Combination, Undetermined, combinations
from mbdkit_paper.drift.drift_figures import energies, errors
from mbdkit_paper.wording import Words, reported
from mbdkit_report import Answer, Claim, Range, Verdict, exceeds, together
from mbdkit_studies import Study
from mbdkit_studies.results.judge import study_verdict

#: Observed and expected order agree if they differ by at most `NEAR`, and disagree if they differ by `APART` or more.
NEAR, APART = 0.2, 0.3
TENFOLD = Range.around(10.0, 3.0)
#: Largest reversibility defect, relative to the size, that round-off over about 20,000 steps can explain.
REVERSIBLE = 1e-11
NAMES = ("q", "v", "lambda")
OPPOSITE = {Answer.YES: Answer.NO, Answer.NO: Answer.YES}

#: Orders from the literature: name of the claim, label on the axis `method`, orders of positions q, velocities v and
#: multipliers lambda (None if not given), source.
EXPECTED: tuple[tuple[str, str, tuple[float | None, ...], str], ...] = (
    ("radau-index-3", "Radau IIA 3, index-3", (5, 3, 2), "Hairer, Lubich, Roche 1989"),
    ("radau-index-2", "Radau IIA 3, index-2", (5, 5, 3), "Hairer, Lubich, Roche 1989"),
    ("radau-ggl", "Radau IIA 3, ggl", (5, 5, 3), "Gear, Gupta, Leimkuhler 1985"),
    ("generalized-alpha", "Generalized-alpha, index-3", (2, 2, 2), "Arnold, Bruls 2007"),
    ("rattle", "RATTLE, index-3", (2, 2, None), "Leimkuhler, Skeel 1994"),
)
PLAIN, ORDINARY, SYMMETRIC = "Gauss 2", "Gauss 2, projected", "Gauss 2, projected symmetrically"
PROJECTED = ", projected"
WORDS = Words(__file__)


@study_verdict
def verdict(study: Study) -> Verdict:
    """Return the verdict on the packaged study `drift`.

    Parameters
    ----------
    study
        The study; see `combinations` for the required families.
    """
    results = combinations(study)
    table = WORDS.table("drift", [(result.mechanism, result.method, *result.cells()) for result in results])
    own = [result for result in results if result.method not in study.spec.added]
    claims = [_orders(own, *expected) for expected in EXPECTED]
    claims += [_projection_keeps_the_order(own), _projection_cuts_the_error(own)]
    claims += [_reversibility(own), _energy(own)]
    decided = reported(claims)
    return Verdict(
        "drift",
        "Formulations and stabilizations against drift",
        " ".join(claim.sentence for claim in decided if claim.answer is not Answer.OPEN),
        decided,
        (table,),
        errors(results, study.spec.added)
        + energies(study, (PLAIN, ORDINARY, SYMMETRIC), "energy", "Energy with and without projection")
        + energies(study, study.spec.added, "energy-added", "Energy of added methods"),
        _notes(results),
    )


def _notes(results: Sequence[Combination]) -> tuple[str, ...]:
    absent = dict.fromkeys(result.method for result in results if result.position_order == "not installed")
    return (f"Left out because they are not installed: {', '.join(absent)}.",) if absent else ()


def _by(results: Sequence[Combination], method: str) -> dict[str, Combination]:
    return {result.mechanism: result for result in results if result.method == method}


def order_meets(results: float | Undetermined, expected: float) -> Answer:
    """Return whether an observed order is the expected one.

    The answer is yes if they differ by at most `NEAR`, and open if they differ by less than `APART` or the observed
    order is unknown. Otherwise, it is partly for a higher order, and no for a lower one.
    """
    if isinstance(results, str):
        return Answer.OPEN
    away = results - expected
    if abs(away) <= NEAR:
        return Answer.YES
    if abs(away) < APART:
        return Answer.OPEN
    return Answer.PARTLY if away > 0 else Answer.NO


def all_of(answers: Sequence[Answer]) -> Answer:
    """Return whether all conditions hold: the first of no, partly and open that is among the answers, else yes."""
    return next((answer for answer in (Answer.NO, Answer.PARTLY, Answer.OPEN) if answer in answers), Answer.YES)


def _known(answers: Mapping[str, Answer]) -> Answer:
    """Combine the answers for several mechanisms, ignoring open ones; open if all are open."""
    return together([answer for answer in answers.values() if answer is not Answer.OPEN])


def _holding(answers: Mapping[str, Answer]) -> str:
    holding = [name for name, answer in answers.items() if answer is Answer.YES]
    undecided = [name for name, answer in answers.items() if answer is Answer.OPEN]
    text = f"on {len(holding)} of {len(answers) - len(undecided)} mechanisms"
    return text + (f" (open: {', '.join(undecided)})" if undecided else "")


def _figure(value: float | Undetermined, form: str = ".2f") -> str:
    return value if isinstance(value, str) else format(value, form)


def _orders(
    results: Sequence[Combination], name: str, label: str, expected: tuple[float | None, ...], source: str
) -> Claim:
    answers, computed = {}, []
    for mechanism, result in _by(results, label).items():
        seen = (result.position_order, result.velocity_order, result.multiplier_order)
        asked = [(order, wanted) for order, wanted in zip(seen, expected, strict=True) if wanted is not None]
        answers[mechanism] = all_of([order_meets(order, wanted) for order, wanted in asked])
        computed.append(f"{'/'.join(_figure(order) for order, _ in asked)} ({mechanism})")
    wanted = "/".join(f"{order:g}" for order in expected if order is not None)
    of = ", ".join(letter for letter, order in zip(NAMES, expected, strict=True) if order is not None)
    values = {"label": label, "wanted": wanted, "of": of, "source": source, "computed": ", ".join(computed)}
    return WORDS.claim("orders", _known(answers), name, holding=_holding(answers), **values)


def _pairs(results: Sequence[Combination]) -> list[tuple[Combination, Combination]]:
    """Return pairs of results for the same method, without and with ordinary projection."""
    plain = {(result.mechanism, result.method): result for result in results}
    return [
        (plain[key], result)
        for result in results
        if (key := (result.mechanism, result.method.removesuffix(PROJECTED))) in plain
        and result.method.endswith(PROJECTED)
    ]


def _projection_keeps_the_order(results: Sequence[Combination]) -> Claim:
    answers, computed = {}, []
    for result, projected in _pairs(results):
        for letter, before, after in (
            ("q", result.position_order, projected.position_order),
            ("v", result.velocity_order, projected.velocity_order),
        ):
            answer = Answer.OPEN if isinstance(before, str) else order_meets(after, before)
            answers[f"{result.method}, {result.mechanism}, {letter}"] = answer
            if answer in (Answer.NO, Answer.PARTLY):
                where = f"({result.method}, {result.mechanism})"
                computed.append(f"{letter} from {_figure(before)} to {_figure(after)} {where}")
    decided = [answer for answer in answers.values() if answer is not Answer.OPEN]
    kept = sum(answer is Answer.YES for answer in decided)
    exceptions = f"; {', '.join(computed)}" if computed else ""
    return WORDS.claim("projection-order", _known(answers), kept=kept, decided=len(decided), exceptions=exceptions)


def gain(plain: Combination, projected: Combination) -> float:
    """Return the factor by which projection reduces the error of positions, as geometric mean over common steps.

    Steps at which either error is at round-off level are ignored; the result is nan if none is left.
    """
    ratios = [
        math.log(plain.errors[step] / projected.errors[step])
        for step in plain.errors.keys() & projected.errors.keys()
        if min(plain.errors[step], projected.errors[step]) > 1e-12
    ]
    return math.exp(sum(ratios) / len(ratios)) if ratios else math.nan


def _projection_cuts_the_error(results: Sequence[Combination]) -> Claim:
    gains = {f"{result.method}, {result.mechanism}": gain(result, projected) for result, projected in _pairs(results)}
    answers = {name: TENFOLD.holds(value) for name, value in gains.items()}
    known = sorted((value, name) for name, value in gains.items() if math.isfinite(value))
    between = f"{known[0][0]:.2g} ({known[0][1]}) to {known[-1][0]:.2g} ({known[-1][1]})" if known else "unknown"
    middle = f", median {known[len(known) // 2][0]:.2g}" if known else ""
    return WORDS.claim("projection-error", _known(answers), tenfold=TENFOLD, between=f"{between}{middle}")


def _reversibility(results: Sequence[Combination]) -> Claim:
    labels = (PLAIN, ORDINARY, SYMMETRIC)
    by = [_by(results, label) for label in labels]
    answers, computed = {}, []
    for mechanism in by[0]:
        defects = [result[mechanism].reversal if mechanism in result else "missing" for result in by]
        found = [Answer.OPEN if isinstance(defect, str) else exceeds(REVERSIBLE, defect) for defect in defects]
        found[1] = OPPOSITE.get(found[1], found[1])  # ordinary projection is not reversible
        answers[mechanism] = all_of(found)
        computed.append(f"{', '.join(_figure(defect, '.0e') for defect in defects)} ({mechanism})")
    computed_text = "; ".join(computed)
    return WORDS.claim("projection-reversibility", _known(answers), computed=computed_text, holding=_holding(answers))


def _energy(results: Sequence[Combination]) -> Claim:
    ordinary, symmetric = _by(results, ORDINARY), _by(results, SYMMETRIC)
    answers, computed = {}, []
    for mechanism, result in ordinary.items():
        other = symmetric.get(mechanism)
        has = [result.has_trend, None if other is None else other.has_trend]
        pairs = zip(has, (True, False), strict=True)
        answers[mechanism] = all_of(
            [Answer.OPEN if trend is None else Answer.YES if trend is wanted else Answer.NO for trend, wanted in pairs]
        )
        shown = [_figure(which.trend, ".0e") if which is not None else "missing" for which in (result, other)]
        computed.append(f"{shown[0]}, {shown[1]} ({mechanism})")
    return WORDS.claim("projection-energy", _known(answers), computed="; ".join(computed), holding=_holding(answers))
