"""Elementary functions as batches compile them, against a scalar library: a compiler may get one wrong, and has.

jaxlib 0.10.2 does with the arctangent, for vectors as wide as batches are given: it is wrong from 64 lanes on, by all
its digits, and right for 16. So what batches are compiled with is tried on the machine where it runs.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import jax.scipy.special as jsp
import numpy as np
import scipy.special

from qsmc_jax.base.precision import in_64_bits
from qsmc_jax.tracing.compiled import compiled


class Elementary(NamedTuple):
    """A function of JAX and what it should be.

    Attributes:
        fn: The function of JAX, of one or two numbers.
        truth: The same, of floats, by another library.
        ranges: The least and the largest value of each argument to try. They leave out roots at which JAX loses digits
            because of the formula that it uses, on any machine.
        ulps: Error allowed, in units in the last place of the result: twice what a right program does at the least.
    """

    fn: Callable[..., Any]
    truth: Callable[..., float]
    ranges: tuple[tuple[float, float], ...]
    ulps: float = 4.0


_ALL, _POSITIVE, _UNIT = (-20.0, 20.0), (0.01, 20.0), (-1.0, 1.0)

# JAX takes 2^x and the hyperbolic sine and cosine from the exponential of another number, which is rounded first.
_BY_EXP = 40.0

# XLA takes log1p from a quotient of polynomials that is 130 units off at -0.414, the far end of its range.
_BY_LOG1P = 200.0

ELEMENTARY = {
    "sin": Elementary(jnp.sin, math.sin, (_ALL,)),
    "cos": Elementary(jnp.cos, math.cos, (_ALL,)),
    "tan": Elementary(jnp.tan, math.tan, (_ALL,)),
    "arcsin": Elementary(jnp.arcsin, math.asin, (_UNIT,)),
    "arccos": Elementary(jnp.arccos, math.acos, (_UNIT,)),
    "arctan": Elementary(jnp.arctan, math.atan, (_ALL,)),
    "arctan2": Elementary(jnp.arctan2, math.atan2, (_ALL, _ALL)),
    "sinh": Elementary(jnp.sinh, math.sinh, (_ALL,), _BY_EXP),
    "cosh": Elementary(jnp.cosh, math.cosh, (_ALL,), _BY_EXP),
    "tanh": Elementary(jnp.tanh, math.tanh, (_ALL,), 16.0),
    "arcsinh": Elementary(jnp.arcsinh, math.asinh, (_ALL,)),
    "arccosh": Elementary(jnp.arccosh, math.acosh, ((1.1, 20.0),), 8.0),
    "arctanh": Elementary(jnp.arctanh, math.atanh, ((0.1, 0.99),), _BY_LOG1P),
    "exp": Elementary(jnp.exp, math.exp, (_ALL,)),
    "exp2": Elementary(jnp.exp2, math.exp2, (_ALL,), _BY_EXP),
    "expm1": Elementary(jnp.expm1, math.expm1, (_ALL,), 8.0),
    "log": Elementary(jnp.log, math.log, (_POSITIVE,)),
    "log2": Elementary(jnp.log2, math.log2, (_POSITIVE,)),
    "log10": Elementary(jnp.log10, math.log10, (_POSITIVE,)),
    "log1p": Elementary(jnp.log1p, math.log1p, ((-0.99, 20.0),), _BY_LOG1P),
    "sqrt": Elementary(jnp.sqrt, math.sqrt, (_POSITIVE,)),
    "rsqrt": Elementary(jax.lax.rsqrt, lambda x: 1.0 / math.sqrt(x), (_POSITIVE,)),
    "cbrt": Elementary(jnp.cbrt, math.cbrt, (_ALL,)),
    "power": Elementary(jnp.power, math.pow, (_POSITIVE, (-5.0, 5.0))),
    "hypot": Elementary(jnp.hypot, math.hypot, (_ALL, _ALL)),
    "divide": Elementary(jnp.divide, lambda x, y: x / y, (_ALL, _ALL), 1.0),
    "sigmoid": Elementary(jax.nn.sigmoid, lambda x: 1.0 / (1.0 + math.exp(-x)), (_ALL,)),
    "softplus": Elementary(jax.nn.softplus, lambda x: math.log1p(math.exp(x)), (_ALL,)),
    "logaddexp": Elementary(jnp.logaddexp, np.logaddexp, (_ALL, _ALL)),
    "erf": Elementary(jsp.erf, math.erf, ((-4.0, 4.0),)),
    "erfc": Elementary(jsp.erfc, math.erfc, ((-4.0, 4.0),), 16.0),
    "ndtr": Elementary(jsp.ndtr, scipy.special.ndtr, ((-5.0, 5.0),), 64.0),
    "ndtri": Elementary(jsp.ndtri, scipy.special.ndtri, ((0.001, 0.49),), 16.0),
    "gammaln": Elementary(jsp.gammaln, math.lgamma, ((2.5, 30.0),), _BY_EXP),
    "floor": Elementary(jnp.floor, math.floor, (_ALL,), 0.0),
    "ceil": Elementary(jnp.ceil, math.ceil, (_ALL,), 0.0),
    "round": Elementary(jnp.round, round, (_ALL,), 0.0),
    "trunc": Elementary(jnp.trunc, math.trunc, (_ALL,), 0.0),
    "sign": Elementary(jnp.sign, lambda x: math.copysign(1.0, x), (_ALL,), 0.0),
    "abs": Elementary(jnp.abs, abs, (_ALL,), 0.0),
    "maximum": Elementary(jnp.maximum, max, (_ALL, _ALL), 0.0),
    "minimum": Elementary(jnp.minimum, min, (_ALL, _ALL), 0.0),
    "fmod": Elementary(jnp.fmod, math.fmod, (_ALL, _ALL), 0.0),
    "mod": Elementary(jnp.mod, lambda x, y: x % y, (_ALL, _ALL), 0.0),
}

# Fractions of these, one an argument, fill the unit square evenly: the golden ratio and its relative in two dimensions.
_SPREAD = (0.6180339887498949, 0.7548776662466927)


def arguments(function: Elementary, lanes: int) -> tuple[np.ndarray, ...]:
    """So many values of each argument, spread over its range."""
    count = np.arange(lanes) + 0.5
    pairs = zip(function.ranges, _SPREAD, strict=False)
    return tuple(low + (high - low) * (count * spread % 1.0) for (low, high), spread in pairs)


def batch(function: Elementary, lanes: int, vectorise: bool) -> np.ndarray:
    """Its values at `arguments`, as a batch computes them."""
    with in_64_bits():
        values = arguments(function, lanes)
        return np.asarray(compiled(jax.vmap(function.fn), *values, vectorise=vectorise)(*values))


def wrong_functions(lanes: int = 512) -> list[str]:
    """Names of the elementary functions that batches of so many runs get wrong on this machine."""
    wrong = []
    for name, function in ELEMENTARY.items():
        points = zip(*arguments(function, lanes), strict=True)
        truth = np.array([function.truth(*map(float, point)) for point in points], float)
        for vectorise in (True, False):
            errors = abs(batch(function, lanes, vectorise) - truth)
            # A NaN is no error that is small enough.
            if not np.all(errors <= function.ulps * np.spacing(abs(truth))):
                wrong.append(name if vectorise else f"{name} (vectorise=False)")
    return wrong
