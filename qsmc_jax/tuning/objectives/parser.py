"""Objectives and constraints from texts."""

import ast
from typing import Any, TypeVar

from qsmc_jax.base.errors import InputError
from qsmc_jax.tuning.objectives.objective import Constraint, Objective
from qsmc_jax.tuning.objectives.statistics import cvar, least, mean, violation, worst
from qsmc_jax.tuning.terms import METRICS as METRICS

_Kind = TypeVar("_Kind")
_FUNCTIONS: dict[str, Any] = {"mean": mean, "cvar": cvar, "worst": worst, "least": least}


def parse_objective(text: "str | Objective") -> Objective:
    """An objective from a text such as `cvar(peak_error[0], 0.9) + 0.01 * mean(energy_u)`.

    Args:
        text: The text; an objective is given back as it is.

    Raises:
        InputError: The text is not of that form.

    Examples:
        >>> import qsmc_jax as qj
        >>> str(qj.objectives.parse_objective("cvar(peak_error[0], 0.9) - 2 * mean(energy_u)"))
        'cvar(peak_error[0], 0.9) - 2 * mean(energy_u)'
    """
    return _parsed(text, Objective, f"Argument `objective` must be a sum of statistics, but is `{text}`.")


def parse_constraint(text: "str | Constraint") -> Constraint:
    """A constraint from a text such as `worst(peak_u) <= 20` or `violation <= 0.01`.

    Args:
        text: The text; a constraint is given back as it is.

    Raises:
        InputError: The text is not of that form.

    Examples:
        >>> import qsmc_jax as qj
        >>> qj.objectives.parse_constraint("worst(peak_u) <= 20").bound
        20.0
    """
    return _parsed(text, Constraint, f"Argument `subject_to` must be a comparison with a number, not `{text}`.")


def _parsed(text: "str | _Kind", kind: type[_Kind], message: str) -> _Kind:
    """What the text says, which must be of that kind."""
    if isinstance(text, kind):
        return text
    argument = "objective" if kind is Objective else "subject_to"
    try:
        made = _read(ast.parse(str(text).strip(), mode="eval").body)
    except (SyntaxError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
        raise InputError(
            f"Argument `{argument}` must be made of mean(m), cvar(m, level), worst(m) and least(m), such as "
            f"cvar(peak_error[0], 0.9) + 0.01 * mean(energy_u) or worst(peak_u) <= 20, but is `{text}`."
        ) from None
    if not isinstance(made, kind):
        raise InputError(message)
    return made


def _read(node: ast.AST) -> Any:
    """The value of an expression of numbers, statistics, +, -, * and one comparison; nothing else is evaluated."""
    match node:
        case ast.Constant(value=int() | float() as number):
            return float(number)
        case ast.Call(func=ast.Name(id=name), args=[metric, *rest], keywords=[]):
            return _FUNCTIONS[name](ast.unparse(metric).strip("'\""), *map(_read, rest))
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return -1.0 * _read(inner)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return _read(left) + _read(right)
        case ast.BinOp(left=left, op=ast.Sub(), right=right):
            return _read(left) - _read(right)
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            return _read(left) * _read(right)
        case ast.Compare(left=ast.Name(id="violation"), ops=[ast.LtE()], comparators=[bound]):
            return violation(_read(bound))
        case ast.Compare(left=left, ops=[ast.LtE()], comparators=[bound]):
            return _read(left) <= _read(bound)
        case ast.Compare(left=left, ops=[ast.GtE()], comparators=[bound]):
            return _read(left) >= _read(bound)
    raise TypeError
