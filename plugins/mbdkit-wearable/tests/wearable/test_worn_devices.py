"""Inverse dynamics of a person who wears a device that no data observe."""

from __future__ import annotations

import numpy as np
import pytest
from tests.wearable.walking_with_brace import brace, driven_limbs, squat_spec, two_limbs

import mbdkit
from mbdkit.plugin.runs import AddedForces
from mbdkit_wearable.device import Device, add_devices
from mbdkit_wearable.worn.worn_device import WornDevice, worn_device
from tests.margins import assert_within

G = 9.81


def forces(t: np.ndarray, **keys: object) -> dict[str, np.ndarray]:
    """Return force and torque (T, 3) of each cuff of the orthosis on the limbs of `two_limbs`."""
    q, v, a = two_limbs(t)
    added = worn_device(Device.model_validate(brace(**keys)), "brace", driven_limbs()).forces(t, q, v, a)
    values = np.concatenate([added.force, added.torque[..., None]], axis=2)
    return dict(zip(added.names, np.moveaxis(values, 1, 0), strict=True))


def test_a_device_moves_as_in_a_run_in_which_drivers_move_the_limbs() -> None:
    """The run integrates the whole mechanism with a Gauss method of order 6 and small steps."""
    offset, t = (0.01, 0.015, 0.05), np.linspace(0.0, 1.5, 151)
    m = driven_limbs()
    add_devices({"brace": Device.model_validate(brace(offset=offset))}, m)
    run = mbdkit.run(
        m, integrator={"name": "gauss", "stages": 3}, time={"end": 1.5, "step": 0.001}, output={"every": 10}
    )
    own = forces(t, offset=offset)
    settled = t > 0.3  # the run starts with the tissue at rest, and the device from its equilibrium
    for name in ("brace.upper", "brace.lower"):
        cuff = run.cuffs[name]
        size = np.hypot(cuff.normal_force, cuff.shear_force)
        difference = np.hypot(*own[name].T[:2]) - size
        assert_within(difference[settled], 2e-3 * np.max(size))
        assert_within((own[name][:, 2] - cuff.moment)[settled], 5e-3 * np.max(np.abs(cuff.moment)))


def test_motions_nearby_are_the_same_as_those_computed_step_by_step() -> None:
    t = np.linspace(0.0, 1.0, 51)
    q, v, a = two_limbs(t)
    device = worn_device(Device.model_validate(brace()), "brace", driven_limbs())
    device.forces(t, q, v, a)
    near = device.changed({"misfit_x": 0.01, "misfit_y": -0.02, "tissue": 0.5}).forces(t, q, v, a)
    stiff = {key: {name: np.exp(0.5) * one if key == "stiffness" else one for name, one in values.items()}
             for key, values in brace()["attach"]["upper"]["cuff"].items()}  # type: ignore[index]  # fmt: skip
    given = brace(offset=(0.01, -0.02, 0.0))
    for one in given["attach"].values():  # type: ignore[attr-defined]
        one["cuff"] = stiff
    alone = worn_device(Device.model_validate(given), "brace", driven_limbs()).forces(t, q, v, a)
    np.testing.assert_allclose(near.force, alone.force, atol=1e-5)
    np.testing.assert_allclose(near.torque, alone.torque, atol=1e-6)


def test_forces_of_a_device_at_rest_are_its_weight() -> None:
    t = np.linspace(0.0, 1.0, 11)
    q = np.tile(two_limbs(np.zeros(1))[0], (11, 1))
    none = np.zeros_like(q)
    added = worn_device(Device.model_validate(brace()), "brace", driven_limbs()).forces(t, q, none, none)
    np.testing.assert_allclose(added.force.sum(axis=1), np.tile([0.0, -G], (11, 1)), atol=1e-7)  # 1 kg


def test_plates_without_the_device_leave_no_residuals_of_its_weight() -> None:
    """The ground carries what its forces add; the other forces of the foot do not change but by this."""
    worn, without = (mbdkit.inverse(squat_spec(worn=True)), mbdkit.inverse(squat_spec(None) | {"model": bare()}))
    apart = mbdkit.inverse(squat_spec(worn=False))
    for residual in ("hip_x", "hip_y", "trunk_tilt"):
        assert_within(apart.actuators[residual].value - without.actuators[residual].value, 1e-9)
    # residuals carry the device of 1 kg, whose links move about as the centres of the limbs, if the plates contain it
    extra = worn.actuators["hip_y"].value - without.actuators["hip_y"].value
    rise = (without["thigh"].acceleration[:, 1] + without["shank"].acceleration[:, 1]) / 2
    np.testing.assert_allclose(extra, G + rise, atol=0.4)  # margin: links move only about as the centres of the limbs
    assert any("same with and without 'brace'" in warning for warning in apart.warnings)
    np.testing.assert_allclose(
        apart.array("followers/reaction_force_without"), without.array("joints/reaction_force"), atol=1e-9
    )


def test_a_device_follows_each_changed_motion_from_its_first_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames of several motions must not be computed together: the device would move on from the end of another one."""
    intervals, forces_of = [], WornDevice.forces

    def forces(device: WornDevice, time: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> AddedForces:
        intervals.append(np.min(np.diff(time)))
        return forces_of(device, time, q, v, a)

    monkeypatch.setattr(WornDevice, "forces", forces)
    spec = squat_spec(worn=True) | {"uncertainty": "none"}
    spec["motion"]["errors"] = {"samples": 20}  # type: ignore[index]
    mbdkit.inverse(spec)
    assert len(intervals) > 10
    assert min(intervals) > 0


def bare() -> dict[str, object]:
    """Return the model of the leg without a device."""
    model = dict(squat_spec()["model"])  # type: ignore[call-overload]
    del model["devices"]
    return model


def test_the_bar_of_the_added_force_is_that_of_misfits_computed_one_by_one() -> None:
    """With one uncertain number, a bar of 95 % is 1.96 times the change by one standard deviation."""
    spec = squat_spec(worn=False)
    spec["motion"]["errors"] = {"samples": 20}  # type: ignore[index]
    numbers = {"misfit_x": 0.0, "misfit_y": 0.01, "misfit_angle": 0.0, "tissue": 0.0}
    run = mbdkit.inverse(spec | {"uncertainty": {"devices": numbers, "samples": 400}})
    sides = [mbdkit.inverse(squat_spec(worn=False, offset=[0.0, y, 0.0])) for y in (0.01, -0.01)]
    change = np.linalg.norm(sides[0].joints["knee"].reaction_force - sides[1].joints["knee"].reaction_force, axis=1) / 2
    added = run.added_force("knee")
    np.testing.assert_allclose(added.added_error, 1.96 * change, rtol=0.1, atol=0.05)
    assert "misfit y of brace" in run.contributions("knee").shares
    # with one uncertain number, the bar of a change that is linear in it is 1.96 times half the difference of its
    # values at both ends; a largest force is not, because its time changes
    pairs = [side.added_force("knee").changes for side in sides]
    for one, first, second in list(zip(added.changes, *pairs, strict=True))[1:3]:
        half = abs(first.difference - second.difference) / 2
        assert one.difference_bar[1] == pytest.approx(1.96 * half, rel=0.1, abs=0.05)
    assert [one.what for one in added.changes[1:3]] == ["mean force", "impulse"]
    assert f"mean force {added.changes[1].force:.4g} N with devices" in run.summary()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"model": bare()}, "follows.*has no effect"),
        ({"uncertainty": {"devices": {"misfit_z": 0.1}}}, "uncertainty.devices.misfit_z.*no uncertain number"),
        ({"follows": None}, "do not observe.*brace"),
    ],
)
def test_what_does_not_fit_is_one_sentence_with_the_key(changes: dict[str, object], message: str) -> None:
    with pytest.raises(mbdkit.SpecError, match=message):
        mbdkit.inverse(squat_spec() | changes)
