r"""How large the errors can be when the sliding variable is bounded: L1 norms of impulse responses.

With $E = (e, \dots, e^{(n-2)})$, $\dot E = A E + B \sigma$, A the companion matrix of $p(s)$ and B the last unit
vector. The transfer function from $\sigma$ to $e^{(i)}$ is $G_i(s) = s^i / p(s)$, and the largest $|e^{(i)}|$ that
$|\sigma| \le \varepsilon$ permits is $\varepsilon \|G_i\|_1$. All impulse responses are derivatives of the first,
$h_i = h_0^{(i)}$: so $\|h_i\|_1$ is the total variation of $h_{i-1}$, a sum of differences between turning points that
needs no quadrature.

Everything is computed in units of a bound R on the poles, time in 1/R and $e^{(i)}$ in $R^{i-n+1}$: the coefficients
are then at most 1, and one step size suits all surfaces.

Source: C. A. Desoer and M. Vidyasagar, Feedback Systems: Input-Output Properties (1975), for the L1 norm as peak gain.
"""

import functools as ft
import itertools as it
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from qsmc_jax.base.checks import is_traced
from qsmc_jax.base.precision import entry_point
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.numerics.hermite import Cubic
from qsmc_jax.numerics.hurwitz import is_hurwitz

_TRACED_POINTS = 128
_POINTS = 1024
_MOST_POINTS = 2**17
_RESOLVED_RATIO = 8.0  # |Im| / |Re| of a pole up to which _POINTS give 1e-8
_PANELS = 20  # together at least 4e6 / R long: room for the slowest pole to decay
_FIRST_STEP = 0.03125  # times R: short enough for the Taylor sum
_TAYLOR_TERMS = 10
_NODES, _WEIGHTS = (0.5 * (v + shift) for v, shift in zip(np.polynomial.legendre.leggauss(5), (1.0, 0.0), strict=True))


@entry_point
def peak_gains(c: Float[Array | np.ndarray, " c"], points: int | None = None) -> Float[Array | np.ndarray, " n"]:
    r"""The peak gains $\|G_i\|_1$ [s^{n-1-i}], i = 0 ... n - 1, of the errors over the sliding variable.

    Args:
        c: Coefficients of the surface, lowest derivative first.
        points: Points per time panel. None chooses from the poles, for a relative error below 1e-6 while
            $|\mathrm{Im}| \le 1000 |\mathrm{Re}|$ for every pole, or takes 128 if `c` is traced: good to 1e-5 up to
            a factor of 20. Turning points missed beyond that make the result too small.

    Returns:
        One number per derivative; `inf` if the polynomial is not Hurwitz.
    """
    if c.shape[0] < 2:
        return _first_order_gains(c)
    if points is None:
        points = _TRACED_POINTS if is_traced(c) or not is_hurwitz(c) else _points_for(np.asarray(c))
    return _peak_gains(c, points)


def _first_order_gains(c: Float[Array | np.ndarray, " c"]) -> Float[Array | np.ndarray, " n"]:
    """The gains for n <= 2: 1, or 1 / c_1 and 2. Numbers are not worth a program to compile."""
    xp: Any = jnp if is_traced(c) else np
    stable, last = c > 0.0, xp.ones(1)
    gains = xp.concatenate([1.0 / xp.where(stable, c, 1.0), (1.0 + c.shape[0]) * last])
    return xp.where(xp.concatenate([stable, xp.all(stable)[None]]), gains, xp.inf)


@eqx.filter_jit
def _peak_gains(c: Float[Array | np.ndarray, " c"], points: int) -> Float[Array, " n"]:
    c = jnp.asarray(c)
    degree = c.shape[0]
    stable = is_hurwitz(c)
    safe = jnp.where(stable, c, jnp.asarray([math.comb(degree, j) for j in range(degree)], c.dtype))
    units = jax.lax.stop_gradient(pole_bound(safe)) ** np.arange(degree, -1.0, -1.0)
    direct = jnp.zeros(degree + 1).at[-1].set(1.0)
    gains = (_variations(safe / units[:-1], points) + direct) / units
    return jnp.where(stable, gains, jnp.inf)


def _variations(c: Float[Array, " c"], points: int) -> Float[Array, " n"]:
    """Total variations over (0, inf) of the step response and of the impulse responses."""
    matrix = companion(c)
    start = jnp.asarray(_impulse(len(c)))
    carry = (jnp.asarray(_FIRST_STEP), start, short_exponential(_FIRST_STEP * matrix))
    (_, end, _), panels = jax.lax.scan(ft.partial(_panel, c, points), carry, length=_PANELS)
    tail = jnp.abs(_integrals(end[None], c)[0])
    return jnp.sum(panels, axis=0) + tail


def _panel(
    c: Float[Array, " c"], points: int, carry: tuple[Array, Array, Array], _: None
) -> tuple[tuple[Array, Array, Array], Float[Array, " n"]]:
    """Total variations over `points` equal steps; the next panel starts at the end and has steps twice as long."""
    step, x, exponential = carry
    end, xs = jax.lax.scan(lambda x, _: (exponential @ x, x), x, length=points)
    xs = jnp.concatenate([xs, end[None]])
    return (2.0 * step, end, exponential @ exponential), jnp.sum(variations(xs, c, step), axis=0)


def variations(xs: Float[Array, "points c"], c: Float[Array, " c"], step: RealScalarLike) -> Float[Array, "steps n"]:
    r"""The integrals of $|h_i|$ over each step between consecutive states: total variations of the antiderivatives.

    Each is that of the cubic through values and slopes at both ends.

    Args:
        xs: States of the impulse response.
        c: Coefficients of the surface, lowest derivative first.
        step: Time between them.
    """
    value, slope = _integrals(xs, c), step * jnp.concatenate([xs, -(xs @ c)[:, None]], axis=1)
    return jnp.vectorize(_cubic_variation)(value[:-1], value[1:], slope[:-1], slope[1:])


def _cubic_variation(y0: Array, y1: Array, m0: Array, m1: Array) -> Float[Array, ""]:
    """Total variation of one cubic."""
    cubic = Cubic(y0, y1, m0, m1)
    low, high = (cubic(theta) for theta in cubic.turning_points())
    return jnp.abs(low - y0) + jnp.abs(high - low) + jnp.abs(y1 - high)


def _integrals(xs: Float[Array, "points c"], c: Float[Array, " c"]) -> Float[Array, "points n"]:
    """Antiderivatives, zero at infinity, of the impulse responses: the states, after that of the first response."""
    first = -(xs @ jnp.concatenate([c[1:], jnp.ones(1)])) / c[0]
    return jnp.concatenate([first[:, None], xs], axis=1)


def short_exponential(matrix: Float[Array | np.ndarray, "*times c c"]) -> Any:
    """The exponential of a matrix of norm well below 1, by Horner's scheme."""
    unit = np.eye(matrix.shape[-1])
    total = unit
    for k in range(_TAYLOR_TERMS, 0, -1):
        total = unit + matrix @ total / k
    return total


def companion(c: Float[Array | np.ndarray, " c"]) -> Any:
    """The matrix A of the errors without sliding variable."""
    xp = jnp if is_traced(c) else np
    return xp.concatenate([np.eye(len(c), k=1)[:-1], -c[None]])


def pole_bound(c: Float[Array | np.ndarray, " c"]) -> Any:
    """Fujiwara's bound on the size of the poles."""
    xp = jnp if is_traced(c) else np
    halved = xp.concatenate([0.5 * xp.abs(c[:1]), xp.abs(c[1:])])
    return 2.0 * xp.max(halved ** (1.0 / np.arange(len(c), 0, -1)))


def poles(c: Float[np.ndarray, " c"]) -> Complex[np.ndarray, " c"]:
    r"""The roots of $s^m + c_m s^{m-1} + \dots + c_1$ [1/s]; numbers only."""
    return np.roots([1.0, *c[::-1]]).astype(complex)


def _points_for(c: Float[np.ndarray, " c"]) -> int:
    doublings = max(0, math.ceil(math.log2(damping_ratio(c) / _RESOLVED_RATIO)))
    return min(_POINTS * 2**doublings, _MOST_POINTS)


def damping_ratio(c: Float[np.ndarray, " c"]) -> float:
    """The largest |Im| / |Re| of a pole, at least 1."""
    roots = poles(c)
    return float(np.max(np.abs(np.imag(roots) / np.real(roots)), initial=1.0))


@entry_point
def error_envelope(
    c: Float[np.ndarray, " c"],
    ts: Float[np.ndarray, " times"],
    e0: Float[np.ndarray, " n"],
    rho0: float,
    mu: float,
    rho_inf: float,
) -> Float[np.ndarray, "times n"]:
    r"""The bounds $|C_i e^{At} E(0)| + \int_0^t |h_i(t - s)| \rho(s) ds$ on $|e^{(i)}(t)|$.

    For i = n - 1, $\rho(t)$ is added. They hold for every measurable $|\sigma| \le \rho = \rho_0 e^{-\mu t} +
    \rho_\infty$, and at each time some such $\sigma$ attains them. Numbers only, within a relative 1e-8.

    Args:
        c: Coefficients of the surface, lowest derivative first.
        ts: Times [s], not negative, in any order.
        e0: Errors at time 0.
        rho0: Initial excess width of the funnel.
        mu: Decay rate of the funnel [1/s].
        rho_inf: Final half-width of the funnel.

    Returns:
        One row per time, one column per derivative i = 0 ... n - 1.
    """
    bound = (rho0 * np.exp(-mu * ts) + rho_inf)[:, None] * (np.arange(len(c) + 1) == len(c))
    if len(c) == 0 or len(ts) == 0:
        return bound
    scale = float(pole_bound(c))
    units = scale ** np.arange(len(c), -1, -1)
    c, ts, mu = c / units[:-1], ts * scale, mu / scale
    flat, fading = _faded_integrals(c, ts, mu)
    return (np.abs(_responses(c, ts, (e0 * units)[:-1])) + rho_inf * flat + rho0 * fading + bound) / units


def _faded_integrals(
    c: Float[np.ndarray, " c"], ts: Float[np.ndarray, " times"], mu: float
) -> tuple[Float[np.ndarray, "times n"], Float[np.ndarray, "times n"]]:
    r"""$\int_0^t |h_i(s)| ds$ and $\int_0^t |h_i(s)| e^{-\mu (t - s)} ds$, by Gauss' rule between the sign changes."""
    edges = _split_at_sign_changes(c, _edges(c, ts, mu))
    lengths = np.diff(edges)[:, None]
    nodes = edges[:-1, None] + lengths * _NODES
    h = np.abs(_responses(c, nodes.ravel(), _impulse(len(c)))).reshape(*nodes.shape, -1)
    flat = np.einsum("kq,kqi->ki", lengths * _WEIGHTS, h)
    fading = np.einsum("kq,kqi->ki", lengths * _WEIGHTS * np.exp(-mu * (edges[1:, None] - nodes)), h)
    cells = zip(np.exp(-mu * lengths), fading, strict=True)
    faded = list(it.accumulate(cells, lambda total, cell: cell[0] * total + cell[1], initial=np.zeros(len(c) + 1)))
    at = np.searchsorted(edges, ts)
    return np.cumsum(np.pad(flat, ((1, 0), (0, 0))), axis=0)[at], np.asarray(faded)[at]


def _edges(c: Float[np.ndarray, " c"], ts: Float[np.ndarray, " times"], mu: float) -> Float[np.ndarray, " edges"]:
    """The times asked for, and between them steps that grow with time as far as the poles and the funnel allow."""
    first, growth = 0.25, 1.0 / (16.0 * damping_ratio(c))
    steps = math.ceil(math.log1p(ts.max() * growth / first) / math.log1p(growth))
    growing = first / growth * ((1.0 + growth) ** np.arange(steps) - 1.0)
    return np.unique(np.concatenate([[0.0], ts, growing[growing < ts.max()], np.arange(0.0, ts.max(), 0.5 / mu)]))


def _split_at_sign_changes(
    c: Float[np.ndarray, " c"], edges: Float[np.ndarray, " edges"]
) -> Float[np.ndarray, " more"]:
    """The edges and the zeros of all impulse responses between them, by a secant and a Newton step."""
    h = _responses(c, edges, _impulse(len(c)))
    cell, i = np.nonzero(np.sign(h[:-1]) * np.sign(h[1:]) < 0)
    left, right = edges[cell], edges[cell + 1]
    zeros = left + (right - left) * h[cell, i] / (h[cell, i] - h[cell + 1, i])
    at_zeros = _responses(c, zeros, _impulse(len(c)))
    slopes = np.concatenate([at_zeros[:, 1:], -(at_zeros[:, 1:] @ c)[:, None]], axis=1)
    row = np.arange(len(zeros))
    return np.union1d(edges, np.clip(zeros - at_zeros[row, i] / slopes[row, i], left, right))


def _responses(
    c: Float[np.ndarray, " c"], ts: Float[np.ndarray, " times"], start: Float[np.ndarray, " c"]
) -> Float[np.ndarray, "times n"]:
    r"""$e, \dots, e^{(n-1)}$ at times `ts` for $\sigma = 0$, from the given errors, by scaling and squaring."""
    squarings = math.ceil(math.log2(max(1.0, ts.max(initial=0.0) / _FIRST_STEP)))
    power = short_exponential(companion(c) * (ts / 2.0**squarings)[:, None, None])
    for _ in range(squarings):
        power = power @ power
    x = power @ start
    return np.concatenate([x, -(x @ c)[:, None]], axis=1)


def _impulse(degree: int) -> Float[np.ndarray, " c"]:
    """The errors just after a unit impulse of the sliding variable."""
    return np.eye(degree)[-1]
