"""Limits of the linearised loop, where stability is first lost, and the time to escape with the wrong sign."""

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from jaxtyping import ArrayLike, Float
from numpy.polynomial import Polynomial

from qsmc_jax.base.checks import require, require_finite, require_positive, show
from qsmc_jax.base.types import RealScalarLike
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
