"""Whether what a plant computes is continuous in the state."""

import functools as ft
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from qsmc_jax.base.checks import is_traced, show
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.precision import entry_point
from qsmc_jax.model.components import components
from qsmc_jax.model.crossings import first_jump, lines_along, with_decisions
from qsmc_jax.model.kinks import may_jump
from qsmc_jax.tracing.traceable import once_per_structure, trace

# The disturbance while the state is looked at: not 0, by which what jumps may be multiplied.
_DISTURBANCE = 0.7320508


def require_no_state_jumps(plant: Any) -> None:
    """Raises if what a plant computes is found to jump as a function of the state; traced numbers pass."""
    for method in _suspects(plant):
        require_continuous(plant, method)


@once_per_structure
def _suspects(plant: Any) -> tuple[str, ...]:
    """The components whose operations may jump in the state."""
    number = jax.ShapeDtypeStruct((), float)
    found = []
    for method, component in components(plant).items():
        call = lambda plant, t, *x, component=component: component(plant, t, x, _DISTURBANCE)  # noqa: E731
        program, _ = trace(f"`{method}`", "a time and a state", plant, call, number, *(number,) * plant.states)
        if may_jump(program, plant.states):
            found.append(method)
    return tuple(found)


def require_continuous(plant: Any, method: str) -> None:
    """Raises if a component is found to jump as a function of the state; traced numbers pass.

    The function is followed along each axis of the state, through states and times of many sizes, and where it
    switches its values are compared: see crossings.py. What joins passes, and what jumps in time only. So does what
    can't be followed: inside a loop, in a call out of JAX, or with a traced number in its closure.

    Args:
        plant: The plant.
        method: Its name in `components`, such as `drift`.
    """
    if is_traced(plant):
        return
    try:
        found = _first_jump(plant, method)
    except (jax.errors.UnexpectedTracerError, NotImplementedError):
        return
    if found is None:
        return
    t, x, before, after = found
    name, state = f"`{method}` of `{type(plant).__name__}`", ", ".join(map(show, x))
    raise InputError(
        f"{name} must be continuous in the state, but jumps from {show(before)} to {show(after)} at t = {show(t)}, "
        f"x = ({state}). A loop may stick on such a jump, where no solver goes on. Round it over a width that does "
        "not matter to you: `qj.smoothed.sign(v, width)` for `jnp.sign(v)`, `qj.smoothed.step(v, width)` for "
        "`jnp.where(v > 0, 1, 0)`, `qj.smoothed.dead_zone` or `qj.smoothed.stribeck`. Jumps in time may stay."
    )


@entry_point
def _first_jump(plant: Any, method: str) -> tuple[Any, ...] | None:
    """Time, state, and the values before and after a jump; None if there is none."""
    evaluated, coordinates = ft.partial(_evaluated, plant, method), 1 + plant.states
    for axis in range(1, coordinates):
        found = first_jump(evaluated, lines_along(coordinates, axis), axis)
        if found is not None:
            at, before, after = found
            return at[0], at[1:], before, after
    return None


@eqx.filter_jit
def _evaluated(plant: Any, method: str, points: Any) -> tuple[Any, Any]:
    """Value and decisions at points (t, x), a row each."""

    def function(t: Any, *x: Any) -> Any:
        return jnp.asarray(components(plant)[method](plant, t, x, _DISTURBANCE), dtype=float)

    return jax.vmap(lambda point: with_decisions(function, tuple(point)))(points)
