"""What a study computes, by hashes: noticed is whatever changes it, be it in a file of data or an imported module."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np

from qsmc_jax.base.digest import digest
from qsmc_jax.base.precision import in_64_bits
from qsmc_jax.base.traceable import trace
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.study.draw import PointDraw, dimension
from qsmc_jax.study.study import Study


def contents(study: Study) -> dict[str, str]:
    """A hash of the program of each part of a study, and of the numbers in it.

    Args:
        study: The study.

    Returns:
        Hashes by part: "scenario", "drift of `Mine`", ... Two studies with the same give the same rows.
    """
    return {"scenario": _scenario(study), **_functions(study.nominal.loop)}


def _scenario(study: Study) -> str:
    point = jax.ShapeDtypeStruct((dimension(study.specs),), np.float64)
    structures: list[Any] = []

    def program(point: Any) -> Any:
        arrays, rest = eqx.partition(study.scenario(PointDraw(point, {})), eqx.is_array_like)
        structures.append(rest)
        return arrays

    with in_64_bits():
        traced = jax.make_jaxpr(program)(point)
    return digest(traced, jax.tree.leaves(structures[0]), str(jax.tree.structure(structures[0])))


def _functions(loop: ClosedLoop) -> dict[str, str]:
    """The programs of what the user may have written, for numbers of the loop that are not known yet."""
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
    return {name: digest(trace(name, "its arguments", *part[:2], *part[2])[0]) for name, part in parts.items()}
