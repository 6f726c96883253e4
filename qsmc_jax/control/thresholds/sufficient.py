"""Limits that every admissible run bears, or that some run does not."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import special

from qsmc_jax.base.checks import require, require_finite, require_nonnegative, require_positive, show
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.control.funnel import AbstractFunnel, Funnel

_LEAST_CONTROL = 1e-6  # the smallest tan(pi z / 2) that `sufficient_period` tries
_POINTS, _ROUNDS = 256, 2  # the search is narrowed twice, 128 times each: to 1e-5 of the best
_NEWTON_STEPS = 12  # they converge quadratically: to rounding for bounds up to 1e8, to 1e-9 at 1e12
_CHORDS = np.geomspace(1e-6, 1e6, 2000)  # times at which a funnel without a formula is looked at, over 1 / rate
_CLEARANCE = 1e-9  # closer to where no period will do, the quotient would lose its digits


def sufficient_saturation(residual_bound: RealScalarLike, gain_min: RealScalarLike, funnel: AbstractFunnel) -> float:
    r"""An input limit $(W + \mu \rho_0) / g_\min$ with which the saturated law keeps the funnel. SUFFICIENT.

    For every $|w| \le W$, $|g| \ge g_\min$ and start inside the funnel, also one at which the law asks for more. In a
    funnel of another shape $\mu \rho_0$ is the largest rate of an edge.

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
    return (float(residual_bound) + float(funnel.steepest)) / float(gain_min)


def necessary_saturation(
    residual: RealScalarLike, gain_max: RealScalarLike, funnel: AbstractFunnel, sigma0: RealScalarLike = 0.0
) -> float:
    r"""The input limit below which no controller at all keeps the funnel. NECESSARY.

    $(W_0 + \sup_{t > 0} (|\sigma_0| - \rho(t)) / t) / g_\max$ against the constant residual
    $W_0 \mathrm{sgn}(\sigma_0)$ with gains $|g| \le g_\max$. The supremum is 0 if $|\sigma_0| \le \rho_\infty$,
    otherwise how steeply the tangent from $(0, |\sigma_0|)$ to the funnel's edge falls: in closed form for the paper's
    funnel, else the steepest chord to 2000 times, which is no steeper.

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
    centre, width = float(funnel.centre(0.0)), float(funnel(0.0))
    middle = f"|sigma0 - {centre:.6g}|" if centre else "|sigma0|"
    require(
        abs(float(sigma0) - centre) < width,
        f"Argument `sigma0` must lie strictly inside the funnel, {middle} < {width:.6g}, but is {show(float(sigma0))}.",
    )
    return (float(residual) + _steepest_chord(funnel, float(sigma0))) / float(gain_max)


def _steepest_chord(funnel: AbstractFunnel, sigma0: float) -> float:
    """How fast the sliding variable must at least move in to be inside at all later times."""
    size = abs(sigma0)
    if isinstance(funnel, Funnel):
        rho0, mu, rho_inf = (float(v) for v in (funnel.rho0, funnel.mu, funnel.rho_inf))
        excess = max((size - rho_inf) / rho0, 0.0)
        return mu * rho0 * excess / -float(special.lambertw(-excess / math.e, -1).real) if excess > 0 else 0.0
    ts = _CHORDS / float(funnel.rate)
    edges = [float(math.copysign(1.0, sigma0) * funnel.centre(t) + funnel(t)) for t in ts]
    return max(0.0, float(np.max((size - np.asarray(edges)) / ts)))


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
    funnel: AbstractFunnel,
    ratio0: RealScalarLike = 0.0,
) -> SufficientPeriod:
    r"""A period of a sampled and held input with which the law keeps the funnel, at any order n. SUFFICIENT.

    For all measurable $|w| \le W$, $g_\min \le |g| \le g_\max$, however they vary between samples, and $|z(0)| \le$
    `ratio0`. It is the largest over $\bar z$ of the periods $\tau$ for which one sample cannot leave $|z| \le \bar z$:
    with $T(z) = \tan(\pi z / 2)$, $r = \mu (\rho - \rho_\infty)$, for all $0 \le z \le \bar z$ and both
    $\rho = \rho_\infty$ and $\rho_0 + \rho_\infty$,

        $\tau (W + \bar z r - g_\min T(z)) \le (\bar z - z) \rho$ and
        $\tau (W + \bar z r + g_\max T(\bar z)) \le 2 \bar z \rho$.

    In a funnel of another shape $\rho$ is the least half-width, and $\bar z r$ the largest rate of an edge.

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


def _invariant_periods(
    controls: Float[np.ndarray, " v"], w: float, gains: tuple[float, float], funnel: AbstractFunnel
) -> Float[np.ndarray, " v"]:
    r"""The longest periods for given $\tan(\pi \bar z / 2)$; 0 where none will do.

    The first condition is the least $(\bar z - z) \rho / (W + \bar z r - g_\min T(z))$ over z, by Newton's method on
    the greatest excess as a convex function of the period (Dinkelbach's), from above; its z has a closed form.
    """
    ratio = 2.0 / math.pi * np.arctan(controls)
    if isinstance(funnel, Funnel):
        excess = np.array([[0.0], [float(funnel.rho0)]])
        rho, push = excess + float(funnel.rho_inf), w + ratio * float(funnel.mu) * excess
    else:
        rho, push = np.array([[float(funnel.narrowest)]]), w + float(funnel.steepest)
    unit = 2.0 / math.pi * rho
    with np.errstate(divide="ignore", invalid="ignore"):  # nothing pushes, or where no period will do
        period = ratio * rho / push
        for _ in range(_NEWTON_STEPS):
            tangent = np.sqrt(np.maximum(unit / (gains[0] * period) - 1.0, 0.0))
            gap = unit * np.arctan2(controls - tangent, 1.0 + controls * tangent)
            period = gap / (push - gains[0] * tangent)
    period = np.minimum(period, 2.0 * ratio * rho / (push + gains[1] * controls))
    return np.min(np.where(gains[0] * controls > (1.0 + _CLEARANCE) * push, period, 0.0), axis=0)
