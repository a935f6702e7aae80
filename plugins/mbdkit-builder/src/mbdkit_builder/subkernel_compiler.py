"""Compile subkernels only as far as linking requires.

Numba optimizes each function together with all its callees and generates machine code for it. For a function that only
kernels call, this code is never used, because each kernel is linked and optimized again as a whole. The wasted time
grows with the depth of calls. A subkernel is therefore only lowered to LLVM IR, without optimization.

This module uses internals of Numba: `JITCodeLibrary`, the pass builder and `NativeLowering`. The stored machine code is
built with the version of Numba that ``pyproject.toml`` names under ``build``.
"""

from __future__ import annotations

from typing import Any

import llvmlite.binding as llvm
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering

from mbdkit.engine.native.functions import DECLARED
from mbdkit_builder.elementary_names import with_own_names


class _SubkernelLibrary(JITCodeLibrary):
    """The LLVM IR of a subkernel and of its callees, for linking only."""

    def add_llvm_module(self, ll_module: Any) -> None:
        """Add the module of a function, with calls of our own elementary functions."""
        super().add_llvm_module(llvm.parse_assembly(with_own_names(str(ll_module))))

    def _optimize_final_module(self) -> None:
        """Skip optimization: each kernel optimizes the linked module."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _SubkernelLowering(NativeLowering):
    _name = "subkernel_lowering"

    def run_pass(self, state: Any) -> bool:
        """Lower the function and register its IR as the implementation of calls to it."""
        state["library"] = code = _SubkernelLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        if state.func_id.func in DECLARED.separate:  # its callees have been compiled already, and inherit the flag
            state.flags.forceinline = False
        super().run_pass(state)
        code.finalize()
        # Numba registers the code of a callee under a Python function, here a bound builtin method of a new dictionary,
        # which is unique to this subkernel and never called.
        key: Any = {}.__getitem__
        state.targetctx.insert_user_function(key, state.cr.fndesc, [code])
        state.cr = state.cr._replace(cfunc=key)
        return True


class SubkernelCompiler(CompilerBase):
    """Numba's compiler with `_SubkernelLowering` as lowering pass."""

    def define_pipelines(self) -> list[Any]:
        """Return Numba's default pipeline with the lowering pass replaced."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [(_SubkernelLowering if kind is NativeLowering else kind, why) for kind, why in passes.passes]
        passes.finalize()
        return [passes]
