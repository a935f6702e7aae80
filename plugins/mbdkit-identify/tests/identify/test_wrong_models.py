"""Identifications doubt wrong models at the right place, and trust sound ones."""

from __future__ import annotations

import pytest
from tests.identify.wrong_models import campaign, judge_sound, judge_wrong

SEED = 3001
WRONG, SOUND = campaign(SEED)
WRONG_ROBOTS, SOUND_ROBOTS = campaign(SEED, robots=True)
FEW_WRONG = (
    "Stribeck friction of the rail taken as viscous", "centre of mass of the pole 5 % too near",
    "gain of the encoder of the pole 2 % too large", "amplifier 5 % stronger than assumed",
)  # fmt: skip
FEW_SOUND = [("motor", "white"), ("motor", "ar"), ("beam", "white"), ("slider-crank", "ar")]


@pytest.mark.parametrize("case", [case for case in WRONG if case[0] in FEW_WRONG], ids=str)
def test_a_wrong_model_is_doubtful_at_the_right_place(case: tuple[str, int]) -> None:
    is_right, fit = judge_wrong(*case)
    assert is_right, fit.doubts


@pytest.mark.parametrize("case", [case for case in SOUND[::2] if case[:2] in FEW_SOUND], ids=str)
def test_a_sound_model_is_good(case: tuple[str, str, int]) -> None:
    is_doubtful, fit = judge_sound(*case)
    assert not is_doubtful, fit.doubts


@pytest.mark.slow
def test_sixteen_of_twenty_wrong_models_are_doubtful_at_the_right_place() -> None:
    named = {name: judge_wrong(name, seed)[0] for name, seed in WRONG}
    assert len(named) == 20
    assert sum(named.values()) >= 16, [name for name, is_right in named.items() if not is_right]


@pytest.mark.slow
def test_two_of_forty_sound_sets_of_data_are_doubtful_at_most() -> None:
    doubtful = [case for case in SOUND if judge_sound(*case)[0]]
    assert len(SOUND) == 40
    assert len(doubtful) <= 2, doubtful


@pytest.mark.slow
def test_wrong_models_of_a_real_robot_are_doubtful_at_the_right_place_and_sound_ones_good() -> None:
    named = {name: judge_wrong(name, seed)[0] for name, seed in WRONG_ROBOTS}
    assert sum(named.values()) >= 17, [name for name, is_right in named.items() if not is_right]
    doubtful = [case for case in SOUND_ROBOTS if judge_sound(*case)[0]]
    assert (len(named), len(SOUND_ROBOTS)) == (20, 40)
    assert len(doubtful) <= 2, doubtful
