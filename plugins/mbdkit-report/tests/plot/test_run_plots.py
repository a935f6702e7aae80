"""`Run.plot` and `mbdkit.plot.compare`: what is drawn on the axes of a user, and how it is named."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import mbdkit
from mbdkit.base.errors import MbdkitError, SpecError

MASS, HALF, RATE, STIFFNESS = 2.0, 0.5, 3.0, 40.0

# A rod turns about its end at a constant rate, driven by a motor; a spring is hooked to its tip.
DRIVEN: dict[str, Any] = {
    "mbdkit": 1, "title": "a driven rod",
    "model": {
        "name": "mechanism",
        "bodies": {"rod": {"mass": MASS, "inertia": 0.2, "position": [HALF, 0.0], "angular_velocity": RATE}},
        "joints": {
            "pin": {"type": "revolute", "bodies": ["ground", "rod"], "points": [[0, 0], [-HALF, 0]]},
            "motor": {"type": "driver", "bodies": ["ground", "rod"], "coordinate": "angle", "motion": f"{RATE} * t"},
        },
        "markers": {"tip": {"body": "rod", "point": [HALF, 0.0]}},
    },
    "integrator": {"name": "gauss", "stages": 2}, "time": {"end": 2.0, "step": 0.01},
}  # fmt: skip


def with_spring(spec: dict[str, Any]) -> dict[str, Any]:
    """Return the spec with a vertical spring between the ground and the tip, and a spring about the pin."""
    forces = {
        "hook": {
            "type": "spring-damper", "bodies": ["ground", "rod"], "points": [[0, 3], [HALF, 0]], "stiffness": STIFFNESS,
            "free_length": 1.0,
        },
        "coil": {"type": "torsion-spring", "bodies": ["ground", "rod"], "stiffness": 0.3},
    }  # fmt: skip
    return spec | {"model": spec["model"] | {"forces": forces}}


@pytest.fixture(scope="module")
def driven() -> Iterator[mbdkit.Run]:
    with mbdkit.run(DRIVEN) as run:
        yield run


@pytest.fixture(scope="module")
def sprung() -> Iterator[mbdkit.Run]:
    with mbdkit.run(with_spring(DRIVEN)) as run:
        yield run


@pytest.fixture
def axes() -> Axes:
    return Figure().add_subplot()


def lines(axes: Axes) -> dict[str, np.ndarray]:
    """Values of the lines of axes by their names in the legend, of which there must be one for each line."""
    found = {line.get_label(): np.asarray(line.get_ydata()) for line in axes.get_lines()}
    legend = axes.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == list(found)
    assert not any(str(name).startswith("_") for name in found)
    return found


def test_every_kind_draws_on_the_given_axes_and_returns_them(sprung: mbdkit.Run) -> None:
    labels = {
        "trajectory": ("x [m]", "y [m]"), "drift": ("time [s]", "misalignment [m]"),
        "energy": ("time [s]", "energy [J]"), "reactions": ("time [s]", "joint force [N]"),
        "torques": ("time [s]", "torque [N m]"), "forces": ("time [s]", "force [N]"),
    }  # fmt: skip
    for kind, named in labels.items():
        axes = Figure().add_subplot()
        assert getattr(sprung.plot, kind)(axes) is axes
        assert (axes.get_xlabel(), axes.get_ylabel()) == named
        assert lines(axes)


def test_without_axes_a_figure_of_pyplot_is_made(sprung: mbdkit.Run) -> None:
    from matplotlib import pyplot

    with mpl.rc_context({"backend": "Agg"}):
        axes = sprung.plot.energy()
        assert axes.figure is pyplot.gcf()
        pyplot.close(axes.figure)


def test_the_torque_of_a_motor_is_that_which_holds_the_rod(driven: mbdkit.Run, axes: Axes) -> None:
    # at a constant rate the motor only carries the weight: m g l cos(angle), positive against gravity
    drawn = lines(driven.plot.torques(axes))["motor"]
    np.testing.assert_allclose(drawn, MASS * 9.81 * HALF * np.cos(RATE * driven.time), atol=1e-6)


def test_forces_of_a_spring_and_of_the_spring_about_the_pin(sprung: mbdkit.Run, axes: Axes) -> None:
    angle = RATE * sprung.time
    length = np.hypot(2 * HALF * np.cos(angle), 3 - 2 * HALF * np.sin(angle))
    drawn = lines(sprung.plot.forces(axes))
    assert list(drawn) == ["hook"]
    np.testing.assert_allclose(drawn["hook"], STIFFNESS * (length - 1.0), atol=1e-6)
    drawn = lines(sprung.plot.torques(Figure().add_subplot(), elements="coil"))
    np.testing.assert_allclose(drawn["coil"], -0.3 * angle, atol=1e-6)
    assert set(lines(sprung.plot.torques(Figure().add_subplot()))) == {"motor", "coil"}
    with pytest.raises(MbdkitError, match="no force element with a force 'coil'"):
        sprung.plot.forces(Figure().add_subplot(), elements=["coil"])


def test_components_of_forces_in_the_global_frame_and_along_the_rod(driven: mbdkit.Run) -> None:
    # about its end at a constant rate: centripetal force along the rod, and the weight; the motor is a pure torque
    angle = RATE * driven.time
    up = MASS * (9.81 - RATE**2 * HALF * np.sin(angle))
    right = -MASS * RATE**2 * HALF * np.cos(angle)
    known = {
        "x": {"pin": right}, "y": {"pin": up}, "global": {"pin, x": right, "pin, y": up},
        "axial": {"pin": right * np.cos(angle) + up * np.sin(angle)},
        "shear": {"pin": up * np.cos(angle) - right * np.sin(angle)}, "magnitude": {"pin": np.hypot(right, up)},
    }  # fmt: skip
    known["body"] = {f"pin, {name}": known[name]["pin"] for name in ("axial", "shear")}
    for components, expected in known.items():
        axes = driven.plot.reactions(Figure().add_subplot(), joints="pin", components=components)  # type: ignore[arg-type]
        drawn = lines(axes)
        assert list(drawn) == list(expected)
        for name, values in expected.items():
            np.testing.assert_allclose(drawn[name], values, atol=1e-6)
        both = len(expected) == 2 or components == "magnitude"
        assert axes.get_ylabel() == "joint force [N]" or not both
        assert both or components in axes.get_ylabel()


def test_body_components_at_the_ground_are_those_of_the_first_body(axes: Axes) -> None:
    joint = {"type": "revolute", "bodies": ["rod", "ground"], "points": [[-HALF, 0], [0, 0]]}
    model = DRIVEN["model"] | {"joints": DRIVEN["model"]["joints"] | {"pin": joint}}
    with mbdkit.run(DRIVEN | {"model": model}) as run:
        drawn = lines(run.plot.reactions(axes, joints=["pin"], components="axial"))["pin"]
        # the rod pulls the ground outwards by m r w^2, less what its weight takes
        expected = MASS * (RATE**2 * HALF - 9.81 * np.sin(RATE * run.time))
        np.testing.assert_allclose(drawn, expected, atol=1e-6)


def test_markers_are_the_default_of_paths_and_points_can_be_named(driven: mbdkit.Run, axes: Axes) -> None:
    driven.plot.trajectory(axes)
    assert list(lines(axes)) == ["tip"]
    np.testing.assert_allclose(np.hypot(*axes.get_lines()[0].get_data()), 2 * HALF, atol=1e-9)
    other = driven.plot.trajectory(Figure().add_subplot(), points=["rod"])
    np.testing.assert_allclose(np.hypot(*other.get_lines()[0].get_data()), HALF, atol=1e-9)
    with pytest.raises(MbdkitError, match=r"no point 'tpi' \(did you mean 'tip'\?\)"):
        driven.plot.trajectory(Figure().add_subplot(), points="tpi")


def test_energies_are_named_and_potential_counts_from_the_start(driven: mbdkit.Run, axes: Axes) -> None:
    drawn = lines(driven.plot.energy(axes))
    assert set(drawn) == {"kinetic", "potential", "total", "work"}  # the rod is level at the start
    potential = next(values for name, values in drawn.items() if name.startswith("potential"))
    np.testing.assert_allclose(potential, MASS * 9.81 * HALF * np.sin(RATE * driven.time), atol=1e-6)
    balance = driven.plot.energy(Figure().add_subplot(), terms="balance")
    assert balance.get_ylabel() == "energy balance [J]"
    np.testing.assert_array_equal(lines(balance)["balance"], driven.energy.balance)
    with pytest.raises(SpecError, match=r"not 'kinetik' \(did you mean 'kinetic'\?\)"):
        driven.plot.energy(Figure().add_subplot(), terms=["kinetik"])


def test_energies_that_are_drawn_from_the_start_on_say_so(axes: Axes) -> None:
    model = {"name": "single-pendulum", "angle": 1.0}
    run = mbdkit.run("pendulum", time={"end": 0.1, "step": 0.01}, model=model)
    drawn, base = lines(run.plot.energy(axes)), run.energy.potential[0]
    assert abs(base) > 0.1
    np.testing.assert_allclose(drawn["potential, 0 at the start"], run.energy.potential - base)
    np.testing.assert_allclose(drawn["total, minus potential at the start"], run.energy.total - base)


def test_the_settings_of_the_user_are_respected(sprung: mbdkit.Run) -> None:
    mine = {"lines.linewidth": 3.25, "axes.prop_cycle": cycler(color=["#112233", "#445566"]), "font.size": 17.0}
    with mpl.rc_context(mine):
        axes = sprung.plot.torques(Figure().add_subplot())
        assert [line.get_color() for line in axes.get_lines()] == ["#112233", "#445566"]
        assert {line.get_linewidth() for line in axes.get_lines()} == {3.25}
        assert axes.xaxis.label.get_size() == 17.0
    before = dict(mpl.rcParams)
    sprung.plot.drift(Figure().add_subplot())
    assert dict(mpl.rcParams) == before


def test_of_many_joints_those_with_the_largest_values_are_drawn_and_all_lines_are_named(make_run: Any) -> None:
    def load(data: dict[str, np.ndarray]) -> None:
        data["joints/reaction_force"][:] = 1.0
        data["joints/reaction_force"][:, [3, 7, 11]] = 100.0

    run = make_run(rods=40, change=load)
    drawn = lines(run.plot.reactions(Figure().add_subplot()))
    assert len(drawn) == 6
    assert {"J4", "J8", "J12"} <= set(drawn)
    named = [f"J{k}" for k in range(10, 30)]
    assert list(lines(run.plot.reactions(Figure().add_subplot(), joints=named))) == named
    both = lines(run.plot.reactions(Figure().add_subplot(), components="global"))
    assert list(both) == ["J4, x", "J4, y", "J8, x", "J8, y", "J12, x", "J12, y"]


def test_wrong_names_and_empty_plots_are_explained(driven: mbdkit.Run, axes: Axes) -> None:
    with pytest.raises(MbdkitError, match=r"no joint 'pni' \(did you mean 'pin'\?\)"):
        driven.plot.reactions(axes, joints=["pni"])
    with pytest.raises(SpecError, match=r"not 'axail' \(did you mean 'axial'\?\)"):
        driven.plot.reactions(axes, components="axail")  # type: ignore[arg-type]
    with pytest.raises(SpecError, match="position, velocity or angle"):
        driven.plot.drift(axes, gap="force")  # type: ignore[arg-type]
    with pytest.raises(SpecError, match="no force element of this run exerts a force"):
        driven.plot.forces(axes)
    assert not axes.get_lines()


def test_estimated_errors_are_bands_around_components_too() -> None:
    spec = {"mbdkit": 1, "model": {"name": "double-pendulum", "angles": [-1.0, -0.4]}, "check": True}
    spec |= {"integrator": {"name": "gauss", "stages": 2}, "time": {"end": 1.0, "step": 0.05}}
    with mbdkit.run(spec) as run:
        axes = run.plot.reactions(Figure().add_subplot(), joints=["J2"], components="y")
        (band,) = axes.patches
        assert run.accuracy is not None
        values, error = run.joints["J2"].reaction_force[:, 1], run.accuracy.reaction_error[:, 1]
        corners = band.get_path().vertices[: 2 * len(values), 1]
        np.testing.assert_allclose(corners[: len(values)], values - error)
        np.testing.assert_allclose(corners[len(values) :], (values + error)[::-1])


def test_runs_are_compared_by_what_differs(driven: mbdkit.Run) -> None:
    coarse = mbdkit.run(DRIVEN, time={"end": 2.0, "step": 0.05})
    axes = mbdkit.plot.compare([driven, coarse], "torques", Figure().add_subplot())
    assert list(lines(axes)) == ["step 0.01 s", "step 0.05 s"]
    assert axes.get_legend().get_title().get_text() == "motor"  # type: ignore[union-attr]
    first, second = axes.get_lines()
    assert first.get_color() != second.get_color()
    assert first.get_linestyle() != second.get_linestyle()
    np.testing.assert_array_equal(second.get_xdata(), coarse.time)
    other = mbdkit.run(DRIVEN, integrator={"name": "rk4"})
    axes = mbdkit.plot.compare([driven, other], "reactions", Figure().add_subplot(), joints="pin", components="body")
    assert list(lines(axes)) == ["axial, gauss, 2 stages", "shear, gauss, 2 stages", "axial, rk4", "shear, rk4"]
    heavy = mbdkit.run(DRIVEN, model=DRIVEN["model"] | {"gravity": [0.0, -1.62]})
    axes = mbdkit.plot.compare([driven, heavy], "torques", Figure().add_subplot())
    assert list(lines(axes)) == ["y of gravity -9.81 m/s²", "y of gravity -1.62 m/s²"]
    long = [
        mbdkit.run("pendulum", time={"end": 0.1, "step": 0.01}, model={"name": "single-pendulum", "length": length})
        for length in (1.0, 2.0)
    ]
    axes = mbdkit.plot.compare(long, "drift", Figure().add_subplot())
    assert list(lines(axes)) == ["length 1 m", "length 2 m"]


def test_equal_specs_are_told_apart_by_title_by_file_or_by_number(
    driven: mbdkit.Run, make_run: Any, tmp_path: Any
) -> None:
    one, two = make_run(title="before"), make_run(title="after")
    axes = mbdkit.plot.compare([one, two], "energy", Figure().add_subplot(), terms="total")
    assert list(lines(axes)) == [f"minus potential at the start, {name}" for name in ("before", "after")]
    for name in ("left", "right"):
        driven.save(tmp_path / f"{name}.h5")
    with mbdkit.load(tmp_path / "left.h5") as left, mbdkit.load(tmp_path / "right.h5") as right:
        assert list(lines(mbdkit.plot.compare([left, right], "torques", Figure().add_subplot()))) == ["left", "right"]
    same = mbdkit.plot.compare([driven, driven], "torques", Figure().add_subplot())
    assert list(lines(same)) == ["run 1", "run 2"]
    mine = mbdkit.plot.compare([driven, driven], "torques", Figure().add_subplot(), labels=["a", "b"])
    assert list(lines(mine)) == ["a", "b"]


def test_the_same_elements_are_compared_although_others_matter_in_the_second_run(make_run: Any) -> None:
    def load(joint: int) -> Any:
        def change(data: dict[str, np.ndarray]) -> None:
            data["joints/reaction_force"][:, joint] = 1000.0

        return change

    runs = [make_run(rods=20, change=load(4), title="one"), make_run(rods=20, change=load(9), title="two")]
    drawn = list(lines(mbdkit.plot.compare(runs, "reactions", Figure().add_subplot())))
    assert len(drawn) == 6
    assert {name.partition(",")[0] for name in drawn[:3]} == {name.partition(",")[0] for name in drawn[3:]}
    assert "J5, one" in drawn
    assert "J10, one" in drawn  # the largest of the second run


def test_kind_and_axes_of_a_comparison_stand_in_any_order(driven: mbdkit.Run, axes: Axes) -> None:
    assert mbdkit.plot.compare([driven], axes, kind="torques") is axes
    assert mbdkit.plot.compare([driven], axes, "torques") is axes
    assert mbdkit.plot.compare([driven], "torques", ax=axes) is axes
    for wrong, name in ((("torques", "drift"), "str"), ((axes.figure,), "Figure"), (([driven],), "list")):
        with pytest.raises(TypeError, match=rf"^compare takes one kind of plot .* but not this {name}$"):
            mbdkit.plot.compare([driven], *wrong)


def test_wrong_comparisons_are_explained(driven: mbdkit.Run, axes: Axes) -> None:
    with pytest.raises(SpecError, match="no run to draw"):
        mbdkit.plot.compare([], "drift", axes)
    with pytest.raises(SpecError, match="no kind of plot 'drfit'"):
        mbdkit.plot.compare([driven], "drfit", axes)
    with pytest.raises(SpecError, match="'drift' has no option 'components'; its options are joints, gap"):
        mbdkit.plot.compare([driven], "drift", axes, components="x")
    with pytest.raises(SpecError, match="2 runs, but 1 label"):
        mbdkit.plot.compare([driven, driven], "drift", axes, labels=["a"])
