"""The masks of the generated module name exactly what its kernels write."""

from __future__ import annotations

import numpy as np
import pytest

from mbdkit.engine.kernels import element_kernels

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
    shapes = {"q": 9, "v": 9, "acc": 9, "cs": (3, 2), "p": (1, 6), "u": (19, 3), "lam": (1, 2), "guide": (1, 9)}
    outputs = {name: np.full((1, 36), np.nan) for name in names if name not in shapes and name not in inputs}
    arrays = {name: rng.random(shapes[name]) for name in names if name in shapes}
    function(**{name: (inputs | arrays | outputs)[name] for name in names})
    written = np.flatnonzero(~np.isnan(outputs[names[place]][0]))
    assert tuple(written) == masks[kind]
