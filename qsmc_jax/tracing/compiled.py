"""How batches are compiled, and with which of the compiler's options."""

import logging
import time
from collections.abc import Callable
from typing import Any

import jax

from qsmc_jax.base.stack import with_room
from qsmc_jax.tracing.platforms import platform
from qsmc_jax.tracing.vectorise import is_vectorised, vectorised

_LOG = logging.getLogger(__name__)


def compiled(fn: Callable[..., Any], *arguments: Any, vectorise: bool) -> Callable[..., Any]:
    """The program of a function, for arguments of the given shapes.

    Args:
        fn: Any function of arrays that `jit` could trace.
        *arguments: Its arguments, or `jax.ShapeDtypeStruct`s in their place.
        vectorise: Whether its sines, cosines, tangents and arctangents are replaced, see `vectorised`. Where none is
            left, the program is given wide vectors.
    """
    return traced(fn, *arguments, vectorise=vectorise)()


def traced(fn: Callable[..., Any], *arguments: Any, vectorise: bool) -> Callable[[], Callable[..., Any]]:
    """The same in two parts: what it returns compiles, for which Python, all of whose work is done here, is not needed.

    Args:
        fn: As for `compiled`, and so are the others.
        *arguments: Its arguments.
        vectorise: Whether sines and the like are replaced.
    """
    begin, chosen = time.perf_counter(), platform()
    program = with_room(jax.jit(vectorised(fn) if vectorise else fn).trace, *arguments)
    is_wide = vectorise and chosen.rewrites and is_vectorised(program.jaxpr)
    options = chosen.wide_options if is_wide else chosen.options
    lowered, tracing = with_room(program.lower), time.perf_counter() - begin

    def compile_now() -> Callable[..., Any]:
        begin = time.perf_counter()
        made = lowered.compile(compiler_options=dict(options) or None)
        _LOG.info("compiled %s in %.1f s, traced in %.1f s", _named(fn), time.perf_counter() - begin, tracing)
        return made

    return compile_now


def _named(fn: Any) -> str:
    inner = getattr(fn, "func", fn)
    return getattr(inner, "__name__", type(inner).__name__).strip("_")
