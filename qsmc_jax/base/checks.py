"""Checks of arguments, with one wording: what must hold, what it is instead, what to do.

A value that is being traced has no number yet and passes: whatever it breaks then shows per run, as INADMISSIBLE.
"""

import difflib
import operator
from collections.abc import Iterable
from inspect import isabstract
from typing import Any

import jax
import numpy as np
from jax.core import Tracer

from qsmc_jax.base.errors import InputError


def is_hashable(value: Any) -> bool:
    """Whether a value has a hash."""
    try:
        hash(value)
    except TypeError:
        return False
    return True


def is_traced(*values: Any) -> bool:
    """Whether any of the values (leaves of pytrees) is a tracer."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))


def require(condition: bool, message: str) -> None:
    """Raises `InputError(message)` unless the condition holds."""
    if not condition:
        raise InputError(message)


def require_kind(name: str, value: Any, kind: type, hint: str) -> None:
    """Raises unless `value` is an instance of a class; `hint` says how to make one."""
    if not isinstance(value, kind):
        is_class = isinstance(value, type)
        found = f"the class `{value.__name__}` itself" if is_class else f"of class `{type(value).__name__}`"
        if is_class and issubclass(value, kind) and not isabstract(value):
            hint = f"Call it: `{value.__name__}(...)`."
        raise InputError(f"Argument `{name}` must be of class `{kind.__name__}`, but is {found}. {hint}".rstrip())


def require_list(name: str, values: Any) -> None:
    """Raises if `values` is a text, which would come apart into its letters, instead of a list of texts."""
    require(not isinstance(values, str), f"Argument `{name}` must be a list, but is a text: write [{values!r}].")


def require_count(name: str, value: Any, least: int = 1) -> None:
    """Raises unless `value` is a whole number and at least `least`."""
    require(is_whole(value), f"Argument `{name}` must be a whole number, but is {value!r}.")
    require(value >= least, f"Argument `{name}` must be at least {least}, but is {value}.")


def is_whole(value: Any) -> bool:
    """Whether Python takes `value` for an index, and it is no truth value."""
    try:
        operator.index(value)
    except TypeError:
        return False
    return not isinstance(value, bool)


def nearest(name: str, names: Iterable[str]) -> str:
    """A question that proposes the most similar of the names, with a space before it; nothing if none is similar."""
    found = difflib.get_close_matches(name, list(names), n=1, cutoff=0.5)
    return f" Did you mean `{found[0]}`?" if found else ""


def require_finite(name: str, value: Any) -> None:
    """Raises unless every entry of `value` is finite."""
    if not is_traced(value):
        ok = bool(np.all(np.isfinite(np.asarray(value))))
        require(ok, f"Argument `{name}` must be finite, but is {show(value)}.")


def require_positive(name: str, value: Any) -> None:
    """Raises unless every entry of `value` is positive and finite."""
    if not is_traced(value):
        ok = bool(np.all(np.isfinite(np.asarray(value)) & (np.asarray(value) > 0)))
        require(ok, f"Argument `{name}` must be positive and finite, but is {show(value)}.")


def require_nonnegative(name: str, value: Any) -> None:
    """Raises unless every entry of `value` is finite and at least zero."""
    if not is_traced(value):
        ok = bool(np.all(np.isfinite(np.asarray(value)) & (np.asarray(value) >= 0)))
        require(ok, f"Argument `{name}` must be finite and not negative, but is {show(value)}.")


def require_range(name: str, limits: Any) -> None:
    """Raises unless there are two numbers, the smaller one first; they may be infinite."""
    require(np.shape(limits) == (2,), f"Argument `{name}` must be two numbers, but has shape {np.shape(limits)}.")
    if not is_traced(limits):
        low, high = map(float, limits)
        require(low < high, f"Argument `{name}` must have low < high, but is ({show(low)}, {show(high)}).")


def require_sign(name: str, value: Any) -> None:
    """Raises unless every entry of `value` is 1 or -1."""
    if not is_traced(value):
        ok = bool(np.all(np.abs(np.asarray(value)) == 1.0))
        require(ok, f"Argument `{name}` must be 1 or -1, but is {show(value)}. It is the sign of g.")


def require_fraction(name: str, value: Any) -> None:
    """Raises unless `value` lies strictly between 0 and 1."""
    require(bool(0.0 < value < 1.0), f"Argument `{name}` must lie strictly between 0 and 1, but is {value}.")


def require_shape(name: str, value: Any, shape: tuple[int, ...], why: str) -> None:
    """Raises unless `value` has the given shape; `why` says where the shape comes from."""
    is_shape = np.shape(value)
    require(
        is_shape == shape,
        f"Argument `{name}` must have shape {shape} ({why}), but has shape {is_shape}.",
    )


def show(value: Any) -> str:
    """A number or short array as a person would write it."""
    array = np.asarray(value)
    return f"{array:.6g}" if array.ndim == 0 and array.dtype.kind == "f" else str(array.tolist())
