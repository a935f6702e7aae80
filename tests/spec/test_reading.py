"""Files, their formats, and where in them something is wrong."""

from __future__ import annotations

import gc
import io
import json
import os
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

import mbdkit
from mbdkit.base.errors import ResourceError, SpecError
from mbdkit.base.plain_data import DEEPEST, parse_path
from mbdkit.spec import load_spec

TOML = """
mbdkit = 1
integrator = { name = "gauss", stages = 2 }

[model]
name = "double-pendulum"
masses = [1.0, 2.0]

[time]
end = 1.0
step = 0.01
"""

YAML = """
mbdkit: 1
integrator: {name: gauss, stages: 2}
model:
  name: double-pendulum
  masses: [1.0, 2.0]
time:
  end: 1
  step: 1e-2
"""

DATA = {"mbdkit": 1, "integrator": {"name": "gauss", "stages": 2}}
DATA |= {"model": {"name": "double-pendulum", "masses": [1, 2]}, "time": {"end": 1, "step": 0.01}}
JSON = json.dumps(DATA, indent=1)


def test_yaml_toml_and_json_of_one_spec_are_one_spec(in_tmp_path):
    hashes = set()
    for name, text in (("a.yaml", YAML), ("a.yml", YAML), ("a.toml", TOML), ("a.json", JSON), ("a", YAML)):
        (in_tmp_path / name).write_text(text)
        hashes.add(load_spec(name).sha256())
    assert len(hashes) == 1


def test_a_byte_order_mark_does_no_harm(in_tmp_path):
    (in_tmp_path / "a.yaml").write_bytes(b"\xef\xbb\xbf" + YAML.encode())
    load_spec("a.yaml")


@pytest.mark.parametrize("text", [YAML, JSON])
def test_stdin_is_yaml_or_json(text, monkeypatch):
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(text.encode())))
    assert load_spec("-").time.end == 1.0


@pytest.mark.parametrize(
    ("name", "text", "line", "key"),
    [
        ("a.yaml", YAML.replace("masses: [1.0", "masses: [-1"), 6, "model.masses[0]"),
        ("a.yaml", YAML.replace("step:", "stpe:"), 9, "time.stpe"),
        ("a.yaml", YAML.replace("  step: 1e-2\n", ""), 7, "time.step"),
        ("a.toml", TOML.replace("masses = [1.0", "masses = [-1.0"), 7, "model.masses[0]"),
        ("a.toml", TOML.replace("stages = 2", "stages = 9"), 3, "integrator.stages"),
        ("a.toml", TOML.replace("step =", "stpe ="), 11, "time.stpe"),
        ("a.json", JSON.replace('"end": 1', '"end": -1'), 15, "time.end"),
        ("a.json", JSON.replace('"stages": 2', '"stages": NaN'), 5, "integrator.stages"),
    ],
)
def test_an_error_names_file_line_and_key(name, text, line, key, in_tmp_path):
    (in_tmp_path / name).write_text(text)
    with pytest.raises(SpecError) as caught:
        load_spec(name)
    assert (caught.value.file, caught.value.line, caught.value.key) == (name, line, key)
    assert str(caught.value).startswith(f"{name}:{line}: {key}: ")


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.yaml", b"", "is empty"),
        ("a.yaml", b"# nothing but a comment\n", "is empty"),
        ("a.json", b"  ", "is empty"),
        ("a.toml", b"", "is empty"),
        ("a.yaml", b"- 1\n", "mapping"),
        ("a.json", b"[]", "mapping"),
        ("a.yaml", b"\xff\xfe\x00", "UTF-8"),
        ("a.yaml", b"a\x00b", "control character"),
        ("a.yaml", b"\x89HDF\r\n\x1a\n", "`mbdkit.load` reads an archive, and `mbdkit rerun` runs"),
        ("a.yaml", b"a" * (16 * 2**20 + 1), "larger than 16 MiB"),
        ("a.json", b'{"a": 1, "a": 2}', "twice"),
        ("a.json", b'{"a" 1}', "not valid JSON"),
        ("a.json", b"[" * 100_000, "nested too deeply"),
        ("a.json", rb'{"title": "\ud83d\ude00 \ud800"}', r"half of a surrogate pair, .ud800 \(column 25\)"),
        ("a.toml", b"a = \n", "not valid TOML"),
        ("a.toml", b"a = 1\na = 2\n", "not valid TOML"),
        ("a.toml", b"a = " + b"[" * 100_000, "nested too deeply"),
    ],
)
def test_a_file_that_is_no_spec_is_refused_in_a_sentence(name, content, words, in_tmp_path):
    (in_tmp_path / name).write_bytes(content)
    with pytest.raises(SpecError, match=words) as caught:
        load_spec(name)
    assert caught.value.file == name
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["missing.yaml", "", ".", "x" * 5000, "nul\0byte", "a/b/c"])
def test_a_name_that_is_no_file_is_refused_in_a_sentence(name, in_tmp_path):
    with pytest.raises(SpecError):
        load_spec(name)


@pytest.mark.usefixtures("no_garbage_collection")
def test_a_key_deeper_than_any_spec_is_refused_in_a_short_sentence(in_tmp_path):
    key = "a." * 100_000
    (in_tmp_path / "a.yaml").write_text(f"{YAML}forces:\n  ? {key}\n  : 1\n")
    with pytest.raises(SpecError) as caught:
        load_spec("a.yaml")
    assert len(str(caught.value)) < 2000
    begin = time.process_time()
    path = parse_path(key)
    assert len(path) == DEEPEST + 1
    assert time.process_time() - begin < 0.1


def test_the_garbage_collector_runs_again_after_an_error():
    with pytest.raises(SpecError):
        load_spec({"mbdkit": 1, "unknown": 2})
    assert gc.isenabled()


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="needs a file whose first byte cannot be read")
def test_a_spec_that_the_system_cannot_read_is_no_wrong_input():
    with pytest.raises(ResourceError, match="this file cannot be read: Input/output error"):
        load_spec("/proc/self/mem")


@pytest.mark.parametrize("source", ["a.yaml", {"mbdkit_study": 1, "base": "a.yaml", "axes": {"time.step": [0.1]}}])
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_is_not_read(source, in_tmp_path):
    os.mkfifo("a.yaml")
    with pytest.raises(SpecError, match="this is not a regular file but a pipe, a socket or a device; it is not read"):
        (load_spec if isinstance(source, str) else mbdkit.study)(source)
