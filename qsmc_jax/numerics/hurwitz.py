"""Whether a polynomial is Hurwitz, by Routh's array, for numbers and tracers alike."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import is_traced
from qsmc_jax.base.types import BoolScalarLike


def is_hurwitz(c: Float[Array | np.ndarray, " c"]) -> BoolScalarLike:
    r"""Whether every root of $s^m + c_m s^{m-1} + \dots + c_1$ has a negative real part.

    A root on the imaginary axis fails.

    Routh's array, one row per degree: the polynomial is Hurwitz exactly when no row starts with a number $\le 0$. After
    a row that does, the rest is computed with a stand-in for it, finite and without meaning. Numbers are worked on in
    NumPy, so in float64 whatever the context.
    """
    xp = jnp if is_traced(c) else np
    descending = [xp.ones(()), *(c[j] for j in reversed(range(len(c))))]
    upper, lower = descending[0::2], descending[1::2]
    hurwitz = xp.ones((), bool)
    while lower:
        positive = lower[0] > 0
        hurwitz = hurwitz & positive
        padded = [*lower[1:], *([xp.zeros(())] * (len(upper) - len(lower)))]
        with np.errstate(over="ignore", invalid="ignore"):  # an infinite entry fails its row's test, as it should
            factor = upper[0] / xp.where(positive, lower[0], 1.0)
            upper, lower = lower, [a - factor * b for a, b in zip(upper[1:], padded, strict=True)]
    return hurwitz
