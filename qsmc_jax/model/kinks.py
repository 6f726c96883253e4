"""Where a function of time may have kinks or jumps: operations of its program that make them, on what depends on time.

What is said of a program is said of the operations in it, not of its values: a continuous function joined by
`jnp.where` counts as one that may jump, as does a jump in the state inside a loop, where every real number counts as
depending on time. A function with a derivative rule of its own (`jax.custom_jvp`, as in `jax.nn.softplus`) is judged by
that rule, where it is differentiated, not by its body.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Var, jaxprs_in_params
from jaxtyping import Array

from qsmc_jax.base.checks import require

_JUMPING = {"sign", "floor", "ceil", "round", "rem", "nextafter", "lt", "le", "gt", "ge", "lt_to", "le_to"}
_JUMPING |= {"bitcast_convert_type"}  # by which signbit and copysign read a sign
_BENDING = {"abs", "max", "min", "clamp", "stop_gradient"}
_RANKING = {"sort", "top_k", "argmax", "argmin", "reduce_max", "reduce_min", "cummax", "cummin"}
_WINDOWED = {"reduce_window_max", "reduce_window_min"}
# Their inner program has the arguments of the call, or of the chosen branch, one for one.
_CALLS = {"jit", "pjit", "closed_call", "core_call", "remat", "remat2", "checkpoint", "cond"}
_KINKED = _JUMPING | _BENDING | _RANKING | _WINDOWED


def kinks(closed: ClosedJaxpr) -> list[str]:
    """Names of the operations of a function of time that may make kinks or jumps.

    Args:
        closed: The function of one argument, traced.
    """
    return _found(closed, (True,), _KINKED)


def as_times(times: Any) -> Array:
    """Break times as a one-dimensional array of floats, however they were given."""
    return jnp.atleast_1d(jnp.asarray(times, dtype=float))


def require_declared(name: str, closed: ClosedJaxpr, arguments: int, declared: int) -> None:
    """Raises if a function may jump in time though not a single time is declared: a solver may step over the jump.

    Args:
        name: The function, for the message.
        closed: The function, traced, with the time as the first of its last arguments.
        arguments: How many the last arguments are; what comes before them does not depend on time, nor does the state.
        declared: How many times are declared.
    """
    others = len(closed.jaxpr.invars) - arguments
    jumps = _found(closed, (False,) * others + (True,) + (False,) * (arguments - 1), _JUMPING)
    listed = ", ".join(f"`{jump}`" for jump in jumps)
    require(
        not jumps or declared > 0,
        f"{name} may jump in time, for it uses {listed} on what may depend on it, but "
        "`break_times` is empty, and a solver may step over what it is not told of. Give the class a property "
        "`break_times`: the times [s] of its jumps and kinks, or [inf] if it has none.",
    )


def timed_equations(jaxpr: Jaxpr, timed: Sequence[bool] = (True,)) -> Iterator[JaxprEqn]:
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
    given = enters[1:] if eqn.primitive.name == "cond" else enters
    for inner in jaxprs_in_params(eqn.params):
        yield from timed_equations(inner, given if eqn.primitive.name in _CALLS else list(map(_is_real, inner.invars)))


def _found(closed: ClosedJaxpr, timed: Sequence[bool], names: set[str]) -> list[str]:
    equations = timed_equations(closed.jaxpr, timed)
    return sorted({eqn.primitive.name for eqn in equations if _is_one(eqn, names) and not _is_empty(eqn)})


def _is_one(eqn: JaxprEqn, names: set[str]) -> bool:
    to_integer = eqn.primitive.name == "convert_element_type" and not _is_real(eqn.outvars[0])
    return eqn.primitive.name in names or (to_integer and _is_real(eqn.invars[0]))


def _is_empty(eqn: JaxprEqn) -> bool:
    """Whether it makes no number at all, as a comparison with no switching times does."""
    return all(np.size(var.aval) == 0 for var in eqn.outvars)


def _is_real(value: Any) -> bool:
    return jnp.issubdtype(value.aval.dtype, jnp.inexact)
