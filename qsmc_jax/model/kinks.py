"""Operations of a program that may make kinks or jumps, on what depends on given arguments.

What is said of a program is said of the operations in it, not of its values: a continuous function joined by
`jnp.where` has one that may jump. Whether it does is asked of its values, by crossings.py. Inside loops every real
number counts as depending on the arguments. A function with a derivative rule of its own (`jax.custom_jvp`, as in
`jax.nn.softplus`) is judged by that rule, where it is differentiated, not by its body.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Var, jaxprs_in_params
from jaxtyping import Array

_JUMPING = {"sign", "floor", "ceil", "round", "rem", "nextafter", "lt", "le", "gt", "ge", "lt_to", "le_to"}
_JUMPING |= {"bitcast_convert_type"}  # by which signbit and copysign read a sign
_BENDING = {"abs", "max", "min", "clamp", "stop_gradient"}
_RANKING = {"sort", "top_k", "argmax", "argmin", "reduce_max", "reduce_min", "cummax", "cummin"}
_WINDOWED = {"reduce_window_max", "reduce_window_min"}
_KINKED = _JUMPING | _BENDING | _RANKING | _WINDOWED
# What may jump though each of its parts is smooth where it is defined: arctan(tan x), arctan2(sin x, cos x).
_WRAPPING = {"atan2", "tan"}
_LEAPING = _JUMPING | _WRAPPING | {"sort", "top_k", "argmax", "argmin"}
# Their inner program has the arguments of the call, or of the chosen branch, one for one.
CALLS = {"jit", "pjit", "closed_call", "core_call", "remat", "remat2", "checkpoint"}


class Use(NamedTuple):
    """An equation of a program, entered by what depends on the given arguments.

    Attributes:
        eqn: The equation.
        enters: Which of its operands depend on them.
        is_looped: Whether it stands in a loop, where values can't be asked for.
    """

    eqn: JaxprEqn
    enters: Sequence[bool]
    is_looped: bool


def kinks(closed: ClosedJaxpr) -> list[Use]:
    """The operations of a function of time that may make kinks or jumps.

    Args:
        closed: The function of one argument, traced.
    """
    return [use for use in uses(closed.jaxpr) if _is_one(use.eqn, _KINKED) and not _is_empty(use.eqn)]


def may_jump(closed: ClosedJaxpr, arguments: int) -> bool:
    """Whether a function may jump in its last arguments, by the operations in it.

    Args:
        closed: The function, traced.
        arguments: How many the last arguments are.
    """
    others = len(closed.jaxpr.invars) - arguments
    found = uses(closed.jaxpr, (False,) * others + (True,) * arguments)
    return any((_is_one(use.eqn, _LEAPING) or _divides(use)) and not _is_empty(use.eqn) for use in found)


def as_times(times: Any) -> Array:
    """Break times as a one-dimensional array of floats, however they were given."""
    return jnp.atleast_1d(jnp.asarray(times, dtype=float))


def uses(jaxpr: Jaxpr, depends: Sequence[bool] = (True,), is_looped: bool = False) -> Iterator[Use]:
    """The equations that a dependent number enters, inner ones included; `depends` says which arguments are such."""
    seen = {var for var, is_such in zip(jaxpr.invars, depends, strict=True) if is_such}
    for eqn in jaxpr.eqns:
        enters = [isinstance(var, Var) and var in seen for var in eqn.invars]
        if any(enters):
            seen.update(eqn.outvars)
            use = Use(eqn, enters, is_looped)
            yield use
            yield from _inner_uses(use)


def _inner_uses(use: Use) -> Iterator[Use]:
    name = use.eqn.primitive.name
    if name == "custom_jvp_call":
        return
    given = use.enters[1:] if name == "cond" else use.enters
    for inner in jaxprs_in_params(use.eqn.params):
        if name in CALLS or name == "cond":
            yield from uses(inner, given, use.is_looped)
        else:
            yield from uses(inner, list(map(is_real, inner.invars)), True)


def _is_one(eqn: JaxprEqn, names: set[str]) -> bool:
    to_integer = eqn.primitive.name == "convert_element_type" and not is_real(eqn.outvars[0])
    return eqn.primitive.name in names or (to_integer and is_real(eqn.invars[0]))


def _divides(use: Use) -> bool:
    """Whether it divides by a dependent number, as in `x / abs(x)`."""
    return use.eqn.primitive.name == "div" and use.enters[1]


def _is_empty(eqn: JaxprEqn) -> bool:
    """Whether it makes no number at all, as a comparison with no switching times does."""
    return all(np.size(var.aval) == 0 for var in eqn.outvars)


def is_real(value: Any) -> bool:
    """Whether a variable or literal of a program is a real number."""
    return jnp.issubdtype(value.aval.dtype, jnp.inexact)
