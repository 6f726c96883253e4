r"""From when on a run that keeps its funnel must keep the bounds on its errors: the settling time $t_s$.

It is the first time $t_s \ge t_r$ from which the envelope $|C_i e^{At} E(0)| + \int_0^t |h_i(t - s)| \rho(s) ds$
(for i = n - 1 plus $\rho(t)$) of every error stays inside its bound $\varepsilon \|G_i\|_1$. Before it the theorem
promises nothing, from it on everything.

For n = 1 it is $t_r$, for n = 2 the root of a sum of two exponentials. Beyond, the envelope is followed along cells
that grow with time, over a table that depends on the surface alone, so that a study whose surface is fixed pays for the
table once. A funnel that is not exponential counts as one that is, around it: its time is later than need be.
"""

import functools as ft
import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import is_traced
from qsmc_jax.base.module import as_float64
from qsmc_jax.base.precision import entry_point
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.control.error_bounds import companion, damping_ratio, pole_bound, short_exponential, variations
from qsmc_jax.control.funnel import AbstractFunnel, Funnel
from qsmc_jax.numerics import pytrees
from qsmc_jax.numerics.hurwitz import is_hurwitz

_NEWTON_STEPS = 8
_LATER = 1e-6  # of the time beyond t_r: so that what rounding and Newton leave is on the late side
_PANELS = 18  # together 3e5 / R long, for a bound R on the poles
_CELLS = 16  # a panel: each some 3 to 6 % of the time
_FIRST_CELL = 0.0625  # times R
_TRACED_PARTS = 2  # of a cell, for the maxima and integrals in it
_MOST_PARTS = 512


class _Width(NamedTuple):
    """A width as the table is given it: that of a funnel, or a constant one."""

    rho0: RealScalarLike
    mu: RealScalarLike
    rho_inf: RealScalarLike


class _Table(NamedTuple):
    """What the envelope needs of a surface, in units of a bound on its poles; one row per panel, but for `units`.

    Attributes:
        units: The bound to the powers n - 1 ... 0: what e^(i) is multiplied by.
        start, cell: Where the panel starts, and the length of its cells.
        responses: Errors without sliding variable at the ends of the cells, over the errors at time 0.
        deviations: How far these stray from a straight line in a cell.
        masses: Integrals of |h_i| over each cell.
        integrals: Their sums up to the ends of the cells.
        strays: How far these stray from a straight line in a cell.
    """

    units: Float[Array | np.ndarray, " n"]
    start: Float[Array | np.ndarray, " panels"]
    cell: Float[Array | np.ndarray, " panels"]
    responses: Float[Array | np.ndarray, "panels ends n c"]
    deviations: Float[Array | np.ndarray, "panels cells n c"]
    masses: Float[Array | np.ndarray, "panels cells n"]
    integrals: Float[Array | np.ndarray, "panels ends n"]
    strays: Float[Array | np.ndarray, "panels cells n"]


def settling_time(
    c: Float[Array | np.ndarray, " c"], funnel: AbstractFunnel, bandwidth: RealScalarLike, bounds: Scalars, e0: Scalars
) -> RealScalarLike:
    r"""The settling time $t_s$ [s] that the funnel guarantees, `inf` if there is none.

    It is never early. For n > 2 it is late by 1 % as a rule and up to 20 % where $|\mathrm{Im}| \le 3 |\mathrm{Re}|$
    for every pole, and by a tenth of the fastest pole's time constant at least; surfaces that oscillate more are given
    longer, and what has not settled after 3e5 such time constants never counts as settled. Gradients do not pass.

    Args:
        c: Coefficients of the surface, lowest derivative first.
        funnel: The funnel.
        bandwidth: Bandwidth $\varepsilon$ of the quasi-sliding mode, in units of the sliding variable.
        bounds: $\varepsilon \|G_i\|_1$, i = 0 ... n - 1.
        e0: Errors at time 0.
    """
    numbers = jax.tree.map(as_float64, (bandwidth, bounds, e0))
    c, funnel, bandwidth, bounds, e0 = pytrees.stop_gradient((c, funnel, *numbers))
    if len(e0) == 1:
        return funnel.reaching_time(bandwidth)
    return _settling_time(c, _table(c) if len(e0) > 2 else None, funnel, bandwidth, bounds, e0)


@entry_point
@eqx.filter_jit
def _settling_time(
    c: Float[Array | np.ndarray, " c"],
    table: "_Table | None",
    funnel: AbstractFunnel,
    bandwidth: RealScalarLike,
    bounds: Scalars,
    e0: Scalars,
) -> RealScalarLike:
    reached, around = funnel.reaching_time(bandwidth), funnel.enclosing(bandwidth)
    if table is None:
        later = _second_order(c[0], around, bandwidth, jnp.abs(e0[0]), around.reaching_time(bandwidth))
    else:
        later = _by_table(table, around, jnp.stack(bounds), jnp.stack(e0))
    if not isinstance(funnel, Funnel):
        level = 0.5 * (bandwidth + funnel.bandwidths[0])
        narrow = funnel.reaching_time(level)
        later = jnp.minimum(later, narrow + _once_narrow(c, table, level, around(0.0), bandwidth, bounds, e0))
    is_known = jnp.isfinite(reached) & jnp.all(is_hurwitz(c))
    return jnp.where(is_known, jnp.maximum(reached, later), jnp.inf)


def _once_narrow(
    c: Float[Array | np.ndarray, " c"],
    table: "_Table | None",
    level: RealScalarLike,
    widest: RealScalarLike,
    bandwidth: RealScalarLike,
    bounds: Scalars,
    e0: Scalars,
) -> RealScalarLike:
    """How long it takes at most from when on a funnel, `widest` before, is within a level below the bandwidth."""
    gains = jnp.stack(bounds) / bandwidth
    if table is None:
        e = jnp.maximum(jnp.abs(e0[0]), widest * gains[0])
        excess = (c[0] * e - level) / (bandwidth - level)
        return jnp.log(jnp.maximum(excess, 1.0)) / c[0] * (1.0 + _LATER)
    sizes, start = table._replace(responses=jnp.abs(table.responses)), jnp.abs(jnp.stack(e0) * table.units)[:-1]
    of_start = jnp.max(sizes.responses @ start, axis=(0, 1)) + jnp.max(sizes.deviations @ start, axis=(0, 1))
    constant = _Width(0.0, table.units[-2], level)
    return _by_table(sizes, constant, jnp.stack(bounds), of_start / table.units + widest * gains)


def _second_order(
    c: RealScalarLike, funnel: Funnel, bandwidth: RealScalarLike, e0: RealScalarLike, reached: RealScalarLike
) -> RealScalarLike:
    r"""For n = 2, where only the bound on e can hold out beyond $t_r$, since $|\dot e| \le c |e| + \rho$.

    From $t_r$ on $\rho \le \varepsilon$, so that the envelope falls as long as it is outside. A time v later it is
    beyond $\rho_\infty$ by $y = r e^{-cv} + c w (e^{-\mu v} - e^{-cv}) / (c - \mu)$, in units of
    $\varepsilon - \rho_\infty$. As ln y is convex or concave, Newton's method for ln y = 0 comes from one side.
    """
    mu, level = funnel.mu, bandwidth - funnel.rho_inf
    level = jnp.where(level > 0.0, level, 1.0)
    at_reached = jnp.where(jnp.isfinite(reached), reached, 0.0)
    start = c * e0 - funnel.rho_inf
    r = (start * jnp.exp(-c * at_reached) + c * funnel.rho0 * _lag(c, mu, at_reached)) / level
    w = funnel.rho0 * jnp.exp(-mu * at_reached) / level
    r = jnp.maximum(r, 1.0)  # inside already: the root is at v = 0
    v = jnp.zeros_like(r)
    for _ in range(_NEWTON_STEPS):
        lag = _lag(c, mu, v)
        y = r * jnp.exp(-c * v) + c * w * lag
        rate = c * (w * jnp.exp(-mu * v) - y)
        v = jnp.maximum(v - y * jnp.log(y) / jnp.where(rate < 0.0, rate, -jnp.inf), 0.0)
    return at_reached + v * (1.0 + _LATER)


def _lag(c: RealScalarLike, mu: RealScalarLike, t: RealScalarLike) -> RealScalarLike:
    r"""$\int_0^t e^{-c(t - s)} e^{-\mu s} ds = (e^{-\mu t} - e^{-ct}) / (c - \mu)$, also where both rates agree."""
    apart = jnp.abs(c - mu)
    is_same = apart * t < 1e-9
    part = -jnp.expm1(-apart * t) / jnp.where(is_same, 1.0, apart)
    return jnp.exp(-jnp.minimum(c, mu) * t) * jnp.where(is_same, t, part)


def _by_table(
    table: _Table, funnel: "Funnel | _Width", bounds: Float[Array, " n"], e0: Float[Array, " n"]
) -> Float[Array, ""]:
    """The end of the last cell, or of that part of it, in which an envelope reaches its bound."""
    rate = table.units[-2]
    scaled = dict(mu=funnel.mu / rate, bounds=bounds * table.units, e0=(e0 * table.units)[:-1])
    follow = ft.partial(_follow, funnel.rho0, funnel.rho_inf, **scaled)
    rows = table[1:]
    first = (jnp.zeros_like(bounds), jnp.zeros(()), jnp.array(False))
    (_, last, ends_outside), _ = jax.lax.scan(follow, first, rows)
    return jnp.where(ends_outside, jnp.inf, last / rate)


def _follow(
    rho0: RealScalarLike,
    rho_inf: RealScalarLike,
    carry: tuple[Array, Array, Array],
    row: tuple[Array, ...],
    *,
    mu: RealScalarLike,
    bounds: Float[Array, " n"],
    e0: Float[Array, " c"],
) -> tuple[tuple[Array, Array, Array], None]:
    r"""The last time outside after one more panel; carried with it, $\int_0^t |h_i(s)| e^{-\mu (t - s)} ds$."""
    (fading, last, _), (start, cell, responses, deviations, masses, integrals, strays) = carry, row
    x = mu * cell
    # As if |h_i| were the same all over a cell, and what the integral can be beyond that.
    lost = -jnp.expm1(-x)
    faded = lost / x * masses + jnp.minimum(lost, 4.0 / x) * strays
    shift = 1
    while shift < _CELLS:
        faded = faded + jnp.exp(-shift * x) * jnp.pad(faded[:-shift], ((shift, 0), (0, 0)))
        shift *= 2
    decays = jnp.exp(-x * np.arange(_CELLS + 1.0))[:, None]
    fading = decays * fading[None] + jnp.pad(faded, ((1, 0), (0, 0)))
    width = rho0 * jnp.exp(-mu * start) * decays + rho_inf
    own = jnp.pad(width, ((0, 0), (len(bounds) - 1, 0)))
    envelope = jnp.abs(responses @ e0) + rho_inf * integrals + rho0 * fading + own - bounds[None]
    # In a cell it runs exponentially from where it is to |h_i| / mu: above the straight line only if it rises.
    rise = jnp.maximum(masses / x - fading[:-1], 0.0)
    inside = x * x / (8.0 + x * (3.5 + x)) * rise + jnp.minimum(2.0, 4.0 / x) * strays
    bulge = deviations @ jnp.abs(e0) + rho_inf * strays + rho0 * inside
    left, right = envelope[:-1] + bulge, envelope[1:] + bulge
    falls = (left >= 0.0) & (right < 0.0)
    part = jnp.where(falls, left / jnp.where(falls, left - right, 1.0), jnp.where(right >= 0.0, 1.0, -jnp.inf))
    times = start + cell * (np.arange(float(_CELLS))[:, None] + part)
    return (fading[-1], jnp.maximum(last, jnp.max(times)), jnp.any(right[-1] >= 0.0)), None


@entry_point
def _table(c: Float[Array | np.ndarray, " c"]) -> _Table:
    """The table of a surface; numbers are tabulated at once, and more finely the more the surface oscillates."""
    if is_traced(c) or not is_hurwitz(c):
        return _tabulate(c, _TRACED_PARTS)
    finer = max(0, math.ceil(math.log2(damping_ratio(np.asarray(c)))))
    return _tabulate(c, min(8 * _TRACED_PARTS * 2**finer, _MOST_PARTS))


@eqx.filter_jit
def _tabulate(c: Float[Array | np.ndarray, " c"], parts: int) -> _Table:
    c = jnp.asarray(c)
    degree = c.shape[0]
    safe = jnp.where(is_hurwitz(c), c, jnp.asarray([math.comb(degree, j) for j in range(degree)], c.dtype))
    units = pole_bound(safe) ** np.arange(degree, -1.0, -1.0)
    safe = safe / units[:-1]
    first = _FIRST_CELL / parts
    carry = (jnp.eye(degree), short_exponential(first * companion(safe)), jnp.zeros(degree + 1))
    cells = _FIRST_CELL * 2.0 ** np.arange(_PANELS)
    starts = _CELLS * _FIRST_CELL * (2.0 ** np.arange(_PANELS) - 1.0)
    _, rows = jax.lax.scan(ft.partial(_panel, safe, parts), carry, jnp.asarray(cells))
    return _Table(units, jnp.asarray(starts), jnp.asarray(cells), *rows)


def _panel(
    c: Float[Array, " c"], parts: int, carry: tuple[Array, Array, Array], cell: Float[Array, ""]
) -> tuple[tuple[Array, Array, Array], tuple[Array, ...]]:
    """One row of the table; the next panel starts at its end and has steps twice as long."""
    x, exponential, integral = carry
    end, xs = jax.lax.scan(lambda x, _: (exponential @ x, x), x, length=_CELLS * parts)
    xs = jnp.concatenate([xs, end[None]])
    responses = jnp.concatenate([xs, -(c @ xs)[:, None]], axis=1)
    ends = responses[::parts]
    sums = jnp.cumsum(variations(xs[:, :, -1], c, cell / parts).reshape(_CELLS, parts, -1), axis=1)
    masses, theta = sums[:, -1], (np.arange(1, parts + 1) / parts)[None, :, None]
    strays = jnp.max(jnp.abs(sums - theta * masses[:, None]), axis=1)
    integrals = integral[None] + jnp.concatenate([jnp.zeros_like(masses[:1]), jnp.cumsum(masses, axis=0)])
    rows = (ends, _deviations(responses[:-1].reshape(_CELLS, parts, *ends.shape[1:]), ends), masses, integrals, strays)
    return (end, exponential @ exponential, integrals[-1]), rows


def _deviations(inner: Float[Array, "cells parts n c"], ends: Float[Array, "ends n c"]) -> Float[Array, "cells n c"]:
    """How far the responses inside the cells stray from the straight line between those at their ends."""
    theta = (np.arange(inner.shape[1]) / inner.shape[1])[:, None, None][None]
    straight = ends[:-1, None] + theta * (ends[1:] - ends[:-1])[:, None]
    return jnp.max(jnp.abs(inner - straight), axis=1)
