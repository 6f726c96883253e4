"""What the functions of a loop compute, by hashes."""

from collections.abc import Callable
from typing import Any, TypeAlias

import jax
import numpy as np

from qsmc_jax.base.digest import digest
from qsmc_jax.base.traceable import trace
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.model.unseen import is_consistent, is_known, is_own

# Hashes by part: "drift of `Mine`", ...
Contents: TypeAlias = tuple[tuple[str, str], ...]


def brought(loop: ClosedLoop) -> Contents:
    """The same, but nothing for a loop in which all is the library's."""
    is_ours = is_known(loop.plant) and is_consistent(loop.reference) and is_own(loop.disturbance)
    is_plain = loop.implementation is None and not any(map(callable, jax.tree.leaves(loop)))
    return () if is_ours and is_plain else functions_of(loop)


def functions_of(loop: ClosedLoop) -> Contents:
    """Hashes of the programs of what the user may have written, for numbers of the loop that are not known yet.

    Whatever such a function reads from outside, a global say, is in them: JAX keeps programs by what a loop looks like.
    """
    number = jax.ShapeDtypeStruct((), np.float64)
    state = (number,) * loop.order
    plant = type(loop.plant).__name__
    parts: dict[str, tuple[Any, Callable[..., Any], tuple[Any, ...]]] = {
        f"drift of `{plant}`": (loop.plant, lambda plant, t, x: plant.drift(t, x), (number, state)),
        f"gain of `{plant}`": (loop.plant, lambda plant, t, x: plant.gain(t, x), (number, state)),
        f"disturbance `{type(loop.disturbance).__name__}`": (loop.disturbance, lambda d, t: d(t), (number,)),
        f"reference `{type(loop.reference).__name__}`": (
            loop.reference,
            lambda reference, t: reference.derivatives(t, loop.order),
            (number,),
        ),
    }
    if loop.implementation is not None:
        noise, count = loop.implementation.noise, jax.ShapeDtypeStruct((), np.int64)
        for i, signal in enumerate(loop.implementation.unmatched):
            parts[f"unmatched disturbance {i} `{type(signal).__name__}`"] = (signal, lambda d, t: d(t), (number,))
        if noise is not None:
            parts[f"noise `{type(noise).__name__}`"] = (noise, lambda noise, t, k: noise(t, k), (number, count))
    return tuple((name, digest(trace(name, "its arguments", *part[:2], *part[2])[0])) for name, part in parts.items())
