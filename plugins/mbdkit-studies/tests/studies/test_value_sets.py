"""The values of an axis."""

from __future__ import annotations

import pytest

from mbdkit.base.errors import SpecError
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
