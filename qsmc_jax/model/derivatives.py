"""Time derivatives of any order of a smooth function."""

import functools as ft
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.experimental.jet import jet
from jaxtyping import Array

from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.model.kinks import uses
from qsmc_jax.tracing.programs import Program, UnknownProgramError

# Operations whose rule in jet is exact wherever the function is smooth. Left out on purpose: `pow` and `sqrt`, which go
# through a logarithm and are NaN at 0; `expm1`, `log1p`, `asinh`, `erfc`, which lose digits; and functions with a
# derivative rule of their own, which jet ignores.
_ARITHMETIC = {"add", "sub", "mul", "div", "neg", "square", "integer_pow", "reduce_sum", "dot_general"}
_ELEMENTARY = {"sin", "cos", "sinh", "cosh", "exp", "log", "tanh", "logistic"}
_SHAPING = {"broadcast_in_dim", "reshape", "squeeze", "slice", "concatenate", "stack", "convert_element_type", "copy"}
_TAYLOR = _ARITHMETIC | _ELEMENTARY | _SHAPING | {"jit", "pjit"}


def time_derivatives(fn: Callable[..., Any], t: RealScalarLike, order: int) -> tuple[Array, ...]:
    """`fn` and its first `order` derivatives at `t`.

    By Taylor mode, whose cost grows like the square of the order, if all its operations allow; else by repeated forward
    mode, whose cost doubles with each order.
    """
    number, t = ft.partial(scalar, fn), jnp.asarray(t, dtype=float)
    if order > 1 and _uses_only(_TAYLOR, jax.make_jaxpr(number)(t)):
        return _taylor(number, t, order)
    return tower(number, order)(t)


def scalar(fn: Callable[..., Any], t: RealScalarLike) -> Array:
    """`fn(t)` as a float array, so that a constant function is one like any other."""
    return jnp.asarray(fn(t), dtype=float)


def _uses_only(names: set[str], program: Program) -> bool:
    try:
        return {use.eqn.name for use in uses(program)} <= names
    except UnknownProgramError:
        return False


def _taylor(fn: Callable[..., Any], t: Array, order: int) -> tuple[Array, ...]:
    # Plain coefficients, for jet computes factorials as exp(lgamma(k + 1)), which rounds.
    series = [jnp.ones_like(t), *(jnp.zeros_like(t) for _ in range(order - 1))]
    value, coefficients = jet(fn, (t,), (series,), factorial_scaled=False)
    return (value, *(math.factorial(k) * coefficient for k, coefficient in enumerate(coefficients, start=1)))


def tower(fn: Callable[..., Any], order: int) -> Callable[..., Any]:
    """The function t -> (f, f', ..., f^(order)) by repeated forward mode."""
    if order == 0:
        return lambda t: (fn(t),)
    lower = tower(fn, order - 1)

    def extended(t: Array) -> tuple[Array, ...]:
        values, slopes = jax.jvp(lower, (t,), (jnp.ones_like(t),))
        return (*values, slopes[-1])

    return extended
