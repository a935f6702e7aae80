"""Specs and studies that are mutated, huge, deep or absurd: each is refused in a sentence, or runs."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit.runs.simulation import simulate
from mbdkit.spec import example_names, load_spec
from mbdkit.spec.loading import example_text
from mbdkit.spec.yaml_reader import read_yaml, write_yaml
from mbdkit_design.design_loading import load_design_spec
from mbdkit_studies.points.planned_points import PlannedPoints
from mbdkit_studies.spec.study_loading import load_study_spec, study_names

from .attack import LONGEST_MESSAGE, Attack, in_child

Random = np.random.Generator

NUMBERS: tuple[Any, ...] = (0, -0.0, -1, 1, 1e-320, 5e-324, 1e-160, 1e160, 1e308, -1e308, 1e15, 0.1, 10**30, -(10**400))
VALUES: tuple[Any, ...] = (
    *NUMBERS,
    *(None, True, False, "", " ", "x", "t", "1/0", "9**9**9", "sin(1e300*t)", "exp(t)", "t**1000000", "1e999", "rk4"),
    *("<script>", "=1+1", "a.b", "a|b", "../x", "/", "\x7f", "\U0001f980", "é", "ground", "x" * 5000, "1" * 5000),
    *([], {}, [[]], [[], []], {"": 0}, {"name": None}, {"table": [[0, 1], [0, 1]]}, {"table": [[0], [0]]}, [0, 0]),
    *([1e308, -1e308], [0.0] * 1000, {str(i): i for i in range(50)}, {"geomspace": [1, 2, 3]}, {"linspace": [0, 1, 0]}),
)
SUFFIXES = ("", "s", ".", " ", "0", "[0]")
PIECES = (
    *(
        "&a ",
        "*a",
        "<<: ",
        "!!python/object ",
        "---\n",
        "\t",
        "0x" + "f" * 600,
        "1e999",
        "\r",
        "\ufeff",
        "\x85",
        "\u2028",
    ),
    *(
        "[",
        "]",
        "{",
        "}",
        ": ",
        "- ",
        "#",
        "'",
        '"',
        "%",
        "@",
        "`",
        "|",
        ">",
        "?",
        ",",
        "\n",
        "\\",
        ".nan",
        "-.inf",
        "~",
    ),
)


@cache
def _specs() -> list[dict[str, Any]]:
    return [read_yaml(example_text(name))[0] for name in example_names("run")]


@cache
def _studies() -> list[dict[str, Any]]:
    folder = files("mbdkit_paper")
    found = [read_yaml(path.read_text())[0] for path in sorted(Path(str(folder)).rglob("*.yaml"))]
    return [data for data in found if "mbdkit_study" in data]


def places(data: Any) -> list[tuple[Any, Any]]:
    """Return (container, key) of every value in plain data."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    found = []
    for key, value in items:
        found += [(data, key), *places(value)]
    return found


def mutate(data: dict[str, Any], random: Random) -> None:
    """Change plain data in one to four places."""
    for _ in range(random.integers(1, 5)):
        every = places(data)
        if not every:
            return
        holder, key = every[random.integers(len(every))]
        match random.integers(8):
            case 0 | 1 | 2:
                holder[key] = copy.deepcopy(VALUES[random.integers(len(VALUES))])
            case 3:
                del holder[key]
            case 4 if isinstance(holder, dict):
                holder[f"{key}{SUFFIXES[random.integers(len(SUFFIXES))]}"] = holder.pop(key)
            case 5:
                there, other = every[random.integers(len(every))]
                holder[key] = copy.deepcopy(there[other])
            case 6 if isinstance(holder[key], int | float) and abs(holder[key]) < 1e308:
                holder[key] *= float(random.choice([-1, 1])) * 10.0 ** int(random.integers(-300, 300))
            case 7 if isinstance(holder[key], list):
                holder[key] = holder[key] * int(random.integers(2, 60))


def _edited(text: str, random: Random) -> str:
    """Return the text with one to four edits of characters and lines."""
    for _ in range(random.integers(1, 5)):
        at = int(random.integers(len(text) + 1))
        match random.integers(5):
            case 0:
                text = text[:at] + str(random.choice(PIECES)) + text[at:]
            case 1:
                text = text[:at] + text[at + int(random.integers(1, 20)) :]
            case 2:
                text = text[:at] + text[max(0, at - int(random.integers(1, 200))) :]
            case 3:
                text = text[:at] + chr(int(random.integers(32, 0x3000))) + text[at + 1 :]
            case 4:
                text = text[: max(at, 20)]
    return text


def _toml(data: Any) -> str:
    """Return plain data as a TOML value."""
    match data:
        case dict():
            return "{" + ", ".join(f"{json.dumps(str(key))} = {_toml(value)}" for key, value in data.items()) + "}"
        case list():
            return "[" + ", ".join(map(_toml, data)) + "]"
        case None:
            return '"none"'
    return json.dumps(data)


def written(data: dict[str, Any], folder: Path, random: Random) -> Path:
    """Write mutated data in a format by chance, sometimes with errors of syntax, and return the file."""
    suffix = str(random.choice(["yaml", "json", "toml"], p=[0.6, 0.25, 0.15]))
    try:
        if suffix == "yaml":
            text = write_yaml(data)
        elif suffix == "json":
            text = json.dumps(data)
        else:
            text = "\n".join(f"{json.dumps(str(key))} = {_toml(value)}" for key, value in data.items())
    except ValueError:  # a number with more digits than Python writes
        text = "mbdkit: 0x" + "f" * 20_000
    if random.random() < 0.3:
        text = _edited(text, random)
    file = folder / f"spec.{suffix}"
    file.write_bytes(text.encode("utf-8", "surrogatepass"))
    return file


def refused(work: Callable[..., Any], *arguments: Any) -> list[str]:
    """Call `work` in a child; return what did not hold: it ends soon, with a result or with a readable MbdkitError."""

    def attempt() -> str:
        try:
            work(*arguments)
        except MbdkitError as error:
            return str(error)
        return ""

    ending = in_child(attempt)
    found = ending.problems(allowed=(0,))
    if ending.value and (len(ending.value) > LONGEST_MESSAGE or ending.value.count("\n") > 20):
        found.append(f"its message has {len(ending.value)} characters: {ending.value[:100]!r}")
    return found


def _load_and_run(file: Path, runs: bool) -> None:
    spec = load_spec(file, ["limits.max_steps=3", "limits.wall_time=1.0"] if runs else ())
    if runs and not spec.check and len(spec.mechanism().bodies) <= 30:
        simulate(spec).close()


def _spec(random: Random, folder: Path) -> list[str]:
    data = copy.deepcopy(_specs()[random.integers(len(_specs()))])
    for key in ("check", "accuracy"):
        data.pop(key, None)
    mutate(data, random)
    return refused(_load_and_run, written(data, folder, random), bool(random.random() < 0.5))


def _plan(file: Path) -> None:
    for point in PlannedPoints(load_study_spec(file))[:50]:
        _ = point.run_id


def _study(random: Random, folder: Path) -> list[str]:
    study_names()
    data = copy.deepcopy(_studies()[random.integers(len(_studies()))])
    mutate(data, random)
    return refused(_plan, written(data, folder, random))


def _head(body: str) -> str:
    return f"mbdkit: 1\nintegrator: {{name: rk4}}\ntime: {{end: 1, step: 0.1}}\nmodel:\n  name: mechanism\n{body}"


def _design(
    variables: str = "  model.length: {bounds: [1, 2]}\n", goals: str = "final(rod1.y)", base: str = "base: pendulum\n"
) -> str:
    return f"mbdkit_design: 1\n{base}variables:\n{variables}minimize: {goals}\n"


def _nested_aliases(item: str, levels: int = 9) -> str:
    text = f"a0: &a0 {item}\n"
    for level in range(1, levels):
        text += f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 9)}]\n"
    return text


_JOINT = "{type: revolute, bodies: [ground, b], points: [[0, 0], [0, 0]], "

BOMBS: dict[str, Callable[[], str | bytes]] = {
    "dotted.toml": lambda: ".".join(["a"] * 100_000) + " = 1\n",
    "dotted-spaces.toml": lambda: " . ".join(['"a"'] * 100_000) + " = 1\n",
    "header.toml": lambda: "[" + " " * 100_000 + "\na = 1\nb = [\n",
    "header-of-parts.toml": lambda: "[" + ".".join(["a"] * 50_000) + "]\n",
    "many-tables.toml": lambda: "".join(f"[a{i}.{'b.' * 90}c]\nx = 1\n" for i in range(10_000)),
    "many-keys.toml": lambda: "".join(f"a{i}.b.c = 1\n" for i in range(400_000)),
    "word.toml": lambda: "a" * 4_000_000,
    "aliases.yaml": lambda: _nested_aliases("[1, 1, 1]"),
    "aliases-of-text.yaml": lambda: _nested_aliases("'" + "x" * 100_000 + "'"),
    "aliases-of-maps.yaml": lambda: _nested_aliases("{a: 1, b: 2}", 12),
    "merges.yaml": lambda: (
        "a: &a {" + ", ".join(f"k{i}: 1" for i in range(3000)) + "}\nb: {<<: [" + ", ".join(["*a"] * 3000) + "]}\n"
    ),
    "anchors.yaml": lambda: "".join(f"k{i}: &a{i} [{i}]\n" for i in range(100_000)),
    "flat.yaml": lambda: "a: [" + "1," * 2_000_000 + "1]\n",
    "flat-block.yaml": lambda: "a:\n" + "- 1\n" * 1_000_000,
    "flat.json": lambda: '{"a": [' + "1," * 2_000_000 + "1]}",
    "lists.json": lambda: '{"a": [' + "[]," * 2_000_000 + "1]}",
    "large.yaml": lambda: "a: '" + "x" * 17 * 2**20 + "'\n",
    "deep.yaml": lambda: "a: " + "[" * 1_000_000,
    "deep-map.yaml": lambda: "a: " + "{a: " * 100_000,
    "deep-block.yaml": lambda: "".join(" " * i + "a:\n" for i in range(2000)),
    "deep-dashes.yaml": lambda: "a:\n" + "- " * 100_000 + "1\n",
    "deep.json": lambda: "[" * 1_000_000,
    "deep-900.json": lambda: '{"a":' * 900 + "1" + "}" * 900,
    "deep.toml": lambda: "a = " + "[" * 900 + "]" * 900,
    "hexadecimal.yaml": lambda: _head("  bodies: {b: {mass: 0x" + "f" * 100_000 + "}}\n"),
    "hexadecimal.toml": lambda: "mbdkit = 0x" + "f" * 100_000 + "\n",
    "digits.json": lambda: '{"mbdkit": ' + "9" * 100_000 + "}",
    "digits-of-a-float.yaml": lambda: _head("  bodies: {b: {mass: '" + "1" * 200_000 + "x'}}\n"),
    "digits-and-dots.yaml": lambda: _head("  bodies: {b: {mass: " + "1." * 200_000 + "}}\n"),
    "unknown-keys.yaml": lambda: _head("  bodies: {b: {" + ", ".join(f"k{i}: 1" for i in range(24_000)) + "}}\n"),
    "wrong-values.yaml": lambda: _head("  bodies: {" + ", ".join(f"b{i}: {{mass: x}}" for i in range(24_000)) + "}\n"),
    "wrong-joints.yaml": lambda: _head(
        "  bodies: {b: {mass: 1}}\n  joints: {" + ", ".join(f"J{i}: {{type: no}}" for i in range(24_000)) + "}\n"
    ),
    "unknown-bodies.yaml": lambda: _head(
        "  bodies: {"
        + ", ".join(f"body{i}: {{mass: 1}}" for i in range(3000))
        + "}\n  joints: {"
        + ", ".join(
            f"J{i}: {{type: revolute, bodies: [ground, bodi{i}], points: [[0, 0], [0, 0]]}}" for i in range(3000)
        )
        + "}\n"
    ),
    "long-name.yaml": lambda: _head("  bodies: {" + "b" * 1_000_000 + ": {mass: 1}}\n"),
    "long-key.yaml": lambda: "a" * 1_000_000 + ": 1\nmbdkit: 1\n",
    "long-expression.yaml": lambda: _head(
        "  bodies: {b: {mass: 1}}\n  forces: {f: {type: torque, body: b, value: '"
        + "(" * 5000
        + "t"
        + ")" * 5000
        + "'}}\n"
    ),
    "powers.yaml": lambda: _head(
        "  bodies: {b: {mass: 1}}\n  forces: {f: {type: torque, body: b, value: '" + "9**" * 3000 + "9'}}\n"
    ),
    "interval.yaml": lambda: (
        "mbdkit: 1\nmodel: {name: single-pendulum}\nintegrator: {name: gauss, stages: 2}\n"
        "time: {end: 1, step: 0.1}\noutput: {interval: 1.0e-320}\n"
    ),
    "interval-small.yaml": lambda: (
        "mbdkit: 1\nmodel: {name: single-pendulum}\nintegrator: {name: gauss, stages: 2}\n"
        "time: {end: 1, step: 0.1}\noutput: {interval: 1.0e-12}\n"
    ),
    "infinite-pendulum.yaml": lambda: (
        "mbdkit: 1\nmodel: {name: n-pendulum, n: 1000000000}\nintegrator: {name: rk4}\ntime: {end: 1, step: 0.1}\n"
    ),
    "heavy.yaml": lambda: (
        "mbdkit: 1\nmodel: {name: double-pendulum, masses: [1.0e+308, 1.0e+308]}\n"
        "integrator: {name: rk4}\ntime: {end: 1, step: 0.1}\n"
    ),
    "long.yaml": lambda: (
        "mbdkit: 1\nmodel: {name: double-pendulum, lengths: [1.0e+200, 1.0e+200]}\n"
        "integrator: {name: rk4}\ntime: {end: 1, step: 0.1}\n"
    ),
    "short.yaml": lambda: (
        "mbdkit: 1\nmodel: {name: n-four-bar, n: 3, length: 1.0e-200}\n"
        "integrator: {name: rk4}\ntime: {end: 1, step: 0.1}\n"
    ),
    "light.yaml": lambda: (
        "mbdkit: 1\nmodel: {name: double-pendulum, masses: [1.0e-320, 1.0]}\n"
        "integrator: {name: gauss, stages: 3}\ntime: {end: 1, step: 0.1}\n"
    ),
    "null.yaml": lambda: "a\0b: 1\n",
    "nothing.toml": lambda: "\n" * 3_000_000,
    "quotes.toml": lambda: "a = '''" + "'" * 1_000_000,
    "comments.yaml": lambda: "# x\n" * 3_000_000,
    "documents.yaml": lambda: "---\n" * 1_000_000,
    "tabs.yaml": lambda: "a:\n" + "\t" * 4_000_000 + "b: 1\n",
    "spaces.json": lambda: " " * 15_000_000 + "{",
    "keys-in-one-object.json": lambda: "{" + ", ".join(f'"k{i}": 1' for i in range(300_000)) + "}",
    "events.yaml": lambda: (
        "mbdkit: 1\nmodel: {name: single-pendulum}\nintegrator: {name: rk4}\n"
        "time: {end: 1, step: 0.1}\nevents: {" + ", ".join(f"e{i}: {{when: 't - {i}'}}" for i in range(8_000)) + "}\n"
    ),
    "quoted-event.yaml": lambda: (
        "mbdkit: 1\nmodel: {name: single-pendulum}\nintegrator: {name: rk4}\n"
        "time: {end: 1, step: 0.1}\nevents: {e: {when: 'joints[\"" + "\\" * 4000 + "'}}\n"
    ),
    "same-labels.yaml": lambda: (
        "mbdkit_study: 1\nbase: pendulum\naxes:\n- time.step:\n"
        + "".join(f"  - {{label: a, value: {i + 1}}}\n" for i in range(9_999))
    ),
    "points.yaml": lambda: (
        "mbdkit_study: 1\nbase: pendulum\naxes:\n"
        + "".join(f"- {{k{i}: {{linspace: [0, 1, 10000]}}}}\n" for i in range(40))
    ),
    "axes.yaml": lambda: (
        "mbdkit_study: 1\nbase: pendulum\naxes:\n" + "".join(f"- {{k{i}: [0]}}\n" for i in range(50_000))
    ),
    "deep-axis.yaml": lambda: f"mbdkit_study: 1\nbase: pendulum\naxes:\n- ? {'a.' * 100_000}b\n  : [0]\n",
    "deep-axis-of-indices.yaml": lambda: f"mbdkit_study: 1\nbase: pendulum\naxes:\n- ? a{'[0]' * 100_000}\n  : [0]\n",
    "index.yaml": lambda: f"mbdkit_study: 1\nbase: pendulum\naxes:\n- ? a[{'9' * 10_000}]\n  : [0]\n",
    "dots.yaml": lambda: _head(f"  bodies: {{? {'a.' * 100_000}b : {{mass: x}}}}\n"),
    "keys.yaml": lambda: (
        "mbdkit_study: 1\nbase: pendulum\naxes:\n-\n"
        + "".join(f"  k{i}: {{linspace: [0, 1, 10000]}}\n" for i in range(5_000))
    ),
    "families.yaml": lambda: (
        "mbdkit_study: 1\nbase: pendulum\nfamilies:\n"
        + "".join(f"  f{i}: {{axes: [{{time.step: [0.1]}}]}}\n" for i in range(5_000))
    ),
    "members.yaml": lambda: (
        "mbdkit_study: 1\nbase: pendulum\nsample: {n: 1000000000, variables: {model.length: {uniform: [1, 2]}}}\n"
    ),
    "distributions.yaml": lambda: (
        "mbdkit_study: 1\nbase: pendulum\nsample:\n  n: 4\n  variables:\n"
        + "".join(f"    k{i}: {{uniform: [1, 2]}}\n" for i in range(25_000))
    ),
    "measures.yaml": lambda: (
        "mbdkit_study: 1\nbase: pendulum\naxes: [{time.step: [0.1]}]\nmeasures:\n"
        + "".join(f"  m{i}: max(rod1.y)\n" for i in range(20_000))
    ),
    "long-measure.yaml": lambda: (
        "mbdkit_study: 1\nbase: pendulum\naxes: [{time.step: [0.1]}]\nmeasures: {m: '" + "1+" * 500_000 + "1'}\n"
    ),
    "variables.yaml": lambda: _design(
        variables="".join(f"  k{i}: {{bounds: [0, 1]}}\n" for i in range(50_000)), goals="final(rod1.y)"
    ),
    "goals.yaml": lambda: _design(goals="{" + ", ".join(f"g{i}: final(rod1.y)" for i in range(20_000)) + "}"),
    "long-goal.yaml": lambda: _design(goals="'" + "(" * 200_000 + "1" + ")" * 200_000 + "'"),
    "limits.yaml": lambda: (
        _design() + "subject_to:\n" + "".join(f"  l{i}: {{value: final(rod1.y), max: 1}}\n" for i in range(20_000))
    ),
    "scenarios.yaml": lambda: (
        _design(base="") + "scenarios:\n" + "".join(f"  s{i}: {{base: pendulum}}\n" for i in range(20_000))
    ),
    "deep-variable.yaml": lambda: _design(variables=f"  ? {'a.' * 100_000}b\n  : {{bounds: [0, 1]}}\n"),
    "front.yaml": lambda: _design(goals="{a: final(rod1.y), b: final(rod1.x)}") + "front: 1000000000\n",
    "starts.yaml": lambda: _design() + "optimizer: {name: slsqp, starts: 1000000000, max_iterations: 1000000000}\n",
}
"""Texts by file name: the suffix says the format."""


def _bomb(random: Random, folder: Path) -> list[str]:
    study_names()
    name = list(BOMBS)[random.integers(len(BOMBS))]
    return [f"{name}: {problem}" for problem in bomb(name, folder)]


def bomb(name: str, folder: Path) -> list[str]:
    """Return what did not hold when a bomb is read, and run if it is a valid spec."""
    file, content = folder / name, BOMBS[name]()
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    if "mbdkit_study" in str(content)[:20]:
        return refused(_plan, file)
    if "mbdkit_design" in str(content)[:20]:
        return refused(load_design_spec, file)
    return refused(_load_and_run, file, True)


ATTACKS = (
    Attack("specs", "mutated specs are refused in a sentence, or run", 20_000, _spec),
    Attack("studies", "mutated studies are refused in a sentence, or planned", 3_000, _study),
    Attack("bombs", "small files that would cost minutes or gigabytes are refused soon", 300, _bomb),
)
