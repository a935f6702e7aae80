"""The values of an axis, and distributions of a sample: against scipy.stats, and wrong input of each kind."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.stats

from mbdkit.base.errors import SpecError
from mbdkit_studies.spec.sample_section import frozen
from mbdkit_studies.spec.study_loading import load_study_spec
from mbdkit_studies.spec.value_sets import check_values, expand


def values(given):
    return [entry.value for entry in expand(check_values(given))]


def labels(given):
    return [entry.label for entry in expand(check_values(given))]


def test_geomspace_has_equal_ratios_and_meets_its_ends_and_the_powers_between_exactly():
    assert values({"geomspace": [0.1, 0.001, 3]}) == [0.1, 0.01, 0.001]
    steps = values({"geomspace": [1.0, 16.0, 9]})
    assert steps[::2] == [1.0, 2.0, 4.0, 8.0, 16.0]
    assert steps[1] == pytest.approx(2**0.5, rel=1e-11)
    assert values({"geomspace": [-1.0, -100.0, 3]}) == [-1.0, -10.0, -100.0]


def test_linspace_has_equal_distances_and_whole_numbers_stay_whole():
    assert values({"linspace": [0.0, 1.0, 5]}) == [0.0, 0.25, 0.5, 0.75, 1.0]
    bodies = values({"linspace": [1, 10, 10]})
    assert bodies == list(range(1, 11))
    assert all(isinstance(number, int) for number in bodies)
    assert values({"linspace": [2.5, 2.5, 1]}) == [2.5]


def test_numbers_and_texts_are_their_own_labels_and_objects_go_by_name_and_options():
    assert labels([0.1, 2, "index-1"]) == [0.1, 2, "index-1"]
    assert labels([{"name": "rk4"}, {"name": "gauss", "stages": 2}]) == ["rk4", "gauss, stages 2"]
    assert labels([[1.0, 2.0], True]) == ["[1.0, 2.0]", "true"]
    assert labels([{"label": "mine", "value": {"name": "rk4"}}]) == ["mine"]
    assert values([{"label": "mine", "value": {"name": "rk4"}}]) == [{"name": "rk4"}]


def test_different_objects_never_share_a_label_and_equal_ones_do():
    long = [{"name": "mechanism", "bodies": {"x" * 80: index}} for index in (1, 2, 1)]
    first, second, third = labels(long)
    assert first == third
    assert second == f"{first} (2)"


def test_equal_values_are_recognised_at_all_levels():
    shared = [
        {"label": "a", "value": value} for value in ({"x": [1, {"y": 2}]}, {"x": [1.0, {"y": 2}]}, {"x": [1]}, [])
    ]
    assert labels(shared) == ["a", "a", "a (2)", "a (3)"]


def test_a_numbered_label_is_none_that_another_value_has():
    given = [{"label": label, "value": value} for value, label in enumerate(["a", "a", "a (2)", "a", "a (2)"])]
    assert labels(given) == ["a", "a (3)", "a (2)", "a (4)", "a (2) (2)"]


def test_spaced_numbers_of_any_size_are_finite():
    assert values({"geomspace": [1e-300, 1e300, 3]}) == [1e-300, 1.0, 1e300]
    assert values({"geomspace": [-1e300, -1e-300, 3]}) == [-1e300, -1.0, -1e-300]
    assert values({"linspace": [-1.5e308, 1.5e308, 5]}) == [-1.5e308, -7.5e307, 0.0, 7.5e307, 1.5e308]
    assert values({"linspace": [-15 * 10**307, 15 * 10**307, 3]})[1] == 0


@pytest.mark.parametrize(
    ("given", "key", "words"),
    [
        ([], "", "at least one value"),
        (5, "", "should be a list of values"),
        ({"geomspce": [1, 2, 3]}, "geomspce", "did you mean 'geomspace'?"),
        ({"geomspace": [1, 2, 3], "linspace": [1, 2, 3]}, "geomspace", "cannot be combined with other keys"),
        ({"geomspace": [1, 2]}, "geomspace", "[first, last, number of values], not a list of 2"),
        ({"linspace": [1, "2", 3]}, "linspace", "[first, last, number of values]"),
        ({"linspace": [1, True, 3]}, "linspace", "[first, last, number of values]"),
        ({"linspace": [1, 2, 2.5]}, "linspace[2]", "whole number"),
        ({"linspace": [1, 2, 0]}, "linspace[2]", "from 1 to 10000"),
        ({"linspace": [1, 2, 10**9]}, "linspace[2]", "from 1 to 10000"),
        ({"linspace": [1, 2, 1]}, "linspace[2]", "both 1 and 2"),
        ({"linspace": [0, 10**400, 3]}, "linspace[1]", "a finite number"),
        ({"linspace": [float("nan"), 1, 3]}, "linspace[0]", "a finite number"),
        ({"geomspace": [1, float("inf"), 3]}, "geomspace[1]", "a finite number"),
        ({"geomspace": [0, 1, 3]}, "geomspace[0]", "non-zero"),
        ({"geomspace": [1, -1, 3]}, "geomspace[1]", "the same sign"),
    ],
)
def test_what_is_no_set_of_values_is_refused(given, key, words):
    with pytest.raises(SpecError) as caught:
        check_values(given)
    assert caught.value.key == key
    assert words in caught.value.message


@pytest.mark.parametrize(
    ("entry", "key", "words"),
    [
        ({"label": "x", "value": 1, "if_instaled": "acme"}, "[0].if_instaled", "did you mean 'if_installed'?"),
        ({"label": "x", "value": 1, "set": {"time.step": 1}}, "[0]", "either `value` or `set`, not both"),
        ({"label": "x", "set": {}}, "[0].set", "dotted keys of a run spec with their values, not an empty mapping"),
        ({"label": "x", "set": 3}, "[0].set", "dotted keys of a run spec with their values, not 3"),
        ({"label": "x", "value": 1, "if_installed": True}, "[0].if_installed", "name of a Python package"),
        ({"label": "x", "value": 1, "if_installed": ""}, "[0].if_installed", "name of a Python package"),
    ],
)
def test_what_is_no_labelled_value_is_refused(entry, key, words):
    with pytest.raises(SpecError) as caught:
        check_values([entry])
    assert caught.value.key == key
    assert words in caught.value.message


PROBABILITIES = np.linspace(0.01, 0.99, 25)

SAME: list[tuple[dict[str, Any], Any]] = [
    ({"uniform": [-1, 3]}, scipy.stats.uniform(loc=-1, scale=4)),
    ({"uniform": {"high": 3, "low": -1}}, scipy.stats.uniform(loc=-1, scale=4)),
    ({"normal": [2, 0.5]}, scipy.stats.norm(loc=2, scale=0.5)), ({"normal": {"std": 0.5}}, scipy.stats.norm(scale=0.5)),
    ({"norm": [2, 0.5]}, scipy.stats.norm(2, 0.5)), ({"lognorm": [0.3, 0, 2]}, scipy.stats.lognorm(0.3, 0, 2)),
    ({"lognorm": {"s": 0.3, "scale": 2}}, scipy.stats.lognorm(s=0.3, scale=2)),
    ({"triang": {"c": 0.25, "loc": 1, "scale": 2}}, scipy.stats.triang(0.25, 1, 2)),
    ({"truncnorm": [-1, 2, 0.5, 0.1]}, scipy.stats.truncnorm(-1, 2, 0.5, 0.1)),
    ({"loguniform": [0.1, 10]}, scipy.stats.loguniform(0.1, 10)), ({"beta": [2, 5]}, scipy.stats.beta(2, 5)),
    ({"expon": []}, scipy.stats.expon()),
]  # fmt: skip


@pytest.mark.parametrize(("given", "expected"), SAME, ids=[str(given) for given, _ in SAME])
def test_quantiles_are_those_of_scipy(given: dict[str, Any], expected: Any) -> None:
    assert np.array_equal(frozen(given).ppf(PROBABILITIES), expected.ppf(PROBABILITIES))


WRONG: dict[str, tuple[Any, str, str]] = {
    "no mapping": (3, "", "should be {DISTRIBUTION: PARAMETERS}"),
    "two names": ({"uniform": [0, 1], "norm": [0, 1]}, "", "should be {DISTRIBUTION: PARAMETERS}"),
    "misspelt": ({"unifrom": [0, 1]}, "unifrom", "did you mean 'uniform'?"),
    "not a distribution": ({"zzz": [0, 1]}, "zzz", "there is no continuous distribution 'zzz'"),
    "a function of scipy.stats": ({"ttest_ind": [0, 1]}, "ttest_ind", "there is no continuous distribution"),
    "discrete": ({"poisson": [3]}, "poisson", "is a discrete distribution"),
    "slow": ({"levy_stable": [1.5, 0]}, "levy_stable", "too slowly"),
    "parameters not listed": ({"norm": 3}, "norm", "needs its parameters as a list or a mapping, not 3"),
    "too many": ({"norm": [0, 1, 2]}, "norm", "has 3 parameters, which are too many: 'norm' has"),
    "too few": ({"uniform": [0]}, "uniform", "needs `high`"),
    "no shape": ({"triang": {"loc": 1}}, "triang", "needs `c`: 'triang' has the parameters c, loc and scale"),
    "unknown parameter": ({"norm": {"scael": 1}}, "norm.scael", "unknown parameter (did you mean 'scale'?)"),
    "text": ({"norm": ["a", 1]}, "norm.loc", "should be a number, not the text 'a'"),
    "true": ({"norm": [True, 1]}, "norm.loc", "should be a number, not true"),
    "limits in the wrong order": ({"uniform": [1, -1]}, "uniform", "`low` should be less than `high`"),
    "negative scale": ({"norm": [0, -1]}, "norm", "`scale` should be positive, not -1"),
    "negative deviation": ({"normal": [0, 0]}, "normal", "`std` should be positive, not 0"),
    "impossible shape": ({"triang": [1.5]}, "triang", "does not exist for these parameters: c 1.5"),
    "too wide": ({"uniform": [-1.7e308, 1.7e308]}, "uniform", "too large for double precision"),
}


def _study(**sample: Any) -> dict[str, Any]:
    return {"mbdkit_study": 1, "base": "double-pendulum", "sample": sample}


@pytest.mark.parametrize(("given", "key", "message"), WRONG.values(), ids=WRONG)
def test_wrong_distributions_are_refused_with_their_key(given: Any, key: str, message: str) -> None:
    with pytest.raises(SpecError) as error:
        load_study_spec(_study(n=4, variables={"model.angles.0": given}))
    assert message in error.value.message
    assert error.value.key == ".".join(filter(None, ['sample.variables."model.angles.0"', key]))


UNIFORM = {"uniform": [0, 1]}


def _steps(**sample: Any) -> dict[str, Any]:
    return _study(**({"n": 4, "variables": {"time.step": UNIFORM}} | sample))


AXES = [{"time.step": [0.1, 0.2]}]
ANGLE, ANGLES = "model.angles.0", 'sample.variables."model.angles'
REFUSED: dict[str, tuple[dict[str, Any], str, str]] = {
    "no members": (_steps(n=0), "sample.n", "should be at least 1, not 0"),
    "half a member": (_steps(n=1.5), "sample.n", "whole"),
    "no variables": (_study(n=4, variables={}), "sample.variables", "needs at least one key"),
    "no n": (_study(variables={"time.step": UNIFORM}), "sample.n", "missing"),
    "unknown method": (_steps(method="sobl"), "sample.method", "'sobol'"),
    "unknown design": (_steps(design="morris"), "sample.design", "'saltelli'"),
    "negative seed": (_steps(seed=-1), "sample.seed", "should be at least 0, not -1"),
    "unknown key": (_steps(sed=1), "sample.sed", "seed"),
    "no key of a spec": (_steps(variables={"a..b": UNIFORM}), 'sample.variables."a..b"', "dotted key"),
    "one key twice": (_steps(variables={ANGLE: UNIFORM, "model.angles[0]": UNIFORM}), f'{ANGLES}[0]"', "the same key"),
    "a key and a part": (_steps(variables={ANGLE: UNIFORM, "model.angles": UNIFORM}), f'{ANGLES}.0"', "is part of"),
    "an axis of the same key": (_steps() | {"axes": AXES}, "axes[0]", "is a variable of the sample"),
    "an axis of a family": (_steps() | {"families": {"a": {"axes": AXES}}}, "families.a.axes[0]", "is a variable of"),
    "a reference": (_steps() | {"reference": {"time.step": 0.1}}, "sample", "cannot be combined with `reference`"),
}


@pytest.mark.parametrize(("study", "key", "message"), REFUSED.values(), ids=REFUSED)
def test_wrong_samples_are_refused_with_their_key(study: dict[str, Any], key: str, message: str) -> None:
    with pytest.raises(SpecError) as error:
        load_study_spec(study)
    assert message in error.value.message
    assert error.value.key == key


def test_too_many_variables_are_refused_before_their_distributions() -> None:
    # each of them would take a third of a millisecond; the message names the first problem found
    wrong = {f"model.k{number}": {"no-such-distribution": []} for number in range(1001)}
    with pytest.raises(SpecError, match=r"sample.variables: has 1001 variables; a sample has at most 1000"):
        load_study_spec(_study(n=4, variables=wrong))


def test_what_a_sample_sets_cannot_be_assigned() -> None:
    with pytest.raises(SpecError, match=r"--set time.step=0.1: the sample of the study sets time.step"):
        load_study_spec(_study(n=4, variables={"time.step": UNIFORM}), ["time.step=0.1"])
