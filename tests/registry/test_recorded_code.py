"""Formulas of numbers stand only for code of mbdkit and of items with `pure=True`; numbers refuse what formulas lack.

The oracle is the ordinary way: each run by itself, from its spec.
"""

from __future__ import annotations

import copy
import math
import pickle
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import pytest
from pydantic import BaseModel

import mbdkit
from mbdkit.base import elementary
from mbdkit.base.traced_numbers import Trace, UntraceableError
from mbdkit.plugin import CriterionItem, FunctionJoint, JointKind, PoseFunction, Positive, Target
from mbdkit.plugin.seams import spec_criterion
from mbdkit.registry import items as item_classes
from mbdkit.registry.catalogue import KINDS
from mbdkit.runs import repeated_runs, simulation
from mbdkit.runs.varied_numbers import Variant
from mbdkit.spec.loading import load_spec

TABLE = {1.0: 0.6, 1.5: 1.7, 2.0: 1.3}
SIZES = (1.1, 1.1, 1.1, 1.2, 1.5, 2.0, 1.7366)
FILE: list[Path] = []  #: The file that code of plugins reads.

Number = Callable[[Any], Any]


def remembered(size: Any) -> Any:
    try:
        return 0.4 + float(size) / 5
    except Exception:
        return 0.7


IMPURE: dict[str, Number] = {
    "table": lambda size: TABLE.get(size, 0.9),
    "set": lambda size: 0.7 if size in {1.0, 1.5, 2.0} else 1.2,
    "hash": lambda size: 0.5 + hash((size, 1.0)) % 1000 / 1000,
    "random": lambda size: 0.5 + random.Random(size).random(),
    "array": lambda size: float(np.array([size, *(0.1 * k for k in range(1, 11))]).sum()) / 5,
    "objects": lambda size: np.array([size, *(0.1 * k for k in range(1, 11))], dtype=object).sum() / 5,
    "text": lambda size: 0.5 + float(f"{size:.1f}") / 4,
    "caught": remembered,
    "member": lambda size: 0.5 + 0.3 * getattr(size, "value", 1.0 + size),
    "sine": lambda size: 1.2 + np.sin(size) / 2,
}
READING: Number = lambda size: float(FILE[0].read_text()) + 0.0 * size  # noqa: E731
PURE: dict[str, Number] = {
    "polynomial": lambda size: 0.3 + 0.2 * size**2 - 0.1 * size,
    "branch": lambda size: 0.5 + size / 5 if size < 1.4 else 1.1 + elementary.sin(size) / 4,
    "quotient": lambda size: max(0.3, abs(1.0 - size) / (0.2 + size)) + elementary.hypot(size, 0.3) / 3,
}

REFUSED: dict[str, Callable[[Any], object]] = {
    "dict": lambda x: {1.3: 2.0}.get(x),
    "set": lambda x: x in {1.3},
    "hash": lambda x: hash((x, 1)),
    "array": lambda x: np.array([x, 1.0]),
    "objects": lambda x: np.array([x], dtype=object),
    "mean": lambda x: np.mean([x]),
    "item": lambda x: np.zeros(1).__setitem__(0, x),
    "times array": lambda x: x * np.ones(2),
    "interp": lambda x: np.interp(x, [0, 2], [0, 1]),
    "sine of NumPy": np.sin,
    "sine of the C library": math.sin,
    "float": float,
    "int": int,
    "round": round,
    "floor": math.floor,
    "complex": complex,
    "divmod": lambda x: divmod(x, 2.0),
    "other divmod": lambda x: divmod(2.0, x),
    "text": str,
    "format": lambda x: f"{x:.3f}",
    "percent": lambda x: "%g".__mod__(x),
    "repr": repr,
    "hex": lambda x: x.hex(),
    "ratio": lambda x: x.as_integer_ratio(),
    "real": lambda x: x.real,
    "random": random.Random,
    "generator": lambda x: np.random.default_rng(1).normal(x),
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": pickle.dumps,
    "fsum": lambda x: math.fsum([x, 1.0]),
    "asked": lambda x: hasattr(x, "__array__"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_recorded_number_refuses_all_but_arithmetic_even_if_the_error_is_caught(name: str) -> None:
    trace = Trace()
    with trace.recording():
        number = trace.input(1.3)
        with pytest.raises(UntraceableError):
            REFUSED[name](number)
    with pytest.raises(UntraceableError):
        trace.formulas([2.0 * number])


def test_functions_of_elementary_are_recorded_with_their_bits() -> None:
    trace = Trace()
    number = trace.input(1.3)
    formulas = trace.formulas([elementary.sin(number), elementary.atan2(number, 2.0), elementary.erf(number)])
    assert formulas(0.7) == (elementary.sin(0.7), elementary.atan2(0.7, 2.0), elementary.erf(0.7))


class Options(BaseModel):
    size: float = 1.1


def rail(pose: Any, p: Any) -> Any:
    return p["slope"] * pose.x + pose.y


def model(function: Number, *, pure: bool) -> tuple[object, dict[str, Any], str]:
    def build(options: Options) -> mbdkit.Mechanism:
        mechanism = mbdkit.Mechanism((0.0, 0.0), name="block")
        block = mechanism.body("b", mass=function(options.size), inertia=1.0)
        mechanism.force("F", block, value=("1", "0"))
        return mechanism

    return mbdkit.ModelPlugin("drawn", "x.", Options, build, pure=pure), {"name": "drawn"}, "model.size"


class Rail(FunctionJoint):
    type: Literal["drawn"] = "drawn"
    size: Positive
    """Size [m]."""
    rows: ClassVar[tuple[str, ...]] = ("rail",)
    units: ClassVar[tuple[str, ...]] = ("m",)
    function: ClassVar[list[Number]] = []

    def functions(self, start: Any) -> list[PoseFunction]:
        return [PoseFunction(rail, (("slope", self.function[0](self.size)),))]


def joint(function: Number, *, pure: bool) -> tuple[object, dict[str, Any], str]:
    Rail.function[:] = [function]
    item = JointKind(name="drawn", summary="a rail", model=Target(f"{__name__}:Rail"), pure=pure)
    joints = {"s": {"type": "drawn", "bodies": ["ground", "b"]}}
    return item, {**block(), "joints": joints}, "model.joints.s.size"


CHECKED: list[Number] = []


@spec_criterion
def too_large(spec: Any, measures: Any) -> Any:
    if any(CHECKED[0](body.mass) > 0.95 for body in spec.mechanism().bodies.values()):
        yield "too large"


def criterion(function: Number, *, pure: bool) -> tuple[object, dict[str, Any], str]:
    CHECKED[:] = [function]
    item = CriterionItem(name="drawn", summary="x", stage="spec", find=Target(f"{__name__}:too_large"), pure=pure)
    return item, block(), "model.bodies.b.mass"


def method(function: Number, *, pure: bool) -> tuple[object, dict[str, Any], str]:
    def create(options: Options) -> mbdkit.ExplicitRungeKutta:
        a, b, c = ([[], ["1/2"]], [0, 1], [0, "1/2"]) if function(1.1) > 0.95 else ([[], [1]], ["1/2", "1/2"], [0, 1])
        return mbdkit.ExplicitRungeKutta(mbdkit.ButcherTableau("t", a=a, b=b, c=c, order=2, reference="x (2000)"))

    claims = lambda options: mbdkit.Claims(order=2)  # noqa: E731
    item = mbdkit.IntegratorPlugin("drawn", "x.", Options, create=create, claims=claims, pure=pure)
    return item, block(), "model.bodies.b.mass"


def block() -> dict[str, Any]:
    return {
        "name": "mechanism",
        "bodies": {"b": {"mass": 1.0, "inertia": 0.1, "position": [0.0, 0.0], "angular_velocity": 1.0}},
    }


KINDS_OF_CODE = {"model": model, "joint": joint, "criterion": criterion, "method": method}


def spec_of(kind: str, data: dict[str, Any], key: str, size: float) -> dict[str, Any]:
    data = copy.deepcopy(data)
    holder: dict[str, Any] = {"model": data}
    for part in key.split(".")[:-1]:
        holder = holder[part]
    holder[key.split(".")[-1]] = size
    chosen = {"name": "drawn"} if kind == "method" else {"name": "gauss", "stages": 2}
    return {"mbdkit": 1, "model": data, "integrator": chosen, "time": {"end": 0.04, "step": 0.02}}


def outcome(run: mbdkit.Run) -> tuple[object, ...]:
    return run.data_sha256, run.run_id, str(run.verdict), run.warnings, run.status


CASES = [(kind, True, name) for kind in KINDS_OF_CODE for name in PURE]
CASES += [
    (kind, pure, name)
    for kind in KINDS_OF_CODE
    for pure in (True, False)  # a wrong permission, which recorded numbers refuse, and none
    for name in random.Random(f"{kind} {pure}").sample(sorted(IMPURE), 2)
]
CASES += [(kind, False, "file") for kind in KINDS_OF_CODE]


@pytest.mark.parametrize(("kind", "pure", "name"), CASES)
def test_runs_with_code_of_others_equal_ordinary_ones(
    kind: str,
    pure: bool,
    name: str,
    installed: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    FILE[:] = [tmp_path / "number.txt"]
    FILE[0].write_text("0.8")
    item, data, key = KINDS_OF_CODE[kind]({**PURE, **IMPURE, "file": READING}[name], pure=pure)
    installed(acme=[item])
    monkeypatch.setattr(repeated_runs, "_KNOWN", {})
    prepared = mbdkit.prepare(spec_of(kind, data, key, SIZES[0]))
    for number, size in enumerate(SIZES):
        FILE[0].write_text(str(0.8 if number < 4 else 1.2))
        own = spec_of(kind, data, key, size)
        expected = outcome(simulation.simulate(load_spec(own)))
        assert outcome(mbdkit.run(own)) == expected
        assert outcome(prepared.run({key: size})) == expected


@pytest.mark.parametrize("kind", KINDS_OF_CODE)
@pytest.mark.parametrize("pure", [True, False])
def test_code_that_says_that_it_is_pure_is_recorded_and_other_code_is_not(
    kind: str, pure: bool, installed: Callable[..., Any]
) -> None:
    item, data, key = KINDS_OF_CODE[kind](PURE["branch"], pure=pure)
    installed(acme=[item])
    spec, path = load_spec(spec_of(kind, data, key, 1.1)), tuple(key.split("."))
    if pure:
        assert Variant.of(spec, [path]).formulas(1.2) is not None
    else:
        with pytest.raises(UntraceableError, match="acme:drawn is not pure"):
            Variant.of(spec, [path])


@pytest.mark.parametrize("pure", [True, False])
def test_an_ensemble_of_a_model_that_looks_up_numbers_has_the_right_motions(
    pure: bool, installed: Callable[..., Any]
) -> None:
    # expected: a mass at rest moves by F t^2 / (2 m)
    item, data, key = model(IMPURE["table"], pure=pure)
    installed(acme=[item])
    spec = spec_of("model", data, key, 1.1) | {"measures": {"x": "final(b.x)"}}
    runs = mbdkit.ensemble(spec, {key: [1.1, 1.5, 2.0]}, workers=1)
    right = [0.04**2 / 2 / TABLE.get(size, 0.9) for size in (1.1, 1.5, 2.0)]
    assert runs.to_frame()["x"].to_numpy() == pytest.approx(right, rel=1e-9)


def test_every_kind_of_item_takes_the_permission_and_checks_it() -> None:
    assert all("pure" in kind.__dataclass_fields__ for kind in KINDS.values())
    item = item_classes.ModelPlugin("swing", "x.", Options, print, pure="yes")  # type: ignore[arg-type]
    with pytest.raises(mbdkit.PluginError, match="its `pure` is 'yes', not True or False"):
        item.check()
