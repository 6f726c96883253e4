"""Funnel coordinate and guarded physical route against SciPy on its own right-hand side: n = 1 to 5, both signs."""

import functools as ft
import math

import numpy as np
import pytest
import scipy.integrate

import problems
import qsmc_jax as qj
from scipy_loops import MU, RHO_INF, T1, rate, rho0, sigma, start, surface

ATOL = 10 * float(qj.tight().rtol)
SIGNS = pytest.mark.parametrize("sign", [1.0, -1.0], ids=["g > 0", "g < 0"])
METHODS = pytest.mark.parametrize("method", ["Radau", "DOP853"])


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
        if route == "funnel" or n in (1, 2, 4)
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
    assert float(ours(n, sign, route).metrics.peak_ratio) == pytest.approx(peak, abs=ATOL)


@SIGNS
@ROUTES
def test_run_is_held(n, route, sign):
    assert ours(n, sign, route).verdict == qj.Verdict.HELD
