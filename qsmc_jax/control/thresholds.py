r"""How imperfectly the law may be implemented: limits on saturation, sampling, delay, actuator and noise.

Notation: $\dot\sigma = w + g u$ with the residual w (everything that is not the input: drift, reference, disturbance,
$\sum_j c_j e^{(j)}$) and the gain g, here $|g|$; $z = \sigma / \rho$; $u = -\tan(\pi z / 2)$. Held against a constant w,
the law rests at $u = w / g$, where its slope makes the loop gain $k' = \frac{\pi g}{2 \rho} (1 + (w / g)^2)$ [1/s].

Each limit says what it is worth:

- LOCAL: exact for the loop linearised there, with w, g and $\rho$ frozen. Its loop transfer function is
  $L(s) = k' p(s) / s^n$, p the polynomial of the surface. All these limits hold up to the first loss of stability
  counted from the ideal loop. The ideal loop itself is stable for n = 1 and 2, and for n >= 3 once $k'$ is large enough;
  where it is not, nothing is left to lose: periods, delays and lags are 0, the actuator frequency is `inf`.
- SUFFICIENT: the funnel is kept by every run that meets the bounds.
- NECESSARY: below it some admissible run leaves the funnel.

Numbers only, nothing traced; results are Python floats.
"""

import itertools as it
import math
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import ArrayLike, Float
from numpy.polynomial import Polynomial
from scipy import optimize, special

from qsmc_jax.base.checks import require, require_finite, require_nonnegative, require_positive, show
from qsmc_jax.base.hurwitz import is_hurwitz
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.control.funnel import Funnel
from qsmc_jax.control.surface import SlidingSurface

Coefficients: TypeAlias = Sequence[float] | Float[ArrayLike, " c"]

_LEAST_CONTROL = 1e-6  # the smallest tan(pi z / 2) that `sufficient_period` tries
_POINTS, _ROUNDS = 64, 5  # each round narrows the search 32 times
_NEWTON_STEPS = 12  # quadratic convergence: 6 suffice for moderate numbers
_TINY = 1e-300  # absolute tolerance of root finding: none, the relative one decides


def small_signal_gain(gain: RealScalarLike, residual: RealScalarLike, rho: RealScalarLike) -> float:
    r"""The loop gain $k' = \frac{\pi g}{2 \rho} (1 + (w / g)^2)$ [1/s] of the linearised loop. LOCAL.

    Args:
        gain: Size of the input gain $|g|$, in units of the sliding variable per second and unit of input; positive.
        residual: Residual w at rest, in units of the sliding variable per second; either sign.
        rho: Half-width of the funnel, in units of the sliding variable; positive.

    Raises:
        ValueError: An argument is out of range.

    Source: derived here: the slope of $-g \tan(\pi \sigma / (2 \rho))$ where $\tan(\pi \sigma / (2 \rho)) = w / g$.
    """
    require_positive("gain", gain)
    require_finite("residual", residual)
    require_positive("rho", rho)
    return 0.5 * math.pi * float(gain) * (1.0 + (float(residual) / float(gain)) ** 2) / float(rho)


def critical_period(gain: RealScalarLike, residual: RealScalarLike, rho: RealScalarLike, c: Coefficients = ()) -> float:
    r"""The longest period [s] of a sampled and held input with a stable linearised loop. LOCAL.

    $2 / k' = 4 \rho g / (\pi (g^2 + w^2))$ for n = 1, $\min(2 / k', 2 / c_1)$ for n = 2; near $2 / k'$ for n >= 3 if the
    surface is slow. Where $|w| < g / \sqrt 3$ and n = 1, runs leave the funnel soon above it (the period doubling is
    subcritical); at larger residuals they chatter inside first.

    Args:
        gain: Size of the input gain, positive; see `small_signal_gain`.
        residual: Residual at rest.
        rho: Half-width of the funnel, positive.
        c: Coefficients of the surface, lowest derivative first; empty for n = 1.

    Raises:
        ValueError: An argument is out of range, or the surface is not Hurwitz.

    Source: derived here. $1/s^m$ behind a hold is $\tau^m B_m(z) / (m! (z - 1)^m)$ with the Eulerian polynomial
        $B_m$. With $z = (1 + s \tau / 2) / (1 - s \tau / 2)$ the closed loop has a polynomial in s of degree n, which
        tends to $s^n + k' p(s)$ as $\tau \to 0$, has a constant term > 0, and must be Hurwitz. Stability first goes
        where a root crosses at infinity (z = -1, the leading coefficient vanishes) or on the axis (Hurwitz's
        determinant n - 1 vanishes, Orlando's formula). Both are polynomials in $\tau$.
    """
    k, a = _linearised_loop(gain, residual, rho, c)
    if not _is_stable(a):
        return 0.0
    coefficients = _sampled_loop(a)
    conditions = coefficients[-1], _determinant(_hurwitz_matrix(coefficients))
    return min(root for condition in conditions for root in _positive_roots(condition)) / k


def critical_delay(gain: RealScalarLike, residual: RealScalarLike, rho: RealScalarLike, c: Coefficients = ()) -> float:
    r"""The longest delay [s] around the loop with a stable linearised loop. LOCAL.

    The least $\arg(-L(j \omega)) / \omega$, argument in $[0, 2 \pi)$, over all $\omega$ with $|L(j \omega)| = 1$.
    For n = 1 it is $\frac{\pi}{2 k'} = \rho g / (g^2 + w^2)$; for large $k'$ it tends to
    $(\pi / 2 - c_{n-1} / k') / k'$.

    Args:
        gain: Size of the input gain, positive; see `small_signal_gain`.
        residual: Residual at rest.
        rho: Half-width of the funnel, positive.
        c: Coefficients of the surface, lowest derivative first; empty for n = 1.

    Raises:
        ValueError: An argument is out of range, or the surface is not Hurwitz.

    Source: derived here: $1 + L(j \omega) e^{-j \omega h} = 0$ says both; as the delay grows from 0, the first root to
        reach the axis is the first solution.
    """
    k, a = _linearised_loop(gain, residual, rho, c)
    if not _is_stable(a):
        return 0.0
    real, lag = _loop_parts(a)
    crossings = _positive_roots(real**2 + Polynomial([0.0, 1.0]) * lag**2 - 1.0)
    return min(_phase(-real(y), math.sqrt(y) * lag(y)) * math.sqrt(y) for y in crossings) / k


def critical_lag(gain: RealScalarLike, residual: RealScalarLike, rho: RealScalarLike, c: Coefficients = ()) -> float:
    r"""The longest time constant [s] of a first-order actuator with a stable linearised loop. LOCAL.

    Up to it $T s^{n+1} + s^n + k' p(s)$ is Hurwitz: `inf` for n = 1, $1 / c_1$ for n = 2,
    $1 / c_2 - c_1 / (k' c_2^2)$ for n = 3; it tends to $1 / c_{n-1}$ for large $k'$, so no gain helps.

    Args:
        gain: Size of the input gain, positive; see `small_signal_gain`.
        residual: Residual at rest.
        rho: Half-width of the funnel, positive.
        c: Coefficients of the surface, lowest derivative first; empty for n = 1.

    Raises:
        ValueError: An argument is out of range, or the surface is not Hurwitz.

    Source: derived here: $1 + j \omega T = -L(j \omega)$, so $\mathrm{Re} L = -1$ and $T = -\mathrm{Im} L / \omega$. The
        root that the actuator adds comes from $-\infty$ as T leaves 0, so the least such T > 0 is the first loss.
    """
    k, a = _linearised_loop(gain, residual, rho, c)
    if not _is_stable(a):
        return 0.0
    real, lag = _loop_parts(a)
    lags = (y * lag(y) for y in _positive_roots(real + 1.0))
    return min((value for value in lags if value > 0), default=math.inf) / k


def critical_actuator_frequency(
    gain: RealScalarLike,
    residual: RealScalarLike,
    rho: RealScalarLike,
    damping: RealScalarLike,
    c: Coefficients = (),
) -> float:
    r"""The natural frequency [rad/s] above which a second-order actuator leaves the linearised loop stable. LOCAL.

    The actuator is $\omega_a^2 / (s^2 + 2 \zeta \omega_a s + \omega_a^2)$. For n = 1 the limit is $k' / (2 \zeta)$. For
    large $k'$ it grows like $k' / (2 \zeta)$ at any n.

    Args:
        gain: Size of the input gain, positive; see `small_signal_gain`.
        residual: Residual at rest.
        rho: Half-width of the funnel, positive.
        damping: Damping ratio $\zeta$ of the actuator [-], positive.
        c: Coefficients of the surface, lowest derivative first; empty for n = 1.

    Raises:
        ValueError: An argument is out of range, or the surface is not Hurwitz.

    Source: derived here: with $q = 1 / \omega_a$, $1 - \omega^2 q^2 + 2 j \zeta \omega q = -L(j \omega)$, so
        $q = -\mathrm{Im} L / (2 \zeta \omega)$ and $1 + \mathrm{Re} L = (\mathrm{Im} L)^2 / (4 \zeta^2)$; the least q > 0
        is the first loss.
    """
    require_positive("damping", damping)
    k, a = _linearised_loop(gain, residual, rho, c)
    if not _is_stable(a):
        return math.inf
    real, lag = _loop_parts(a)
    twice = 2.0 * float(damping)
    crossings = _positive_roots(real + 1.0 - Polynomial([0.0, 1.0]) * lag**2 / twice**2)
    return k * twice / min(y * lag(y) for y in crossings if lag(y) > 0)


def sufficient_saturation(residual_bound: RealScalarLike, gain_min: RealScalarLike, funnel: Funnel) -> float:
    r"""An input limit $(W + \mu \rho_0) / g_\min$ with which the saturated law keeps the funnel. SUFFICIENT.

    It holds for every $|w| \le W$, $|g| \ge g_\min$ and start inside the funnel, also one at which the law asks for more.

    Args:
        residual_bound: Bound W on $|w|$ while in the funnel, in units of the sliding variable per second; at least 0.
        gain_min: Least size of the input gain, positive.
        funnel: The funnel.

    Raises:
        ValueError: An argument is out of range.

    Source: derived here. For z > 0, $\rho \dot z = w + g u - z \dot\rho \le W + \mu \rho_0 - g_\min \min(u_\max,
        \tan(\pi z / 2))$: not positive once $\tan(\pi z / 2) \ge (W + \mu \rho_0) / g_\min$.
    """
    require_nonnegative("residual_bound", residual_bound)
    require_positive("gain_min", gain_min)
    return (float(residual_bound) + float(funnel.mu * funnel.rho0)) / float(gain_min)


def necessary_saturation(
    residual: RealScalarLike, gain_max: RealScalarLike, funnel: Funnel, sigma0: RealScalarLike = 0.0
) -> float:
    r"""The input limit below which no controller at all keeps the funnel. NECESSARY.

    $(W_0 + \sup_{t > 0} (|\sigma_0| - \rho(t)) / t) / g_\max$ against the constant residual $W_0 \mathrm{sgn}(\sigma_0)$
    and gains $|g| \le g_\max$. The supremum is the slope of the tangent from $(0, |\sigma_0|)$ to the funnel's edge if
    $|\sigma_0| > \rho_\infty$, otherwise 0.

    Args:
        residual: Size $W_0$ of the constant residual, in units of the sliding variable per second; at least 0.
        gain_max: Largest size of the input gain, positive.
        funnel: The funnel.
        sigma0: Sliding variable at the start, strictly inside the funnel.

    Raises:
        ValueError: An argument is out of range.

    Source: derived here. $|\sigma(t)| \ge |\sigma_0| + (W_0 - g_\max u_\max) t$ must stay below $\rho(t)$, which is
        convex. Tangency at t: $(1 + x) e^{-x} = q$ with $x = \mu t$, $q = (|\sigma_0| - \rho_\infty) / \rho_0$, so
        $1 + x = -W_{-1}(-q / e)$ by Lambert's function, and the slope is $\mu \rho_0 e^{-x} = \mu \rho_0 q / (1 + x)$.
    """
    require_nonnegative("residual", residual)
    require_positive("gain_max", gain_max)
    require_finite("sigma0", sigma0)
    rho0, mu, rho_inf = (float(v) for v in (funnel.rho0, funnel.mu, funnel.rho_inf))
    size = abs(float(sigma0))
    require(
        size < rho0 + rho_inf,
        f"Argument `sigma0` must lie strictly inside the funnel, |sigma0| < {rho0 + rho_inf:.6g}, but is "
        f"{show(float(sigma0))}.",
    )
    excess = max((size - rho_inf) / rho0, 0.0)
    slope = mu * rho0 * excess / -special.lambertw(-excess / math.e, -1).real if excess > 0 else 0.0
    return (float(residual) + float(slope)) / float(gain_max)


class SufficientPeriod(NamedTuple):
    r"""A sample period and the ratio that runs sampled so keep.

    Attributes:
        period: Sample period [s].
        ratio: Bound $\bar z < 1$ on $|\sigma| / \rho$, at and between samples; $|u| \le \tan(\pi \bar z / 2)$.
    """

    period: float
    ratio: float


def sufficient_period(
    residual_bound: RealScalarLike,
    gain_bounds: tuple[RealScalarLike, RealScalarLike],
    funnel: Funnel,
    ratio0: RealScalarLike = 0.0,
) -> SufficientPeriod:
    r"""A period of a sampled and held input with which the law keeps the funnel, at any order n. SUFFICIENT.

    For all measurable $|w| \le W$, $g_\min \le |g| \le g_\max$, however they vary between samples, and $|z(0)| \le$
    `ratio0`. It is the largest over $\bar z$ of the periods $\tau$ for which one sample cannot leave $|z| \le \bar z$:
    with $T(z) = \tan(\pi z / 2)$, $r = \mu (\rho - \rho_\infty)$, for all $0 \le z \le \bar z$ and both
    $\rho = \rho_\infty$ and $\rho_0 + \rho_\infty$,

        $\tau (W + \bar z r - g_\min T(z)) \le (\bar z - z) \rho$ and
        $\tau (W + \bar z r + g_\max T(\bar z)) \le 2 \bar z \rho$.

    Where runs may chatter in the funnel (large W), it can exceed `critical_period`.

    Args:
        residual_bound: Bound W on $|w|$ while in the funnel, in units of the sliding variable per second; at least 0.
        gain_bounds: Least and largest size of the input gain, positive.
        funnel: The funnel.
        ratio0: Bound on $|\sigma| / \rho$ at the start [-], in [0, 1).

    Raises:
        ValueError: An argument is out of range.

    Source: derived here. At a sample let $0 \le z \le \bar z$ (else mirror). Until the next, $-\dot\rho \le r$ and
        $\sigma - \bar z \rho$ grows from $-(\bar z - z) \rho$ at no more than $W + \bar z r - g_\min T(z)$: the first
        condition keeps it $\le 0$. $-\sigma - \bar z \rho$ grows from $-(\bar z + z) \rho$ at no more than
        $W + \bar z r + g_\max T(z)$, convex in z, so z = 0 (the first condition again) and $z = \bar z$ decide. All is
        affine in $\rho$, so its two ends decide. Among the $\bar z$ with $g_\min T(\bar z) \ge W + \bar z r$, others
        allow no period, each condition allows an interval, so the best period is unimodal in $\bar z$.
    """
    gain_min, gain_max = gain_bounds
    require_nonnegative("residual_bound", residual_bound)
    require_positive("gain_bounds", gain_bounds)
    require(
        bool(gain_min <= gain_max),
        f"Argument `gain_bounds` must be in increasing order, but is ({show(gain_min)}, {show(gain_max)}).",
    )
    require(bool(0 <= ratio0 < 1), f"Argument `ratio0` must be in [0, 1), but is {show(ratio0)}.")
    w, g = float(residual_bound), (float(gain_min), float(gain_max))
    low = max(math.tan(0.5 * math.pi * float(ratio0)), w / g[0], _LEAST_CONTROL)
    high = 10.0 * (low + (1.0 + sufficient_saturation(w, g[0], funnel)) ** 2)  # from here the period only falls
    for _ in range(_ROUNDS):
        controls = np.geomspace(low, high, _POINTS)
        periods = _invariant_periods(controls, w, g, funnel)
        best = int(np.argmax(periods))
        low, high = controls[max(best - 1, 0)], controls[min(best + 1, _POINTS - 1)]
    return SufficientPeriod(float(periods[best]), 2.0 / math.pi * math.atan(controls[best]))


def noise_gain(gain: RealScalarLike, residual: RealScalarLike, rho: RealScalarLike, period: RealScalarLike) -> float:
    r"""The variance of $\sigma$ over that of white measurement noise, $k' \tau / (2 - k' \tau)$ [-], n = 1. LOCAL.

    For noise that is small against $\rho$, at the samples, in the long run; `inf` from `critical_period` on.

    Args:
        gain: Size of the input gain, positive; see `small_signal_gain`.
        residual: Residual at rest.
        rho: Half-width of the funnel, positive.
        period: Sample period [s], positive.

    Raises:
        ValueError: An argument is out of range.

    Source: derived here: $\sigma_{i+1} = (1 - k' \tau) \sigma_i - k' \tau \nu_i$, a first-order autoregression.
    """
    require_positive("period", period)
    step = small_signal_gain(gain, residual, rho) * float(period)
    return step / (2.0 - step) if step < 2.0 else math.inf


def escape_time(gain: RealScalarLike, rho: RealScalarLike, ratio0: RealScalarLike) -> float:
    r"""The time [s] after which the law with the wrong sign leaves a constant funnel; exact for n = 1, w = 0.

    $\frac{1}{k} \ln \frac{1}{\sin(\pi |z_0| / 2)}$ with $k = \frac{\pi g}{2 \rho}$; `inf` if it starts at 0.

    Args:
        gain: Size of the input gain, positive and constant.
        rho: Half-width of the funnel, positive.
        ratio0: $\sigma / \rho$ at the start [-], strictly between -1 and 1.

    Raises:
        ValueError: An argument is out of range.

    Source: derived here: $\dot\sigma = g \tan\theta$ with $\theta = \pi \sigma / (2 \rho)$ gives
        $\sin\theta(t) = \sin\theta(0) e^{k t}$.
    """
    require(bool(-1 < ratio0 < 1), f"Argument `ratio0` must lie strictly between -1 and 1, but is {show(ratio0)}.")
    k = small_signal_gain(gain, 0.0, rho)
    tangent = math.tan(0.5 * math.pi * abs(float(ratio0)))
    return 0.5 * math.log1p(1.0 / tangent / tangent) / k if tangent > 0 else math.inf


def _linearised_loop(
    gain: RealScalarLike, residual: RealScalarLike, rho: RealScalarLike, c: Coefficients
) -> tuple[float, Float[np.ndarray, " n"]]:
    r"""$k'$, and in units of $1 / k'$ of time the $a_m$ of $L(s) = \sum_m a_m / s^m$, m = 1 ... n, $a_1 = 1$."""
    k = small_signal_gain(gain, residual, rho)
    c = np.asarray(SlidingSurface(c).c)
    return k, np.concatenate([[1.0], c[::-1]]) / k ** np.arange(len(c) + 1.0)


def _is_stable(a: Float[np.ndarray, " n"]) -> bool:
    """Whether the ideal loop is."""
    return bool(is_hurwitz(a[::-1]))


def _loop_parts(a: Float[np.ndarray, " n"]) -> tuple[Polynomial, Polynomial]:
    r"""$\mathrm{Re} L$ and $-\omega \mathrm{Im} L$ at $s = j \omega$, polynomials in $y = 1 / \omega^2$."""
    signed = a * (-1.0) ** (np.arange(1, len(a) + 1) // 2)
    return Polynomial([0.0, *signed[1::2]]), Polynomial(signed[0::2])


def _phase(real: float, imaginary: float) -> float:
    """The argument of a complex number, in [0, 2 pi)."""
    return math.atan2(imaginary, real) % (2.0 * math.pi)


def _positive_roots(polynomial: Polynomial) -> list[float]:
    """The positive roots at which the sign changes: one between turning points, which come from the derivative."""
    coefficients = polynomial.trim().coef
    if len(coefficients) == 1:
        return []
    powers = 1.0 / np.arange(len(coefficients) - 1, 0, -1)
    bound = 2.0 * float(np.max(np.abs(coefficients[:-1] / coefficients[-1]) ** powers))  # Fujiwara's
    knots = [0.0, *_positive_roots(polynomial.trim().deriv()), bound]
    cells = [cell for cell in it.pairwise(knots) if polynomial(cell[0]) * polynomial(cell[1]) < 0]
    return [float(optimize.brentq(polynomial, *cell, xtol=_TINY, maxiter=2000)) for cell in cells]


def _sampled_loop(a: Float[np.ndarray, " n"]) -> list[Polynomial]:
    r"""The coefficients, lowest first, of the sampled loop's polynomial in s; each a polynomial in the period."""
    order = len(a)
    table = np.zeros((order + 1, order + 1))
    table[order, 0] = 1.0
    for m in range(1, order + 1):
        for j, value in enumerate(_held_integrators(m).coef):
            table[order - m + j, j] += a[m - 1] * value / 2.0**j
    return [Polynomial(row) for row in table]


def _held_integrators(m: int) -> Polynomial:
    r"""$(1 - v)^m B_m(z) / m!$ with $z = (1 + v) / (1 - v)$ and the Eulerian polynomial $B_m$."""
    row = [1]
    for i in range(2, m + 1):
        row = [
            (j + 1) * right + (i - j) * left for j, (left, right) in enumerate(zip([0, *row], [*row, 0], strict=True))
        ]
    plus, minus = Polynomial([1.0, 1.0]), Polynomial([1.0, -1.0])
    terms = (number * plus**j * minus ** (m - j) for j, number in enumerate(row))
    return sum(terms, start=Polynomial([0.0])) / math.factorial(m)


def _hurwitz_matrix(coefficients: list[Polynomial]) -> list[list[Polynomial]]:
    """Hurwitz's matrix of size n - 1 for a polynomial of degree n, lowest coefficient first."""
    n = len(coefficients) - 1
    padded = [Polynomial([0.0])] * n + coefficients + [Polynomial([0.0])] * n
    return [[padded[n + n - 2 * j + i - 1] for j in range(n - 1)] for i in range(n - 1)]


def _determinant(rows: list[list[Polynomial]]) -> Polynomial:
    """The determinant of a small matrix of polynomials, by its first row."""
    total = Polynomial([1.0 if not rows else 0.0])
    for j, entry in enumerate(rows[0] if rows else []):
        if np.any(entry.coef):
            total += (-1.0) ** j * entry * _determinant([row[:j] + row[j + 1 :] for row in rows[1:]])
    return total


def _invariant_periods(
    controls: Float[np.ndarray, " v"], w: float, gains: tuple[float, float], funnel: Funnel
) -> Float[np.ndarray, " v"]:
    r"""The longest periods for given $\tan(\pi \bar z / 2)$; 0 where none will do.

    The first condition is the least $(\bar z - z) \rho / (W + \bar z r - g_\min T(z))$ over z, by Newton's method on
    the greatest excess as a convex function of the period (Dinkelbach's), from above; its z has a closed form.
    """
    excess = np.array([[0.0], [float(funnel.rho0)]])
    rho = excess + float(funnel.rho_inf)
    ratio = 2.0 / math.pi * np.arctan(controls)
    push = w + ratio * float(funnel.mu) * excess
    with np.errstate(divide="ignore", invalid="ignore"):  # nothing pushes, or where no period will do
        period = ratio * rho / push
        for _ in range(_NEWTON_STEPS):
            tangent = np.sqrt(np.maximum(2.0 * rho / (math.pi * gains[0] * period) - 1.0, 0.0))
            gap = 2.0 / math.pi * np.arctan2(controls - tangent, 1.0 + controls * tangent)
            period = gap * rho / (push - gains[0] * tangent)
    period = np.minimum(period, 2.0 * ratio * rho / (push + gains[1] * controls))
    return np.min(np.where(gains[0] * controls >= push, period, 0.0), axis=0)
