"""Loops whose lanes go in step under `vmap`: as long as any of them runs, without a selection for every number."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from qsmc_jax.base.types import BoolScalarLike


@jax.custom_batching.custom_vmap
def any_lane(claim: BoolScalarLike) -> Bool[Array, ""]:
    """Whether a claim holds; under `vmap`, whether it holds in any of the lanes, one answer for all.

    A `while_loop` on it stays one under `vmap`, where a claim of each lane's own would turn into selections of all that
    the loop carries. What it guards must do nothing in lanes where the claim does not hold.
    """
    return jnp.asarray(claim)


@any_lane.def_vmap
def _any_lane(axis_size: int, in_batched: list[bool], claim: Bool[Array, " lanes"]) -> tuple[Bool[Array, ""], bool]:
    return jnp.any(claim), False
