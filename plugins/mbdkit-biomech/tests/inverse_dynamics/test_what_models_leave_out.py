"""What a model says that it leaves out is a doubt of inverse dynamics."""

from __future__ import annotations

import re

import mbdkit
from mbdkit.guide.pages import find_page
from mbdkit_biomech.inverse_dynamics.criteria.model_criteria import mechanism_doubts


def test_a_model_says_what_it_leaves_out_as_printed() -> None:
    section = find_page("plugins").text.split("# A model in twenty lines\n", 1)[1].split("\n#", 1)[0]
    m = mbdkit.Mechanism()
    exec(re.findall(r"^```python\n(.*?)^```", section, flags=re.MULTILINE | re.DOTALL)[1], {"m": m})
    assert [one.criterion for one in mechanism_doubts(m)] == ["left-out"]
    assert len(m.warnings) == 1
