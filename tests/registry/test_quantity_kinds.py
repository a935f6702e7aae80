"""A group of the archive from a plugin is recorded, exported, measured and watched, and read without the plugin."""

from __future__ import annotations

import json
import shutil

import h5py
import numpy as np
import pytest

import mbdkit
from mbdkit.archive.reader import load
from tests.installing import install_module, python

pytestmark = pytest.mark.end_to_end

PLUGIN = """
from mbdkit.plugin import QuantityKind, Target, hookimpl

@hookimpl
def mbdkit_items():
    return [QuantityKind(name="wear", summary="Friction power and its share.", word="wear", of="contacts",
                         target=Target("wear_kit.kind:WEAR"))]
"""
KIND = """
from mbdkit.plugin import Array, Chart, Recorded, name_array, quantity_group
from mbdkit_contact.quantities import contacts_in

def values(states):
    found = states.of(contacts_in)
    return {"power": -found["friction_force"] * found["slip"]}

WEAR = quantity_group(
    "wear",
    Array("time", ("time",), "s", "time of the recorded row"),
    name_array("pair", "pair", "name of the contact", lambda names: names.names_of("contacts")),
    Recorded("power", ("time", "pair"), "W", "power that friction dissipates", take=lambda s: s.of(values)["power"],
             charts=(Chart("wear", "Wear", "Power that friction dissipates.", "power", "W"),)),
    Recorded("rate", ("time", "pair"), "m/s", "slip, without its sign", take=lambda s: abs(s.of(contacts_in)["slip"])),
    optional=True, word="wear", one="worn pair", example="power", axis="pair", is_optional=True,
)
"""
MASS, FRICTION, G, SPEED, STOP = 2.0, 0.3, 9.81, 1.5, 0.2
BLOCK = {"mass": MASS, "position": [0.0, 0.1], "velocity": [SPEED, 0.0]}
COMPLIANCE = {"law": "linear", "stiffness": 1e6, "dissipation": 1e3, "transition_speed": 1e-4}
FLOOR = {"bodies": ["ground", "block"], "shapes": [{"line": {"normal": [0, 1]}}, {"circle": {"radius": 0.1}}]}
SPEC = {
    "mbdkit": 1,
    "model": {
        "name": "mechanism",
        "bodies": {"block": BLOCK},
        "contacts": {"floor": {**FLOOR, "friction": FRICTION, "compliance": COMPLIANCE}},
    },
    "integrator": {"name": "dop853", "adaptive": True},
    "time": {"end": STOP, "step": 0.005},
    "measures": {"lost": "integral(wear.floor.power)", "slowest": "min(wear.floor.rate)"},
    "events": {"half": {"when": "wear.floor.rate - 1.0"}},
}


def of_kit(here, *arguments, is_installed=True):
    done = python(*arguments, path=(here / "site",) if is_installed else (), cwd=here)
    assert done.returncode == 0, done.stderr
    return done


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return a folder with a run, its table and its report, and the folder of the plugin."""
    here = tmp_path_factory.mktemp("made")
    install_module(here / "site", "wear-kit", PLUGIN, version="1.4")
    shutil.move(here / "site" / "wear_kit.py", here / "site" / "wear_plugin.py")
    (here / "site" / "wear_kit").mkdir()
    shutil.move(here / "site" / "wear_plugin.py", here / "site" / "wear_kit" / "__init__.py")
    (here / "site" / "wear_kit" / "kind.py").write_text(KIND)
    (here / "spec.json").write_text(json.dumps(SPEC))
    of_kit(here, "-m", "mbdkit", "run", "spec.json")
    of_kit(here, "-m", "mbdkit", "archive", "export", "spec.h5", "--to", "csv", "-o", "with")
    of_kit(here, "-m", "mbdkit", "report", "spec.h5", "-o", "spec.html")
    return here


def test_columns_measures_and_events_have_the_values_of_a_sliding_block(made):
    # expected: under the friction force mu m g, the speed is v0 - mu g t, and mu m g times the distance is lost
    with h5py.File(made / "spec.h5") as file:
        time, power, rate = (file[f"wear/{name}"][:] for name in ("time", "power", "rate"))
        (event,) = file["events/time"][:]
    speed = SPEED - FRICTION * G * time
    settled = time > 0.05  # the contact, which carries no weight at first, is at rest
    np.testing.assert_allclose(rate[settled, 0], speed[settled], rtol=0.01)
    np.testing.assert_allclose(power[settled, 0], FRICTION * MASS * G * speed[settled], rtol=0.02)
    lost = 0.5 * MASS * (SPEED**2 - (SPEED - FRICTION * G * STOP) ** 2)
    with load(made / "spec.h5") as run:
        assert run.measures["lost"] == pytest.approx(lost, rel=0.01)
        assert run.measures["slowest"] == pytest.approx(SPEED - FRICTION * G * STOP, rel=0.01)
    assert event == pytest.approx(0.5 / (FRICTION * G), rel=0.01)


def test_histories_tables_and_reports_have_the_columns(made):
    program = """
import mbdkit
run = mbdkit.load("spec.h5")
pair = run.wear["floor"]
print(type(pair).__name__, list(run.wear), float(pair.power[-1]) == float(run.array("wear/power")[-1, 0]))
print("wear" in dir(run), list(run.to_frame("wear").columns))
"""
    told = of_kit(made, "-c", program).stdout.splitlines()
    assert told[0] == "WornPairHistory ['floor'] True"
    assert told[1] == "True ['floor.power', 'floor.rate']"
    assert (made / "with" / "wear.csv").read_text().splitlines()[0].startswith("time")
    assert "Power that friction dissipates." in (made / "spec.html").read_text(encoding="utf-8")


def test_runs_without_such_elements_have_the_same_hash_and_do_not_import_the_kind(made):
    program = """
import sys, mbdkit
run = mbdkit.run("pendulum", time={"end": 0.1, "step": 0.01})
print(run.data_sha256, "wear" in run.kinds, len(run.wear), "quantities" in run.provenance)
"""
    importing = "import sys, mbdkit; mbdkit.run('pendulum'); print('wear_kit.kind' in sys.modules)"
    alone = "import mbdkit; print(mbdkit.run('pendulum', time={'end': 0.1, 'step': 0.01}).data_sha256)"
    sha256 = of_kit(made, "-c", alone, is_installed=False).stdout.strip()
    assert of_kit(made, "-c", program).stdout.split() == [sha256, "False", "0", "False"]
    assert of_kit(made, "-c", importing).stdout.split() == ["False"]


def test_an_archive_is_read_without_the_plugin_and_one_sentence_names_it(made):
    of = {"is_installed": False}
    program = """
import mbdkit
run = mbdkit.load("spec.h5")
print(run.array("wear/power").shape[1], list(run.to_frame("wear").columns), run.to_frame("wear").attrs["units"])
print(run.to_xarray()["wear"]["power"].dims, run.dataset("wear/rate").attrs["units"])
"""
    done = of_kit(made, "-c", program, **of)
    assert done.stdout.splitlines() == [
        "1 ['floor.power', 'floor.rate'] {'time': 's', 'floor.power': 'W', 'floor.rate': 'm/s'}",
        "('time', 'pair') m/s",
    ]
    (sentence,) = done.stderr.splitlines()
    assert "the group wear is read as the file describes it" in sentence
    assert "wear-kit 1.4" in sentence
    of_kit(made, "-m", "mbdkit", "archive", "export", "spec.h5", "--to", "csv", "-o", "without", **of)
    assert (made / "without" / "wear.csv").read_bytes() == (made / "with" / "wear.csv").read_bytes()
    assert "sound" in of_kit(made, "-m", "mbdkit", "archive", "check", "spec.h5", **of).stdout
    again = python("-m", "mbdkit", "rerun", "spec.h5", path=(), cwd=made)
    assert again.returncode == 2
    assert "the quantity 'wear-kit:wear' is not installed here" in again.stderr


def test_histories_of_a_part_that_is_left_out_are_read_as_the_file_describes_them(tmp_path):
    mbdkit.run("elbow-curl", archive=tmp_path / "curl.h5", time={"end": 0.05, "step": 0.01}).close()
    with mbdkit.load(tmp_path / "curl.h5") as run:
        force, columns = run.muscles["biceps"].force.tolist(), list(run.to_frame("muscles").columns)
    program = """
import json, sys, mbdkit
run = mbdkit.load("curl.h5")
print(json.dumps([run.muscles["biceps"].force.tolist(), sorted(run.to_frame("muscles").columns), len(run.loads)]))
print(any(name.startswith("mbdkit_biomech") for name in sys.modules))
"""
    done = python("-c", program, path=(), cwd=tmp_path, MBDKIT_DISABLE_PLUGINS="mbdkit/biomech")
    first, second = done.stdout.splitlines()
    assert json.loads(first) == [force, sorted(columns), 0]
    assert second == "False"
    (sentence,) = done.stderr.splitlines()
    assert sentence.endswith("it needs mbdkit-biomech, a part of mbdkit that is not installed")


@pytest.mark.parametrize(
    ("before", "after", "sentence"),
    [
        (", is_optional=True", "", "has arrays that are not optional, as those of plugins must be"),
        ('word="wear"', 'word="worn"', "the word of its kind is 'worn', not 'wear'"),
        (
            'take=lambda s: abs(s.of(contacts_in)["slip"])',
            "take=lambda s: s.time",
            "returned wear/rate with the shape (1,), not",
        ),
        ('take=lambda s: abs(s.of(contacts_in)["slip"])', "take=lambda s: s.nothing", "has no attribute 'nothing'"),
    ],
)
def test_a_wrong_kind_is_refused_in_one_sentence(before, after, sentence, made, tmp_path):
    shutil.copytree(made / "site", tmp_path / "site")
    code = KIND.replace(before, after)
    assert code != KIND
    (tmp_path / "site" / "wear_kit" / "kind.py").write_text(code)
    program = f"""
import mbdkit
try:
    run = mbdkit.run({ {key: value for key, value in SPEC.items() if key not in ("measures", "events")}!r})
    print(run.status_reason)
except mbdkit.MbdkitError as error:
    print(error)
"""
    told = python("-c", program, path=(tmp_path / "site",), cwd=tmp_path)
    assert told.returncode == 0, told.stderr
    assert "wear-kit" in told.stdout
    assert sentence in told.stdout


def test_a_group_of_mbdkit_is_not_replaced(made, tmp_path):
    shutil.copytree(made / "site", tmp_path / "site")
    plugin = tmp_path / "site" / "wear_kit" / "__init__.py"
    plugin.write_text(PLUGIN.replace('word="wear"', 'word="wear", group="muscles"'))
    done = python(
        "-c", "import mbdkit; print(mbdkit.run('elbow-curl').muscles)", path=(tmp_path / "site",), cwd=tmp_path
    )
    assert done.stdout.strip() == "<3 of muscle: biceps, brachialis, triceps>"
    assert "the group 'muscles' belongs to 'mbdkit:muscles', so 'wear-kit:wear' is not used" in done.stderr


@pytest.mark.parametrize(("key", "builder"), [("muscles", ""), ("bodies", ""), ("ropes", "body"), ("ropes", "muscle")])
def test_a_kind_of_elements_does_not_replace_names_of_mechanisms(key, builder, tmp_path):
    code = f"""
from mbdkit.plugin import Element, ElementKind, Target, hookimpl

class Rope(Element):
    pass

@hookimpl
def mbdkit_items():
    return [ElementKind(name="rope", summary="Ropes.", key_in_model={key!r}, builder={builder!r},
                        model=Target("rope_kit:Rope"))]
"""
    install_module(tmp_path / "site", "rope-kit", code)
    done = python("-m", "mbdkit", "validate", "elbow-curl", path=(tmp_path / "site",), cwd=tmp_path)
    assert "this spec is valid" in done.stdout
    assert (
        f"mechanisms have '{builder or key}' already, so the kind of elements 'rope-kit:rope' is not used"
        in done.stderr
    )
