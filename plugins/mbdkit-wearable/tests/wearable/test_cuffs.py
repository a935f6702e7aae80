"""Cuffs against closed forms: momentum, power, laws of tissue, friction on the skin, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest

import mbdkit
from tests.margins import assert_within

STIFFNESS = {"normal": 900.0, "tangential": 400.0, "rotation": 3.0}


def free_pair(**keys: object) -> mbdkit.Mechanism:
    """Return two free bodies without gravity that a cuff connects, far from rest."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("limb", mass=3.0, inertia=0.05, velocity=(0.2, -0.1), angular_velocity=3.0)
    m.body("link", mass=0.7, inertia=0.01, position=(0.1, 0.06), angle=0.4, angular_velocity=-5.0)
    place = {"bodies": ("limb", "link"), "at": (0.12, 0.02), "on": (0.03, -0.02), "angle": 0.1, "axis": (1.0, 2.0)}
    m.cuff("cuff", **{**place, "stiffness": STIFFNESS, **keys})
    return m


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the z component of a x b for vectors (T, 2)."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def driven(motion: tuple[str, str, str], **keys: object) -> mbdkit.Mechanism:
    """Return a link that drivers move in x, y and angle, whose cuff is on the ground."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("link", mass=1.0, inertia=0.01)
    for coordinate, text in zip(("x", "y", "angle"), motion, strict=True):
        m.driver(coordinate, m.ground, "link", coordinate=coordinate, motion=text)
    m.cuff("cuff", bodies=(m.ground, "link"), at=(0.0, 0.0), **{"stiffness": STIFFNESS, **keys})
    return m


def run_of(m: mbdkit.Mechanism, end: float, step: float, **sections: object) -> mbdkit.Run:
    """Return a run by an implicit method of order 6."""
    return mbdkit.run(m, integrator={"name": "gauss", "stages": 3}, time={"end": end, "step": step}, **sections)


def test_momentum_and_energy_are_kept_with_displaced_points() -> None:
    m = free_pair()
    run = run_of(m, 2.0, 2e-3)
    mass = {name: (body.mass, body.inertia) for name, body in m.bodies.items()}
    p = sum(mass[name][0] * run[name].velocity for name in mass)
    turn = sum(
        mass[name][1] * run[name].angular_velocity + mass[name][0] * cross(run[name].position, run[name].velocity)
        for name in mass
    )
    assert np.ptp(run.cuffs["cuff"].displacement[:, 0]) > 0.05
    assert_within(p - p[0], 1e-12)
    assert_within(turn - turn[0], 1e-12)
    assert_within(run.energy.balance, 1e-9 * run.energy.total.max())


def test_forces_follow_from_displacements_and_do_their_virtual_work() -> None:
    # the displacement from the poses; the power is that of the forces at the device's point, on link and limb
    run = run_of(free_pair(damping={"normal": 3.0, "tangential": 2.0, "rotation": 0.02}), 1.0, 2e-3)
    limb, link, cuff = run["limb"], run["link"], run.cuffs["cuff"]
    axis = np.array([1.0, 2.0]) / np.sqrt(5.0)
    c, s = np.cos(limb.angle), np.sin(limb.angle)
    normal = np.stack([c * axis[0] - s * axis[1], s * axis[0] + c * axis[1]], axis=1)
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    c, s = np.cos(link.angle), np.sin(link.angle)
    arm = np.stack([0.03 * c + 0.02 * s, 0.03 * s - 0.02 * c], axis=1)
    point = link.position + arm
    rest = np.array([0.12, 0.02])
    expected = [((point - limb.position) * e).sum(axis=1) - rest @ f for e, f in
                ((normal, axis), (tangent, np.array([-axis[1], axis[0]])))]  # fmt: skip
    assert_within(cuff.displacement.T - np.array(expected), 1e-13)
    assert cuff.rotation == pytest.approx(link.angle - limb.angle - 0.1, abs=1e-13)
    force = cuff.normal_force[:, None] * normal + cuff.shear_force[:, None] * tangent  # on the limb
    at_link = link.velocity + link.angular_velocity[:, None] * np.stack([-arm[:, 1], arm[:, 0]], axis=1)
    lever = point - limb.position
    at_limb = limb.velocity + limb.angular_velocity[:, None] * np.stack([-lever[:, 1], lever[:, 0]], axis=1)
    power = (force * (at_limb - at_link)).sum(axis=1) + cuff.moment * (limb.angular_velocity - link.angular_velocity)
    assert cuff.power == pytest.approx(power, abs=1e-11)
    # Newton and Euler of the limb
    assert 3.0 * limb.acceleration == pytest.approx(force, abs=1e-10)
    assert 0.05 * limb.angular_acceleration == pytest.approx(cross(lever, force) + cuff.moment, abs=1e-11)


def test_exponential_tissue_with_clearance_has_fungs_law_and_its_energy() -> None:
    k, length, gap = 2000.0, 0.01, 0.004
    law = {"name": "exponential", "length": length, "angle": 0.1}
    run = run_of(driven(("0.03*sin(2*pi*t)", "0.02*sin(4*pi*t)", "0.2*sin(2*pi*t)"), law=law, clearance=gap,
                        stiffness={"normal": k, "tangential": 500.0, "rotation": 4.0}), 1.0, 0.01)  # fmt: skip
    cuff = run.cuffs["cuff"]
    x, y = cuff.displacement.T

    def fung(x: np.ndarray, k: float, scale: float, gap: float = 0.0) -> np.ndarray:
        return np.sign(x) * k * scale * np.expm1(np.maximum(np.abs(x) - gap, 0.0) / scale)

    assert cuff.normal_force == pytest.approx(fung(x, k, length, gap), abs=1e-11)
    assert cuff.shear_force == pytest.approx(fung(y, 500.0, length), abs=1e-11)
    assert cuff.moment == pytest.approx(fung(cuff.rotation, 4.0, 0.1), abs=1e-12)
    at = np.array([0.01 * 30 * i / 1000 for i in range(101)])  # the potential, by quadrature
    energy = np.trapezoid(fung(at, k, length, gap), at)
    stored = fung_energy(at[-1] - gap, k, length)
    assert stored == pytest.approx(energy, rel=1e-3)
    assert run.energy.potential[25] == pytest.approx(
        fung_energy(0.03 - gap, k, length) + fung_energy(0.2, 4.0, 0.1) + fung_energy(abs(y[25]), 500.0, length)
    )


def fung_energy(x: float, k: float, scale: float) -> float:
    """Return the energy of exponential tissue at a displacement beyond the clearance."""
    return k * scale * (scale * np.expm1(x / scale) - x)


def test_a_slipping_cuff_follows_dahls_curve_and_its_friction_dissipates() -> None:
    # F = Fc (1 - exp(-k x / Fc)) from rest; then from x0 back: F = -Fc + (F0 + Fc) exp(-k (x0 - x) / Fc)
    k, mu, n0 = 5000.0, 0.4, 60.0
    limit = mu * (n0 + 900.0 * 0.01)  # pressed by 10 mm
    m = driven(("0.01", "0.03*sin(pi*t)", "0"), stiffness={"normal": 900.0, "tangential": k},
               slip={"friction": mu, "preload": n0})  # fmt: skip
    # the driver starts at 0.01, where the tissue is not at rest
    cuff_of = m.cuffs["cuff"].model_copy(update={"on": (0.0, 0.0), "angle": 0.0})
    m.cuffs["cuff"] = cuff_of
    run = run_of(m, 1.0, 1e-3, limits={"misalignment": 1.0})
    x, force = run.cuffs["cuff"].displacement[:, 1], run.cuffs["cuff"].shear_force
    assert run.cuffs["cuff"].normal_force == pytest.approx(9.0)
    forth = limit * -np.expm1(-k * x[:501] / limit)
    back = -limit + (forth[-1] + limit) * np.exp(-k * (x[500] - x[500:]) / limit)
    assert force[:501] == pytest.approx(forth, abs=1e-6)
    assert force[500:] == pytest.approx(back, abs=1e-6)
    assert run.energy.dissipated[-1] == pytest.approx(np.trapezoid(force, x), rel=1e-4)
    assert run.verdict == "doubtful"
    assert any(reason.startswith("cuff-slip: cuff 'cuff' slides by") for reason in run.verdict_reasons)


def test_loads_beyond_the_limits_are_doubtful_and_a_spec_may_accept_them() -> None:
    m = driven(("0.01*t", "0.02*t", "0"), stiffness={"normal": 5e3, "tangential": 2e4}, area=2e-3)
    run = run_of(m, 1.0, 0.05)
    assert run.verdict == "doubtful"
    reasons = "\n".join(run.verdict_reasons)
    assert "shears the skin with 400 N, above its limit of 250 N" in reasons
    assert "presses on the limb with 25 kPa, above its limit of 17.3 kPa" in reasons
    assert "normal_force" not in reasons  # 50 N
    assert run_of(m, 1.0, 0.05, accept=["cuff-loads"]).verdict != "doubtful"


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"stiffness": {"normal": -1.0}}, "stiffness.normal: should be at least 0"),
        ({"axis": (0.0, 0.0)}, "axis: should not be [0, 0]"),
        ({"stiffness": {"normal": 1.0}, "slip": {"friction": 0.5, "preload": 10.0}}, "stiffness.tangential: should be"),
        (
            {"slip": {"friction": 0.5, "preload": 10.0}, "damping": {"tangential": 1.0}},
            "damping.tangential: is not possible with `slip`",
        ),
        ({"law": "quadratic"}, "law"),
        ({"bodies": ("thigh", "link")}, "there is no body 'thigh'"),
    ],
)
def test_wrong_cuffs_are_refused_by_key(keys: dict[str, object], message: str) -> None:
    with pytest.raises(mbdkit.SpecError) as caught:
        mbdkit.run(free_pair(**keys), integrator={"name": "rk4"}, time={"end": 0.1, "step": 0.1})
    assert str(caught.value).startswith("model.cuffs.cuff")
    assert message in str(caught.value)


def test_equilibria_refuse_friction_on_the_skin() -> None:
    with pytest.raises(
        mbdkit.SpecError, match=r"\(cuff.tangential.skin\) have values at rest that the position does not"
    ):
        mbdkit.equilibrium(free_pair(slip={"friction": 0.5, "preload": 10.0}))


@pytest.mark.parametrize(
    "keys",
    [
        {},
        {"law": {"name": "exponential", "length": 0.05, "angle": 0.5}, "clearance": 0.003},
        {"slip": {"friction": 0.5, "preload": 10.0}},
    ],
)
def test_exported_equations_are_those_of_the_run(keys: dict[str, object]) -> None:
    pytest.importorskip("casadi", reason="CasADi, to which mechanisms are exported, is not installed")
    m = free_pair(damping={"normal": 3.0}, **keys)
    run = mbdkit.run(m, integrator={"name": "radau-iia"}, time={"end": 0.1, "step": 0.01})
    bodies = [run[name] for name in m.bodies]
    q, v, a = (
        np.concatenate([[*getattr(one, linear)[-1], getattr(one, angular)[-1]] for one in bodies])
        for linear, angular in (
            ("position", "angle"), ("velocity", "angular_velocity"), ("acceleration", "angular_acceleration"),
        )
    )  # fmt: skip
    z = [run.states["cuff.tangential.skin"].value[-1]] if "slip" in keys else []
    residual = np.array(m.to_casadi().residual(q, v, a, [], z, [], [], run.time[-1]))
    assert np.abs(a).max() > 50.0
    assert_within(residual, 1e-12)


def test_a_run_whose_stiffness_overflows_fails_with_a_verdict() -> None:
    m = mbdkit.Mechanism()
    leg = m.body("leg", mass=4.0, inertia=0.05, position=(0.0, -0.2))
    bar = m.body("bar", mass=0.5, inertia=0.002, position=(0.05, -0.2))
    m.revolute("hip", m.ground, leg, at=(0.0, 0.0))
    m.cuff("strap", bodies=(leg, bar), at=(-1e308, 0.0), axis=(0.0, 1.0), stiffness=STIFFNESS)
    run = mbdkit.run(m, integrator={"name": "radau-iia"}, time={"end": 0.1, "step": 0.01})
    assert (run.status, run.verdict) == ("failed", "bad")
