"""Time derivatives of any order of a smooth function, and the check that it is smooth.

What smooth means is read off the traced program of the function, and off that of its derivative. An operation that
makes kinks or jumps is refused where it acts on a number that depends on time: `abs`, `sign`, rounding, remainders,
minima and maxima, sorting, order comparisons (so every `jnp.where(t < 1, ...)`), conversion to integers;
`stop_gradient` too, for it hides a derivative. Tests for equality pass: they guard single points, as in `jnp.sinc`. A
function with a derivative rule of its own (`jax.custom_jvp`, as in `jax.nn.softplus` and `jax.nn.relu`) is judged by
that rule, not by its body. Inside loops and branches every real number counts as depending on time, so there a smooth
function may be refused needlessly.
"""

import functools as ft
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.jet import jet
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Var, jaxprs_in_params
from jaxtyping import Array

from qsmc_jax.base.checks import is_traced, require, show
from qsmc_jax.base.traceable import traceable
from qsmc_jax.base.types import RealScalarLike

_ROUNDING = {"abs", "sign", "floor", "ceil", "round", "rem", "nextafter"}
_COMPARING = {"lt", "le", "gt", "ge", "lt_to", "le_to", "max", "min", "clamp"}
_RANKING = {"sort", "top_k", "argmax", "argmin", "reduce_max", "reduce_min", "cummax", "cummin"}
_WINDOWED = {"reduce_window_max", "reduce_window_min"}
_KINKED = _ROUNDING | _COMPARING | _RANKING | _WINDOWED | {"stop_gradient"}

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
    names = {eqn.primitive.name for eqn in _timed_equations(jax.make_jaxpr(scalar)(t).jaxpr)}
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
    names = {eqn.primitive.name for eqn in _timed_equations(closed.jaxpr)}
    require(
        "custom_vjp_call" not in names,
        "Argument `fn` of `references.Smooth` must have a forward derivative, but uses a `jax.custom_vjp`, which has "
        "only a reverse one. Use `jax.custom_jvp`.",
    )


def _require_no_kinks(closed: ClosedJaxpr) -> None:
    kinks = sorted({eqn.primitive.name for eqn in _timed_equations(closed.jaxpr) if _is_kink(eqn)})
    require(
        not kinks,
        f"Argument `fn` of `references.Smooth` must be smooth, but uses {', '.join(f'`{name}`' for name in kinks)} on "
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


def _is_kink(eqn: JaxprEqn) -> bool:
    to_integer = eqn.primitive.name == "convert_element_type" and not _is_real(eqn.outvars[0])
    return eqn.primitive.name in _KINKED or (to_integer and _is_real(eqn.invars[0]))


def _is_real(value: Any) -> bool:
    return jnp.issubdtype(value.aval.dtype, jnp.inexact)


def _timed_equations(jaxpr: Jaxpr, timed: Sequence[bool] = (True,)) -> Iterator[JaxprEqn]:
    """The equations that a time-dependent number enters, inner ones included; `timed` says which arguments are such."""
    seen = {var for var, is_timed in zip(jaxpr.invars, timed, strict=True) if is_timed}
    for eqn in jaxpr.eqns:
        enters = [isinstance(var, Var) and var in seen for var in eqn.invars]
        if any(enters):
            seen.update(eqn.outvars)
            yield eqn
            yield from _inner_equations(eqn, enters)


def _inner_equations(eqn: JaxprEqn, enters: Sequence[bool]) -> Iterator[JaxprEqn]:
    if eqn.primitive.name == "custom_jvp_call":
        return
    for inner in jaxprs_in_params(eqn.params):
        is_call = eqn.primitive.name in ("jit", "pjit")
        yield from _timed_equations(inner, enters if is_call else [_is_real(var) for var in inner.invars])
