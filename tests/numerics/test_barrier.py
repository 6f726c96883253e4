"""A barrier changes no number, and stops XLA from repeating what it is around."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qsmc_jax.numerics.barrier import Barrier


def polynomial(x):
    for _ in range(20):
        x = 0.5 + x * 0.3
    return x


def multiplications(is_behind_barrier):
    """How many a compiled loop has, in which a polynomial of degree 20 decides what of four numbers is kept."""

    def kept(_, state, one):
        a, b, highest, square = state
        y = polynomial(a + b)
        y = Barrier(one)(y) if is_behind_barrier else y
        is_higher = y > highest
        new, old = (a, b, y, y * y), (b, a, highest, square)
        return tuple(jnp.where(is_higher, x, z) for x, z in zip(new, old, strict=True))

    def loop(x, one):
        return jax.lax.fori_loop(0, 1000, lambda i, state: kept(i, state, one), (x, x, x, x))

    return jax.jit(loop).lower(jnp.ones(64), 1.0).compile().as_text().count(" multiply(")


@pytest.mark.parametrize("x", [0.1, -3e-300, 1.7e308, np.inf])
def test_numbers_stay_exactly_what_they_are(x):
    assert jax.jit(lambda one: Barrier(one)((jnp.asarray(x),)))(1.0)[0] == x


def test_shared_work_is_done_once():
    assert multiplications(is_behind_barrier=True) < 0.5 * multiplications(is_behind_barrier=False)
