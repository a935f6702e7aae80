"""Parts take few names from the insides of other parts, and ever fewer."""

from __future__ import annotations

from tests.names_between_parts import BUDGET, names_between


def test_parts_take_as_many_names_from_each_other_as_their_budget_says() -> None:
    budget = dict(line.rsplit(" ", 1) for line in BUDGET.read_text(encoding="utf-8").splitlines())
    counts = {pair: str(len(names)) for pair, names in names_between().items()}
    hint = "use the door of the other part (`python -m tests.names_between_parts --names` lists the names)"
    assert counts == budget, f"{hint}; where there are fewer, lower the budget"


def test_parts_take_at_most_a_hundred_names_from_each_other() -> None:
    assert len(set().union(*names_between().values())) <= 100
