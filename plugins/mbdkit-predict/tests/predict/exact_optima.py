"""Optimal control problems with known optima; run as a script, prints the errors and the error bars of predictions.

    python plugins/mbdkit-predict/tests/predict/exact_optima.py [WORD ...]

All optima are closed forms or published values, except that of the swing-up: `swing_up` computes it from its equations
in two coordinates, by a transcription of its own.
"""

from __future__ import annotations

import copy
import sys
import time
from typing import Any

import casadi as ca
import numpy as np

import mbdkit
from mbdkit_predict.predict_loading import load_predict_spec

PUSH = "forces.push.value[0]"
BLOCK: dict[str, Any] = {
    "name": "mechanism", "gravity": [0, 0], "bodies": {"block": {"mass": 1.0, "inertia": 1.0}},
    "joints": {
        "rail": {"type": "prismatic", "bodies": ["ground", "block"], "points": [[0, 0], [0, 0]], "axis": [1, 0]},
    },
    "forces": {"push": {"type": "force", "body": "block", "value": [0.0, 0.0]}},
}  # fmt: skip
EFFORT = "integral(forces.push.value**2)"
AT_REST = {"block.x": 0, "block.vx": 0}
STILL = {f"dot.{name}": 0 for name in ("x", "y", "vx", "vy")}


def block(mass: float = 1.0, forces: dict[str, Any] | None = None, **sections: Any) -> dict[str, Any]:
    model = copy.deepcopy(BLOCK)
    model["bodies"]["block"]["mass"] = mass
    model["forces"] |= forces or {}
    first = {
        "controls": {PUSH: {"bounds": [-100, 100]}}, "duration": 1.0, "initial": AT_REST, "minimize": EFFORT,
        "final": {"block.x": 1, "block.vx": 0},
    }  # fmt: skip
    return {"mbdkit_predict": 1, "base": {"model": model}, **first, **sections}


def of_states(states: dict[str, Any], final: dict[str, float], bounds: list[float]) -> dict[str, Any]:
    """Return a problem of least time in first-order states; the angle `turn` is the control."""
    model = {"name": "mechanism", "gravity": [0, 0], "bodies": {"dot": {"mass": 1}}, "states": states}
    return {
        "mbdkit_predict": 1, "base": {"model": model}, "duration": {"bounds": [0.1, 10]}, "initial": STILL,
        "controls": {"states.turn": {"bounds": bounds, "start": 0.1}}, "minimize": "final(t)",
        "final": {f"states.{name}.value": value for name, value in final.items()},
    }  # fmt: skip


DRAG = {"drag": {"type": "force", "body": "block", "value": ["-block.vx", 0]}}
FALL = {
    "x": {"rate": "states.v*sin(states.turn)"}, "y": {"initial": 10, "rate": "-states.v*cos(states.turn)"},
    "v": {"rate": "9.80665*cos(states.turn)"}, "turn": {"rate": "0"},
}  # fmt: skip
CHAIN = {
    "y": {"initial": 1, "rate": "states.turn"}, "length": {"rate": "sqrt(1 + states.turn**2)"}, "turn": {"rate": "0"},
}  # fmt: skip
STEERED = {
    "x": {"rate": "states.vx"}, "y": {"rate": "states.vy"}, "vx": {"rate": "100*cos(states.turn)"},
    "vy": {"rate": "100*sin(states.turn)"}, "turn": {"rate": "0"},
}  # fmt: skip
EXACT = {
    # the force is 6 - 12 t
    "least effort": (block(), 12.0),
    "least effort by gauss": (block(collocation={"method": "gauss", "points": 2, "intervals": 5}), 12.0),
    # 12 / T^3 + w T with T^4 = 36 / w
    "effort and time": (
        block(duration={"bounds": [0.5, 20]}, minimize='integral(controls["forces.push.value[0]"]**2) + 0.1*final(t)'),
        0.4 / 3.0 * 360.0**0.25,
    ),
    # bang-bang: 2 sqrt(m s / F)
    "least time": (
        block(2.0, controls={PUSH: {"bounds": [-50, 50]}}, duration={"bounds": [0.05, 5]}, minimize="final(t)"), 0.4,
    ),
    # D. E. Kirk, Optimal Control Theory (1970), example 5.1-1, in closed form
    "drag": (
        block(forces=DRAG, duration=2.0, final={"block.x": 5, "block.vx": 2}, minimize=f"0.5*{EFFORT}"),
        16.75072339679631,
    ),
    # A. E. Bryson and Y.-C. Ho, Applied Optimal Control (1975), section 3.11: 4 / (9 l)
    "wall": (
        block(
            initial={"block.x": 0, "block.vx": 1},
            final={"block.x": 0, "block.vx": -1},
            subject_to={"wall": {"value": "block.x", "max": 1 / 9}},
            minimize=f"0.5*{EFFORT}",
        ),
        4.0,
    ),
    # J. T. Betts, Practical Methods for Optimal Control (2010), the chain of length 4 between heights 1 and 3
    "hanging chain": (
        {
            **of_states(CHAIN, {"y": 3, "length": 4}, [-20.0, 20.0]),
            "duration": 1.0, "minimize": "integral(states.y.value*sqrt(1 + controls[\"states.turn\"]**2))",
        },
        5.068480110993416,
    ),
    "brachistochrone": (of_states(FALL, {"x": 10, "y": 5}, [0.0, 3.0]), 1.801603122453081),
    "linear tangent steering": (of_states(STEERED, {"y": 5, "vx": 45, "vy": 0}, [-1.57, 1.57]), 0.5545708783346031),
}  # fmt: skip

BY_GAUSS = load_predict_spec("cart-pole", (), collocation={"method": "gauss", "points": 2})


def swing_up(points: int, intervals: int, push: float = 0.0) -> float:
    """Return the effort of the swing-up of M. Kelly, An introduction to trajectory optimization (2017), section 6.

    Direct collocation in the coordinates x, angle and their rates, with a guess on a straight line and a constant
    force. There are two local optima; a guess of -10 N leads to the lower one.
    """
    length, cart, pole, g, end = 0.5, 1.0, 0.3, 9.81, 2.0
    y, u = ca.SX.sym("y", 4), ca.SX.sym("u")
    sin, cos, rate = ca.sin(y[1]), ca.cos(y[1]), y[3]
    down = cart + pole * sin**2
    ax = (length * pole * sin * rate**2 + u + pole * g * cos * sin) / down
    turn = -(length * pole * cos * sin * rate**2 + u * cos + (cart + pole) * g * sin) / (length * down)
    rates = ca.Function("rates", [y, u], [ca.vertcat(y[2], y[3], ax, turn)])
    c = np.array(ca.collocation_points(points, "radau"))
    slopes, _, weights = (np.array(matrix) for matrix in ca.collocation_coeff(list(c)))
    h, unknowns, guess, rows, effort = end / intervals, [], [], [], 0.0
    low, high = [], []
    start: Any = ca.MX(ca.DM.zeros(4))
    for i in range(intervals):
        values, force = ca.MX.sym(f"y{i}", 4, points), ca.MX.sym(f"u{i}", 1, points)
        nodes = ca.horzcat(start, values)
        rows.append(ca.vec(ca.mtimes(nodes, ca.DM(slopes)) - h * rates.map(points)(values, force)))
        effort = effort + h * ca.mtimes(force**2, ca.DM(weights.reshape(-1, 1)))
        unknowns += [ca.vec(values), ca.vec(force)]
        for at in (i + c) / intervals:
            guess += [at, np.pi * at, 0.0, 0.0]
            low += [-2.0, -np.inf, -np.inf, -np.inf]
        guess += [push] * points
        low += [-20.0] * points
        start = values[:, -1]
    rows.append(start - ca.DM([1.0, np.pi, 0.0, 0.0]))
    high = [-x for x in low]
    options = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-10}
    program: Any = {"x": ca.vertcat(*unknowns), "f": effort, "g": ca.vertcat(*rows)}
    solver = ca.nlpsol("swing_up", "ipopt", program, options)
    return float(solver(x0=guess, lbx=low, ubx=high, lbg=0.0, ubg=0.0)["f"])


def main() -> None:
    """Print the table."""
    problems: dict[str, tuple[Any, float]] = {
        **EXACT, "cart-pole": ("cart-pole", np.nan), "cart-pole by gauss": (BY_GAUSS, np.nan),
    }  # fmt: skip
    heads = (
        ("optimum", 19), ("objective", 19), ("error", 8), ("bar", 8), ("bar/error", 9), ("bar/optimum", 11), ("s", 6),
    )  # fmt: skip
    print(f"{'problem':<24} " + " ".join(f"{head:>{width}}" for head, width in heads))
    for name, (spec, exact) in problems.items():
        if any(word not in name for word in sys.argv[1:]):
            continue
        exact = swing_up(5, 80) if np.isnan(exact) else exact
        begin = time.process_time()
        run = mbdkit.predict(spec)
        seconds, error, bar = time.process_time() - begin, abs(run.objective - exact), run.objective_error
        ratio = f"{bar / error:9.3g}" if error else f"{'-':>9}"
        print(
            f"{name:<24} {exact:19.15g} {run.objective:19.15g} {error:8.1e} {bar:8.1e} {ratio} {bar / exact:11.2e} "
            f"{seconds:6.2f}"
        )


if __name__ == "__main__":
    main()
