"""What every built-in model has in common."""

import json

import pytest

from mbdkit.base.errors import SpecError
from mbdkit.base.strict_model import description
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.models import MODELS
from mbdkit.models.free_form import MechanismOptions, build

LEAST = {"n-pendulum": {"n": 2}, "mechanism": {"bodies": {"a": {"mass": 1, "inertia": 1}}}}

every_model = pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)


@every_model
def test_model_builds_a_valid_mechanism_from_its_defaults(model):
    mechanism = model.build(model.options(**LEAST.get(model.name, {})))
    mechanism.validate()
    assert mechanism.name == model.name
    assert mechanism.gravity == (0.0, -9.81)


@every_model
def test_model_written_out_as_a_free_form_spec_is_the_same_mechanism(model):
    mechanism = model.build(model.options(**LEAST.get(model.name, {})))
    spec = json.loads(json.dumps(mechanism.to_spec()))
    again = Mechanism.from_spec(spec)
    assert (again.bodies, again.joints, again.forces) == (mechanism.bodies, mechanism.joints, mechanism.forces)
    assert again.assembly == mechanism.assembly
    spec.pop("name")
    assert build(MechanismOptions(**spec)).to_spec() == mechanism.to_spec()


@every_model
def test_every_parameter_says_what_it_is(model):
    for name in model.options.model_fields:
        assert description(model.options, name), f"{model.name}.{name}"


@every_model
def test_gravity_is_a_parameter(model):
    mechanism = model.build(model.options(**LEAST.get(model.name, {}), gravity=[1, 0]))
    assert mechanism.gravity == (1.0, 0.0)


def test_references_are_bibtex():
    for model in MODELS:
        for entry in model.references:
            assert entry.startswith("@")
            assert entry.count("{") == entry.count("}")
    assert any(model.references for model in MODELS)


def test_free_form_model_is_cross_checked():
    with pytest.raises(SpecError, match="there is no body 'b'"):
        build(
            MechanismOptions(bodies={"a": {"mass": 1}}, forces={"f": {"type": "force", "body": "b", "value": [1, 0]}})
        )
