"""Whether a function of the signals jumps where nobody said that it may."""

import functools as ft
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np

from qsmc_jax.base.checks import is_traced, show
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.precision import entry_point
from qsmc_jax.metrics.metric import AbstractFunction
from qsmc_jax.metrics.signals import Signals
from qsmc_jax.model.crossings import first_jump, lines_along, with_decisions
from qsmc_jax.model.kinks import may_jump
from qsmc_jax.tracing.digest import digest
from qsmc_jax.tracing.programs import Program, parts

_SAME_TIME = 1e-9
_ROUNDED = "Round it over a width that does not matter to you, as `qj.smoothed.step(v, width)` does"


def require_no_jump(what: str, part: AbstractFunction, program: Program, start: Signals, horizon: float) -> None:
    """Raises if a function of the signals is found to jump inside its window.

    It is followed along each signal, as if the others had no part in it; what can't be followed passes.

    Args:
        what: The function, as the subject of a message.
        part: What is kept of it.
        program: The function, traced.
        start: The signals at the start of a run, for their names.
        horizon: The longest horizon of any run [s].

    Raises:
        InputError: It jumps.
    """
    structure = jax.tree.structure(start)
    if part.jumps or not may_jump(program, structure.num_leaves) or is_traced(list(parts(program).constants.values())):
        return
    try:
        found = _first_jump(part, digest(program), structure, min(part.before, horizon))
    except (jax.errors.UnexpectedTracerError, NotImplementedError):
        return
    if found is None:
        return
    name, place, *values = found
    windows = "Make one of each window, by `after` and `before`" if name == "t" else _ROUNDED
    raise InputError(
        f"{what} must not jump inside a step, where nothing looks for it, but does where `{name}` is {show(place)}, "
        f"between {' and '.join(map(show, values))}. {windows}. A metric that need be right to the length of a "
        "step only may say `jumps=True`."
    )


# By the program too: a function may close over a number that has changed. A study that is varied asks again and again.
@ft.lru_cache(maxsize=256)
@entry_point
def _first_jump(part: AbstractFunction, program: str, structure: Any, end: float) -> tuple[str, Any, Any, Any] | None:
    """The signal, its value, and the values of the function before and after; None if no jump is found."""
    names = _names(jax.tree.unflatten(structure, range(structure.num_leaves)))

    def function(*point: Any) -> Any:
        return part.value(jax.tree.unflatten(structure, point))

    evaluated = eqx.filter_jit(jax.vmap(lambda point: with_decisions(function, tuple(point))))
    for axis, name in enumerate(names):
        found = first_jump(evaluated, _onto(names, part.after, end, lines_along(len(names), axis)), axis)
        if found is not None:
            at, before, after = found
            return name, at[axis], before, after
    return None


def _names(start: Signals) -> list[str]:
    """The signals' names, one for each number."""
    named, _ = jax.tree_util.tree_flatten_with_path(start)
    return [jax.tree_util.keystr(path).lstrip(".") for path, _ in named]


def _onto(names: Sequence[str], begin: float, end: float, points: np.ndarray) -> np.ndarray:
    """Points at which signals may be: times in the window, positive widths, and ratios inside the funnel."""
    made = points.copy()
    for i, name in enumerate(names):
        values = points[..., i]
        if name == "t":
            made[..., i] = begin + _SAME_TIME + (end - begin - 2.0 * _SAME_TIME) * _part(np.abs(values))
        elif name.startswith("rho"):
            made[..., i] = np.abs(values) + 1e-9
        elif name.startswith("ratio"):
            made[..., i] = np.sign(values) * _part(np.abs(values))
    return made


def _part(size: np.ndarray) -> np.ndarray:
    """Any size, as a number between 0 and 1."""
    return size / (1.0 + size)
