"""Whatever is changed in a spec, the answer is a RunSpec or a SpecError with the key, never another exception."""

from __future__ import annotations

import copy

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbdkit.base.errors import SpecError
from mbdkit.spec import example_names, example_text, load_spec
from mbdkit.spec.yaml_reader import read_yaml

EXAMPLES = [read_yaml(example_text(name))[0] for name in example_names("run")]

ODD = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.just(10**400),
    st.floats(),
    st.text(max_size=5),
    st.sampled_from(["gauss", "ground", "1e3", "__import__('os')", "sin(", "t" * 2000, "\ud800", "mbdkit:rk4"]),
    st.lists(st.integers(0, 2), max_size=4),
    st.dictionaries(
        st.sampled_from(["name", "type", "x", "mass", ""]), st.sampled_from(["gauss", 1, None]), max_size=2
    ),
    st.builds(lambda: [[]]),
)


def places(data, path=()):
    for key, value in data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ():
        yield (*path, key)
        yield from places(value, (*path, key))


@st.composite
def changed_specs(draw):
    spec = copy.deepcopy(draw(st.sampled_from(EXAMPLES)))
    for _ in range(draw(st.integers(1, 3))):
        where = draw(st.sampled_from(sorted(places(spec), key=str)))
        place = spec
        for part in where[:-1]:
            place = place[part]
        match draw(st.sampled_from(["replace", "remove", "rename"])):
            case "replace":
                place[where[-1]] = draw(ODD)
            case "remove":
                del place[where[-1]]
            case "rename" if isinstance(place, dict):
                place[draw(st.text(max_size=4) | st.just("stpe"))] = place.pop(where[-1])
        if not spec:
            break
    return spec


def attempt(function, argument):
    """Return what the function gives, or None and the sentence by which it refuses."""
    try:
        return function(argument), ""
    except SpecError as error:
        return None, str(error)


@settings(max_examples=30, deadline=None)
@given(changed_specs())
def test_a_changed_spec_is_taken_or_refused_in_a_sentence(data):
    spec, refusal = attempt(load_spec, data)
    if spec is None:
        assert refusal
        assert "pydantic" not in refusal
    else:
        assert load_spec(spec.model_dump()).sha256() == spec.sha256()


ODD_YAML = ["\x85", "a: \x85", "{", "]", "- - -", "&a", "!", "%", "? ?", "'", '"\\', "a: |2\n x", "--- ---"]


@pytest.mark.parametrize("text", ODD_YAML)
def test_odd_yaml_is_data_or_a_sentence(text):
    assert "\n" not in attempt(read_yaml, text)[1]


@settings(max_examples=30, deadline=None)
@given(st.text(alphabet="ab:-[]{},&*!|>'\"%@`#?\n\t 01.", max_size=30))
def test_any_text_is_yaml_or_a_sentence(text):
    assert "\n" not in attempt(read_yaml, text)[1]
