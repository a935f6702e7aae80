"""YAML 1.2 as plain data with line numbers."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbdkit.base.errors import SpecError
from mbdkit.spec.yaml_reader import read_yaml, write_yaml


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 1e-3),
        ("1E5", 1e5),
        ("-2.5e+3", -2500.0),
        (".5", 0.5),
        ("5.", 5.0),
        ("+7", 7),
        ("010", 10),
        ("0x1F", 31),
        ("0o17", 15),
        (".inf", math.inf),
        ("-.inf", -math.inf),
        ("yes", "yes"),
        ("no", "no"),
        ("on", "on"),
        ("true", True),
        ("False", False),
        ("~", None),
        ("null", None),
        ("", None),
        ("1:30", "1:30"),
        ("1_000", "1_000"),
        ("2024-01-01", "2024-01-01"),
        ("'5'", "5"),
        ('"true"', "true"),
        ("!!str 5", "5"),
        ("0.5*sin(2*pi*t)", "0.5*sin(2*pi*t)"),
        ("=", "="),
    ],
)
def test_scalars_are_those_of_yaml_1_2(text, value):
    data, _ = read_yaml(f"a: {text}\n")
    assert data == {"a": value}
    assert type(data["a"]) is type(value)


def test_not_a_number_is_read_as_such_and_refused_later():
    assert math.isnan(read_yaml("a: .nan")[0]["a"])


def test_every_key_and_item_has_its_line():
    _, lines = read_yaml("a: 1\nb:\n  c:\n    - 1\n    - {d: 2,\n       e: 3}\n")
    upper = {("a",): 1, ("b",): 2, ("b", "c"): 3}
    assert lines == upper | {("b", "c", 0): 4, ("b", "c", 1): 5, ("b", "c", 1, "d"): 5, ("b", "c", 1, "e"): 6}


def test_aliases_and_merge_keys_are_expanded():
    data, _ = read_yaml("a: &x {p: 1, q: 2}\nb: *x\nc: {<<: *x, q: 3}\nd: {<<: [{p: 9}, *x]}\n")
    assert data["b"] == {"p": 1, "q": 2}
    assert data["c"] == {"p": 1, "q": 3}
    assert data["d"] == {"p": 9, "q": 2}


NINE = ", ".join(["*{0}"] * 9)
EXPLOSION = "a0: &a0 [1]\n" + "".join(f"a{i}: &a{i} [{NINE.format(f'a{i - 1}')}]\n" for i in range(1, 10))

REFUSED = {
    "a duplicate key": ("a: 1\nb: 2\na: 3\n", "occurs twice", 3),
    "a recursive alias": ("a: &x [1, *x]\n", "contains the alias", 1),
    "a recursive merge": ("a: &x\n  <<: *x\n", "contains the alias", 2),
    "an alias explosion": (EXPLOSION, "too large", None),
    "an unknown alias": ("a: *x\n", "needs quotes", 1),
    "a tab": ("a:\n\tb: 1\n", "tab", 2),
    "an open bracket": ("a: [1,\nb: 2\n", "not valid YAML", None),
    "a colon in a text": ("a: b: c\n", "quotes", 1),
    "two documents": ("a: 1\n---\nb: 2\n", "second YAML document", 2),
    "an object": ("a: !!python/object/apply:os.system [ls]\n", "plain data", 1),
    "a set": ("a: !!set {b}\n", "plain data", 1),
    "a tag of one's own": ("a: !mine 3\n", "plain data", 1),
    "a forced float": ("a: 3\nb: !!float 'x'\n", "plain data", 2),
    "a list as key": ("[1, 2]: 3\n", "key should be text", 1),
    "endless nesting": ("a: 1\nb: " + "[" * 100_000, "more than 100 levels", 2),
    "a character with a meaning": ("a: @x\n", "put the text in quotes", 1),
    "an endless number": ("a: " + "9" * 5000, "too large", 1),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_plain_data_is_refused_with_its_line(case):
    text, words, line = REFUSED[case]
    with pytest.raises(SpecError, match=words) as caught:
        read_yaml(text)
    assert "\n" not in caught.value.message
    if line is not None:
        assert caught.value.line == line


LETTERS = st.characters(exclude_categories=["Cc", "Cs"])
WORDS = st.sampled_from(
    [
        "yes",
        "1e5",
        "0x1F",
        "1_000",
        "~",
        "null",
        "",
        "5",
        ".nan",
        "a: b",
        "- a",
        "#",
        "<<",
        "=",
        "a\nb",
        ":0",
        "?x",
        "(",
    ]
)
SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(allow_nan=False, allow_infinity=False), st.text(LETTERS), WORDS
)
PLAIN = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(LETTERS) | WORDS, inner, max_size=4)
)


@settings(max_examples=30, deadline=None)
@given(st.dictionaries(st.text(LETTERS, min_size=1), PLAIN, max_size=4))
def test_what_is_written_is_read_back_to_the_same_data(data):
    back, _ = read_yaml(write_yaml(data))
    assert back == data
    assert repr(back) == repr(data)  # a number is of the same type, and keys are in the same order
