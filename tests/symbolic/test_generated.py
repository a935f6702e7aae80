"""The generated module is what the definitions say, and its masks name exactly what its kernels write."""

from __future__ import annotations

import numpy as np
import pytest

from mbdkit.engine.kernels import element_kernels
from mbdkit.symbolic import __main__ as command
from mbdkit.symbolic.generate import TARGET, source


@pytest.fixture(scope="module")
def fresh() -> str:
    return source()


def test_the_checked_in_kernels_are_those_that_the_definitions_generate(fresh: str) -> None:
    assert TARGET.read_text(encoding="utf-8") == fresh, "run `python -m mbdkit.symbolic`"


def test_check_tells_fresh_kernels_from_stale_ones(
    fresh: str, tmp_path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "element_kernels.py"
    target.write_text(fresh.replace("gx", "gy", 1), encoding="utf-8")
    monkeypatch.setattr(command, "TARGET", target)
    monkeypatch.setattr(command, "source", lambda: fresh)
    assert command.main(["--check"]) == 1
    assert "element_kernels.py differs from the output of mbdkit/symbolic" in capsys.readouterr().err
    assert command.main([]) == 0
    assert command.main(["--check"]) == 0


WRITTEN = [
    (kind, kernel, place, masks)
    for kind in element_kernels.CONSTRAINT_KINDS
    for kernel, place, masks in (
        ("acceleration", -2, element_kernels.JACOBIAN_ENTRIES),
        ("tangent", -3, element_kernels.STIFFNESS_ENTRIES),
        ("tangent", -2, element_kernels.GAMMA_V_ENTRIES),
        ("tangent", -1, element_kernels.RESIDUAL_Q_ENTRIES),
    )
] + [
    (kind, kernel, -1, masks)
    for kind in element_kernels.PATHWAY_KINDS
    for kernel, masks in (("gradient", element_kernels.GRADIENT_ENTRIES), ("hessian", element_kernels.HESSIAN_ENTRIES))
    if masks.get(kind)
]


@pytest.mark.parametrize(("kind", "kernel", "place", "masks"), WRITTEN)
def test_a_mask_names_exactly_the_entries_that_its_kernel_writes(
    kind: str, kernel: str, place: int, masks: dict[str, tuple[int, ...]]
) -> None:
    # expected: nothing but the mask loses the NaN that the outputs are full of before
    function = getattr(element_kernels, f"{kind}_{kernel}")
    names = function.__code__.co_varnames[: function.__code__.co_argcount]
    inputs = {"k": 0, "a": 0, "b": 1, "m": 0}
    rng = np.random.default_rng(3)
    shapes = {"q": 9, "v": 9, "acc": 9, "cs": (3, 2), "p": (1, 6), "u": (4, 3), "lam": (1, 2)}
    outputs = {name: np.full((1, 36), np.nan) for name in names if name not in shapes and name not in inputs}
    arrays = {name: rng.random(shapes[name]) for name in names if name in shapes}
    function(**{name: (inputs | arrays | outputs)[name] for name in names})
    written = np.flatnonzero(~np.isnan(outputs[names[place]][0]))
    assert tuple(written) == masks[kind]
