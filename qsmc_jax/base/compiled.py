"""How batches are compiled, and with which of the compiler's options."""

from collections.abc import Callable
from typing import Any

import jax

from qsmc_jax.base.vectorise import is_vectorised, vectorised

# No splitting of work over cores, which threads do here with whole blocks.
_OPTIONS = {"xla_disable_hlo_passes": "cpu-parallel-task-assigner"}

# Vectors as wide as they come, where XLA for CPUs stays at half the width: a third less time. Only for programs without
# an arctangent of JAX's own, which jaxlib 0.10.2 compiles to wrong numbers at this width.
_WIDE_OPTIONS = {**_OPTIONS, "xla_cpu_prefer_vector_width": "512"}


def compiled(fn: Callable[..., Any], *arguments: Any, vectorise: bool) -> Callable[..., Any]:
    """The program of a function, for arguments of the given shapes.

    Args:
        fn: Any function of arrays that `jit` could trace.
        *arguments: Its arguments, or `jax.ShapeDtypeStruct`s in their place.
        vectorise: Whether its sines, cosines, tangents and arctangents are replaced, see `vectorised`. Where none is
            left, the program is given wide vectors.
    """
    traced = jax.jit(vectorised(fn) if vectorise else fn).trace(*arguments)
    if jax.default_backend() != "cpu":
        return traced.lower().compile()
    is_wide = vectorise and is_vectorised(traced.jaxpr)
    return traced.lower().compile(compiler_options=_WIDE_OPTIONS if is_wide else _OPTIONS)
