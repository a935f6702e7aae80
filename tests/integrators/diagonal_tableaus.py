"""Diagonally implicit tableaus of the literature."""

from __future__ import annotations

from mbdkit import ButcherTableau

G, K = "(2 - sqrt(2))/2", "(3 + sqrt(3))/6"


TABLEAUS = {
    # Alexander (1977), SIAM J. Numer. Anal. 14, two stages, stiffly accurate, L-stable
    "alexander-2": ButcherTableau("alexander-2", [[G], ["sqrt(2)/2", G]], ["sqrt(2)/2", G], [G, 1], 2),
    # Crouzeix (1975), thesis, and Norsett (1974): two stages, A-stable
    "crouzeix-3": ButcherTableau(
        "crouzeix-3", [[K], ["-sqrt(3)/3", K]], ["1/2", "1/2"], [K, "(3 - sqrt(3))/6"], 3
    ),
    # Hairer and Wanner (1996), table IV.6.5: five stages, L-stable
    "sdirk-4": ButcherTableau(
        "sdirk-4",
        [
            ["1/4"],
            ["1/2", "1/4"],
            ["17/50", "-1/25", "1/4"],
            ["371/1360", "-137/2720", "15/544", "1/4"],
            ["25/24", "-49/48", "125/16", "-85/12", "1/4"],
        ],
        ["25/24", "-49/48", "125/16", "-85/12", "1/4"],
        ["1/4", "3/4", "11/20", "1/2", "1"],
        4,
    ),
    # Bank et al. (1985), as a tableau with an explicit first stage: Hosea and Shampine (1996)
    "tr-bdf2": ButcherTableau(
        "tr-bdf2",
        [[0], [G, G], ["sqrt(2)/4", "sqrt(2)/4", G]],
        ["sqrt(2)/4", "sqrt(2)/4", G],
        [0, "2 - sqrt(2)", 1],
        2,
    ),
}  # fmt: skip
