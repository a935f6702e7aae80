"""Whatever is changed in a study, the answer is a plan or a SpecError, never another exception."""

from __future__ import annotations

import copy

from hypothesis import given, settings
from hypothesis import strategies as st

from mbdkit.base.errors import SpecError
from mbdkit_studies.points.planned_points import PlannedPoints
from mbdkit_studies.spec.study_loading import load_study_spec

STUDY = {
    "mbdkit_study": 1, "title": "t",
    "base": {"mbdkit": 1, "model": {"name": "double-pendulum"}, "time": {"end": 1.0, "step": 0.1}},
    "overrides": {"output.every": 2},
    "families": {
        "a": {"axes": [{"integrator": [{"name": "rk4"}, {"label": "x", "value": {"name": "gauss"}}]}], "repeats": 2},
        "b": {"axes": [{"time.step": {"geomspace": [0.1, 0.01, 3]}}], "overrides": {"integrator": {"name": "rk4"}}},
    },
    "reference": {"integrator": {"name": "gauss", "stages": 3}}, "measures": ["end_error"],
}  # fmt: skip

ODD = st.one_of(
    st.none(), st.booleans(), st.integers(-3, 3), st.floats(), st.text(max_size=5),
    st.sampled_from(["none", "all", "knee", "gauss", "-", "a.b", "a[0]", "[0]", "time.step", "\ud800", "..", "a/b"]),
    st.lists(st.integers(0, 2), max_size=3),
    st.dictionaries(st.sampled_from(["geomspace", "label", "value", "time.step", "x[0]", "", "."]), st.just([1, 2, 3])),
)  # fmt: skip


def places(data, path=()):
    """Every key path of the study."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        yield (*path, key)
        yield from places(value, (*path, key))


def attempt(study):
    """Return the ids of all runs of a study, or none and the sentence by which it is refused."""
    try:
        return [(point.run_id, point.reference_id) for point in PlannedPoints(load_study_spec(study))], ""
    except SpecError as error:
        return [], str(error)


PLACES = list(places(STUDY))


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(PLACES), ODD, st.sampled_from(["replace", "rename", "remove", "add"]))
def test_a_changed_study_is_planned_or_refused_in_a_sentence(path, odd, how):
    study = copy.deepcopy(STUDY)
    place = study
    for key in path[:-1]:
        place = place[key]
    if how == "replace" or isinstance(place, list):
        place[path[-1]] = odd
    elif how == "rename":
        place[str(odd)] = place.pop(path[-1])
    elif how == "remove":
        del place[path[-1]]
    else:
        place[str(odd)] = odd
    runs, refusal = attempt(study)
    assert bool(runs) != bool(refusal)
    assert "pydantic" not in refusal
