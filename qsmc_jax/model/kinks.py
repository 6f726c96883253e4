"""Operations of a program that may make kinks or jumps, on what depends on given arguments.

What is said of a program is said of the operations in it, not of its values: a continuous function joined by
`jnp.where` has one that may jump. Whether it does is asked of its values, by crossings.py. Inside loops every real
number counts as depending on the arguments. A function with a derivative rule of its own (`jax.custom_jvp`, as in
`jax.nn.softplus`) is judged by that rule, where it is differentiated, not by its body.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from qsmc_jax.tracing.programs import (
    CALLS,
    OPAQUE,
    Equation,
    Program,
    branches,
    called,
    dtype_of,
    is_literal,
    parts,
    programs_in,
    shape_of,
)

_JUMPING = {"sign", "floor", "ceil", "round", "rem", "nextafter", "lt", "le", "gt", "ge", "lt_to", "le_to"}
_JUMPING |= {"bitcast_convert_type"}  # by which signbit and copysign read a sign
_BENDING = {"abs", "max", "min", "clamp", "stop_gradient"}
_RANKING = {"sort", "top_k", "argmax", "argmin", "reduce_max", "reduce_min", "cummax", "cummin"}
_WINDOWED = {"reduce_window_max", "reduce_window_min"}
_KINKED = _JUMPING | _BENDING | _RANKING | _WINDOWED | OPAQUE
# What may jump though each of its parts is smooth where it is defined: arctan(tan x), arctan2(sin x, cos x).
_WRAPPING = {"atan2", "tan"}
_LEAPING = _JUMPING | _WRAPPING | OPAQUE | {"sort", "top_k", "argmax", "argmin"}
# Tests of single points, which guard them.
EQUALITIES = {"eq", "ne", "is_finite"}


class Use(NamedTuple):
    """An equation of a program, entered by what depends on the given arguments.

    Attributes:
        eqn: The equation.
        enters: Which of its operands depend on them.
        is_looped: Whether it stands in a loop, where values can't be asked for.
    """

    eqn: Equation
    enters: Sequence[bool]
    is_looped: bool


def kinks(program: Program) -> list[Use]:
    """The operations of a function of time that may make kinks or jumps.

    Args:
        program: The function of one argument, traced.
    """
    return [use for use in uses(program) if _is_one(use.eqn, _KINKED) and not _is_empty(use.eqn)]


def may_jump(program: Program, arguments: int) -> bool:
    """Whether a function may jump in its last arguments, by the operations in it.

    Args:
        program: The function, traced.
        arguments: How many the last arguments are.
    """
    others = len(parts(program).inputs) - arguments
    found = uses(program, (False,) * others + (True,) * arguments)
    return any((_is_one(use.eqn, _LEAPING) or _divides(use)) and not _is_empty(use.eqn) for use in found)


def as_times(times: Any) -> Array:
    """Break times as a one-dimensional array of floats, however they were given."""
    return jnp.atleast_1d(jnp.asarray(times, dtype=float))


def uses(program: Program, depends: Sequence[bool] = (True,), is_looped: bool = False) -> Iterator[Use]:
    """The equations that a dependent number enters, inner ones included; `depends` says which arguments are such."""
    made_of = parts(program)
    seen = {var for var, is_such in zip(made_of.inputs, depends, strict=True) if is_such}
    for eqn in made_of.equations:
        enters = [not is_literal(var) and var in seen for var in eqn.inputs]
        if any(enters):
            seen.update(eqn.outputs)
            use = Use(eqn, enters, is_looped)
            yield use
            yield from _inner_uses(use)


def _inner_uses(use: Use) -> Iterator[Use]:
    if use.eqn.name == "custom_jvp_call":
        return
    chosen, body = branches(use.eqn), called(use.eqn) if use.eqn.name in CALLS else None
    if chosen is not None or body is not None:
        for inner in chosen or (body,):
            yield from uses(inner, use.enters[1:] if chosen else use.enters, use.is_looped)
    else:
        for inner in programs_in(use.eqn.params):
            yield from uses(inner, list(map(is_real, parts(inner).inputs)), True)


def _is_one(eqn: Equation, names: set[str]) -> bool:
    return eqn.name in names or _decides(eqn)


def _decides(eqn: Equation) -> bool:
    """Whether it makes something else of real numbers, whose steps are jumps."""
    is_made_of_others = eqn.name in EQUALITIES or any(True for _ in programs_in(eqn.params))
    return not is_made_of_others and any(map(is_real, eqn.inputs)) and not all(map(is_real, eqn.outputs))


def _divides(use: Use) -> bool:
    """Whether it divides by a dependent number, as in `x / abs(x)`."""
    return use.eqn.name == "div" and use.enters[1]


def _is_empty(eqn: Equation) -> bool:
    """Whether it makes no number at all, as a comparison with no switching times does."""
    return all(0 in shape_of(var) for var in eqn.outputs)


def is_real(value: Any) -> bool:
    """Whether a variable or literal of a program is a real number."""
    return jnp.issubdtype(dtype_of(value), jnp.inexact)
