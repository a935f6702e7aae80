"""Controlled steps end where forces switch. Expected values are closed forms of motions along a line."""

import math

import numpy as np
import pytest
import sympy

import mbdkit
from mbdkit.engine.law_compiler import switches_of
from mbdkit.laws import exponential, one_sided
from mbdkit.mechanism.force_law import ExpressionLaw, law_parameters

METHODS = [
    *({"name": "gauss", "stages": stages, "adaptive": True} for stages in (1, 2, 3, 6)),
    {"name": "radau-iia", "stages": 3, "adaptive": True},
    {"name": "dopri5", "adaptive": True},
    {"name": "dop853", "adaptive": True},
    {"name": "scipy-dop853"},
    {"name": "scipy-lsoda"},
]


def run(force, speed, end, method, **more):
    """Return a run of a mass of 1 kg that starts at x = 0."""
    body = {"mass": 1.0, "position": [0, 0], "velocity": [speed, 0]}
    if isinstance(force, str):
        force = {"type": "force", "body": "b", "value": [force, "0"]}
    model = {"name": "mechanism", "gravity": [0, 0], "bodies": {"b": body}, "forces": {"f": force}}
    return mbdkit.run({"mbdkit": 1, "model": model, "integrator": method, "time": {"end": end}} | more)


@pytest.mark.parametrize("method", METHODS, ids=lambda x: f"{x['name']}{x.get('stages', '')}")
def test_a_stop_returns_a_mass_at_its_own_speed(method):
    stiffness, speed, end = 1e6, 3.0, 0.6
    r = run(f"-{stiffness}*max(0, b.x - 1)", speed, end, method)
    back = end - 1.0 / speed - math.pi / math.sqrt(stiffness)  # a linear spring holds the mass for half a period
    assert r["b"].velocity[-1, 0] == pytest.approx(-speed, rel=1e-4)
    assert r["b"].position[-1, 0] == pytest.approx(1.0 - speed * back, rel=1e-4)


@pytest.mark.parametrize("method", METHODS[3:8], ids=lambda x: f"{x['name']}{x.get('stages', '')}")
def test_peaks_and_integrals_do_not_interpolate_across_the_beginning_of_a_stop(method):
    stiffness, speed = 1e5, 2.0
    measures = {"peak": "max(abs(b.ax))", "change": "integral(abs(b.ax))"}
    r = run(f"-{stiffness}*max(0, b.x - 1)", speed, 2.0, method | {"rtol": 1e-7, "atol": 1e-9}, measures=measures)
    assert r.measures["peak"] == pytest.approx(speed * math.sqrt(stiffness), rel=1e-5)
    assert r.measures["change"] == pytest.approx(2.0 * speed, rel=1e-5)


@pytest.mark.parametrize("method", METHODS[3:7], ids=lambda x: f"{x['name']}{x.get('stages', '')}")
def test_integrals_have_the_force_before_a_jump_and_that_after_it(method):
    measures = {"peak": "max(abs(b.ax))", "change": "integral(abs(b.ax))"}
    r = run("-2*b.vx/abs(b.vx) - 3", 4.0, 1.2, method | {"rtol": 1e-7, "atol": 1e-9}, measures=measures)
    assert r.measures["peak"] == pytest.approx(5.0, rel=1e-6)
    assert r.measures["change"] == pytest.approx(5.0 * 0.8 + 1.0 * 0.4, rel=1e-6)


#: In the second case, DOP853 meets the stop only with stages that count neither in its result nor in its error, and its
#: dense output ends up kilometres away.
PRELOADED = {
    "near": (1e5, 0.004, 2.0, 0.5, 0.4),
    "far": (25755.92713, 2.5244516e-3, 1.25149804, 2.96460306, 4.34310043),
}


@pytest.mark.parametrize("case", PRELOADED)
@pytest.mark.parametrize("method", METHODS[4:8], ids=lambda x: x["name"])
def test_a_preloaded_stop_acts_from_where_it_engages(method, case):
    stiffness, stretch, speed, distance, end = PRELOADED[case]
    pathway = {"type": "two-points", "bodies": ["ground", "b"], "points": [[distance + 1.0, 0], [0, 0]]}
    law = {"type": "law", "law": "one-sided", "acts": "compression", "pathway": pathway, "stiffness": stiffness}
    r = run(law | {"free_length": 1.0 + stretch, "engages_at": 1.0}, speed, end, method)
    rate = math.sqrt(stiffness)
    back = end - distance / speed - (math.pi - 2.0 * math.atan2(rate * stretch, speed)) / rate
    assert r["b"].position[-1, 0] == pytest.approx(distance - speed * back, abs=1e-4 * distance)


@pytest.mark.parametrize("method", METHODS, ids=lambda x: f"{x['name']}{x.get('stages', '')}")
def test_a_barrier_narrower_than_any_step_turns_a_mass_back(method):
    width, speed = 1e-5, 3.0
    force = 1.2 * speed**2 / 2.0 / width  # its potential exceeds the kinetic energy by a fifth
    inside = f"(abs(b.x - {1.0 + width / 2!r}) - {width / 2!r})"
    r = run(f"-{force / 2!r}*(1 - {inside}/abs({inside}))", speed, 0.6, method)
    # dopri5 4.5e-4, others below 1e-5: the mass is in the barrier for 1.1e-5 s
    assert r["b"].velocity[-1, 0] == pytest.approx(-speed, rel=2e-3)


def test_a_force_that_never_switches_leaves_all_steps_as_they_are():
    method = {"name": "dop853", "adaptive": True}
    with_switch, without = (run(f"-b.x{more}", 3.0, 5.0, method) for more in (" - max(0, b.x - 100)", ""))
    assert np.array_equal(with_switch.time, without.time)
    assert np.array_equal(with_switch["b"].position, without["b"].position)
    assert with_switch.stats["rhs_evaluations"] == without.stats["rhs_evaluations"]


@pytest.mark.parametrize("name", ["dop853", "scipy-dop853"])
def test_a_jump_that_holds_the_motion_ends_in_a_doubt(name):
    method = {"name": name} | ({"adaptive": True} if name == "dop853" else {})
    r = run("-2*b.vx/abs(b.vx)", 0.5, 0.2501, method, limits={"max_steps": 600})
    assert r.verdict in ("doubtful", "bad")
    named = "model.forces.f.value, ['-2*b.vx/abs(b.vx)', '0'], switches without end"
    assert r.status == "failed" or any(named in reason for reason in r.verdict_reasons)


@pytest.mark.parametrize(
    ("module", "options"),
    [
        (one_sided, {"stiffness": 50.0, "damping": 3.0, "free_length": 1.0, "engages_at": 1.2, "acts": "tension"}),
        (one_sided, {"stiffness": 50.0, "damping": 3.0, "free_length": 1.0, "acts": "compression"}),
        (exponential, {"scale": 5.0, "growth": 4.0, "damping": 2.0, "free_length": 0.4, "acts": "tension"}),
    ],
)
def test_packaged_laws_switch_where_their_formulas_do(module, options):
    law = module.LAW
    own = {"one_sided": "OneSidedOptions", "exponential": "ExponentialOptions"}[module.__name__.rpartition(".")[2]]
    names, values = law_parameters(law, getattr(module, own)(**options), "law")
    numbers = dict(zip(names, values, strict=True))
    symbols = list(law.force().free_symbols)
    force = sympy.lambdify(symbols, law.force(), "math")
    generator = np.random.default_rng(1)
    for length, rate in generator.uniform([0.0, -10.0], [2.0, 10.0], (200, 2)):
        given = numbers | {"length": length, "rate": rate}
        value = force(*(given[symbol.name] for symbol in symbols))
        assert (float(law.switch(length, rate, numbers)) > 0.0) == (value != 0.0)


def test_conditions_of_sympy_and_of_expressions_become_switching_functions():
    length, rate, a = sympy.symbols("length rate a", real=True)
    law = ExpressionLaw(
        sympy.Piecewise((a * length, sympy.And(length > a, rate > 0)), (sympy.Abs(rate), True)), parameters=dict
    )
    switches = switches_of(law, (("a", 0.5),))
    assert switches is not None
    assert switches.number == 2
    assert {0, 1, 3} <= switches.inputs  # length, rate and the parameter
    smooth = ExpressionLaw(a * length**3, parameters=dict)
    assert switches_of(smooth, (("a", 0.5),)) is None
