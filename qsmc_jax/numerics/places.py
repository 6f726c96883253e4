"""Where a number stands in a sorted table, at a cost that hardly grows with the table."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from qsmc_jax.base.types import RealScalarLike


def place(table: Float[Array, " n"], t: RealScalarLike) -> Int[Array, ""]:
    """How many entries of a sorted table are at most `t`, by halving.

    Args:
        table: The entries, in order.
        t: The number.
    """
    return jnp.searchsorted(table, t, side="right", method="scan_unrolled")


def place_on_grid(grid: Float[Array, " n"], t: RealScalarLike) -> Int[Array, ""]:
    """The same for entries that are evenly spaced, each within half a spacing, by division.

    The entries themselves decide, so that an entry belongs to what follows it whatever rounding does.

    Args:
        grid: Two entries or more.
        t: The number.
    """
    last = grid.shape[0] - 1
    guess = jnp.clip(jnp.floor((t - grid[0]) / (grid[-1] - grid[0]) * last), -1.0, last).astype(int) + 1
    is_too_high = (guess > 0) & (t < grid[jnp.maximum(guess - 1, 0)])
    is_too_low = (guess <= last) & (t >= grid[jnp.minimum(guess, last)])
    return guess + is_too_low.astype(int) - is_too_high.astype(int)
