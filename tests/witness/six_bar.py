"""A six-bar linkage and its four-bar linkage."""

from __future__ import annotations

import numpy as np

from tests.witness.dyads import Dyad, Link, Linkage

GROUND = {"A": 0j, "D": 1.0 + 0.1j}


CRANK = Link(2.0, 0.05, {"A": -0.15 + 0.02j, "B": 0.2 - 0.01j})


FOUR_BAR = Linkage(
    ground=GROUND,
    links={
        "crank": CRANK,
        "coupler": Link(1.5, 0.12, {"B": -0.4 - 0.1j, "C": 0.5 - 0.1j}),
        "follower": Link(1.2, 0.08, {"D": -0.1 - 0.4j, "C": 0.05 + 0.4j}),
    },
    dyads=(Dyad("coupler", "follower", "crank", "ground", ("B", "D", "C")),),
    torque=lambda time: 4.0 * np.sin(3 * time),
    torque_text="4*sin(3*t)",
)


#: Watt's chain with a binary link fixed: coupler and follower have three pins each, and carry a dyad between them.
SIX_BAR = Linkage(
    ground=GROUND,
    links={
        "crank": CRANK,
        "coupler": Link(1.5, 0.12, {"B": -0.4 - 0.1j, "C": 0.5 - 0.1j, "E": 0.1 + 0.4j}),
        "follower": Link(1.2, 0.08, {"D": -0.1 - 0.4j, "C": 0.05 + 0.4j, "F": 0.45 + 0.2j}),
        "link": Link(0.8, 0.03, {"E": -0.35 + 0j, "G": 0.4 + 0.05j}),
        "rod": Link(0.6, 0.02, {"F": -0.3 + 0j, "G": 0.35 + 0.03j}),
    },
    dyads=(
        Dyad("coupler", "follower", "crank", "ground", ("B", "D", "C")),
        Dyad("link", "rod", "coupler", "follower", ("E", "F", "G")),
    ),
    torque=lambda time: 4.0 * np.sin(3 * time),
    torque_text="4*sin(3*t)",
)


PHI, RATE, END = 0.5, 7.0, 2.0
