"""Funnel coordinate and guarded physical route against SciPy on its own right-hand side: n = 1 to 5, both signs."""

import functools as ft
import math

import numpy as np
import pytest
import scipy.integrate

import problems
import qsmc_jax as qj

T1, MU, RHO_INF = 2.0, 2.0, 0.1
ATOL = 10 * float(qj.tight().rtol)
SIGNS = pytest.mark.parametrize("sign", [1.0, -1.0], ids=["g > 0", "g < 0"])
METHODS = pytest.mark.parametrize("method", ["Radau", "DOP853"])


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


@ft.cache
def scipys(n, sign, method):
    """The last state, and the peak of |sigma| / rho."""
    tolerances = {"rtol": 1e-9, "atol": 1e-11, "max_step": 0.01}  # short steps: no stage beyond the pole of the tangent
    solution = scipy.integrate.solve_ivp(
        rate, (0.0, T1), start(n), method, dense_output=True, args=(sign,), **tolerances
    )
    ts = np.linspace(0.0, T1, 20001)
    xs = solution.sol(ts)
    ratios = [abs(sigma(t, x)) / (rho0(n) * math.exp(-MU * t) + RHO_INF) for t, x in zip(ts, xs.T, strict=True)]
    return solution.y[:, -1], max(ratios)


@ft.cache
def ours(n, sign, route):
    plant = problems.chain(n)(1.0, 2.0 * sign, 1.0 / 3.0, 0.5)
    control = qj.QuasiSlidingControl(qj.SlidingSurface(surface(n)[:-1]), qj.Funnel(rho0(n), MU, RHO_INF), sign)
    loop = qj.ClosedLoop(plant, qj.references.SumOfSines([1.0], [1.0]), qj.disturbances.Sine(0.5, 3.0), control)
    settings = qj.SolverSettings(qj.tight().rtol, qj.tight().atol, coordinates=route)
    return qj.simulate(loop, start(n), T1, settings=settings)


def case(n, route, *marks):
    return pytest.param(n, route, id=f"n={n}, {route}", marks=marks)


# Each is a program to compile; the physical route is also held to closed forms, in test_violations.
QUICK = ((1, "funnel"), (2, "funnel"), (5, "funnel"))
ROUTES = pytest.mark.parametrize(
    ("n", "route"),
    [
        case(n, route, *([] if (n, route) in QUICK else [pytest.mark.slow]))
        for n in range(1, 6)
        for route in ("funnel", "physical")
    ],
)


@pytest.mark.slow
@METHODS
@SIGNS
@ROUTES
def test_last_state_is_scipys(n, route, sign, method):
    x1, _ = scipys(n, sign, method)
    np.testing.assert_allclose(ours(n, sign, route).x[-1], x1, rtol=0, atol=ATOL)


@METHODS
@SIGNS
@ROUTES
def test_peak_ratio_is_scipys(n, route, sign, method):
    _, peak = scipys(n, sign, method)
    assert float(ours(n, sign, route).figures.peak_ratio) == pytest.approx(peak, abs=ATOL)


@SIGNS
@ROUTES
def test_run_is_held(n, route, sign):
    assert ours(n, sign, route).verdict == qj.Verdict.HELD
