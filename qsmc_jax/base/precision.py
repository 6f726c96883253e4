"""Float64 inside entry points: nothing global is set, and NumPy comes out."""

import functools as ft
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import experimental

from qsmc_jax.base.checks import is_traced
from qsmc_jax.base.stack import with_room

# Contexts. JAX has this one where it documents it from 0.8 on.
_home: Any = jax if hasattr(jax, "enable_x64") else experimental
enable_x64: Callable[..., Any] = _home.enable_x64
in_64_bits = ft.partial(enable_x64, True)

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

        def at_once() -> Any:
            with in_64_bits():
                return to_numpy(function(*args, **kwargs))

        return _outside_traces(at_once) if is_traced(jnp.zeros(())) else with_room(at_once)

    return wrapped


def _outside_traces(compute: Callable[[], Any]) -> Any:
    """What `compute` returns where no trace is under way: in a thread of its own, for traces belong to threads."""
    with ThreadPoolExecutor(1) as elsewhere:
        return elsewhere.submit(compute).result()


def to_numpy(tree: Any) -> Any:
    """The same pytree with every JAX array as a NumPy array."""
    return jax.tree.map(lambda leaf: np.asarray(leaf) if isinstance(leaf, jax.Array) else leaf, tree)
