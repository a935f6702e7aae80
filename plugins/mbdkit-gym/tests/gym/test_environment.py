"""Environments of Gymnasium: their spaces, motions, episodes, seeds and pictures."""

from __future__ import annotations

import tracemalloc
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="gymnasium is not installed: pip install mbdkit[gym]")

from gymnasium.utils.env_checker import check_env  # noqa: E402

import mbdkit  # noqa: E402
from mbdkit import SpecError  # noqa: E402
from mbdkit_gym import Environment, VectorEnvironment  # noqa: E402
from mbdkit_gym.packaged import arguments  # noqa: E402
from tests.margins import assert_within  # noqa: E402

from .cart_pole import ARGUMENTS, cart_pole, motion  # noqa: E402

IDS = ("Acrobot", "CartPole", "FourBar", "KneeSupport")


@pytest.mark.filterwarnings("ignore:.*A Box observation space (min|max)imum value:UserWarning")
@pytest.mark.filterwarnings("ignore:.*we recommend using a symmetric and normalized space:UserWarning")
@pytest.mark.parametrize("name", IDS)
def test_packaged_environments_pass_the_checks_of_gymnasium(name: str) -> None:
    check_env(gymnasium.make(f"mbdkit/{name}-v0").unwrapped)


def test_packaged_environments_are_registered_by_importing_the_module() -> None:
    known = [name for name in gymnasium.registry if name.startswith("mbdkit/")]
    assert sorted(known) == [f"mbdkit/{name}-v0" for name in IDS]
    vector = gymnasium.make_vec("mbdkit/CartPole-v0", num_envs=3, vectorization_mode="vector_entry_point")
    assert isinstance(vector.unwrapped, VectorEnvironment)
    assert vector.metadata["autoreset_mode"] is gymnasium.vector.AutoresetMode.NEXT_STEP
    vector.close()


def test_the_motion_is_that_of_the_equations_in_minimal_coordinates() -> None:
    environment = Environment(cart_pole(0.0025), **ARGUMENTS | {"terminated": None})
    observation, _ = environment.reset(
        options={"cart.x": 0.1, "pole.angle": -1.2, "cart.vx": 0.5, "pole.angular_velocity": 2.0}
    )
    pushes = np.random.default_rng(5).uniform(-3.0, 3.0, 50).astype(np.float32)
    expected = motion([0.1, -1.2, 0.5, 2.0], pushes.astype(float).tolist(), 0.02)
    assert observation == pytest.approx(expected[0], abs=1e-12)
    for push, state in zip(pushes, expected[1:], strict=True):
        observation, reward, terminated, truncated, _ = environment.step(np.array([push]))
        # steps of 2.5 ms by the classical method of order 4: errors were 3e-9 with 5 ms
        assert observation == pytest.approx(state, abs=1e-7)
        assert reward == pytest.approx(np.sin(state[1]) - state[0] ** 2, abs=1e-7)
        assert not terminated
    assert not truncated


@pytest.mark.parametrize(
    "given", [{}, {"integrator": {"name": "gauss"}}, {"integrator": {"name": "dop853", "adaptive": True}}]
)
def test_episodes_are_those_of_open_simulations(given: Mapping[str, Any]) -> None:
    spec = cart_pole(**given)
    environment, texts = Environment(spec, **ARGUMENTS), list(ARGUMENTS["observations"].values())
    observation, _ = environment.reset(options={"cart.x": 0.2})
    with mbdkit.open(environment.definition.spec) as simulation:
        simulation.reset(initial={"cart.x": 0.2})
        read = simulation.reader(texts)
        for number in range(20):
            assert observation.tolist() == read().tolist()
            push = float(np.float32(np.sin(number)))
            observation, *_ = environment.step(np.array([push], dtype=np.float32))
            simulation.inputs["push"] = push
            simulation.advance(0.02)


def test_spaces_have_the_bounds_of_inputs_and_expressions() -> None:
    observations = {
        "sine": "sin(pole.angle)", "distance": "abs(cart.x)", "push": "inputs.push", "rate": "pole.angular_velocity",
        "place": {"value": "cart.x", "min": -2, "max": 2},
    }  # fmt: skip
    environment = Environment(cart_pole(), **ARGUMENTS | {"observations": observations})
    assert environment.observation_space.low.tolist() == [-1.0, 0.0, -5.0, -np.inf, -2.0]
    assert environment.observation_space.high.tolist() == [1.0, np.inf, 5.0, np.inf, 2.0]
    assert environment.definition.observations == {
        "sine": "1", "distance": "m", "push": "N", "rate": "rad/s", "place": "m",
    }  # fmt: skip
    assert environment.action_space == gymnasium.spaces.Box(-5.0, 5.0, (1,), np.float32)
    assert environment.definition.actions == {"push": "N"}
    narrow = Environment(cart_pole(), **ARGUMENTS | {"actions": {"push": [-1, 2]}})
    assert (narrow.action_space.low[0], narrow.action_space.high[0]) == (-1.0, 2.0)
    narrow.reset()
    clipped = narrow.step(np.array([100.0]))[0]
    narrow.reset()
    assert clipped.tolist() == narrow.step(np.array([2.0]))[0].tolist()


def test_episodes_terminate_and_are_truncated() -> None:
    environment = Environment(cart_pole(), **ARGUMENTS | {"duration": 0.1})
    environment.reset()
    ends = [environment.step(np.zeros(1))[2:4] for _ in range(5)]
    assert ends == [(False, False)] * 4 + [(False, True)]
    environment.reset(options={"cart.x": 0.59, "cart.vx": 2.0})
    assert environment.step(np.zeros(1))[2:4] == (True, False)


@pytest.mark.parametrize("further", [{}, {"energy_jump": 10.0}], ids=["in lanes", "in turn"])
def test_a_simulation_that_cannot_go_on_terminates_its_episode_and_says_why(further: dict[str, float]) -> None:
    drifts = {"formulation": "index-1", "limits": {"misalignment": 1e-9, **further}}
    environment = Environment(cart_pole(0.02, **drifts), **ARGUMENTS | {"terminated": None})
    environment.reset(options={"pole.angular_velocity": 20.0})
    outcomes = [environment.step(np.zeros(1)) for _ in range(3)]
    number = next(i for i, outcome in enumerate(outcomes) if outcome[2])
    assert "joint" in outcomes[number][4]["ended"]
    assert not outcomes[number][3]
    environment.reset()
    assert environment.step(np.zeros(1))[2:] == (False, False, {"t": 0.02})


@pytest.mark.parametrize("given", [{}, {"integrator": {"name": "gauss"}}], ids=["in lanes", "in turn"])
@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"reward": "sqrt(0.3 - cart.x)"}, "the reward is nan"),
        ({"reward": lambda values: np.log(values["x"] - 1.0)}, "the reward is nan"),
        ({"reward": "1/(cart.x - cart.x)"}, "the reward is (nan|inf)"),
        ({"terminated": "sqrt(0.3 - cart.x)"}, "`terminated` is nan"),
        ({"observations": {"x": "sqrt(0.3 - cart.x)"}}, "the observation 'x' is nan"),
    ],
)
def test_values_that_are_not_finite_are_errors(given: Any, changed: Mapping[str, Any], sentence: str) -> None:
    environment = Environment(cart_pole(**given), **ARGUMENTS | changed)
    many = VectorEnvironment(cart_pole(**given), number=2, **ARGUMENTS | changed)
    start = {"cart.x": 0.29, "cart.vx": 1.0}
    environment.reset(options=start)
    many.reset(options=start)
    with np.errstate(invalid="ignore"):
        with pytest.raises(mbdkit.RunError, match=rf"{sentence} at t = 0\.02 s; give an expression that is defined"):
            environment.step(np.array([0.5]))
        with pytest.raises(mbdkit.RunError, match=rf"{sentence} at t = 0\.02 s in environment 0; give"):
            many.step(np.full((2, 1), 0.5))


def test_an_observation_of_the_start_that_is_not_finite_is_an_error() -> None:
    environment = Environment(cart_pole(), **ARGUMENTS | {"observations": ["sqrt(cart.x - 1)"]})
    with pytest.raises(mbdkit.RunError, match=r"the observation 'sqrt\(cart\.x - 1\)' is nan at t = 0 s"):
        environment.reset()


def rewarded(values: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return a reward that uses observations, actions and time."""
    return -(values["x"] ** 2) - values["push"] + values["t"]


def test_rewards_and_ends_may_be_functions_of_the_values_by_name() -> None:
    changed = ARGUMENTS | {"reward": rewarded, "terminated": lambda values: values["x"] > 0.3}
    environment, many = Environment(cart_pole(), **changed), VectorEnvironment(cart_pole(), number=3, **changed)
    observation, _ = environment.reset(options={"cart.x": 0.29, "cart.vx": 1.0})
    many.reset(options={"cart.x": 0.29, "cart.vx": 1.0})
    observation, reward, terminated, *_ = environment.step(np.array([0.5]))
    assert terminated
    assert reward == -(observation[0] ** 2) - 0.5 + 0.02
    _, rewards, ends, *_ = many.step(np.full((3, 1), 0.5))
    assert rewards.tolist() == [reward] * 3
    assert ends.all()


RANDOM = {"pole.angle": {"uniform": [-2.0, -1.0]}, "cart.vx": {"normal": [0.0, 2.0]}}


@pytest.mark.parametrize(("given", "randomize", "in_turn"), [
    ({}, RANDOM, ""),
    ({}, RANDOM | {"model.bodies.pole.mass": {"uniform": [0.1, 0.4]}}, ""),
    ({"integrator": {"name": "gauss"}}, RANDOM, "mbdkit:gauss is not an explicit method with fixed steps"),
], ids=["in lanes", "with different numbers", "in turn"])  # fmt: skip
def test_vector_environments_are_environments_with_consecutive_seeds(
    given: Mapping[str, Any], randomize: Mapping[str, Any], in_turn: str
) -> None:
    number, changed = 11 if not in_turn else 3, ARGUMENTS | {"randomize": randomize, "duration": 0.5}
    many = VectorEnvironment(cart_pole(**given), number=number, **changed)
    assert many.why_in_turn == in_turn
    singles = [Environment(cart_pole(**given), **changed) for _ in range(number)]
    observations, _ = many.reset(seed=7)
    assert observations.tolist() == [one.reset(seed=7 + i)[0].tolist() for i, one in enumerate(singles)]
    over, ends = np.zeros(number, dtype=bool), 0
    for _ in range(60):
        actions = many.action_space.sample()
        observations, rewards, terminated, truncated, infos = many.step(actions)
        for i, one in enumerate(singles):
            if over[i]:
                assert (rewards[i], terminated[i], truncated[i]) == (0.0, False, False)
                assert observations[i].tolist() == one.reset()[0].tolist()
            else:
                observation, reward, *has_ended, info = one.step(actions[i])
                assert observations[i].tolist() == observation.tolist()
                assert (rewards[i], terminated[i], truncated[i]) == (reward, *has_ended)
                assert infos["t"][i] == info["t"]
        over = terminated | truncated
        ends += over.sum()
    assert ends > number


def test_seeds_determine_episodes() -> None:
    environment = Environment(cart_pole(), **ARGUMENTS | {"randomize": RANDOM})
    first, second = (environment.reset(seed=3)[0].tolist() for _ in range(2))
    assert first == second
    assert environment.reset()[0].tolist() != first
    assert environment.reset(seed=4)[0].tolist() != first
    many = VectorEnvironment(cart_pole(), number=2, **ARGUMENTS | {"randomize": RANDOM})
    assert many.reset(seed=[4, 3])[0][1].tolist() == first


def test_the_loop_of_the_four_bar_stays_closed_in_every_step() -> None:
    given = arguments("FourBar")
    joints = [f"joints.{joint}.misalignment" for joint in "ABCD"]
    environment = Environment(**given | {"observations": joints, "duration": 4.0})
    environment.action_space.seed(1)
    environment.reset(seed=1)
    gaps = [environment.step(environment.action_space.sample())[0] for _ in range(200)]
    assert_within(gaps, 1e-10)


def test_less_force_of_the_knee_is_rewarded() -> None:
    environment = Environment(**arguments("KneeSupport"))
    returns = []
    for push in (0.0, 300.0):
        environment.reset(options={"knee": 1.6})
        returns.append(sum(environment.step(np.array([push]))[1] for _ in range(29)))
    assert returns[1] > 0.5 * returns[0] > returns[0]


def test_pictures_show_the_mechanism() -> None:
    environment = Environment(cart_pole(), render_mode="rgb_array", **ARGUMENTS)
    environment.reset(options={"pole.angle": 0.5})
    first = environment.render()
    environment.step(np.array([5.0]))
    second = environment.render()
    assert first is not None
    assert first.dtype == np.uint8
    assert first.shape[2] == 3
    assert not np.array_equal(first, second)
    assert Environment(cart_pole(), **ARGUMENTS).render() is None


@pytest.mark.slow
@pytest.mark.parametrize("name", ["CartPole", "FourBar"])
def test_ten_thousand_episodes_need_no_more_memory_than_a_thousand(name: str) -> None:
    environment = gymnasium.make(f"mbdkit/{name}-v0").unwrapped

    def episodes(count: int) -> int:
        for _ in range(count):
            environment.reset()
            environment.step(environment.action_space.sample())
        return tracemalloc.get_traced_memory()[0]

    episodes(100)
    tracemalloc.start()
    try:
        early = episodes(900)
        assert episodes(9000) - early < 100_000
    finally:
        tracemalloc.stop()


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "period": ({"period": 0.0}, "period: should be a positive time in seconds, not 0.0"),
    "duration": ({"duration": 0.01}, "the duration, 0.01 s, is less than a period, 0.02 s"),
    "unknown action": ({"actions": ["pull"]}, "actions: the mechanism has no input 'pull'; inputs: push"),
    "wide action": (
        {"actions": {"push": [-6, 1]}}, r"actions.push: should be finite bounds \[smallest, largest\] within -5 and 5",
    ),
    "observation": ({"observations": ["pole.angel"]}, r"observations.*pole 'pole' has no 'angel'|has no 'angel'"),
    "no observations": ({"observations": []}, "observations: should be a list of expressions, or expressions by name"),
    "form of an observation": (
        {"observations": {"x": {"value": "cart.x", "low": 0}}}, "observations.x: has `value`, `min` and `max`,",
    ),
    "no text": ({"observations": {"x": 1}}, "observations.x: should be an expression, or"),
    "reward": ({"reward": "cos(pole.angle"}, "reward: "),
    "no reward": ({"reward": 1.0}, "reward: should be an expression or a function of the values by name, not 1.0"),
    "distribution": ({"randomize": {"cart.x": {"uniform": [1, 0]}}}, r"randomize\.\"cart\.x\".*`low` should be less"),
    "render mode": ({"render_mode": "human"}, "render_mode: should be 'rgb_array' or None, not 'human'"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_wrong_arguments_are_named(name: str) -> None:
    changed, sentence = WRONG[name]
    with pytest.raises(SpecError, match=sentence):
        Environment(cart_pole(), **ARGUMENTS | changed)


def test_wrong_numbers_names_and_actions_are_named() -> None:
    with pytest.raises(SpecError, match="number: should be a positive number of environments, not 0"):
        VectorEnvironment(cart_pole(), number=0, **ARGUMENTS)
    with pytest.raises(TypeError, match="unexpected keyword argument 'rewards'"):
        VectorEnvironment(cart_pole(), number=1, rewards="1", **ARGUMENTS)
    with pytest.raises(SpecError, match=r"model\.inputs: the mechanism has no inputs, which the actions would set"):
        Environment("double-pendulum", **ARGUMENTS)
    environment = Environment(cart_pole(), **ARGUMENTS)
    environment.reset()
    with pytest.raises(SpecError, match="an action should be 1 finite numbers: push"):
        environment.step(np.array([np.nan]))
    with pytest.raises(SpecError, match=r"the mechanism has no quantity 'cart\.speed'"):
        environment.reset(options={"cart.speed": 1.0})
    with pytest.raises(SpecError, match=r"a parameter that differs between episodes only if `randomize` names it"):
        environment.reset(options={"model.bodies.pole.mass": 1.0})
