"""The command that compares a knee force with the one that an implant measured, on files of a person who is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.inverse_dynamics.c3d_files import Convention, c3d_bytes
from tests.inverse_dynamics.force_plates import plate

import mbdkit
from tests.benchmarks.knee_challenge import compare, largest_peak, main
from tests.benchmarks.person_markers import Array, Walker, in_laboratory

NAMES = {"RASI": "RAsis", "LASI": "LAsis", "RPSI": "RPsis", "LPSI": "LPsis"}
OF_LEGS = {"THU": "ThighSuperior", "THF": "ThighInferior", "THL": "ThighLateral", "SHU": "ShankSuperior",
           "SHF": "ShankInferior", "SHL": "ShankLateral", "HEE": "Heel", "TOE": "Toe", "MT1": "MidfootMedial",
           "MT5": "MidfootLateral"}  # fmt: skip
CELL = 50.0
"""Load of each cell [lbf]."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Files of a trial in the form of the challenge, with a constant force in the knee."""
    pytest.importorskip("ezc3d", reason="ezc3d is not installed: pip install mbdkit[c3d]")
    walker = Walker.of_example(2, slice(24, 230), size=1.66 / 1.8)
    own = {NAMES.get(name) or name[0] + OF_LEGS.get(name[1:], name[1:]): at for name, at in walker.markers().items()}
    own["Sacral"] = (own["RPsis"] + own["LPsis"]) / 2
    for side in "RL":
        own[f"{side}Hindfoot"] = (own[f"{side}Heel"] + own[f"{side}MidfootLateral"]) / 2
        for name in ("KNE", "KNM", "ANK", "ANM"):  # the trials have no such markers
            del own[side + name]
    plates, vertical = [], np.zeros(len(walker.time))
    for number, (force, point) in enumerate(walker.plates()):
        at = 1000 * np.nan_to_num(in_laboratory(point, np.pi))
        middle = np.mean(at[force[:, 1] > 0], axis=0)
        at[force[:, 1] <= 0] = middle
        plates.append(plate(2, in_laboratory(force, np.pi), at, 0 * force, middle))
        vertical = force[:, 1] if number == 0 else vertical
    rate = 1.0 / float(walker.time[1] - walker.time[0])
    markers = {name: 1000 * in_laboratory(at, np.pi) for name, at in own.items()}
    (tmp_path / "trials").mkdir()
    (tmp_path / "trials" / "jw_ngait_og3.c3d").write_bytes(c3d_bytes(markers, rate, Convention(), plates))
    write_forces(
        tmp_path, np.column_stack([walker.time, *[np.full(len(vertical), CELL)] * 4, 0 * vertical, vertical / 1995])
    )
    return tmp_path


def write_forces(folder: Path, rows: Array) -> None:
    text = "\n".join(",".join([*(f"{one:.6f}" for one in row), ""]) for row in rows)
    (folder / "trials" / "jw_ngait_og3_knee_forces.csv").write_text(f"Time(sec),PM,AM,AL,PL,GON,GRFz\n{text}\n")


@pytest.mark.slow
def test_forces_in_pounds_are_compared_with_compression_along_the_shank_in_the_stances(folder: Path) -> None:
    archive = folder / "trial.h5"
    lines = compare(folder, archive=archive, uncertainty="none")
    with mbdkit.load(archive) as run:
        force, angle = run.joints["knee"].reaction_force, run.bodies["shank"].angle
        compression = -np.sum(force * np.column_stack([-np.sin(angle), np.cos(angle)]), axis=1)
        begin, end = (float(lines[0].split()[place]) for place in (4, 6))
        compression = compression[(run.time > begin - 0.001) & (run.time < end + 0.001)]
    row = next(line for line in lines if line.startswith("all"))
    assert float(row.split()[4]) == pytest.approx(np.mean(compression) - 4 * CELL * 4.4482216, abs=1.0)
    assert 1500 < np.max(compression) < 4000
    assert [line.split()[0:2] for line in lines if line.startswith("stance") and "," not in line] == [
        ["stance", "1"],
        ["stance", "2"],
    ]
    assert sum(line.startswith("swing") for line in lines) == 1


def test_a_peak_is_no_value_at_the_end_of_a_half() -> None:
    force = np.array([0.0, 700, 1327, 1100, 900, 1367, 1597, 800, 0])
    assert [largest_peak(force, half) for half in (slice(0, 6), slice(6, 9))] == [2, 6]
    assert largest_peak(force, slice(3, 6)) == 5


def test_files_that_are_absent_or_of_another_trial_are_refused_in_a_sentence(folder: Path, tmp_path: Path) -> None:
    def refusal(*words: str) -> str:
        with pytest.raises(SystemExit) as caught:
            main([str(word) for word in words])
        return str(caught.value.code)

    assert "is not a folder" in refusal(str(tmp_path / "absent"))
    assert "has no file other.c3d" in refusal(str(folder), "--trial", "other")
    table = folder / "trials" / "jw_ngait_og3_knee_forces.csv"
    rows = np.array([line.split(",")[:7] for line in table.read_text().splitlines()[1:]], dtype=float)
    write_forces(folder, rows[:-1])
    assert "rows, but jw_ngait_og3.c3d has" in refusal(str(folder))
    write_forces(folder, np.roll(rows, 20, axis=0))
    assert "its rows are not the frames" in refusal(str(folder))
    table.write_text("a,b\n1,2\n")
    assert "columns PM, AM, AL, PL" in refusal(str(folder))
    table.unlink()
    assert "has no file jw_ngait_og3_knee_forces.csv" in refusal(str(folder))
