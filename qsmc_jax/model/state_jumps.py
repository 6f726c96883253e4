"""Whether what a plant computes is continuous in the state."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from qsmc_jax.base.checks import is_traced, show
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.precision import entry_point
from qsmc_jax.model.components import components
from qsmc_jax.model.crossings import in_batches, jumps, switches, with_decisions
from qsmc_jax.model.kinks import may_jump
from qsmc_jax.tracing.traceable import once_per_structure, trace

# The disturbance while the state is looked at: not 0, by which what jumps may be multiplied.
_DISTURBANCE = 0.7320508
_BASES = 24  # states through which the axes are followed
_MOST = 2048  # switches looked at along an axis


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

    def ask(which: int, points: np.ndarray) -> Any:
        return in_batches(lambda batch: _evaluated(plant, method, batch)[which], points)

    for axis in range(plant.states):
        lines = _lines(plant.states, axis)
        low, high = (part.reshape(-1, plant.states + 1) for part in (lines[:, :-1], lines[:, 1:]))
        a, b = switches(lambda points: ask(1, points), low, high, _MOST)
        if len(a) == 0:
            continue
        is_jump, lower, upper = jumps(lambda points: ask(0, points), a, b)
        if np.any(is_jump):
            first = int(np.argmin(np.where(is_jump, np.abs(b[:, 1 + axis]), np.inf)))
            at = np.where(np.abs(b[first]) < 1e-12, 0.0, b[first])  # the halving of zero ends in 1e-30
            return at[0], at[1:], lower[first], upper[first]
    return None


@eqx.filter_jit
def _evaluated(plant: Any, method: str, points: Any) -> tuple[Any, Any]:
    """Value and decisions at points (t, x), a row each."""

    def function(t: Any, *x: Any) -> Any:
        return jnp.asarray(components(plant)[method](plant, t, x, _DISTURBANCE), dtype=float)

    return jax.vmap(lambda point: with_decisions(function, tuple(point)))(points)


def _lines(order: int, axis: int) -> np.ndarray:
    """Points (t, x) along an axis of the state, (lines, points, 1 + n); the first lines go through the origin."""
    generator = np.random.default_rng(0)
    sizes = 10.0 ** generator.uniform(-3.0, 3.0, (_BASES, order + 1))
    sizes[:, 1:] *= generator.choice([-1.0, 1.0], (_BASES, order))
    sizes[:4] = np.outer([0.0, 1.0, -1.0, 0.1], np.ones(order + 1))
    sizes[:4, 0] = np.abs(sizes[:4, 0])
    # Sizes from 1e-6 to 1e6, and evenly spaced numbers for what repeats itself, by a step that is no round one.
    along = np.concatenate([np.logspace(-6.0, 6.0, 49), np.arange(1, 41) * 0.2618034])
    along = np.sort(np.concatenate([-1.1 * along, along]))  # of which no halving ends at zero itself
    lines = np.repeat(sizes[:, None, :], len(along), axis=1)
    lines[:, :, 1 + axis] = along
    return lines
