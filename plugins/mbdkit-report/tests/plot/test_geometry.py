from __future__ import annotations

import h5py
import numpy as np
import pytest

import mbdkit
from mbdkit.archive.stored_mechanism import built_mechanism
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_report import bands, draw_mechanism, view_box
from mbdkit_report.figures import curves
from mbdkit_report.figures.curves import evenly, take
from mbdkit_report.figures.drawing_geometry import GROUND, choose_traces, draw_centres, draw_run, trace_points
from mbdkit_report.figures.element_places import contact_places
from mbdkit_report.figures.plane_geometry import convex_hull, zigzag
from mbdkit_report.figures.player_data import film_data, gaps
from mbdkit_report.figures.svg_canvas import Canvas


def rods(count: int) -> Mechanism:
    mechanism = Mechanism()
    before = mechanism.ground
    for k in range(count):
        rod = mechanism.body(f"rod{k + 1}", mass=1, inertia=1 / 12, position=(k + 0.5, 0))
        mechanism.revolute(f"J{k + 1}", before, rod, at=(k, 0))
        before = rod
    return mechanism


def initial_poses(mechanism: Mechanism) -> np.ndarray:
    return np.array([[*body.position, body.angle] for body in mechanism.bodies.values()])


def outline(mechanism: Mechanism, body: int) -> list[list[float]]:
    drawing = draw_mechanism(mechanism)
    return sorted(drawing.world(initial_poses(mechanism), drawing.outlines[body]).round(12).tolist())


def test_the_last_rod_of_a_chain_ends_opposite_to_its_joint():
    assert outline(rods(2), 0) == [[0.0, 0.0], [1.0, 0.0]]
    assert outline(rods(2), 1) == [[1.0, 0.0], [2.0, 0.0]]


def test_paths_are_those_of_free_ends_and_of_joints_that_move():
    assert [trace.label for trace in draw_mechanism(rods(3)).traces] == ["rod3 end", "J2", "J3"]


def test_of_many_paths_four_are_chosen_and_the_free_end_is_the_first():
    drawing = draw_mechanism(rods(50))
    chosen = choose_traces(drawing)
    assert len(chosen) == 4
    assert chosen[0].label == "rod50 end"
    points, owners = trace_points(drawing, chosen)
    poses = initial_poses(rods(50))
    wanted = drawing.world(poses, [trace.point for trace in chosen])
    np.testing.assert_array_equal(points.world(poses[owners]), wanted)


def test_world_coordinates_turn_with_the_body_and_leave_the_ground_alone():
    drawing = draw_mechanism(rods(1))
    poses = np.array([[[0.0, 0.5, np.pi / 2]], [[-0.5, 0.0, np.pi]]])
    world = drawing.world(poses)
    assert world.shape == (2, len(drawing.owner), 2)
    end = drawing.traces[0].point
    np.testing.assert_allclose(world[:, end], [[0.0, 1.0], [-1.0, 0.0]], atol=1e-15)
    np.testing.assert_array_equal(world[:, drawing.owner == GROUND], np.zeros((2, 1, 2)))


def test_a_body_with_points_off_one_line_is_an_outline_through_them():
    mechanism = Mechanism()
    plate = mechanism.body("plate", mass=1, inertia=1, position=(0, 0))
    for name, at in {"A": (-1, -1), "B": (1, -1), "C": (0, 1)}.items():
        mechanism.revolute(name, mechanism.ground, plate, at=at)
    assert outline(mechanism, 0) == [[-1.0, -1.0], [0.0, 1.0], [1.0, -1.0]]
    assert len(draw_mechanism(mechanism).grounds) == 3


def test_joints_close_together_and_far_from_the_centre_of_mass_give_a_body_with_a_far_end():
    mechanism = Mechanism()
    shank = mechanism.body("shank", mass=1, inertia=1, position=(0, -1))
    mechanism.revolute("A", mechanism.ground, shank, at=(-0.1, 0))
    mechanism.revolute("B", mechanism.ground, shank, at=(0.1, 0))
    assert outline(mechanism, 0) == [[-0.1, 0.0], [0.0, -2.0], [0.1, 0.0]]
    assert [trace.label for trace in draw_mechanism(mechanism).traces] == ["shank end"]


@pytest.mark.parametrize(("marker", "end"), [((0.4, 0), 0.9), ((0.1, 0), 1.0), ((-0.4, 0), 1.0)])
def test_a_rod_ends_at_a_marker_that_is_far_out(marker, end):
    mechanism = rods(1)
    mechanism.marker("head", "rod1", point=marker)
    assert outline(mechanism, 0) == [[0.0, 0.0], [end, 0.0]]


def test_paths_are_those_of_the_markers_if_there_are_any():
    mechanism = rods(2)
    mechanism.marker("tip", "rod2", point=(0.5, 0))
    mechanism.marker("nail", mechanism.ground, at=(3, 3))
    drawing = draw_mechanism(mechanism)
    assert [trace.label for trace in choose_traces(drawing)] == ["tip"]
    assert drawing.world(initial_poses(mechanism), [drawing.traces[0].point]).tolist() == [[2.0, 0.0]]


def test_a_free_body_is_a_disc_whose_centre_leaves_a_path():
    mechanism = Mechanism()
    mechanism.body("ball", mass=1, position=(3, 4))
    drawing = draw_mechanism(mechanism)
    assert [len(points) for points in drawing.outlines] == [1]
    assert [trace.label for trace in drawing.traces] == ["ball"]
    assert drawing.world(initial_poses(mechanism)).tolist() == [[3.0, 4.0]]


def test_springs_and_distances_join_the_points_of_their_bodies():
    mechanism = rods(1)
    mechanism.spring_damper("s", mechanism.ground, "rod1", from_=(0.5, 1), to=(0.5, 0), stiffness=1)
    bob = mechanism.body("bob", mass=1, position=(1, -1))
    mechanism.distance("string", "rod1", bob, from_=(1, 0), to=(1, -1))
    drawing = draw_mechanism(mechanism)
    world = drawing.world(initial_poses(mechanism))
    assert world[list(drawing.springs[0])].tolist() == [[0.5, 1.0], [0.5, 0.0]]
    assert world[list(drawing.bars[0])].tolist() == [[1.0, 0.0], [1.0, -1.0]]
    assert len(drawing.grounds) == 2


def test_a_slide_is_a_line_of_its_first_body_past_the_point_that_slides_on_it():
    mechanism = Mechanism()
    arm = mechanism.body("arm", mass=1, inertia=1, position=(1, 0), angle=np.pi / 2)
    block = mechanism.body("block", mass=1, inertia=1, position=(1, 2), angle=np.pi / 2)
    mechanism.revolute("pin", mechanism.ground, arm, at=(1, -1))
    mechanism.prismatic("slide", arm, block, points=((0.5, 0), (0, 0)), axis=(2, 0))
    drawing = draw_mechanism(mechanism)
    world = drawing.world(initial_poses(mechanism)).round(12)
    assert world[list(drawing.sliders)].tolist() == [[1.0, 2.0]]
    ends = world[list(drawing.guides[0])]
    assert ends[:, 0].tolist() == [1.0, 1.0]
    assert ends[0, 1] < 0.5
    assert ends[1, 1] > 2.0
    assert set(drawing.owner[list(drawing.guides[0])]) == {0}
    assert [trace.label for trace in drawing.traces] == ["slide"]
    assert len(drawing.pins) == len(drawing.grounds) == 1


def test_a_weld_is_marked_at_its_point():
    mechanism = Mechanism()
    beam = mechanism.body("beam", mass=1, inertia=1, position=(1, 0))
    mechanism.weld("wall", mechanism.ground, beam, at=(0, 0))
    drawing = draw_mechanism(mechanism)
    assert drawing.world(initial_poses(mechanism), drawing.welds).tolist() == [[0.0, 0.0]]
    assert drawing.pins == ()
    assert outline(mechanism, 0) == [[0.0, 0.0], [2.0, 0.0]]


@pytest.mark.parametrize("model", [{"name": "acme:thing"}, {"name": "double-pendulum", "odd": 1}, {}])
def test_a_model_that_cannot_be_built_is_drawn_as_centres_of_mass(model):
    built = built_mechanism({"model": model})
    assert built.mechanism is None
    assert built.not_drawn.startswith("only points of bodies are drawn: the mechanism of this run is not stored")
    drawing = draw_centres(["a", "b"])
    assert [trace.label for trace in drawing.traces] == ["a", "b"]
    poses = np.array([[1.0, 2.0, 0.3], [3.0, 4.0, 0.5]])
    assert drawing.world(poses).tolist() == [[1.0, 2.0], [3.0, 4.0]]


def test_the_hull_leaves_out_points_inside_and_on_its_sides():
    points = np.array([[0, 0], [1, 0], [2, 0], [2, 2], [1, 1], [0, 2]], dtype=float)
    assert convex_hull(points) == [0, 2, 3, 5]
    assert convex_hull(points[:3]) == [0, 2]
    assert convex_hull(points[:1].repeat(3, axis=0)) == [0]


def test_a_spring_runs_from_end_to_end_with_teeth_of_the_given_width():
    start, end = np.zeros((4, 2)), np.tile([0.0, 2.0], (4, 1))
    corners = zigzag(start, end, 0.1)
    assert corners.shape == (4, 16, 2)
    np.testing.assert_array_equal(corners[:, 0], start)
    np.testing.assert_array_equal(corners[:, -1], end)
    np.testing.assert_allclose(np.abs(corners[..., 0]).max(), 0.1)
    assert np.all(np.isfinite(zigzag(start, start, 0.1)))


def test_the_view_holds_all_points_of_a_motion_that_holds_together():
    paths = np.cumsum(np.random.default_rng(1).normal(size=(500, 3, 2)), axis=0)
    (x0, x1), (y0, y1), cut = view_box(paths, np.array([[100.0, 100.0]]))
    assert not cut
    assert x0 < paths[..., 0].min()
    assert y0 < paths[..., 1].min()
    assert x1 > 100.0
    assert y1 > 100.0


@pytest.mark.parametrize("rate", [50.0, 500.0])
def test_the_view_of_a_motion_that_flies_apart_is_that_of_what_went_before(rate):
    time = np.linspace(0.0, 1.0, 1001)
    circle = np.stack([np.cos(time * 9), np.sin(time * 9)], axis=-1)
    flight = np.exp(np.clip(rate * (time - 0.3), 0.0, 300.0))[:, None]
    paths = (circle * flight)[:, None]
    paths[-1] = np.nan
    (x0, x1), (y0, y1), cut = view_box(paths, np.zeros((1, 2)))
    assert cut
    assert max(-x0, x1, -y0, y1) < 10.0


def test_a_mechanism_that_a_growing_torque_moves_from_rest_does_not_fly_apart():
    time = np.linspace(0.0, 1.0, 1001)
    paths = np.stack([0.3 * time**4, 0.0 * time], axis=-1)[:, None]  # of a marker; 1e4 times less in its first tenth
    (_, x1), _, cut = view_box(paths, np.array([[0.0, 0.0], [0.2, 0.1]]))
    assert not cut
    assert x1 > 0.3


def test_names_need_no_points_of_lines_outside_of_the_drawing():
    canvas = Canvas(200.0, 100.0, 1.0, np.zeros(2))
    canvas.line(np.array([[50.0, 50.0], [1e300, 50.0]]), "body")
    canvas.line(np.array([[50.0, 50.0], [60.0, 50.0]]), "body")
    assert len(canvas.ink) == 1 + len(canvas.drawn[1])
    assert canvas.ink.max() <= 60.0


def test_the_view_of_nothing_finite_is_still_a_view():
    (x0, x1), (y0, y1), _ = view_box(np.full((3, 1, 2), np.nan), np.full((1, 2), np.nan))
    assert x0 < x1
    assert y0 < y1


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_the_line_of_a_contact_crosses_the_whole_picture_of_a_motion(angle):
    mechanism = Mechanism()
    mechanism.body("block", mass=1, inertia=0.1, position=(0, 0))
    line = {"line": {"point": [3.0, 0.0], "normal": [-np.sin(angle), np.cos(angle)]}}
    mechanism.contact("floor", mechanism.ground, "block", shapes=[line, {"point": [0.0, -0.1]}])
    drawing = draw_mechanism(mechanism)
    poses = np.array([[[0.0, 0.0, 0.0]], [[50.0, 0.0, 0.0]]])  # the block slides far away
    xlim, ylim, _ = view_box(np.zeros((1, 1, 2)), drawing.world(poses))
    (ends,) = drawing.lines
    start, end = drawing.spanning(xlim, ylim, poses).world(poses[0], ends)
    along = np.array([np.cos(angle), np.sin(angle)])
    corners = np.array([[x, y] for x in xlim for y in ylim])
    np.testing.assert_allclose((np.array([start, end]) - [3.0, 0.0]) @ [-along[1], along[0]], 0.0, atol=1e-9)
    assert min(start @ along, end @ along) < (corners @ along).min()
    assert max(start @ along, end @ along) > (corners @ along).max()


def test_lines_and_polylines_are_drawn_beyond_the_bodies_by_half_of_their_extent() -> None:
    m = mbdkit.Mechanism()
    ball = m.body("ball", mass=1.0, inertia=0.1, position=(3.0, 1.0))
    round_shape = {"circle": {"radius": 0.1}}
    m.contact("floor", m.ground, ball, shapes=[{"line": {"normal": [0, 1]}}, round_shape])
    m.contact("steps", m.ground, ball, shapes=[{"polyline": [[-1, 0], [0, 0], [0, 0.5], [1, 0.5]]}, round_shape])
    floor, steps = ([point for _, point in contact_places(m, "ground", one.shapes[0])] for one in m.contacts.values())
    np.testing.assert_allclose(floor, [[-3.0, 0.0], [5.0, 0.0]], atol=1e-15)  # bodies and points are 4 m apart
    np.testing.assert_allclose(steps, [[-3.0, 0.0], [-1, 0], [0, 0], [0, 0.5], [1, 0.5], [5.0, 0.5]], atol=1e-15)


ROUND_OFF = 1e-14  # m, of lengths of some metres


@pytest.mark.parametrize("example", ["knee", "double-pendulum", "slider-crank", "watt-six-bar", "car-axis"])
def test_the_length_of_a_gap_is_the_recorded_misalignment(example):
    with mbdkit.run(example, integrator={"name": "rk4"}) as run:
        drawing, poses = draw_run(run), run.array("trajectory/position")
        found = gaps(run, drawing, poses)
        assert found.joints
        for column, name in enumerate(found.joints):
            length = np.hypot(*found.vectors[:, column].T)
            np.testing.assert_allclose(length, run.joints[name].misalignment, rtol=1e-9, atol=ROUND_OFF)


def test_the_gap_of_a_moving_center_is_the_recorded_misalignment():
    m = mbdkit.Mechanism()
    base = m.body("base", mass=1.0, inertia=0.3, position=(0.4, 0.0))
    disc = m.body("disc", mass=1.0, inertia=0.1, position=(0.9, 0.1), angle=0.3, angular_velocity=4.0)
    m.revolute("pivot", m.ground, base, at=(0.0, 0.0))
    m.revolute("rolls", base, disc, at=(0.9, 0.0), center={"x": "-0.2*angle", "y": "0.1*cos(angle)"})
    with mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 2, "step": 0.02}) as run:
        drawing, poses = draw_run(run), run.array("trajectory/position")
        length = np.hypot(*gaps(run, drawing, poses).vectors[:, 1].T)
        assert length.max() > 1e-6
        np.testing.assert_allclose(length, run.joints["rolls"].misalignment, rtol=1e-8, atol=ROUND_OFF)


def test_the_ends_of_a_gap_are_the_joints_points(make_run):
    run = make_run(rods=3)
    drawing, poses = draw_run(run), run.array("trajectory/position")
    found = gaps(run, drawing, poses)
    world = drawing.world(poses)
    for (a, b), vector in zip(found.ends, np.moveaxis(found.vectors, 1, 0), strict=True):
        np.testing.assert_allclose(world[:, b] - world[:, a], vector, rtol=0, atol=ROUND_OFF)


def test_of_many_joints_those_that_come_apart_the_most_are_magnified(make_run):
    def pull(data):
        data["trajectory/position"][:, 50:, 0] += 1e-3

    data = film_data(make_run(rods=80, rows=40, change=pull), numbers=10_000)
    assert len(data["gaps"]["joints"]) == 40
    assert "J51" in data["gaps"]["joints"]
    assert data["gaps"]["largest"] == pytest.approx(1e-3, rel=1e-9)


def test_a_model_that_is_not_installed_has_no_gaps(make_run):
    data = film_data(make_run(model={"name": "acme:crane"}), numbers=10_000)
    assert data["gaps"] == {"joints": [], "ends": [], "largest": 0.0, "vectors": []}


def test_bands_of_a_short_recording_are_its_rows():
    values = np.array([[1.0, -2.0], [3.0, 4.0]])
    cut = bands(np.array([0.0, 1.0]), values)
    assert cut.exact
    np.testing.assert_array_equal(cut.high, values)
    np.testing.assert_array_equal(cut.peaks, [3.0, 4.0])
    np.testing.assert_array_equal(cut.curve(1), [[0.0, 1.0], [-2.0, 4.0]])


@pytest.mark.parametrize("block", [1, 1_000, 4_000_000])
def test_bands_keep_every_extreme_whatever_the_size_of_a_block(monkeypatch, block):
    monkeypatch.setattr(curves, "BLOCK", block)
    rows = 30_011 if block > 1 else 1_009
    values = np.random.default_rng(2).normal(size=(rows, 2))
    values[rows // 2, 1] = -99.0
    cut = bands(np.arange(rows, dtype=float), values, points=100)
    edges = np.linspace(0, rows, len(cut.time) + 1).astype(int)
    for low, high, first, last in zip(cut.low, cut.high, edges[:-1], edges[1:], strict=True):
        np.testing.assert_array_equal(low, values[first:last].min(axis=0))
        np.testing.assert_array_equal(high, values[first:last].max(axis=0))
    assert cut.peaks[1] == 99.0
    assert np.all(np.diff(cut.time) > 0)
    assert cut.curve(1)[1].min() == -99.0


def test_values_that_are_not_finite_leave_no_trace_in_bands():
    values = np.array([[1.0, np.nan], [np.inf, np.nan], [2.0, np.nan]])
    cut = bands(np.arange(3.0), values)
    np.testing.assert_array_equal(cut.high, [[1.0, np.nan], [np.nan, np.nan], [2.0, np.nan]])
    np.testing.assert_array_equal(cut.peaks, [2.0, np.nan])


def test_bands_of_no_curves_are_empty():
    assert bands(np.arange(5.0), np.empty((5, 0))).high.shape == (5, 0)


def test_rows_are_spread_evenly_with_both_ends():
    assert evenly(5, 10).tolist() == [0, 1, 2, 3, 4]
    assert evenly(101, 3).tolist() == [0, 50, 100]
    assert evenly(1, 2).tolist() == [0]


@pytest.mark.parametrize("rows", [[0, 99], list(range(100)), [3, 4, 50], []])
@pytest.mark.parametrize("block", [40, 4_000_000])
def test_rows_taken_from_a_file_are_those_of_the_array(tmp_path, monkeypatch, rows, block):
    monkeypatch.setattr(curves, "BLOCK", block)
    values = np.random.default_rng(3).normal(size=(100, 4, 3))
    wanted = values[np.array(rows, dtype=int)]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        data = file.create_dataset("x", data=values, chunks=(10, 4, 3))
        np.testing.assert_array_equal(take(data, np.array(rows, dtype=int)), wanted)
        np.testing.assert_array_equal(take(data, np.array(rows, dtype=int), [2, 0]), wanted[:, [2, 0]])
