"""Identifications doubt wrong models at the right place, and trust sound ones."""

from __future__ import annotations

import pytest
from tests.identify.wrong_models import campaign, judge_sound, judge_wrong

SEED = 3001


@pytest.mark.parametrize(
    "name",
    [
        "Stribeck friction of the rail taken as viscous",
        "gain of the encoder of the pole 2 % too large",
        "centre of mass of the pole 5 % too near",
        "amplifier 5 % stronger than assumed",
    ],
)
def test_a_wrong_model_is_doubtful_at_the_right_place(name: str) -> None:
    is_right, fit = judge_wrong(name, SEED)
    assert is_right, fit.doubts


@pytest.mark.parametrize(
    ("name", "noise"),
    [("motor", "white"), ("motor", "ar"), ("beam", "ar"), ("cart with Stribeck friction", "ar")],
)
def test_a_sound_model_is_good(name: str, noise: str) -> None:
    is_doubtful, fit = judge_sound(name, noise, SEED)
    assert not is_doubtful, fit.doubts


@pytest.mark.slow
def test_sixteen_of_twenty_wrong_models_are_doubtful_at_the_right_place() -> None:
    wrong, _ = campaign(SEED)
    named = {name: judge_wrong(name, seed)[0] for name, seed in wrong}
    assert len(named) == 20
    assert sum(named.values()) >= 16, [name for name, is_right in named.items() if not is_right]


@pytest.mark.slow
def test_two_of_forty_sound_sets_of_data_are_doubtful_at_most() -> None:
    _, sound = campaign(SEED)
    doubtful = [case for case in sound if judge_sound(*case)[0]]
    assert len(sound) == 40
    assert len(doubtful) <= 2, doubtful
