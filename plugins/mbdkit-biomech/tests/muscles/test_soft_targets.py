"""Soft targets of recruitment against a general optimizer, and EMG of a muscle that recruitment leaves out."""

import numpy as np
import pytest
from scipy.optimize import minimize
from tests.muscles.shared_loads import problems

import mbdkit
from mbdkit import SpecError
from mbdkit_biomech.inverse_dynamics.errors import error_bars
from mbdkit_biomech.inverse_dynamics.muscles.programme import Programme
from mbdkit_biomech.inverse_dynamics.muscles.shared_loads import share_loads
from mbdkit_biomech.inverse_dynamics.muscles.soft_targets import (
    Axial,
    Compartments,
    EmgTarget,
    SoftTargets,
    Targets,
    share_softly,
)
from tests.margins import assert_within

DEVIATION = 0.2


@pytest.mark.parametrize("p", [1, 2, 3, np.inf])
def test_bounds_and_targets_are_those_of_the_problem_with_inequalities(p):
    programme = problems(20.0)
    rows, _, count = programme.matrix.shape
    random = np.random.default_rng(76)
    matrix = np.abs(random.standard_normal((rows, 3, count - programme.matrix.shape[1])))
    right = np.insert(random.uniform(0.2, 4.0, (rows, 2)), 1, 0.4, axis=1)  # two bounds, which share muscles
    soft = SoftTargets(matrix, right, np.full((rows, 3), DEVIATION), np.array([True, False, True]))
    whole, found = share_softly(programme, float(p), soft)
    assert_within(found.certificate, 1e-9)
    assert whole.matrix.shape == (rows, programme.matrix.shape[1] + 3, count + 3)
    muscles = matrix.shape[2]
    below = 0
    for row in range(0, rows, 5):

        def cost(x, row=row):
            lacking = right[row] - matrix[row] @ x[:muscles]
            lacking[::2] = np.maximum(lacking[::2], 0.0)
            share = np.abs(np.append(x / programme.weight, lacking / DEVIATION))
            return np.max(share) if np.isinf(p) else np.sum(share**p)

        equal = {"type": "eq", "fun": lambda x, row=row: programme.matrix[row] @ x - programme.right[row]}
        bounds = list(zip(programme.low[row], programme.high[row], strict=True))
        own = found.value[row, :count]
        other = minimize(cost, own, bounds=bounds, constraints=equal, method="SLSQP", options={"ftol": 1e-12})
        assert_within(equal["fun"](own), 1e-8 * np.max(programme.size))
        assert cost(own) <= other.fun * (1 + 1e-6)
        below += right[row, 0] > matrix[row, 0] @ own[:muscles]
    assert below  # some of the bounds act


@pytest.mark.parametrize("seed", [1, 6])
def test_a_bound_that_does_not_act_leaves_a_frame_solvable(seed):
    # The second bound acts in every second row, and deviations are those of forces [N] beside equations of moments.
    programme, random, size = problems(20.0), np.random.default_rng(seed), 1e4
    rows, equations, count = programme.matrix.shape
    matrix = size * np.abs(random.standard_normal((rows, 2, count - equations)))
    right = size * random.uniform(0.2, 4.0, (rows, 2))
    right[::2, 1] = -size
    soft = SoftTargets(matrix, right, np.full((rows, 2), size * DEVIATION), np.array([True, True]))
    assert_within(share_softly(programme, 3.0, soft)[1].certificate, 1e-9)


@pytest.mark.parametrize("p", [3.0, 4.0])
def test_targets_that_are_almost_reached_leave_frames_solvable(p):
    programme, random = problems(20.0), np.random.default_rng(76)
    own = share_loads(programme, p).value
    matrix = np.zeros((len(own), 1, own.shape[1] - programme.matrix.shape[1]))
    matrix[:, 0, 0] = 1.0
    for size in (0.0, 1e-9, 1e-6, 1e-3):
        right = own[:, :1] + size * random.standard_normal((len(own), 1))
        soft = SoftTargets(matrix, right, np.full(right.shape, DEVIATION), np.array([False]))
        assert_within(share_softly(programme, p, soft)[1].certificate, 1e-9)


@pytest.mark.parametrize("p", [2.6667, 3.0, 4.0, 6.0])
@pytest.mark.parametrize("reserves", [0.0, 20.0])
def test_targets_of_all_muscles_leave_no_frame_without_solution(p, reserves):
    # EMG of every muscle, whose targets are far, near and reached, and a force that a knee needs
    programme, random = problems(reserves), np.random.default_rng(86)
    rows, muscles = len(programme.right), 9
    activation = share_loads(programme, p).value[:, :muscles]
    emg = np.clip(
        activation * np.exp(random.choice([0.0, 1e-4, 0.3], (rows, muscles)) * random.standard_normal()), 0, 1
    )
    matrix = np.zeros((rows, muscles + 1, muscles))
    matrix[:, 0] = 1e3 * random.uniform(0.2, 4.0, (rows, muscles))
    matrix[:, range(1, muscles + 1), range(muscles)] = 1.0
    right = np.hstack(
        [np.sum(matrix[:, 0] * activation, axis=1, keepdims=True) * random.uniform(0.7, 1.1, (rows, 1)), emg]
    )
    deviation = np.hstack([np.full((rows, 1), 30.0), np.hypot(0.4 * emg, 0.03)])
    soft = SoftTargets(matrix, right, deviation, np.arange(muscles + 1) == 0)
    _, found = share_softly(programme, p, soft)
    assert np.max(found.certificate) < 1e-9
    count = programme.matrix.shape[2]
    for row in range(0, rows, 3):

        def cost(x, row=row):
            lacking = (right[row] - matrix[row] @ x[:muscles]) / deviation[row]
            lacking[0] = max(lacking[0], 0.0)
            return np.sum(np.abs(np.append(x / programme.weight, lacking)) ** p)

        own = found.value[row, :count]

        def lacks(x, row=row):
            return (programme.matrix[row] @ x - programme.right[row]) / programme.size[row]

        equal = {"type": "eq", "fun": lacks}
        bounds = list(zip(programme.low[row], programme.high[row], strict=True))
        start = np.clip(0.3 * np.ones(count), programme.low[row], programme.high[row])
        other = minimize(cost, start, bounds=bounds, constraints=equal, method="SLSQP", options={"ftol": 1e-14})
        assert np.max(np.abs(lacks(own))) < 1e-9
        assert cost(own) <= other.fun * (1 + 1e-6)


def arm(errors="none", **sections):
    """Return inverse dynamics of a forearm that holds changing loads with two flexors and an extensor."""
    m = mbdkit.Mechanism()
    forearm = m.body("forearm", mass=1.5, inertia=0.02, position=(0.15, 0.0))
    m.revolute("elbow", m.ground, forearm, at=(0, 0))
    muscles = ("biceps", 0.04, 0.04, 600.0), ("brachialis", 0.02, 0.03, 900.0), ("triceps", -0.03, -0.02, 900.0)
    for name, x, y, force in muscles:
        path = [{"body": "ground", "point": (x, 0.3)}, {"body": forearm, "point": (y - 0.15, 0.0)}]
        m.muscle(name, path, max_force=force, optimal_length=0.12, tendon_length=0.18)
    time = np.linspace(0.0, 2.0, 81)
    emg = 0.3 + 0.2 * np.sin(3 * time)
    noise = 0.2 + 0.2 * np.random.default_rng(1).random(81)
    data = {"time": time, "a": 0.4 * np.sin(3 * time), "emg": emg, "noise": noise}
    data |= {
        "volts": 1e-4 * emg,
        "percent": 100 * emg,
        "none": 0 * time,
        "gap": np.where(np.abs(time - 1.0) < 0.3, np.nan, emg),
    }
    motion = {"data": data, "columns": {"elbow.angle": {"column": "a", "deviation": 1e-3}}, "errors": errors}
    spec = {"mbdkit": 1, "model": m.to_spec(), "motion": motion, "recruitment": {"capacity": "isometric"}}
    return mbdkit.inverse({**spec, **sections})


def test_activations_keep_near_emg_and_the_moment_stays():
    with arm() as alone:
        activation = alone.muscles["biceps"].activation
        motion = dict(alone.spec["motion"])
        early = np.interp(np.asarray(alone.time) + 0.07, alone.time, activation + 0.1)  # the force follows by 70 ms
        data = {**motion["data"], "emg": early.tolist()}
        with arm(
            motion={**motion, "data": data}, emg={"biceps": {"column": "emg", "deviation": 0.01, "scale": 1}}
        ) as run:
            reached = (run.muscles["biceps"].activation - activation)[3:-3]
            assert np.all((reached > 0.05) & (reached < 0.1001))
            np.testing.assert_allclose(run.actuators["elbow"].value, alone.actuators["elbow"].value, atol=1e-9)


def test_error_bars_with_emg_do_not_depend_on_how_many_frames_are_computed_together(monkeypatch):
    bars = []
    for frames in (error_bars.FRAMES, 1):
        monkeypatch.setattr(error_bars, "FRAMES", frames)
        with arm(emg={"biceps": "emg"}, errors={"samples": 20}) as run:
            bars.append(run.accuracy.reaction_error)
    assert np.all(bars[0] > 0)
    np.testing.assert_allclose(bars[0], bars[1], rtol=1e-6)


def test_targets_of_repeated_frames_are_those_of_each_frame():
    random = np.random.default_rng(5)
    moment, load = random.standard_normal((2, 4))
    knee = Compartments("knee", 0, 1, 0.046, 0.007, 20 * moment, 700 * np.abs(load))
    targets = Targets((knee,), (EmgTarget(1, random.uniform(size=4), 0.4),))
    axial = Axial(random.standard_normal((4, 1)), random.standard_normal((4, 1, 2)))
    capacity, passive = random.uniform(size=(2, 4, 2))
    once = targets.soft(axial, capacity, passive)
    thrice = targets.repeated(3).soft(
        Axial(*(np.concatenate([one] * 3) for one in axial)),
        *(np.concatenate([one] * 3) for one in (capacity, passive)),
    )
    for name in ("matrix", "right", "deviation"):
        np.testing.assert_array_equal(getattr(thrice, name), np.concatenate([getattr(once, name)] * 3))


def test_noise_is_named_and_changes_little():
    with arm() as alone, arm(emg={"biceps": "noise"}) as run:
        own, noisy = (one.muscles["biceps"].force for one in (alone, run))
        assert np.sqrt(np.mean((noisy - own) ** 2)) < 0.2 * np.sqrt(np.mean(own**2))
        assert any("the EMG of biceps (column 'noise') does not follow" in warning for warning in run.warnings)


@pytest.mark.parametrize("factor", [1e-4, 1.0, 50.0])
def test_the_scale_of_emg_is_found_whatever_its_unit(factor):
    # an extensor acts against a flexor, which recruitment leaves out; the moment is known
    random, time = np.random.default_rng(3), np.linspace(0.0, 6.0, 80)
    true = np.column_stack([0.3 + 0.2 * np.sin(time), 0.1 + 0.05 * np.cos(2 * time), 0.1 + 0.05 * np.cos(time)])
    arms, envelope = np.array([100.0, -60.0, 40.0]), true[:, 0] * np.exp(0.1 * random.standard_normal(80))
    right = np.sum(arms * true, axis=1, keepdims=True)
    alone = np.column_stack([true[:, 0] - 0.6 * true[:, 1], np.full(80, 0.01), true[:, 2]])
    high = np.ones((80, 3))
    programme = Programme(np.tile(arms, (80, 1, 1)), right, 0.0 * high, high, np.ones(3))
    wrong = 1.0 + random.standard_normal(80) ** 2
    channels = (EmgTarget(0, factor * envelope, 0.4, has_scale=False), EmgTarget(1, true[:, 1], 0.4),
                EmgTarget(2, factor * wrong, 0.4, "wrong", has_scale=False))  # fmt: skip
    found = Targets(emg=channels).calibrated(alone, alone, programme)
    # without the flexor, the least squares of activations alone give 0.8 of the scale
    np.testing.assert_allclose(found.emg[0].activation, envelope, rtol=0.15)
    assert found.emg[0].spread < 0.1
    assert found.emg[1] is channels[1]
    assert found.emg[2].spread > 2.0 * found.emg[0].spread
    assert [one.column for one, _ in found.remarks] == ["wrong"]
    assert found.calibrated(0.5 * alone, alone, programme) is found


@pytest.mark.parametrize(
    ("emg", "key"),
    [
        ({"bicep": "emg"}, "emg.bicep"),
        ({"biceps": "emgs"}, "emg.biceps.column"),
        ({"biceps": {"column": "emg", "scale": 10}}, "emg.biceps.scale"),
        ({"biceps": {"column": "percent", "scale": 1}}, "emg.biceps.scale"),
        ({"biceps": {"column": "volts", "scale": 1}}, "emg.biceps.scale"),
        ({"biceps": {"column": "emg", "channels": ["emg"]}}, "emg.biceps.column"),
        ({"biceps": "none"}, "emg.biceps.column"),
        ({"biceps": {"column": "emg", "file": "none.csv"}}, "emg"),
    ],
)
def test_wrong_emg_is_refused(emg, key):
    with pytest.raises(SpecError) as error:
        arm(emg=emg)
    assert error.value.key == key


def test_a_raw_signal_with_an_offset_is_that_without_whatever_its_size():
    time, found = np.linspace(0.0, 2.0, 81), []
    raw = (0.6 + 0.4 * np.sin(3 * time)) * np.sin(2 * np.pi * 17.3 * time)
    with arm() as alone:
        spec = alone.spec["motion"]
    for size, offset in ((1.0, 0.0), (0.005, 2.5)):
        motion = {**spec, "data": {**spec["data"], "VL": (size * raw + offset).tolist()}}
        with arm(motion=motion, emg={"biceps": "VL"}) as run:
            found.append(run.muscles["biceps"].force.copy())
    np.testing.assert_allclose(*found, rtol=1e-6)


def test_two_channels_of_a_muscle_that_agree_count_as_one():
    with arm(emg={"biceps": "emg"}) as one, arm(emg={"biceps": {"channels": ["emg", "volts"]}}) as two:
        forces = [run.muscles["biceps"].force for run in (one, two)]
        np.testing.assert_allclose(*forces, rtol=0.05)  # the constant part of the deviation is that of each


def test_gaps_of_emg_are_those_of_other_columns():
    with pytest.raises(SpecError, match="column 'gap': the value is missing"):
        arm(emg={"biceps": "gap"})


def test_emg_needs_recruitment():
    with pytest.raises(SpecError, match="recruitment") as error:
        arm(emg={"biceps": "emg"}, recruitment=None)
    assert error.value.key == "emg"


def test_emg_of_another_rate_is_read_from_its_own_file(tmp_path):
    with arm() as alone:
        time = np.arange(-0.1, 2.2, 0.001)
        wanted = np.interp(time + 0.07, alone.time, alone.muscles["biceps"].activation + 0.1)
        options = {"deviation": 0.01, "scale": 0.5}
        carrier = 0.5 * np.pi * np.sin(2 * np.pi * 80.0 * time)  # whose rectified mean is 1
        columns = [time, 2.0 * wanted, 2.0 * wanted * carrier]
        np.savetxt(file := tmp_path / "emg.csv", np.transpose(columns), delimiter=",", header="time,e,raw", comments="")
        by = [arm(emg={"biceps": {"column": name, "file": str(file), **options}}) for name in ("e", "raw")]
        own = [run.muscles["biceps"].activation - alone.muscles["biceps"].activation for run in by]
        assert np.all((own[0] > 0.05) & (own[0] < 0.1001))
        np.testing.assert_allclose(own[1][8:-8], own[0][8:-8], atol=0.005)
        motion = {**alone.spec["motion"], "data": {"time": [0.0, 9.0], "a": [0.0, 0.1]}}
        with pytest.raises(SpecError, match=r"lasts from -0.1 to 2.199 s, but the motion from 0 to 9 s"):
            arm(motion=motion, emg={"biceps": {"column": "e", "file": str(file)}})
        file.write_text("time,e\n-1,0.1\n9,0.2\n")
        with pytest.raises(SpecError, match=r"has 0 rows during the motion, which lasts to 2 s"):
            arm(emg={"biceps": {"column": "e", "file": str(file)}})
        for run in by:
            run.close()


def test_an_envelope_that_a_filter_makes_slightly_negative_is_no_raw_signal():
    with arm() as alone:
        data = alone.spec["motion"]["data"]
        below = np.interp(np.asarray(alone.time) + 0.07, alone.time, alone.muscles["biceps"].activation)
        below = 0.4 * (below - np.min(below)) / np.ptp(below) - 0.02
        found = []
        for values in (below, np.maximum(below, 0.0)):
            motion = {**alone.spec["motion"], "data": {**data, "emg": values.tolist()}}
            with arm(motion=motion, emg={"biceps": "emg"}) as run:
                found.append(run.muscles["biceps"].activation.copy())
        np.testing.assert_array_equal(*found)
