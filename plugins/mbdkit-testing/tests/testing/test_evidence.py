"""Evidence of plugins: what was verified is known wherever the plugin is used, and so is what has changed since."""

from __future__ import annotations

import importlib
import json
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import pytest
from pydantic import BaseModel

import mbdkit
from mbdkit.registry.catalogue import Origin, Registered
from mbdkit.registry.items import IntegratorPlugin
from mbdkit.registry.manager import registry
from mbdkit.runs import method_evidence, run_criteria
from mbdkit.runs.method_evidence import FILE, code_digest, digest_of, evidence_file, evidence_of, read_records, seal_of
from mbdkit.spec import load_spec
from mbdkit_testing.check_result import Report, failed, passed
from mbdkit_testing.recorded_evidence import record_of, write_records
from tests.first_party import ROOT
from tests.installing import announce, install_module, python

CODE = "WEIGHT = 0.25\n"
HEUN = """
import mbdkit
from pydantic import BaseModel
HEUN = mbdkit.ButcherTableau(
    "heun", a=[[], ["1/3"], [0, "2/3"]], b=["1/4", 0, "3/4"], c=[0, "1/3", "2/3"], order=3, reference="Heun (1900)")
@mbdkit.hookimpl
def mbdkit_integrators():
    return [mbdkit.IntegratorPlugin("heun", "Heun's method.", BaseModel,
            create=lambda options: mbdkit.ExplicitRungeKutta(HEUN), claims=lambda options: mbdkit.Claims(order=3))]
"""
SPEC = {"mbdkit": 1, "model": {"name": "double-pendulum"}, "integrator": {"name": "heun"}}
SPEC |= {"time": {"end": 0.5, "step": 0.005}}


class StageOptions(BaseModel):
    """Options of the method under test."""

    stages: int = 2
    rtol: float = 1e-6
    max_step: float = 1.0


Made = Callable[..., Registered]


def forget() -> None:
    method_evidence.forget()
    code_digest.cache_clear()


@pytest.fixture
def method(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Made]:
    """Give a function that returns a method of a package `spinner` in the temporary folder."""
    package = tmp_path / "spinner"
    package.mkdir()
    (package / "__init__.py").write_text(CODE)
    monkeypatch.syspath_prepend(tmp_path)
    importlib.import_module("spinner")

    def made(version: str = "1.0") -> Registered:
        plugin: Any = IntegratorPlugin("spin", "It spins.", StageOptions, create=print, claims=print)
        return Registered("integrator", plugin, Origin("mbdkit-spinner", version, "main = spinner"))

    yield made
    del sys.modules["spinner"]
    forget()


def recorded(item: Registered, *, fails: bool = False, **options: Any) -> Path:
    """Record a verification with one check, and return the file."""
    result = failed("its order is 2", measured=2.0123456) if fails else passed(measured=3.0123456)
    results = (replace(result, name="geometry.energy"),)
    report = Report(item.id, "integrator", "1.0", options, {"order": 3, "adaptive": False}, results)
    write_records([record_of(item, report, quick=True)], path := evidence_file(item.origin))
    forget()
    return path


def test_evidence_says_what_was_verified_with_which_options(method: Made) -> None:
    item = method()
    assert evidence_of(item).word == "never"
    path = recorded(item)
    assert path.name == FILE
    recorded(item, fails=True, stages=3)
    words = {stages: evidence_of(item, StageOptions(stages=stages)).word for stages in (2, 3, 4)}
    assert words == {2: "verified", 3: "failed", 4: "never"}
    assert evidence_of(item, StageOptions(rtol=1e-9, max_step=0.1)).word == "verified"  # the checks vary these
    assert evidence_of(item).word == "failed"  # the worst one
    failing, first = read_records(path)  # in the order of their options
    assert first["checks"] == {"geometry.energy": {"outcome": "pass", "figures": {"measured": 3.01}}}
    assert (first["claims"], failing["failed"]) == ({"order": 3}, ["geometry.energy"])


def edit_code(package: Path) -> None:
    (package / "__init__.py").write_text(CODE.replace("25", "26"))


def add_data(package: Path) -> None:
    (package / "weights.txt").write_text("0.25")


def edit_figure(package: Path) -> None:
    (package / FILE).write_text((package / FILE).read_text().replace("3.01", "4.01"))


def damage(package: Path) -> None:
    (package / FILE).write_text((package / FILE).read_text()[:200])


@pytest.mark.parametrize("change", [edit_code, add_data, edit_figure, damage], ids=lambda change: change.__name__)
def test_what_has_changed_since_is_no_evidence(method: Made, change: Callable[[Path], None]) -> None:
    item = method()
    path = recorded(item)
    assert evidence_of(item).word == "verified"
    change(path.parent)
    forget()
    assert evidence_of(item).word == "changed since"


def test_another_version_is_no_evidence(method: Made) -> None:
    recorded(method())
    assert evidence_of(method("1.1")).why.startswith("version 1.0 was checked by mbdkit")


def test_evidence_covers_every_module_of_a_distribution_and_names_what_it_requires(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The method of `heun-kit` takes its weights from a second module, from a namespace, and from `weight-table`."""
    folder, parts = tmp_path / "heun_space" / "heun_part", ("heun_kit.py", "heun_core.py", "heun_space/heun_part/a.py")
    folder.mkdir(parents=True)
    announce(tmp_path, "heun-kit", {"main": "heun_kit"}, requires=("weight-table>=1", "other; extra == 'test'"))
    announce(tmp_path, "weight-table", {})
    for part in parts:
        (tmp_path / part).write_text(CODE)
    (tmp_path / "heun_kit-1.0.dist-info" / "RECORD").write_text("".join(f"{part},,\n" for part in parts))
    monkeypatch.syspath_prepend(tmp_path)
    importlib.import_module("heun_kit")
    plugin: Any = IntegratorPlugin("heun", "Heun.", StageOptions, create=print, claims=print)
    item = Registered("integrator", plugin, Origin("heun-kit", "1.0", "main = heun_kit"))
    recorded(item)
    assert evidence_of(item).word == "verified"
    assert "since then" not in evidence_of(item).why
    (tmp_path / "weight_table-1.0.dist-info").rename(tmp_path / "weight_table-1.1.dist-info")
    forget()
    assert str(evidence_of(item)).endswith("; since then, installed versions changed: weight-table from 1.0 to 1.1")
    for part in parts:
        (tmp_path / part).write_text(CODE.replace("25", "26"))
        forget()
        assert evidence_of(item).word == "changed since", part
        (tmp_path / part).write_text(CODE)
    del sys.modules["heun_kit"]
    forget()


@pytest.mark.parametrize(("version", "word"), [("1.0.7", "verified"), ("1.1.0", "changed since")])
def test_evidence_holds_for_patches_of_mbdkit_but_not_for_another_minor_version(
    method: Made, monkeypatch: pytest.MonkeyPatch, version: str, word: str
) -> None:
    recorded(method())
    monkeypatch.setattr(method_evidence, "own_version", lambda: version)
    assert evidence_of(method()).word == word


def test_a_record_without_checks_verifies_nothing(method: Made) -> None:
    path = recorded(method())
    record: dict[str, Any] = {**read_records(path)[0], "checks": {}}
    write_records([record | {"sha256": seal_of(record)}], path)
    forget()
    assert evidence_of(method()).word == "failed"


def test_evidence_depends_neither_on_line_ends_nor_on_what_python_and_editors_leave(method: Made) -> None:
    item = method()
    package = recorded(item).parent
    (package / "__init__.py").write_bytes(CODE.replace("\n", "\r\n").encode())
    for name in ("__pycache__", ".ruff_cache"):
        (package / name).mkdir(exist_ok=True)
        (package / name / "more.pyc").write_text("")
    (package / "__init__.py~").write_text("")
    forget()
    assert evidence_of(item).word == "verified"


def test_a_method_of_an_edited_checkout_is_not_doubted(monkeypatch: pytest.MonkeyPatch) -> None:
    item = registry().get("integrator", "rk4")
    evidence_of(item)
    monkeypatch.setattr(method_evidence, "code_digest", lambda origin: "other")
    method_evidence.forget()
    assert evidence_of(item).word == "checkout"
    spec = load_spec("pendulum")
    assert not [*run_criteria.method_evidence(spec, ())]
    method_evidence.forget()


DISTRIBUTIONS = sorted(ROOT.glob("plugins/*/pyproject.toml"))


@pytest.mark.parametrize("project", DISTRIBUTIONS, ids=lambda path: path.parent.name)
def test_the_evidence_of_a_distribution_is_of_its_code(project: Path) -> None:
    """`mbdkit plugins verify DISTRIBUTION --record` renews it."""
    known = tomllib.loads(project.read_text(encoding="utf-8"))["project"]
    package = project.parent / "src" / project.parent.name.replace("-", "_")
    records = read_records(package / FILE)
    assert records
    for record in records:
        assert record["digest"] == digest_of(package)
        assert record["sha256"] == seal_of(record)
        assert (record["distribution"], record["version"]) == (known["name"], known["version"])
        assert record["verified"]


@pytest.mark.end_to_end
def test_a_changed_digit_of_a_verified_plugin_is_said_everywhere_and_named_as_the_cause(tmp_path: Path) -> None:
    site = tmp_path / "site"
    install_module(site, "heun-kit", HEUN)
    (tmp_path / "spec.json").write_text(json.dumps(SPEC))

    def said(*arguments: str, status: int = 0) -> str:
        done = python("-m", "mbdkit", *arguments, path=(site,), cwd=tmp_path)
        assert done.returncode == status, done.stdout + done.stderr
        return done.stdout + done.stderr

    def word(file: str) -> str:
        with h5py.File(tmp_path / file) as archive:
            return str(archive.attrs["method_evidence"])

    told = said("run", "spec.json", "-o", "never.h5")
    assert "method-evidence: the method heun-kit:heun was never verified" in told
    assert "verdict       unknown" in told
    said("plugins", "verify", "heun", "--quick", "--record")
    assert "evidence: verified: by mbdkit" in said("plugins", "show", "heun")
    assert "method-evidence" not in said("run", "spec.json", "-o", "good.h5")
    assert [word("never.h5"), word("good.h5")] == ["never", "verified"]

    module = site / "heun_kit.py"  # of order 1 only, which the tableau says
    module.write_text(
        HEUN.replace('b=["1/4", 0, "3/4"]', 'b=["49/200", 0, "151/200"]').replace("order=3, ref", "order=1, ref")
    )
    changed = "its code is not that which was checked by mbdkit"
    assert f"doubtful: method-evidence: the method heun-kit:heun has changed since it was checked: {changed}" in said(
        "run", "spec.json", "-o", "bad.h5"
    )
    assert word("bad.h5") == "changed since"
    for command in ("list", "doctor", "show"):
        words = ["heun"] if command == "show" else []
        assert "changed since" in said("plugins", command, *words)
    said("report", "bad.h5", "-o", "bad.html")
    assert "The method is verified" in (page := (tmp_path / "bad.html").read_text(encoding="utf-8"))
    assert changed in page
    assert "the cause is probably that the code of heun-kit:heun has changed" in said("rerun", "good.h5", status=1)
    said("plugins", "verify", "heun", "--quick", "--record", status=1)
    assert "heun-kit:heun failed its checks: " in said("run", "spec.json", "-o", "failed.h5")
    accepted = said("run", "spec.json", "-o", "accepted.h5", "--set", "accept=[method-evidence]")
    assert "verdict       unknown: Accepted by the spec: method-evidence" in accepted
    with mbdkit.load(tmp_path / "failed.h5") as run:
        assert run.verdict == "doubtful"
