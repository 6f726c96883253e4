"""A loop of any order, its right-hand side written for SciPy: nothing of the package is in it."""

import math

import numpy as np

T1, MU, RHO_INF = 2.0, 2.0, 0.1


def start(n):
    return 0.3 - 0.1 * np.arange(n)


def surface(n):
    """Coefficients of (s + 2)^(n - 1), and 1."""
    return [math.comb(n - 1, n - i) * 2.0 ** (n - i) for i in range(1, n)] + [1.0]


def rho0(n):
    return 2.0 * (abs(sigma(0.0, start(n))) + 0.5)


def sigma(t, x):
    """The sliding variable, for x_des = sin t."""
    n = len(x)
    return sum(c * (x[i] - math.sin(t + i * math.pi / 2)) for i, c in enumerate(surface(n)))


def rate(t, x, sign):
    """x_n' = cos x_1 - x_n + g u + d, g = 2 sign cos(t / 3) (1 + sin(x_n) / 2), d = sin(3 t) / 2."""
    ratio = sigma(t, x) / (rho0(len(x)) * math.exp(-MU * t) + RHO_INF)
    g = 2.0 * sign * math.cos(t / 3.0) * (1.0 + 0.5 * math.sin(x[-1]))
    u = -sign * math.tan(math.pi * ratio / 2)
    return [*x[1:], math.cos(x[0]) - x[-1] + g * u + 0.5 * math.sin(3.0 * t)]
