"""Where a function switches from one smooth piece to another, and whether its values jump there.

A program is run along with its decisions: which side of a comparison, which piece of a `floor`, which sign in an `abs`.
Between two points of different decisions there is a switch; halving finds it to the last digit, where the values on
either side are compared. So a piece is found however narrow it is, as long as two points lie on different sides of one
of its edges, and what joins there is told from what jumps.
"""

import functools as ft
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from qsmc_jax.model.kinks import EQUALITIES, is_real
from qsmc_jax.tracing.programs import Equation, branches, called, computed, evaluated

# At each call, so that a function is compiled once for however many points it is asked.
BATCH = 512
_HALVINGS = 80  # from 1e-6 to 1e-30 at zero; elsewhere to neighbouring floats, long before
_NEAR, _LEAST_NEAR = 1e-7, 1e-10  # distance from a switch, relative and at zero, at which a jump must still show
_FLOATS = 4
_ROUNDING = 1e-7
_SAME = 10.0  # within this factor a step is as high from afar as from near by: no pole, and no slope

# What each decides, of its result and its operands. Any other decides by its integers, if it makes some of reals.
_DECISIONS: dict[str, Callable[..., Any]] = {
    "sign": lambda out, x: out,
    "floor": lambda out, x: out,
    "ceil": lambda out, x: out,
    "round": lambda out, x: out,
    "rem": lambda out, x, y: jnp.round((x - out) / y),
    "bitcast_convert_type": lambda out, x: jnp.sign(x),
    "abs": lambda out, x: jnp.sign(x),
    "max": lambda out, x, y: x > y,
    "min": lambda out, x, y: x > y,
    "clamp": lambda out, low, x, high: 1.0 * (x > low) + (x > high),
    "div": lambda out, x, y: jnp.sign(x) + 3.0 * jnp.sign(y),
    "atan2": lambda out, y, x: jnp.sign(y) + 3.0 * jnp.sign(x),
    "tan": lambda out, x: jnp.floor(x / jnp.pi + 0.5),
    "stop_gradient": lambda out, x: jnp.zeros(0),
}
_BASES = 24  # points through which the axes are followed
_MOST = 2048  # switches looked at along an axis
UNDERSTOOD = set(_DECISIONS) | {"lt", "le", "gt", "ge", "lt_to", "le_to", "argmax", "argmin", "convert_element_type"}
UNDERSTOOD |= {"reduce_max", "reduce_min"}


def with_decisions(fn: Callable[..., Any], point: Sequence[Any]) -> tuple[Any, Float[Array, " decisions"]]:
    """What a function of real numbers returns, and all decisions on the way.

    Args:
        fn: The function; it returns an array.
        point: Its arguments.
    """
    decided: list[Array] = []
    (value,) = evaluated(jax.make_jaxpr(fn)(*point), point, ft.partial(_results, decided=decided))
    return value, jnp.concatenate([jnp.zeros(0), *decided])


def switches(decisions: Callable[[Any], Any], low: np.ndarray, high: np.ndarray, most: int) -> tuple[Any, Any]:
    """Neighbouring points on either side of switches between pairs of points.

    Args:
        decisions: The decisions at points, (points, decisions).
        low: Points, (pairs, coordinates).
        high: Points that differ from them in one coordinate each.
        most: Most switches to look for; of more, some evenly chosen.

    Returns:
        The points below and above each switch, (switches, coordinates) each.
    """
    before, after = decisions(low), decisions(high)
    pairs, which = np.nonzero((before != after) & np.isfinite(before) & np.isfinite(after))
    if len(pairs) > most:
        kept = np.linspace(0, len(pairs) - 1, most).astype(int)
        pairs, which = pairs[kept], which[kept]
    a, b, wanted = low[pairs], high[pairs], before[pairs, which]
    for _ in range(_HALVINGS if len(pairs) else 0):
        middle = a + 0.5 * (b - a)
        is_before = (decisions(middle)[np.arange(len(pairs)), which] == wanted)[:, None]
        a, b = np.where(is_before, middle, a), np.where(is_before, b, middle)
    return a, b


def jumps(
    values: Callable[[Any], Any], a: np.ndarray, b: np.ndarray, negligible: Any = 0.0
) -> tuple[Bool[np.ndarray, "..."], Any, Any]:
    """Whether values jump between neighbouring points, and the values a little before and a little after them.

    A jump is as high between neighbouring floats as between points somewhat farther away, and higher than what the
    values change on either side: where values join, the difference falls with the distance; at a pole it grows.

    Args:
        values: The values at points, (points, values).
        a: Points before, (switches, coordinates).
        b: Points after, each differing in one coordinate.
        negligible: Height of a jump that is none.
    """
    size, side = np.maximum(np.abs(a), np.abs(b)), np.sign(b - a)
    # Not the very points of the switch, at one of which `x / abs(x)` is not defined.
    next_to, near = _FLOATS * np.spacing(size) * side, np.maximum(_NEAR * size, _LEAST_NEAR) * side
    points = (a - next_to, b + next_to, a - near, b + near)
    before, after, lower, upper = map(values, points)
    with np.errstate(invalid="ignore"):  # what is not finite is not greater either
        step, wide = np.abs(after - before), np.abs(upper - lower)
        slope = np.maximum(np.abs(before - lower), np.abs(upper - after))
        is_high = step > np.maximum(_ROUNDING * np.maximum(np.abs(before), np.abs(after)), negligible)
        is_jump = is_high & (step * _SAME >= slope) & (step <= wide * _SAME) & np.isfinite(wide)
    return is_jump, lower, upper


def first_jump(
    evaluated: Callable[[Any], tuple[Any, Any]], lines: np.ndarray, axis: int
) -> tuple[np.ndarray, Any, Any] | None:
    """The point, and the values before and after a jump of a function along lines; None if none is found.

    Where the function switches its values are compared.

    Args:
        evaluated: Value and decisions at points, a row each.
        lines: Points, (lines, points, coordinates), in order along each line.
        axis: The coordinate in which neighbours differ.
    """

    def ask(which: int, points: np.ndarray) -> Any:
        return in_batches(lambda batch: evaluated(batch)[which], points)

    low, high = (part.reshape(-1, lines.shape[-1]) for part in (lines[:, :-1], lines[:, 1:]))
    a, b = switches(ft.partial(ask, 1), low, high, _MOST)
    if len(a) == 0:
        return None
    is_jump, lower, upper = jumps(ft.partial(ask, 0), a, b)
    if not np.any(is_jump):
        return None
    first = int(np.argmin(np.where(is_jump, np.abs(b[:, axis]), np.inf)))
    at = np.where(np.abs(b[first]) < 1e-12, 0.0, b[first])  # the halving of zero ends in 1e-30
    return at, lower[first], upper[first]


def lines_along(coordinates: int, axis: int) -> np.ndarray:
    """Points of many sizes along an axis, (lines, points, coordinates); the first lines go through the origin.

    Args:
        coordinates: How many numbers make a point; the first is a time [s].
        axis: The coordinate along which they go.
    """
    generator = np.random.default_rng(0)
    sizes = 10.0 ** generator.uniform(-3.0, 3.0, (_BASES, coordinates))
    sizes[:, 1:] *= generator.choice([-1.0, 1.0], (_BASES, coordinates - 1))
    sizes[:4] = np.outer([0.0, 1.0, -1.0, 0.1], np.ones(coordinates))
    sizes[:4, 0] = np.abs(sizes[:4, 0])
    # Sizes from 1e-6 to 1e6, and evenly spaced numbers for what repeats itself, by a step that is no round one.
    along = np.concatenate([np.logspace(-6.0, 6.0, 49), np.arange(1, 41) * 0.2618034])
    along = np.sort(np.concatenate([-1.1 * along, along]))  # of which no halving ends at zero itself
    lines = np.repeat(sizes[:, None, :], len(along), axis=1)
    lines[:, :, axis] = along
    return lines


def in_batches(fn: Callable[[Any], Any], points: np.ndarray) -> Any:
    """`fn` at any number of points, `BATCH` of them at a time; NumPy arrays, a row a point."""
    rest = -len(points) % BATCH
    padded = np.concatenate([points, np.broadcast_to(points[:1], (rest, *points.shape[1:]))]) if rest else points
    parts = [jax.tree.map(np.asarray, fn(padded[i : i + BATCH])) for i in range(0, len(padded), BATCH)]
    return jax.tree.map(lambda *rows: np.concatenate(rows)[: len(points)], *parts)


def _results(eqn: Equation, operands: list[Any], decided: list[Array]) -> Sequence[Any]:
    """The results of an operation; its decisions are appended."""
    inside = ft.partial(_results, decided=decided)
    chosen, body = branches(eqn), called(eqn)
    if chosen is not None:
        index, *given = operands
        outcomes = [evaluated(branch, given, inside) for branch in chosen]
        return [jax.lax.select_n(index, *outs) for outs in zip(*outcomes, strict=True)]
    if body is not None:
        return evaluated(body, operands, inside)
    outs = computed(eqn, operands)
    decided.extend(jnp.ravel(decision).astype(float) for decision in _decisions(eqn, operands, outs))
    return outs


def _decisions(eqn: Equation, operands: list[Any], outs: Sequence[Any]) -> list[Any]:
    if eqn.name in EQUALITIES or not any(map(is_real, eqn.inputs)):
        return []
    if eqn.name in _DECISIONS:
        return [_DECISIONS[eqn.name](outs[0], *operands)]
    if eqn.name in ("reduce_max", "reduce_min"):
        return [operands[0] == jnp.expand_dims(outs[0], eqn.param("axes"))]
    return [out for var, out in zip(eqn.outputs, outs, strict=True) if not is_real(var)]
