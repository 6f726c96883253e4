"""Where a function of time may have kinks or jumps: operations of its program that make them, on what depends on time.

What is said of a program is said of the operations in it, not of its values: a continuous function joined by
`jnp.where` counts as one that may jump. Inside loops and branches every real number counts as depending on time. A
function with a derivative rule of its own (`jax.custom_jvp`, as in `jax.nn.softplus`) is judged by that rule, where it
is differentiated, not by its body.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Var, jaxprs_in_params

from qsmc_jax.base.checks import require

_JUMPING = {"sign", "floor", "ceil", "round", "rem", "nextafter", "lt", "le", "gt", "ge", "lt_to", "le_to"}
_BENDING = {"abs", "max", "min", "clamp", "stop_gradient"}
_RANKING = {"sort", "top_k", "argmax", "argmin", "reduce_max", "reduce_min", "cummax", "cummin"}
_WINDOWED = {"reduce_window_max", "reduce_window_min"}
_KINKED = _JUMPING | _BENDING | _RANKING | _WINDOWED


def kinks(closed: ClosedJaxpr) -> list[str]:
    """Names of the operations of a function of time that may make kinks or jumps.

    Args:
        closed: The function of one argument, traced.
    """
    return _found(closed, (True,), _KINKED)


def require_declared(name: str, closed: ClosedJaxpr, timed: Sequence[bool], break_times: Any) -> None:
    """Raises if a function may jump in time though not a single time is declared: a solver may step over the jump.

    Args:
        name: The function, for the message.
        closed: The function, traced.
        timed: Which of its arguments depend on time.
        break_times: The declared times [s].
    """
    jumps = _found(closed, timed, _JUMPING)
    require(
        not jumps or np.size(break_times) > 0,
        f"{name} may jump in time, for it uses {', '.join(f'`{jump}`' for jump in jumps)} on it, but `break_times` is "
        "empty, and a solver may step over what it is not told of. Give the class a property `break_times`: the times "
        "[s] of its jumps and kinks, or [inf] if it has none.",
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
    for inner in jaxprs_in_params(eqn.params):
        is_call = eqn.primitive.name in ("jit", "pjit")
        yield from timed_equations(inner, enters if is_call else [_is_real(var) for var in inner.invars])


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
