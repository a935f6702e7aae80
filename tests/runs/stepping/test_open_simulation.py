"""Simulations that a program advances: the same bits as whole runs, states, forks, records, and wrong use."""

import contextlib
import copy
import json
import pickle
import subprocess
import sys
import threading

import numpy as np
import pytest

import mbdkit
from mbdkit import spec
from mbdkit.runs.simulation import simulate
from mbdkit.runs.stepping.open_simulation import Simulation
from tests.integrators.python_methods import Pair, offering, spec_type
from tests.runs.stepping.driven_pendulum import METHODS, driven_pendulum, sections

EXAMPLES = [
    "pd-leg",
    "car-axis",
    "chain",
    "four-bar",
    "knee",
    "roll-up",
    "watt-six-bar",
    "cam-follower",
    "bouncing-ball",
]
MORE_EXAMPLES = [
    "belt", "crank-press", "delayed-balance", "double-wishbone", "elbow-curl", "flexible-slider-crank",
    "geared-five-bar", "geared-knee-orthosis", "gravity-balanced-arm", "jump", "knee-slot", "limit-stop", "n-four-bar",
    "planetary-gear", "quick-return", "rack-railway", "series-elastic-knee", "sit-down", "slider-crank",
    "slider-crank-clearance", "spin-up-beam", "spring-pendulum", "squat", "sway", "walker",
]  # fmt: skip


def advanced(simulation: Simulation, random: np.random.Generator, count: int) -> None:
    """Advance to the end of the spec in pieces, some of which end between two fixed steps."""
    start, end = simulation.time, simulation.spec.time.final
    for t in [*np.sort(random.uniform(start, end, count)), end]:
        if not simulation.ended:
            simulation.advance_to(float(t))


def driven(simulation: Simulation, random: np.random.Generator, calls: int) -> None:
    """Advance by random times, and set inputs at some of them."""
    for _ in range(calls):
        if random.random() < 0.6:
            simulation.inputs["held"] = random.uniform(-2.0, 2.0)
        if random.random() < 0.4:
            simulation.inputs["ramp"] = random.uniform(-1.0, 1.0)
        simulation.advance(float(random.choice([0.01, 0.02, 0.0137, 0.05])))


@pytest.mark.parametrize("name", [*EXAMPLES, *(pytest.param(name, marks=pytest.mark.slow) for name in MORE_EXAMPLES)])
def test_pieces_of_packaged_examples_repeat(name):
    simulation = mbdkit.open(name)
    advanced(simulation, np.random.default_rng(5), 7)
    run = simulation.finish()
    if not simulation.spec.claims.adaptive:  # the same steps as without the pieces
        assert run.data_sha256 == mbdkit.run(name).data_sha256
    assert mbdkit.run(run.spec).data_sha256 == run.data_sha256


@pytest.mark.parametrize("method", METHODS)
def test_what_was_set_repeats_the_run(method):
    for seed in range(3):
        simulation = mbdkit.open(driven_pendulum(), **sections(method))
        driven(simulation, np.random.default_rng(seed), 12)
        run = simulation.finish()
        again = mbdkit.run(run.spec)
        assert again.data_sha256 == run.data_sha256
        assert again.run_id == run.run_id
        np.testing.assert_array_equal(again.inputs["held"].set.value, run.inputs["held"].set.value)


@pytest.mark.parametrize("tolerance", [None, 1e-6])
def test_what_was_set_repeats_the_run_of_a_method_in_python(tolerance):
    claims = {"states": True, "dense_output": True}
    registry = offering(Pair(tolerance), **claims, **({} if tolerance is None else {"adaptive": True, "order": None}))
    model, time = driven_pendulum().to_spec(), {"end": 1.0, **({} if tolerance else {"step": 0.01})}
    own = spec_type(registry)(mbdkit=1, model=model, integrator={"name": "mine"}, time=time)
    simulation = Simulation(own)
    for t, held in (
        (0.013, 1.0),
        (0.017, None),
        (0.1, -1.0),
        (0.2037, 0.5),
        (0.3, None),
        (0.3041, 1.5),
        (0.3123, None),
        (0.5, 2.0),
    ):
        if held is not None:  # at the ends of steps and between them, after which the simulation reads further on
            simulation.inputs["held"], simulation.inputs["ramp"] = held, 0.3 * held
        simulation.advance_to(t)
    simulation.advance_to(0.6)
    simulation.inputs["held"] = -0.7  # alone: a linear input would change again at the next pause
    for t in (0.6041, 0.6083, 0.7):
        simulation.advance_to(t)
    run = simulation.finish()
    assert simulate(run.run_spec).data_sha256 == run.data_sha256


def test_stops_of_the_spec_after_the_end_are_left_out():
    simulation = mbdkit.open(
        driven_pendulum(), **sections("rk4") | {"time": {"end": 1.0, "step": 0.01, "stops": [0.5, 0.9]}}
    )
    simulation.inputs["held"] = 1.0
    simulation.advance(0.7)
    run = simulation.finish()
    assert run.run_spec.time.stops == (0.5,)
    assert mbdkit.run(run.spec).data_sha256 == run.data_sha256


def test_a_simulation_can_be_used_after_a_reset_that_was_refused(tmp_path):
    with mbdkit.open("four-bar", tmp_path / "run.h5") as simulation:
        for initial in ({"nope.angle": 1.0}, {"B.angle": 1e3, "C.angle": -1e3}):
            with pytest.raises(mbdkit.SpecError):
                simulation.reset(initial=initial)
            simulation.advance(0.01)
    with mbdkit.load(tmp_path / "run.h5") as run:
        assert run.status == "complete"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(200))
def test_random_schedules_repeat(seed):
    random = np.random.default_rng(1000 + seed)
    method = list(METHODS)[seed % len(METHODS)]
    output = [{"every": 1}, {"every": 3}, {"interval": 0.023}][
        seed % 3 if method not in ("rk4", "lobatto") else seed % 2
    ]
    simulation = mbdkit.open(driven_pendulum(), **sections(method, output=output))
    driven(simulation, random, 15)
    run = simulation.finish()
    assert mbdkit.run(run.spec).data_sha256 == run.data_sha256


CONTACT = {
    "compliant": {},
    "event-driven": {"contact": {"treatment": "event-driven"}},
    "time-stepping": {
        "contact": {"treatment": "time-stepping"}, "integrator": {"name": "moreau-jean"},
        "time": {"end": 2.0, "step": 0.002},
    },
    "generalized-alpha": {
        "contact": {"treatment": "time-stepping"}, "integrator": {"name": "nonsmooth-generalized-alpha"},
        "time": {"end": 2.0, "step": 0.002},
    },
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("treatment", CONTACT)
def test_schedules_with_contacts_repeat(treatment, seed):
    ball = yaml_of("bouncing-ball")
    hold = "zero" if "integrator" in CONTACT[treatment] else "linear"  # time-stepping integrates no states
    ball["model"]["inputs"] = {"push": {"unit": "N"}, "lift": {"unit": "N", "hold": hold}}
    ball["model"]["forces"] = {"push": {"type": "force", "body": "ball", "value": ["inputs.push", "inputs.lift"]}}
    pushed(mbdkit.open(ball | CONTACT[treatment]), "push", "lift", seed, 3.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_schedules_with_muscles_repeat(seed):
    curl = yaml_of("elbow-curl")
    curl["model"]["inputs"] = {"flex": {}, "extend": {"hold": "linear"}}
    for muscle, text in {"biceps": "0.05 + inputs.flex", "triceps": "0.05 + inputs.extend"}.items():
        curl["model"]["muscles"][muscle]["excitation"] = text
    integrator = [{"name": "radau-iia"}, {"name": "dop853"}, {"name": "gauss", "stages": 2}][seed % 3]
    pushed(
        mbdkit.open(curl | {"integrator": integrator, "time": {"end": 0.6, "step": 0.002}}), "flex", "extend", seed, 0.5
    )


def yaml_of(name: str) -> dict:
    """Return the spec of a packaged example as plain data."""
    return json.loads(spec.load_spec(name, ()).canonical_json())


def pushed(simulation: Simulation, held: str, ramp: str, seed: int, most: float) -> None:
    """Set both inputs at random times, some after a return to an earlier state, and compare with the repeated run."""
    random = np.random.default_rng(seed)
    state = simulation.state()
    for k in range(10):
        if simulation.ended:
            break
        simulation.inputs[held], simulation.inputs[ramp] = random.uniform(0.0, most, 2)
        simulation.advance(float(random.choice([0.05, 0.0437, 0.02])))
        if k == 3:
            state = simulation.state()
        if k == 6:
            simulation.restore(state)
    run = simulation.finish()
    assert run.status == "complete"
    assert mbdkit.run(run.spec).data_sha256 == run.data_sha256


@pytest.mark.parametrize("method", [method for method in METHODS if not method.startswith("scipy")])
def test_states_and_forks_continue_with_the_same_bits(method):
    simulation = mbdkit.open(driven_pendulum(), **sections(method))
    driven(simulation, np.random.default_rng(1), 4)
    state = simulation.state()
    driven(simulation, np.random.default_rng(2), 5)
    expected = simulation.state()
    simulation.restore(state)
    driven(simulation, np.random.default_rng(3), 3)  # another way, which is then forgotten
    other = simulation.fork()
    simulation.restore(mbdkit.SimulationState.from_bytes(state.to_bytes()))
    other.restore(state)
    runs = []
    for one in (simulation, other):
        driven(one, np.random.default_rng(2), 5)
        assert one.state().to_bytes() == expected.to_bytes()
        runs.append(one.finish())
    straight = mbdkit.open(driven_pendulum(), **sections(method))
    driven(straight, np.random.default_rng(1), 4)
    driven(straight, np.random.default_rng(2), 5)
    assert {run.data_sha256 for run in runs} == {straight.finish().data_sha256}


def test_a_state_continues_in_another_process(tmp_path):
    simulation = mbdkit.open(driven_pendulum(), **sections("gauss"))
    driven(simulation, np.random.default_rng(1), 4)
    (tmp_path / "state").write_bytes(simulation.state().to_bytes())
    program = (
        "import sys, numpy as np, mbdkit\n"
        "from tests.runs.stepping.driven_pendulum import driven_pendulum, sections\n"
        "from tests.runs.stepping.test_open_simulation import driven\n"
        "simulation = mbdkit.open(driven_pendulum(), **sections('gauss'))\n"
        "simulation.restore(mbdkit.SimulationState.from_bytes(open(sys.argv[1], 'rb').read()))\n"
        "driven(simulation, np.random.default_rng(2), 5)\n"
        "print(simulation.finish().data_sha256)\n"
    )
    told = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "state")], check=True, capture_output=True, text=True
    )
    driven(simulation, np.random.default_rng(2), 5)
    assert told.stdout.split()[-1] == simulation.finish().data_sha256


def test_threads_do_not_disturb_each_other():
    hashes: list[str] = []

    def simulate() -> None:
        simulation = mbdkit.open(driven_pendulum(), **sections("gauss"))
        driven(simulation, np.random.default_rng(4), 20)
        hashes.append(simulation.finish().data_sha256)

    threads = [threading.Thread(target=simulate) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    simulate()
    assert len(hashes) == 9
    assert len(set(hashes)) == 1


def refused_to_other_threads(used, calls):
    """Assert that another thread cannot make any of the calls while this one uses an object."""
    refused = []

    def call() -> None:
        for one in calls:
            with pytest.raises(mbdkit.SpecError, match="another thread is using th"):
                one()
            refused.append(one)

    with contextlib.ExitStack() as stack:
        assert used.in_use.acquire(blocking=False)
        stack.callback(used.in_use.release)
        thread = threading.Thread(target=call)
        thread.start()
        thread.join()
    assert refused == calls


def test_a_simulation_refuses_a_second_thread_and_loses_no_time():
    simulation = mbdkit.open(driven_pendulum(), **sections("rk4"))
    read, state = simulation.reader(["t"]), simulation.state()
    calls = [
        lambda: simulation.advance(0.01), lambda: simulation.advance_to(1.0), read, lambda: simulation.state(),
        lambda: simulation.restore(state), lambda: simulation.reset(), lambda: simulation.fork(),
        lambda: simulation.inputs.update({"held": 1.0}), lambda: simulation.misalignment, lambda: simulation.finish(),
    ]  # fmt: skip
    refused_to_other_threads(simulation, calls)
    times = []

    def advance() -> None:
        for _ in range(20):
            with contextlib.suppress(mbdkit.SpecError):
                simulation.advance(0.01)
                times.append(0.01)

    threads = [threading.Thread(target=advance) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert simulation.time == pytest.approx(sum(times))  # what was not refused has been done


def test_a_prepared_run_refuses_a_second_thread():
    prepared = mbdkit.prepare("double-pendulum", time={"end": 0.1, "step": 0.01})
    refused_to_other_threads(prepared, [prepared.run, prepared.spec_with, prepared.start_with])


def test_copying_and_pickling_a_simulation_name_what_does_it():
    simulation = mbdkit.open("double-pendulum")
    for attempt in (pickle.dumps, copy.copy, copy.deepcopy):
        with pytest.raises(TypeError, match=r"`fork` copies it, and `state\(\)\.to_bytes\(\)` takes its state"):
            attempt(simulation)


def test_a_held_torque_turns_a_wheel_as_in_closed_form():
    m = mbdkit.Mechanism(gravity=[0.0, 0.0])
    wheel = m.body("wheel", mass=1.0, inertia=2.0)
    m.revolute("axle", "ground", wheel, at=[0.0, 0.0])
    m.input("torque", unit="N*m")
    m.torque("motor", wheel, value="inputs.torque")
    angle, speed = 0.0, 0.0
    with mbdkit.open(m, integrator={"name": "rk4"}, time={"end": 10.0, "step": 0.1}) as simulation:
        read = simulation.reader(["wheel.angle", "wheel.angular_velocity", "inputs.torque"])
        for torque in (1.0, -3.0, 2.0, 0.0):
            simulation.inputs["torque"] = torque
            simulation.advance(0.5)
            angle, speed = angle + 0.5 * speed + 0.125 * torque / 2.0, speed + 0.5 * torque / 2.0
            np.testing.assert_allclose(read(), [angle, speed, torque], rtol=1e-13, atol=1e-15)
    assert simulation.time == 2.0


def test_a_linear_input_ramps_to_its_value_by_the_end_of_the_advance():
    m = mbdkit.Mechanism(gravity=[0.0, 0.0])
    wheel = m.body("wheel", mass=1.0, inertia=1.0)
    m.revolute("axle", "ground", wheel, at=[0.0, 0.0])
    m.input("torque", unit="N*m", hold="linear")
    m.torque("motor", wheel, value="inputs.torque")
    simulation = mbdkit.open(m, integrator={"name": "rk4"}, time={"end": 10.0, "step": 0.05})
    simulation.inputs["torque"] = 3.0
    simulation.advance(1.0)
    np.testing.assert_allclose(simulation.read(["wheel.angular_velocity", "inputs.torque"]), [1.5, 3.0], rtol=1e-13)
    simulation.advance(1.0)  # held from now on
    np.testing.assert_allclose(simulation.read(["wheel.angular_velocity"]), [4.5], rtol=1e-13)
    run = simulation.finish()
    assert run.inputs["torque"].set.time.tolist() == [0.0, 1.0]
    np.testing.assert_allclose(run.inputs["torque"].value[[10, 20, 40]], [1.5, 3.0, 3.0], rtol=1e-14)


def test_readers_give_what_is_recorded():
    names = ["upper.x", "lower.angle", "elbow.angle", "elbow.force", "shoulder.force_x", "energy.total", "inputs.held"]
    simulation = mbdkit.open(driven_pendulum(), **sections("gauss"))
    read, values = simulation.reader(names), []
    for _ in range(10):
        simulation.inputs["held"] = simulation.time
        simulation.advance(0.1)
        values.append(read())
    run = simulation.finish()
    rows = [np.flatnonzero(np.isclose(run.time, 0.1 * (k + 1)))[0] for k in range(10)]
    force = np.hypot(*run.joints["elbow"].reaction_force[rows].T)
    np.testing.assert_allclose(np.array(values)[:, 3], force, rtol=1e-13)
    np.testing.assert_array_equal(np.array(values)[:, 0], run.bodies["upper"].position[rows, 0])
    np.testing.assert_array_equal(np.array(values)[:, 6], run.inputs["held"].value[rows])
    np.testing.assert_array_equal(np.array(values)[:, 2], run.joints["elbow"].angle[rows])


def test_errors_of_a_checked_simulation_are_those_of_the_repeated_run_for_given_inputs():
    simulation = mbdkit.open(driven_pendulum(), **sections("gauss", check=True))
    driven(simulation, np.random.default_rng(6), 12)
    run = simulation.finish()
    again = mbdkit.run(run.spec)
    assert run.verdict == "good"
    for name in ("position_error", "reaction_error"):
        np.testing.assert_array_equal(run.array(f"accuracy/{name}"), again.array(f"accuracy/{name}"))
    assert "for given inputs" in run.errors.sentence()
    assert run.stats["wall_s"] > 0.0


def test_reset_begins_anew_with_other_numbers():
    simulation = mbdkit.open(driven_pendulum(), **sections("rk4"))
    read = simulation.reader(["upper.angle", "lower.angle"])
    first = read()
    driven(simulation, np.random.default_rng(1), 5)
    simulation.reset(seed=3)
    np.testing.assert_array_equal(read(), first)
    assert simulation.time == 0.0
    assert dict(simulation.inputs) == {"held": 0.2, "ramp": 0.0}
    noise = simulation.random.normal()
    simulation.reset(
        initial={"upper.angle": 0.7, "elbow.angle": 0.0}, parameters={"model.bodies.lower.mass": 2.0}, seed=3
    )
    np.testing.assert_allclose(read(), [0.7, 0.7])
    assert simulation.random.normal() == noise
    driven(simulation, np.random.default_rng(1), 5)
    run = simulation.finish()
    assert mbdkit.run(run.spec).data_sha256 == run.data_sha256
    assert json.loads(run.spec_json)["model"]["bodies"]["lower"]["mass"] == 2.0


def test_many_resets_do_not_take_memory():
    import tracemalloc

    simulation = mbdkit.open(driven_pendulum(), **sections("rk4"))

    def episode() -> None:
        simulation.reset()
        simulation.inputs["held"] = 1.0
        simulation.advance(0.05)

    for _ in range(200):
        episode()
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(2_000):
        episode()
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 20_000


def test_an_archive_is_written_and_keeps_what_a_broken_program_has_recorded(tmp_path):
    whole = tmp_path / "whole.h5"
    with mbdkit.open(driven_pendulum(), whole, **sections("rk4")) as simulation:
        driven(simulation, np.random.default_rng(1), 5)
    with mbdkit.load(whole) as run:
        assert run.status == "complete"
        hash_of_file = run.data_sha256
        assert mbdkit.run(run.spec).data_sha256 == hash_of_file
    broken = tmp_path / "broken.h5"

    def program() -> None:
        with mbdkit.open(driven_pendulum(), broken, **sections("rk4")) as simulation:
            driven(simulation, np.random.default_rng(1), 5)
            1 / 0  # noqa: B018

    with pytest.raises(ZeroDivisionError):
        program()
    with mbdkit.load(broken) as run:
        assert run.status == "interrupted"
        assert "ZeroDivisionError in the program (division by zero)" in run.status_reason
        assert run.data_sha256 == hash_of_file


def wrong(message: str):
    return pytest.raises(mbdkit.SpecError, match=message)


def test_wrong_use_is_refused_in_one_sentence(tmp_path):
    simulation = mbdkit.open(driven_pendulum(), **sections("rk4"))
    with wrong("no input 'hold'.*held"):
        simulation.inputs["hold"] = 1.0
    with wrong("finite number"):
        simulation.inputs["held"] = float("nan")
    with wrong("a number, not"):
        simulation.inputs["held"] = [1.0, 2.0]
    with wrong("outside of its bounds, -5.0 to 5.0"):
        simulation.inputs["held"] = 7.0
    with wrong("not later than the time reached"):
        simulation.advance(0.0)
    with wrong("not a finite time"):
        simulation.advance(float("nan"))
    with wrong("never advanced"):
        simulation.finish()
    with wrong("list of expressions"):
        simulation.read("upper.angle")
    simulation.advance(0.1)
    other = mbdkit.open("pendulum", integrator={"name": "rk4"}, time={"end": 1.0, "step": 0.01})
    with wrong("another spec"):
        other.restore(simulation.state())
    read = simulation.reader(["t"])
    simulation.finish()
    for use in (
        read,
        lambda: simulation.misalignment,
        simulation.fork,
        simulation.finish,
        lambda: simulation.advance(0.1),
        simulation.state,
        lambda: simulation.read(["t"]),
    ):
        with wrong("is finished"):
            use()
    with wrong("accuracy"):
        mbdkit.open("pendulum", accuracy=1e-4)
    with pytest.raises(mbdkit.ArchiveError, match="not the state of a simulation"):
        mbdkit.SimulationState.from_bytes(b"something else")
