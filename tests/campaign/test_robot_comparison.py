"""The comparison with MuJoCo sees effects that an importer leaves out, and nothing where it leaves out none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from .robot_comparison import differences

mujoco = pytest.importorskip("mujoco")
pytest.importorskip("mbdkit_robots")

PENDULUM = """<mujoco><option><flag contact="disable"/></option><worldbody><body name="b"><joint name="j" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -.5" size=".03"/></body></worldbody>
<actuator><motor joint="j"/></actuator></mujoco>"""
FREE = """<mujoco><worldbody><body name="b"><freejoint/><geom type="box" size=".1 .1 .2"/><body name="c" pos=".1 .2 0">
<joint name="j" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -.4" size=".03"/></body>
</body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (PENDULUM, ""),
        (PENDULUM.replace("<motor", '<motor armature="0.5"'), "mass matrix"),
        (PENDULUM.replace("<motor", '<motor ctrlrange="1 2"'), "forces"),
        (FREE, "leaves the plane"),
    ],
)
def test_the_comparison_sees_what_is_left_out(tmp_path: Path, text: str, what: str) -> None:
    file = tmp_path / "model.xml"
    file.write_text(text)
    problems = differences(mujoco.MjModel.from_xml_string(text), "mjcf", str(file), np.random.default_rng(1))
    assert [what in problem for problem in problems] == [True] * bool(what)
