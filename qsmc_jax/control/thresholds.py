r"""How imperfectly the law may be implemented: limits on saturation, sampling, delay, actuator and noise.

Notation: $\dot\sigma = w + g u$ with the residual w (all that is not the input: drift, reference, disturbance,
$\sum_j c_j e^{(j)}$) and the gain g, here $|g|$; $z = \sigma / \rho$; $u = -\tan(\pi z / 2)$. Against a constant w the
law rests at $|u| = |w| / g$, where its slope makes the loop gain $k' = \frac{\pi g}{2 \rho} (1 + (w / g)^2)$ [1/s].

Each limit says what it is worth:

- LOCAL: exact for the loop linearised there, with w, g and $\rho$ frozen and the loop transfer function
  $L(s) = k' p(s) / s^n$, p the polynomial of the surface. It is where stability is first lost, counted from the ideal
  loop. That one is stable for n = 1 and 2, but for n >= 3 only if $k'$ is large enough; otherwise nothing is left to
  lose, and periods, delays and lags are 0, the actuator frequency is `inf`.
- SUFFICIENT: every run that meets the bounds keeps the funnel.
- NECESSARY: beyond it some admissible run leaves the funnel.

Numbers only, nothing traced; results are Python floats. Arguments out of range raise `InputError`.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import ArrayLike, Float
from numpy.polynomial import Polynomial
from scipy import special

from qsmc_jax.base.checks import require, require_finite, require_nonnegative, require_positive, show
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.control.funnel import Funnel
from qsmc_jax.control.linearised_loop import (
    determinant,
    hurwitz_matrix,
    is_stable,
    loop_parts,
    positive_roots,
    sampled_loop,
)
from qsmc_jax.control.surface import SlidingSurface

Coefficients: TypeAlias = Sequence[float] | Float[ArrayLike, " c"]

_LEAST_CONTROL = 1e-6  # the smallest tan(pi z / 2) that `sufficient_period` tries
_POINTS, _ROUNDS = 256, 2  # the search is narrowed twice, 128 times each: to 1e-5 of the best
_NEWTON_STEPS = 12  # they converge quadratically: to rounding for bounds up to 1e8, to 1e-9 at 1e12
_CLEARANCE = 1e-9  # closer to where no period will do, the quotient would lose its digits


def small_signal_gain(gain: RealScalarLike, residual: RealScalarLike, rho: RealScalarLike) -> float:
    r"""The loop gain $k' = \frac{\pi g}{2 \rho} (1 + (w / g)^2)$ [1/s] of the linearised loop. LOCAL.

    Args:
        gain: Size of the input gain $|g|$, in units of the sliding variable per second and unit of input; positive.
        residual: Residual w at rest, in units of the sliding variable per second; either sign.
        rho: Half-width of the funnel, in units of the sliding variable; positive.

    Examples:
        >>> from qsmc_jax import thresholds
        >>> round(thresholds.small_signal_gain(gain=2.0, residual=0.0, rho=1.0), 3)
        3.142

    Source: derived here: the slope of $-g \tan(\pi \sigma / (2 \rho))$ where $\tan(\pi \sigma / (2 \rho)) = w / g$.
    """
    require_positive("gain", gain)
    require_finite("residual", residual)
    require_positive("rho", rho)
    return 0.5 * math.pi * float(gain) * (1.0 + (float(residual) / float(gain)) ** 2) / float(rho)


def critical_period(gain: RealScalarLike, residual: RealScalarLike, rho: RealScalarLike, c: Coefficients = ()) -> float:
    r"""The longest period [s] of a sampled and held input with a stable linearised loop. LOCAL.

    $2 / k' = 4 \rho g / (\pi (g^2 + w^2))$ for n = 1, $\min(2 / k', 2 / c_1)$ for n = 2; just above $2 / k'$ for n >= 3
    if the surface is slow. For n = 1 and $|w| < g / \sqrt 3$ runs leave the funnel just above it (the period doubling
    is subcritical); at larger residuals they chatter inside first.

    Args:
        gain: Size of the input gain, positive; see `small_signal_gain`.
        residual: Residual at rest.
        rho: Half-width of the funnel, positive.
        c: Coefficients of the surface, lowest derivative first; empty for n = 1.

    Raises:
        InputError: An argument is out of range, or the surface is not Hurwitz.

    Examples:
        >>> from qsmc_jax import thresholds
        >>> round(thresholds.critical_period(gain=1.0, residual=0.0, rho=1.0), 3)
        1.273

    Source: derived here. $1/s^m$ behind a hold is $\tau^m B_m(z) / (m! (z - 1)^m)$ with the Eulerian polynomial
        $B_m$. With $z = (1 + s \tau / 2) / (1 - s \tau / 2)$ the closed loop has a polynomial in s of degree n, which
        tends to $s^n + k' p(s)$ as $\tau \to 0$, has a constant term > 0, and must be Hurwitz. Stability first goes
        where a root crosses at infinity (z = -1, the leading coefficient vanishes) or on the axis (Hurwitz's
        determinant n - 1 vanishes, Orlando's formula). Both are polynomials in $\tau$.
    """
    k, a = _linearised_loop(gain, residual, rho, c)
    if not is_stable(a):
        return 0.0
    coefficients = sampled_loop(a)
    conditions = coefficients[-1], determinant(hurwitz_matrix(coefficients))
    return min(root for condition in conditions for root in positive_roots(condition)) / k


def critical_delay(gain: RealScalarLike, residual: RealScalarLike, rho: RealScalarLike, c: Coefficients = ()) -> float:
    r"""The longest delay [s] around the loop with a stable linearised loop. LOCAL.

    The least $\arg(-L(j \omega)) / \omega$, argument in $[0, 2 \pi)$, over all $\omega$ with $|L(j \omega)| = 1$.
    It is $\frac{\pi}{2 k'} = \rho g / (g^2 + w^2)$ for n = 1, and about $(\pi / 2 - c_{n-1} / k') / k'$ for large $k'$.

    Arguments and errors: as `critical_period`.

    Examples:
        >>> from qsmc_jax import thresholds
        >>> round(thresholds.critical_delay(gain=1.0, residual=0.0, rho=1.0), 9)
        1.0

    Source: derived here: both say $1 + L(j \omega) e^{-j \omega h} = 0$; at the least such h a root first arrives.
    """
    k, a = _linearised_loop(gain, residual, rho, c)
    if not is_stable(a):
        return 0.0
    real, lag = loop_parts(a)
    crossings = positive_roots(real**2 + Polynomial([0.0, 1.0]) * lag**2 - 1.0)
    return min(math.atan2(math.sqrt(y) * lag(y), -real(y)) % (2.0 * math.pi) * math.sqrt(y) for y in crossings) / k


def critical_lag(gain: RealScalarLike, residual: RealScalarLike, rho: RealScalarLike, c: Coefficients = ()) -> float:
    r"""The longest time constant [s] of a first-order actuator with a stable linearised loop. LOCAL.

    Up to it $T s^{n+1} + s^n + k' p(s)$ is Hurwitz: `inf` for n = 1, $1 / c_1$ for n = 2,
    $1 / c_2 - c_1 / (k' c_2^2)$ for n = 3; it tends to $1 / c_{n-1}$ for large $k'$, so no gain helps.

    Arguments and errors: as `critical_period`.

    Examples:
        >>> from qsmc_jax import thresholds
        >>> round(thresholds.critical_lag(gain=1.0, residual=0.0, rho=0.01, c=[2.0]), 9)  # 1 / c
        0.5

    Source: derived here: $1 + j \omega T = -L(j \omega)$, so $\mathrm{Re} L = -1$ and $T = -\mathrm{Im} L / \omega$.
        The root that the actuator adds comes from $-\infty$ as T leaves 0, so the least such T > 0 is the first loss.
    """
    k, a = _linearised_loop(gain, residual, rho, c)
    if not is_stable(a):
        return 0.0
    real, lag = loop_parts(a)
    lags = (float(y * lag(y)) for y in positive_roots(real + 1.0))
    return min((value for value in lags if value > 0), default=math.inf) / k


def critical_actuator_frequency(
    gain: RealScalarLike, residual: RealScalarLike, rho: RealScalarLike, damping: RealScalarLike, c: Coefficients = ()
) -> float:
    r"""The natural frequency [rad/s] above which a second-order actuator leaves the linearised loop stable. LOCAL.

    The actuator is $\omega_a^2 / (s^2 + 2 \zeta \omega_a s + \omega_a^2)$. The limit is $k' / (2 \zeta)$ for n = 1, and
    tends to that for large $k'$ at any n.

    Arguments and errors: as `critical_period`; `damping` is the actuator's damping ratio $\zeta$ [-], positive.

    Examples:
        >>> from qsmc_jax import thresholds
        >>> round(thresholds.critical_actuator_frequency(2.0, 0.0, rho=1.0, damping=0.5), 3)  # k' / (2 zeta)
        3.142

    Source: derived here: with $q = 1 / \omega_a$, $1 - \omega^2 q^2 + 2 j \zeta \omega q = -L(j \omega)$, so
        $q = -\mathrm{Im} L / (2 \zeta \omega)$ and $1 + \mathrm{Re} L = (\mathrm{Im} L)^2 / (4 \zeta^2)$; the least
        q > 0 is the first loss.
    """
    require_positive("damping", damping)
    k, a = _linearised_loop(gain, residual, rho, c)
    if not is_stable(a):
        return math.inf
    real, lag = loop_parts(a)
    twice = 2.0 * float(damping)
    crossings = positive_roots(real + 1.0 - Polynomial([0.0, 1.0]) * lag**2 / twice**2)
    return k * twice / min(float(y * lag(y)) for y in crossings if lag(y) > 0)


def sufficient_saturation(residual_bound: RealScalarLike, gain_min: RealScalarLike, funnel: Funnel) -> float:
    r"""An input limit $(W + \mu \rho_0) / g_\min$ with which the saturated law keeps the funnel. SUFFICIENT.

    For every $|w| \le W$, $|g| \ge g_\min$ and start inside the funnel, also one at which the law asks for more.

    Args:
        residual_bound: Bound W on $|w|$ while in the funnel, in units of the sliding variable per second; at least 0.
        gain_min: Least size of the input gain, positive.
        funnel: The funnel.

    Examples:
        >>> import qsmc_jax as qj
        >>> funnel = qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05)
        >>> qj.thresholds.sufficient_saturation(residual_bound=2.0, gain_min=0.5, funnel=funnel)  # (2 + 3 * 4) / 0.5
        28.0

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

    $(W_0 + \sup_{t > 0} (|\sigma_0| - \rho(t)) / t) / g_\max$ against the constant residual
    $W_0 \mathrm{sgn}(\sigma_0)$ with gains $|g| \le g_\max$. The supremum is 0 if $|\sigma_0| \le \rho_\infty$,
    otherwise how steeply the tangent from $(0, |\sigma_0|)$ to the funnel's edge falls.

    Args:
        residual: Size $W_0$ of the constant residual, in units of the sliding variable per second; at least 0.
        gain_max: Largest size of the input gain, positive.
        funnel: The funnel.
        sigma0: Sliding variable at the start, strictly inside the funnel.

    Examples:
        >>> import qsmc_jax as qj
        >>> funnel = qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05)
        >>> qj.thresholds.necessary_saturation(residual=2.0, gain_max=0.5, funnel=funnel)
        4.0

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

    Examples:
        >>> import qsmc_jax as qj
        >>> found = qj.thresholds.sufficient_period(0.5, (1.0, 1.0), qj.Funnel(rho0=1.0, mu=1.0, rho_inf=1.0))
        >>> 0.0 < found.ratio < 1.0
        True
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

    Examples:
        >>> import qsmc_jax as qj
        >>> funnel = qj.Funnel(rho0=1.0, mu=1.0, rho_inf=1.0)
        >>> found = qj.thresholds.sufficient_period(0.5, (1.0, 1.0), funnel)
        >>> 0.0 < found.period < qj.thresholds.critical_period(gain=1.0, residual=0.5, rho=1.0)
        True

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
    controls = np.geomspace(low, high, _POINTS)
    for _ in range(_ROUNDS):
        best = int(np.argmax(_invariant_periods(controls, w, g, funnel)))
        controls = np.geomspace(controls[max(best - 1, 0)], controls[min(best + 1, _POINTS - 1)], _POINTS)
    periods = _invariant_periods(controls, w, g, funnel)
    best = int(np.argmax(periods))
    ratio = max(float(ratio0), 2.0 / math.pi * math.atan(controls[best]))
    return SufficientPeriod(float(periods[best]), ratio)


def noise_gain(gain: RealScalarLike, residual: RealScalarLike, rho: RealScalarLike, period: RealScalarLike) -> float:
    r"""The variance of $\sigma$ over that of white measurement noise, $k' \tau / (2 - k' \tau)$ [-], n = 1. LOCAL.

    For noise that is small against $\rho$, at the samples, in the long run; `inf` from `critical_period` on.

    Arguments: as `small_signal_gain`; `period` is the sample period [s], positive.

    Examples:
        >>> from qsmc_jax import thresholds
        >>> round(thresholds.noise_gain(gain=1.0, residual=0.0, rho=1.0, period=1e-3), 6)
        0.000786

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

    Examples:
        >>> from qsmc_jax import thresholds
        >>> round(thresholds.escape_time(gain=1.0, rho=1.0, ratio0=0.5), 3)
        0.221

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


def _invariant_periods(
    controls: Float[np.ndarray, " v"], w: float, gains: tuple[float, float], funnel: Funnel
) -> Float[np.ndarray, " v"]:
    r"""The longest periods for given $\tan(\pi \bar z / 2)$; 0 where none will do.

    The first condition is the least $(\bar z - z) \rho / (W + \bar z r - g_\min T(z))$ over z, by Newton's method on
    the greatest excess as a convex function of the period (Dinkelbach's), from above; its z has a closed form.
    """
    excess = np.array([[0.0], [float(funnel.rho0)]])
    rho = excess + float(funnel.rho_inf)
    unit = 2.0 / math.pi * rho
    ratio = 2.0 / math.pi * np.arctan(controls)
    push = w + ratio * float(funnel.mu) * excess
    with np.errstate(divide="ignore", invalid="ignore"):  # nothing pushes, or where no period will do
        period = ratio * rho / push
        for _ in range(_NEWTON_STEPS):
            tangent = np.sqrt(np.maximum(unit / (gains[0] * period) - 1.0, 0.0))
            gap = unit * np.arctan2(controls - tangent, 1.0 + controls * tangent)
            period = gap / (push - gains[0] * tangent)
    period = np.minimum(period, 2.0 * ratio * rho / (push + gains[1] * controls))
    return np.min(np.where(gains[0] * controls > (1.0 + _CLEARANCE) * push, period, 0.0), axis=0)
