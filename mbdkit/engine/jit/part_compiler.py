"""How parts of kernels are compiled: as far as linking goes, and no further.

Numba optimizes every function with all that it calls and makes machine code of it, as if Python were to call it. Of a
function that only kernels call this is thrown away, since each kernel is optimized as a whole again: time that grows
with the depth of calls. So a part is lowered and simplified by itself, and its kernels do the rest.
"""

from __future__ import annotations

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering


class _PartLibrary(JITCodeLibrary):
    """The code of a part and of all that it calls, for linking alone."""

    def _optimize_final_module(self) -> None:
        """Leave it to the kernels."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(NativeLowering):
    """Lowers a function to code that is linked into kernels and not made executable."""

    _name = "part_lowering"

    def run_pass(self, state: Any) -> bool:
        """Lower the function, and let kernels find its code."""
        state["library"] = code = _PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        code.finalize()
        entry: Any = {}.__getitem__  # what the code is found by: a builtin of its own, useless from Python
        state.targetctx.insert_user_function(entry, state.cr.fndesc, [code])
        state.cr = state.cr._replace(cfunc=entry)
        return True


class PartCompiler(CompilerBase):
    """Numba's compiler for parts."""

    def define_pipelines(self) -> list[Any]:
        """Return Numba's passes with another lowering."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [(_PartLowering if kind is NativeLowering else kind, why) for kind, why in passes.passes]
        passes.finalize()
        return [passes]
