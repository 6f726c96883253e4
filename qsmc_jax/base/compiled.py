"""How batches are compiled, and with which of the compiler's options."""

import logging
import time
from collections.abc import Callable
from typing import Any

import jax

from qsmc_jax.base.platforms import platform
from qsmc_jax.base.vectorise import is_vectorised, vectorised

_LOG = logging.getLogger(__name__)


def compiled(fn: Callable[..., Any], *arguments: Any, vectorise: bool) -> Callable[..., Any]:
    """The program of a function, for arguments of the given shapes.

    Args:
        fn: Any function of arrays that `jit` could trace.
        *arguments: Its arguments, or `jax.ShapeDtypeStruct`s in their place.
        vectorise: Whether its sines, cosines, tangents and arctangents are replaced, see `vectorised`. Where none is
            left, the program is given wide vectors.
    """
    begin, chosen = time.perf_counter(), platform()
    traced = jax.jit(vectorised(fn) if vectorise else fn).trace(*arguments)
    is_wide = vectorise and chosen.rewrites and is_vectorised(traced.jaxpr)
    options = chosen.wide_options if is_wide else chosen.options
    program = traced.lower().compile(compiler_options=dict(options) or None)
    _LOG.info("compiled %s in %.1f s", _named(fn), time.perf_counter() - begin)
    return program


def _named(fn: Any) -> str:
    inner = getattr(fn, "func", fn)
    return getattr(inner, "__name__", type(inner).__name__).strip("_")
