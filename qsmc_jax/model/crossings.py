"""Where a function switches from one smooth piece to another, and whether its values jump there.

A program is run along with its decisions: which side of a comparison, which piece of a `floor`, which sign in an `abs`.
Between two points of different decisions there is a switch; halving finds it to the last digit, where the values on
either side are compared. So a piece is found however narrow it is, as long as two points lie on different sides of one
of its edges, and what joins there is told from what jumps.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal
from jaxtyping import Array, Bool, Float

from qsmc_jax.model.kinks import CALLS, is_real

# At each call, so that a function is compiled once for however many points it is asked.
BATCH = 512
_HALVINGS = 80  # from 1e-6 to 1e-30 at zero; elsewhere to neighbouring floats, long before
_NEAR, _LEAST_NEAR = 1e-7, 1e-10  # distance from a switch, relative and at zero, at which a jump must still show
_FLOATS = 4
_ROUNDING = 1e-7
_SAME = 10.0  # within this factor a step is as high from afar as from near by: no pole, and no slope
_EQUALITIES = {"eq", "ne", "is_finite"}  # of single points

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
UNDERSTOOD = set(_DECISIONS) | {"lt", "le", "gt", "ge", "lt_to", "le_to", "argmax", "argmin", "convert_element_type"}
UNDERSTOOD |= {"reduce_max", "reduce_min"}


def with_decisions(fn: Callable[..., Any], point: Sequence[Any]) -> tuple[Any, Float[Array, " decisions"]]:
    """What a function of real numbers returns, and all decisions on the way.

    Args:
        fn: The function; it returns an array.
        point: Its arguments.
    """
    closed = jax.make_jaxpr(fn)(*point)
    decided: list[Array] = []
    (value,) = _run(closed.jaxpr, closed.consts, point, decided)
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


def in_batches(fn: Callable[[Any], Any], points: np.ndarray) -> Any:
    """`fn` at any number of points, `BATCH` of them at a time; NumPy arrays, a row a point."""
    rest = -len(points) % BATCH
    padded = np.concatenate([points, np.broadcast_to(points[:1], (rest, *points.shape[1:]))]) if rest else points
    parts = [jax.tree.map(np.asarray, fn(padded[i : i + BATCH])) for i in range(0, len(padded), BATCH)]
    return jax.tree.map(lambda *rows: np.concatenate(rows)[: len(points)], *parts)


def _run(jaxpr: Jaxpr, consts: Sequence[Any], arguments: Sequence[Any], decided: list[Array]) -> list[Any]:
    """The results of a program; its decisions are appended."""
    known = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*consts, *arguments], strict=True))
    read = lambda var: var.val if isinstance(var, Literal) else known[var]  # noqa: E731 - a look-up, used twice
    for eqn in jaxpr.eqns:
        values = _results(eqn, [read(var) for var in eqn.invars], decided)
        known.update(zip(eqn.outvars, values, strict=True))
    return [read(var) for var in jaxpr.outvars]


def _results(eqn: JaxprEqn, operands: list[Any], decided: list[Array]) -> Sequence[Any]:
    name, params = eqn.primitive.name, eqn.params
    if name == "cond":
        index, *given = operands
        branches = [_run(branch.jaxpr, branch.consts, given, decided) for branch in params["branches"]]
        return [jax.lax.select_n(index, *outs) for outs in zip(*branches, strict=True)]
    if name in CALLS or name in ("custom_jvp_call", "custom_vjp_call"):
        inner = params["jaxpr"] if "jaxpr" in params else params["call_jaxpr"]
        consts, body = (inner.consts, inner.jaxpr) if isinstance(inner, ClosedJaxpr) else ((), inner)
        return _run(body, consts, operands, decided)
    made = eqn.primitive.bind(*operands, **eqn.primitive.get_bind_params(params))
    outs = made if eqn.primitive.multiple_results else [made]
    decided.extend(jnp.ravel(decision).astype(float) for decision in _decisions(eqn, operands, outs))
    return outs


def _decisions(eqn: JaxprEqn, operands: list[Any], outs: Sequence[Any]) -> list[Any]:
    name = eqn.primitive.name
    if name in _EQUALITIES or not any(map(is_real, eqn.invars)):
        return []
    if name in _DECISIONS:
        return [_DECISIONS[name](outs[0], *operands)]
    if name in ("reduce_max", "reduce_min"):
        return [operands[0] == jnp.expand_dims(outs[0], eqn.params["axes"])]
    return [out for var, out in zip(eqn.outvars, outs, strict=True) if not is_real(var)]
