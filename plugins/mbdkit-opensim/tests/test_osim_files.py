"""Models in several files, and sections `defaults` that are large or refer to each other."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import osim_texts as osim
import pytest

from mbdkit import Mechanism, SpecError
from mbdkit_opensim.building import build_mechanism

ROD = osim.body("rod", 2.0, (0, -0.5, 0), 0.3)
PIN = osim.joint("PinJoint", "pin", "ground", "rod", "swing=0.3")


def built(folder: Path, text: str, **files: str) -> Mechanism:
    (folder / "model.osim").write_text(text)
    for name, content in files.items():
        (folder / f"{name}.xml").write_text(content)
    return build_mechanism(str(folder / "model.osim"), {}, {}, muscles=False)


def document(content: str, version: int = 40500) -> str:
    return f'<OpenSimDocument Version="{version}">{content}</OpenSimDocument>'


def test_sets_and_objects_are_read_from_their_files(tmp_path: Path) -> None:
    whole = built(tmp_path, osim.document([ROD], [PIN]))
    text = osim.document(['<Body name="rod" file="rod.xml"/>'], [PIN])
    apart = built(tmp_path, text, rod=document(ROD))
    assert apart.to_spec() == whole.to_spec()
    bodies = document('<BodySet><objects><Body file="rod.xml"/></objects></BodySet>')
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "bodies.xml").write_text(bodies)
    (tmp_path / "parts" / "rod.xml").write_text(document(ROD))
    start, end = text.index("<BodySet"), text.index("</BodySet>") + len("</BodySet>")
    apart = built(tmp_path, f'{text[:start]}<BodySet file="parts/bodies.xml"/>{text[end:]}')
    assert apart.to_spec() == whole.to_spec()


def test_forces_in_a_file_of_their_own_are_not_passed_over(tmp_path: Path) -> None:
    spring = '<ForceSet><objects><CoordinateLimitForce name="stop"/></objects></ForceSet>'
    with_forces = osim.document([ROD], [PIN], more='<ForceSet file="forces.xml"/>')
    m = built(tmp_path, with_forces, forces=document(spring))
    assert m.to_spec() == built(tmp_path, osim.document([ROD], [PIN], more=spring)).to_spec()
    assert m.left_out == built(tmp_path, osim.document([ROD], [PIN], more=spring)).left_out != []


@pytest.mark.parametrize(
    ("file", "content", "reason"),
    [
        ("absent.xml", "", "No such file"),
        ("../forces.xml", "", "which is not in the folder of the model"),
        ("/etc/hostname", "", "which is not in the folder of the model"),
        ("model.osim", "", "which refers to itself"),
        ("forces.xml", document('<ForceSet file="forces.xml"/>'), "which refers to itself"),
        ("forces.xml", document("<BodySet/>"), "which contains no <ForceSet>"),
        ("forces.xml", document("<ForceSet/>", 30000), "of another format"),
        ("forces.xml", "<ForceSet/>", "is not a file of OpenSim"),
        ("forces.xml", '<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "document type definition"),
        ("forces.xml", "no XML", "is not XML"),
    ],
)
def test_files_of_parts_are_refused_by_name(tmp_path: Path, file: str, content: str, reason: str) -> None:
    text = osim.document([ROD], [PIN], more=f'<ForceSet file="{file}"/>')
    with pytest.raises(SpecError, match=reason):
        built(tmp_path, text, **({"forces": content} if content else {}))


def test_the_size_of_all_files_together_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbdkit_opensim.osim_document.LARGEST", 20_000)
    rods = '<Body file="rod.xml"/>' * 50
    with pytest.raises(SpecError, match=r"model\.osim are larger than .* MiB together"):
        built(tmp_path, osim.document([rods], [PIN]), rod=document(ROD + " " * 2000))


def test_thousands_of_defaults_take_a_time_proportional_to_their_number(tmp_path: Path) -> None:
    def seconds(count: int) -> float:
        defaults = "".join(f"<Kind{k}><value/></Kind{k}>" for k in range(count))
        begin = time.process_time()
        built(tmp_path, osim.document([ROD], [PIN], more=f"<defaults>{defaults}</defaults>"))
        return time.process_time() - begin

    assert min(seconds(8000) for _ in range(2)) < 8.0 * min(seconds(2000) for _ in range(2)) + 0.05


@pytest.mark.parametrize(
    "defaults",
    [
        "".join(f"<T{k}><T{k - 1}/><T{k - 1}/></T{k}>" for k in range(1, 60)),  # 2^59 elements
        "".join(f"<Coordinate><property{k}/></Coordinate>" for k in range(3000)),
    ],
)
def test_defaults_that_complete_each_other_without_end_are_refused(tmp_path: Path, defaults: str) -> None:
    with pytest.raises(SpecError, match="more than 1000000 components"):
        built(tmp_path, osim.document([ROD], [PIN], more=f"<defaults>{defaults}</defaults>"))


def test_defaults_of_two_types_may_contain_each_other(tmp_path: Path) -> None:
    defaults = "<Knot><Loop/></Knot><Loop><Knot/></Loop>"
    m = built(tmp_path, osim.document([ROD], [PIN], more=f"<defaults>{defaults}</defaults>"))
    assert np.isclose(m.bodies["rod"].mass, 2.0)


def test_messages_do_not_repeat_long_names(tmp_path: Path) -> None:
    body = ROD.replace('name="rod"', f'name="{"r" * 100_000}"').replace("2.0", "nan")
    with pytest.raises(SpecError) as caught:
        built(tmp_path, osim.document([body], [PIN]))
    assert len(str(caught.value)) < 1200
