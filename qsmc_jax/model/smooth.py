"""Time derivatives of any order of a smooth function, and the check that it is smooth.

What smooth means is read off the traced program of the function, and off that of its derivative: an operation that
makes kinks or jumps (kinks.py has them) is refused where it acts on a number that depends on time. So is every
`jnp.where(t < 1, ...)`. Tests for equality pass: they guard single points, as in `jnp.sinc`. Inside loops and branches
a smooth function may be refused needlessly.
"""

import functools as ft
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.jet import jet
from jax.extend.core import ClosedJaxpr
from jaxtyping import Array

from qsmc_jax.base.checks import is_traced, require, show
from qsmc_jax.base.traceable import traceable
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.model.kinks import kinks, timed_equations

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
    scalar, t = ft.partial(_scalar, fn), jnp.asarray(t, dtype=float)
    names = {eqn.primitive.name for eqn in timed_equations(jax.make_jaxpr(scalar)(t).jaxpr)}
    if order > 1 and names <= _TAYLOR:
        return _taylor(scalar, t, order)
    return _tower(scalar, order)(t)


def require_smooth(fn: Callable[..., Any]) -> None:
    """Raises unless `fn` is a smooth function of time, by the rule of this file, that returns one number."""
    scalar = ft.partial(_scalar, fn)
    closed = _traced(scalar)
    shape = closed.out_avals[0].shape
    require(shape == (), f"Argument `fn` of `references.Smooth` must return a single number, but has shape {shape}.")
    _require_no_hidden_tracer(fn, closed)
    _require_forward_derivative(closed)
    _require_no_kinks(closed)
    _require_no_kinks(_traced(_tower(scalar, 1)))
    if not is_traced(fn):
        _require_finite_start(scalar)


def _scalar(fn: Callable[..., Any], t: RealScalarLike) -> Array:
    """`fn(t)` as a float array, so that a constant function is one like any other."""
    return jnp.asarray(fn(t), dtype=float)


def _taylor(fn: Callable[..., Any], t: Array, order: int) -> tuple[Array, ...]:
    # Plain coefficients, for jet computes factorials as exp(lgamma(k + 1)), which rounds.
    series = [jnp.ones_like(t), *(jnp.zeros_like(t) for _ in range(order - 1))]
    value, coefficients = jet(fn, (t,), (series,), factorial_scaled=False)
    return (value, *(math.factorial(k) * coefficient for k, coefficient in enumerate(coefficients, start=1)))


def _tower(fn: Callable[..., Any], order: int) -> Callable[..., Any]:
    """The function t -> (f, f', ..., f^(order)) by repeated forward mode."""
    if order == 0:
        return lambda t: (fn(t),)
    lower = _tower(fn, order - 1)

    def extended(t: Array) -> tuple[Array, ...]:
        values, slopes = jax.jvp(lower, (t,), (jnp.ones_like(t),))
        return (*values, slopes[-1])

    return extended


def _traced(fn: Callable[..., Any]) -> ClosedJaxpr:
    try:
        with traceable("Argument `fn` of `references.Smooth`", "the time"):
            return jax.make_jaxpr(fn)(jnp.zeros(()))
    except TypeError as error:
        raise ValueError(
            f"Argument `fn` of `references.Smooth` must be a function of time, but calling it says: {error}."
        ) from error


def _require_no_hidden_tracer(fn: Callable[..., Any], closed: ClosedJaxpr) -> None:
    visible = {id(leaf) for leaf in jax.tree.leaves(fn)}
    hidden = [value for value in closed.consts if is_traced(value) and id(value) not in visible]
    require(
        not hidden,
        "Argument `fn` of `references.Smooth` must show the numbers it depends on, but has a traced number in its "
        "closure. Write `Smooth(eqx.Partial(fn, number))` with `fn(number, t)`, or make it an `eqx.Module` that holds "
        "the number.",
    )


def _require_forward_derivative(closed: ClosedJaxpr) -> None:
    # Tracing would let it pass, and compiling the solve would then fail.
    names = {eqn.primitive.name for eqn in timed_equations(closed.jaxpr)}
    require(
        "custom_vjp_call" not in names,
        "Argument `fn` of `references.Smooth` must have a forward derivative, but uses a `jax.custom_vjp`, which has "
        "only a reverse one. Use `jax.custom_jvp`.",
    )


def _require_no_kinks(closed: ClosedJaxpr) -> None:
    found = kinks(closed)
    require(
        not found,
        f"Argument `fn` of `references.Smooth` must be smooth, but uses {', '.join(f'`{name}`' for name in found)} on "
        "a number that depends on time. Use a smooth function in its place (`jnp.tanh` for a switch, `jnp.logaddexp` "
        "for a maximum), or subclass `references.AbstractReference` with derivatives of your own.",
    )


def _require_finite_start(fn: Callable[..., Any]) -> None:
    with jax.ensure_compile_time_eval():
        start = np.asarray(jnp.stack(_tower(fn, 1)(jnp.zeros(()))))
    require(
        bool(np.all(np.isfinite(start))),
        "Argument `fn` of `references.Smooth` must be finite with a finite derivative at t = 0, but these are "
        f"{show(start)}. Shift or rewrite it: runs start there.",
    )
