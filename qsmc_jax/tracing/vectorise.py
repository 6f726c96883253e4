"""Functions of JAX with sine, cosine, tangent and arctangent replaced by ones that vectorise on a CPU."""

import functools as ft
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.numerics import elementary
from qsmc_jax.tracing.platforms import platform
from qsmc_jax.tracing.programs import Program, Rewriter

_REWRITER = Rewriter(
    {"sin": elementary.sin, "cos": elementary.cos, "tan": elementary.tan, "atan": elementary.atan},
    # diffrax's, of times that are sorted and within the horizon: `grid_of` refuses others before anything is compiled.
    known_to_hold="saveat.ts must",
)


def vectorised(fn: Callable[..., Any]) -> "_Vectorised":
    """The same function with its float64 `sin`, `cos`, `tan` and `arctan` replaced by those of `elementary`.

    For a function called inside `jit`, such as the vector field of an ODE: each call traces it, rewrites the program
    that came out, through `jit`, `cond`, `scan`, `while_loop`, `checkpoint`, custom derivatives and linear solves, and
    runs it. Other things (a sharded map, a kernel, a callback) are left as they are, and so are other dtypes, and
    everything where JAX's default backend at the time of the call is no CPU: `is_vectorised` tells whether any is left.
    So is everything from the first program on that is not made as `programs` knows it: `why_not_vectorised` says it.
    Values differ in the last places; derivatives are exact.

    Args:
        fn: Any function that `jit` could trace. Arguments may be pytrees with leaves that are not arrays, such as
            functions and None; numbers and NumPy arrays reach it as they are. Results are pytrees of arrays.

    Returns:
        A pytree that is called as `fn` is, and whose leaves are those of `fn`. Made twice of equal functions it is
        equal, so that `jit` does not compile twice.
    """
    return _Vectorised(fn)


def is_vectorised(program: Program) -> bool:
    """Whether no float64 `sin`, `cos`, `tan` or `arctan` of JAX is left in a program, wherever it may hide.

    Args:
        program: What `jax.make_jaxpr` or `jax.jit(fn).trace(...).jaxpr` gives.
    """
    return _REWRITER.is_done(program)


def why_not_vectorised() -> str:
    """A sentence on why functions are left as they are with this version of JAX; empty as long as none was."""
    if not _REWRITER.problem:
        return ""
    return (
        f"Solves are right but slow: this version of qsmc_jax does not know the programs of JAX {jax.__version__} "
        f"({_REWRITER.problem}), so sines and the like are left as they are. Install an older JAX."
    )


class _Vectorised(AbstractModule):
    fn: Callable[..., Any]

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        if not platform().rewrites or _REWRITER.problem:
            return self.fn(*args, **kwargs)
        # Without inputs of its own, the traced program closes over the arguments, whatever they are.
        program, shape = jax.make_jaxpr(ft.partial(self.fn, *args, **kwargs), return_shape=True)()
        results = _REWRITER.run(program)
        if results is None:
            return self.fn(*args, **kwargs)
        # A result that is one number whatever the arguments comes out as a number.
        arrays = [leaf if isinstance(leaf, jax.Array) else jnp.asarray(leaf, leaf.dtype) for leaf in results]
        return jax.tree.unflatten(jax.tree.structure(shape), arrays)
