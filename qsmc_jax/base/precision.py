"""Float64 inside entry points: nothing global is set, and NumPy comes out."""

import contextlib
import functools as ft
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from qsmc_jax.base.checks import is_traced

P = ParamSpec("P")
R = TypeVar("R")


def entry_point(function: Callable[P, R]) -> Callable[P, R]:
    """Runs a function in a 64-bit context and returns its arrays as NumPy; given traced numbers it is left as it is.

    Given plain numbers it computes at once, even while something else is being traced.
    """

    @ft.wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> Any:
        if is_traced(args, kwargs):
            return function(*args, **kwargs)
        with jax.enable_x64(True), _now():
            return to_numpy(function(*args, **kwargs))

    return wrapped


def _now() -> AbstractContextManager[None]:
    """A context in which plain numbers are computed with at once, even if a trace is under way around it."""
    is_staging = is_traced(jnp.zeros(()))
    return jax.ensure_compile_time_eval() if is_staging else contextlib.nullcontext()


def to_numpy(tree: Any) -> Any:
    """The same pytree with every JAX array as a NumPy array."""
    return jax.tree.map(lambda leaf: np.asarray(leaf) if isinstance(leaf, jax.Array) else leaf, tree)
