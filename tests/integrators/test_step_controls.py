"""Controllers of adaptive steps: their closed loop, the smoothness of steps, resumption, and refusals."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.integrators.host.step_host import StepHost
from mbdkit.integrators.interface import Timetable
from mbdkit.integrators.run.step_control import Control, ControlData, control_data, factor_after_acceptance
from mbdkit.integrators.start import start_method
from mbdkit.methods.step_controls import controlled
from mbdkit.plugin import StepFilter, simulate
from mbdkit.registry.item_options import named_options
from mbdkit.registry.manager import registry
from mbdkit.runs.preparation import build, make_method
from mbdkit.runs.run_checkpoint import Parts
from mbdkit.spec import load_spec
from mbdkit.spec.run_spec import RunSpec, spec_type
from tests.integrators.python_methods import Pair, Rk45
from tests.runs.resuming.checkpoints import checkpoint_of
from tests.slow_cases import slow

from .running import DOUBLE
from .step_methods import RungeKutta, offering

NAMES = ["deadbeat", "pi", "pid", "predictive", "h211b", "h312b", "h321"]
K = 5
"""Order of the error in the simulated loops."""
END = 1.2


def filter_of(name: str, **options: Any) -> StepFilter:
    item = registry().get("step-control", name)
    plugin: Any = item.plugin
    found: StepFilter = plugin.create(named_options(item)(name=name, **options))
    return found


def simulated(chosen: StepFilter, disturbance: Callable[[int], float], steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the logarithms of step sizes and of errors, if the error is ``exp(disturbance(n)) h^K``."""
    data = ControlData(*(x.tolist() for x in control_data(Control(order=K, estimate_order=K, filter=chosen), 0.0)))
    past = {"last_error": 0.0, "earlier_error": 0.0, "last_size": 0.0, "earlier_size": 0.0, "retrying": 0}
    h, sizes, errors = 0.9, [], []
    for n in range(steps):
        error = float(np.exp(disturbance(n)) * h**K)
        sizes.append(h)
        errors.append(error)
        record = type("Past", (), {name: [value] for name, value in past.items()})
        factor = factor_after_acceptance(data, h, error, record)
        past |= {"earlier_error": past["last_error"], "last_error": error}
        past |= {"earlier_size": past["last_size"], "last_size": h}
        h *= float(factor)
    return np.log(sizes), np.log(errors)


@pytest.mark.parametrize(
    ("name", "dynamics", "adaptivity", "filtering"),
    [("deadbeat", 1, 1, 0), ("pid", 3, 1, 2), ("predictive", 2, 2, 0), ("h211b", 2, 1, 1), ("h312b", 3, 1, 2),
     ("h321", 3, 2, 1)],
)  # fmt: skip
def test_controllers_have_the_orders_in_their_names(name: str, dynamics: int, adaptivity: int, filtering: int) -> None:
    # Soderlind (2003): roots at 1 of the denominator, and at -1 of the numerator, of the transfer function
    chosen = filter_of(name)
    denominator = np.polymul([1.0, -1.0], [1.0, *chosen.ratios])
    assert np.count_nonzero(chosen.errors) <= dynamics
    assert np.sum(np.abs(np.roots(denominator) - 1.0) < 1e-6) == adaptivity
    assert np.sum(np.abs(np.roots(chosen.errors) + 1.0) < 1e-6) == filtering


@pytest.mark.parametrize("name", NAMES)
def test_step_sizes_settle_where_the_error_has_its_set_value(name: str) -> None:
    chosen = filter_of(name, safety=0.8)
    sizes, errors = simulated(chosen, lambda n: 0.7 if n < 40 else 0.2, 160)
    # expected: the set value safety^k, reached as fast as the largest pole of the closed loop allows
    assert errors[-1] == pytest.approx(K * np.log(0.8), abs=1e-10)
    largest = max(map(abs, chosen.poles()))
    deviations = np.abs(sizes - sizes[-1])[40:]
    if largest > 0.3:
        visible = np.flatnonzero(deviations > 1e-9)[-12:]
        rate = np.polyfit(visible, np.log(deviations[visible]), 1)[0]
        assert rate == pytest.approx(np.log(largest), abs=0.03)


@pytest.mark.parametrize(("name", "response"), [("deadbeat", 1.0), ("h211b", 0.0), ("h312b", 0.0), ("h321", 0.0)])
def test_filters_do_not_respond_to_errors_that_alternate(name: str, response: float) -> None:
    # expected: the transfer function at -1, which is 0 for low-pass filters; deadbeat follows with amplitude 1 / K
    amplitude = 0.1
    sizes, _ = simulated(filter_of(name), lambda n: amplitude * (-1.0) ** n, 400)
    swing = 0.5 * float(np.ptp(sizes[-20:]))
    assert swing == pytest.approx(response * amplitude / K, abs=1e-12)


def changes(run: mbdkit.Run) -> np.ndarray:
    """Return the changes of the logarithm of the step size after the first quarter (Soderlind and Wang 2006)."""
    sizes = np.diff(run.check().time)[:-2]
    changed: np.ndarray = np.abs(np.diff(np.log(sizes)))
    return changed[len(changed) // 4 :]


def damped_rod() -> mbdkit.Mechanism:
    """Return a rod whose motion is so strongly damped that stability limits the steps of explicit methods."""
    m = mbdkit.Mechanism()
    rod = m.body("rod", mass=1.0, inertia=1 / 12, position=(0.5, 0.0))
    m.revolute("A", m.ground, rod, at=(0.0, 0.0))
    m.torsion_spring("damper", m.ground, rod, stiffness=0.0, damping=300.0)
    m.torque("drive", rod, value="5*sin(t)")
    return m


def run_of(model: Any, integrator: dict[str, Any], end: float, **sections: Any) -> mbdkit.Run:
    return mbdkit.run(model, integrator={"adaptive": True} | integrator, time={"end": end}, **sections)


def test_a_proportional_part_damps_the_steps_at_the_limit_of_stability() -> None:
    # Gustafsson (1991): the elementary controller oscillates there, and a tenth of its steps is rejected
    model = damped_rod()
    elementary, pi = (
        run_of(model, {"name": "dopri5", "rtol": 1e-4, "step_control": {"name": name}}, 1.0)
        for name in ("deadbeat", "pi")
    )
    assert np.mean(changes(pi)) < 0.01 * np.mean(changes(elementary))
    assert pi.stats["rejected"] <= 3 < 0.1 * elementary.stats["accepted"] < elementary.stats["rejected"]


@pytest.mark.parametrize("method", [{"name": "dopri5"}, {"name": "radau-iia"}], ids=["dopri5", "radau-iia"])
@pytest.mark.parametrize("name", ["pid", "h211b"])
def test_filters_smooth_the_steps_where_accuracy_limits_them(name: str, method: dict[str, Any]) -> None:
    elementary, smooth = (
        run_of("double-pendulum", method | {"step_control": {"name": name}}, 40.0) for name in ("deadbeat", name)
    )
    assert np.sum(changes(smooth)) < 0.9 * np.sum(changes(elementary))
    assert smooth.stats["accepted"] < 1.15 * elementary.stats["accepted"]


def test_the_default_controller_is_unchanged_by_naming_none() -> None:
    integrator = {"name": "radau-iia", "adaptive": True}
    spec = load_spec("double-pendulum", integrator=integrator, time={"end": 2.0})
    assert "step_control" not in spec.canonical_json()
    assert RunSpec(**spec.model_dump(by_alias=True)).sha256() == spec.sha256()
    # the default of implicit methods is the elementary controller
    named = run_of("double-pendulum", integrator | {"step_control": {"name": "deadbeat"}}, 2.0)
    assert simulate(spec).time.tobytes() == named.time.tobytes()


def adaptive_spec(name: str, method: str) -> RunSpec:
    """Return the spec of a run of `Pair`, which is written in Python, or of a compiled method."""
    integrator = {"name": "mine"} if method == "python" else {"name": method, "adaptive": True, "rtol": 1e-5}
    kind = spec_type(offering(Pair(1e-4), adaptive=True, order=None, states=True)) if method == "python" else RunSpec
    integrator |= {"step_control": {"name": name}}
    return kind(mbdkit=1, model=DOUBLE, integrator=integrator, time={"end": END})


def started(spec: RunSpec) -> Parts:
    workspace = build(spec)[0]
    stepper: Any = start_method(make_method(spec), workspace, Timetable(0.0, END, single=True))
    return Parts(workspace, stepper, None, None)  # type: ignore[arg-type]


@pytest.mark.parametrize("method", ["dopri5", "python", *slow("radau-iia")])
@pytest.mark.parametrize("name", ["h321", *slow("h211b")])
def test_a_run_goes_on_from_any_step_to_the_same_bits(name: str, method: str) -> None:
    spec = adaptive_spec(name, method)
    whole, stored = started(spec), []
    while not whole.stepper.finished:
        stored.append(checkpoint_of(whole.motion()).encoded())
        whole.stepper.advance()
    end = whole.stepper.last_state()
    assert isinstance(whole.stepper, StepHost) == (method == "python")
    assert len(stored) > 10
    assert whole.stepper.counters.rejected > 0
    for bits in stored:
        parts = started(spec)
        parts.restore_motion(type(checkpoint_of({})).decoded(bits).state)
        while not parts.stepper.finished:
            parts.stepper.advance()
        assert parts.stepper.last_state().q.tobytes() == end.q.tobytes()
        assert parts.stepper.counters == whole.stepper.counters


def test_methods_in_python_take_a_controller_without_knowing_it() -> None:
    method = Pair(1e-6)
    runs = []
    for control in ({}, {"step_control": {"name": "h211b"}}, {"step_control": {"name": "h211b", "b": 8}}):
        kind = spec_type(offering(method, adaptive=True, order=None, states=True))
        spec = kind(mbdkit=1, model=DOUBLE, integrator={"name": "mine", **control}, time={"end": 4.0})
        runs.append(simulate(spec).check())
    rough, smooth, smoother = (float(np.sum(changes(run))) for run in runs)
    assert smoother < smooth < rough
    assert method.tolerances is not None
    assert method.tolerances.control is None  # the object of the plugin is not changed


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "an unknown name": (
        {"name": "dopri5", "adaptive": True, "step_control": {"name": "h211x"}},
        "integrator.step_control.name: there is no step control 'h211x' (did you mean 'h211b'?)",
    ),
    "a text": (
        {"name": "dopri5", "adaptive": True, "step_control": "pi"},
        "integrator.step_control: should be a mapping such as `{name: pi}`, not the text 'pi'",
    ),
    "an option of another": (
        {"name": "dopri5", "adaptive": True, "step_control": {"name": "pi", "b": 4}},
        "integrator.step_control.b: 'b' belongs to 'h211b' and 'h312b', not to the step control 'pi'",
    ),
    "an unstable loop": (
        {"name": "gauss", "adaptive": True, "step_control": {"name": "pi", "integral": 3.0}},
        "integrator.step_control: the controller is unstable: a pole of the closed loop has the modulus",
    ),
    "fixed steps of an adaptive method": (
        {"name": "dopri5", "step_control": {"name": "pi"}},
        "integrator.step_control: 'dopri5' takes fixed steps, which no controller chooses; add `adaptive: true`",
    ),
    "a method with fixed steps": (
        {"name": "rk4", "step_control": {"name": "pi"}},
        "integrator.step_control: 'rk4' takes fixed steps, which no controller chooses",
    ),
    "a library": (
        {"name": "scipy-radau", "step_control": {"name": "pi"}},
        "integrator.step_control: the library of 'scipy-radau' chooses its steps, so that no other controller can be",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_no_controller_can_do_is_refused_in_one_sentence(case: str) -> None:
    integrator, sentence = REFUSED[case]
    with pytest.raises(SpecError, match=re.escape(sentence)) as error:
        mbdkit.run("double-pendulum", integrator=integrator, time={"end": 1.0, "step": 0.1})
    assert "\n" not in str(error.value)


class Choosing(RungeKutta):
    """A method that chooses its steps itself."""

    tolerances = mbdkit.Tolerances(1e-6, 1e-6)

    def step(self, equations: Any, t: float, state: Any, h: float) -> Any:
        return mbdkit.Step(super().step(equations, t, state, h), next_step=0.01)


@pytest.mark.parametrize(
    ("method", "sentence"),
    [(Choosing(), "the method chooses its steps itself, so that no other"), (Rk45(), "the library of 'mine' chooses")],
)
def test_methods_that_choose_their_steps_refuse_a_controller(method: Any, sentence: str) -> None:
    kind = spec_type(offering(method, adaptive=True, order=None, stabilizations=("none",)))
    spec = kind(mbdkit=1, model=DOUBLE, integrator={"name": "mine", "step_control": {"name": "pi"}}, time={"end": 0.1})
    if isinstance(method, Rk45):
        with pytest.raises(SpecError, match=sentence):
            simulate(spec)
    else:  # known after the first step only
        assert sentence in simulate(spec).status_reason


def test_the_method_of_a_plugin_is_copied() -> None:
    spec = adaptive_spec("h211b", "python")
    method = Pair(1e-4)
    before = copy.deepcopy(vars(method))
    new = controlled(method, spec.integrator, "mine")
    assert vars(method) == before
    assert new.traits.tolerances is not None
    assert new.traits.tolerances.control == filter_of("h211b")
