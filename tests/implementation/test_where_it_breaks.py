"""Where the guarantee breaks, by the engine: analytic limits of control/thresholds/ from both sides, within 1 %."""

import functools as ft
import math

import numpy as np
import pytest

import qsmc_jax as qj
from qsmc_jax.control import thresholds

RHO = 0.1
SURFACES = {1: (), 2: (1.5,), 3: (1.0, 2.0)}
LONG = qj.SolverSettings(max_steps=1_000_000)
POINTS = [(1.0, 0.0), (1.0, 0.3), (2.0, 1.0), (1.0, 2.0)]  # g and w; the last is beyond g / sqrt(3)


@ft.cache
def integrators(n):
    class Integrators(qj.AbstractPlant):
        """x_n' = g u + d."""

        g: float

        order = n

        def drift(self, t, x):
            """None."""
            return 0.0 * x[0]

        def gain(self, t, x):
            """Constant."""
            return self.g

    return Integrators


@ft.cache
def study(n, effect):
    """A chain of integrators under a constant w, from starts near rest; `value` is the number of the effect."""
    effects = {
        "period": lambda draw, value: qj.Implementation(value),
        "delay": lambda draw, value: qj.Implementation(value / 100.0, delay=value, queue=128),
        "lag": lambda draw, value: qj.Implementation(value / 2000.0, actuator=qj.actuators.FirstOrderLag(value)),
        "actuator": lambda draw, value: qj.Implementation(
            0.002 / value, actuator=qj.actuators.SecondOrderLag(value, 0.7)
        ),
    }

    def scenario(draw):
        funnel = qj.Funnel(1.0, 4.0, RHO)
        control = qj.QuasiSlidingControl(qj.SlidingSurface(list(SURFACES[n])), funnel)
        plant = integrators(n)(draw.parameter("g", 1.0, bounds=(0.1, 10.0)))
        w = qj.disturbances.Constant(draw.parameter("w", 0.0, bounds=(-10.0, 10.0)))
        implementation = effects[effect](draw, draw.parameter("value", 0.01, bounds=(1e-6, 1e4)))
        loop = qj.ClosedLoop(plant, qj.references.Constant(0.0), w, control, implementation)
        t1 = draw.parameter("t1", 10.0, bounds=(0.1, 1e4))
        spread = draw.parameter("spread", 0.02, bounds=(0.0, 0.05))
        return qj.Scenario(loop, x0=spread * draw.uniform("start", -1.0, 1.0, shape=(n,)), t1=t1)

    return qj.Study(scenario, bandwidth=2 * RHO)


def breaks(n, effect, g, w, value, t1, spread=0.02):
    """Whether runs leave the funnel, or swing more in the last quarter of their time than in the one before it."""
    cell = study(n, effect).substitute(g=g, w=w, value=value, spread=spread)
    quarters = [qj.monte_carlo(cell.substitute(t1=part * t1), 64, block=64, settings=LONG) for part in (0.5, 0.75, 1.0)]
    if np.any(quarters[-1]["verdict"] == qj.Verdict.VIOLATED):
        return True
    assert np.all(quarters[-1]["verdict"] == qj.Verdict.HELD)
    before, last = np.diff([quarter["total_variation_u"] for quarter in quarters], axis=0)
    return bool(np.median(last) > max(0.99 * np.median(before), 1e-6))


@pytest.mark.parametrize(("g", "w"), POINTS)
@pytest.mark.parametrize("n", [1, 2, pytest.param(3, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_the_period_of_the_hold(n, g, w):
    limit = thresholds.critical_period(g, w, RHO, SURFACES[n])
    assert not breaks(n, "period", g, w, 0.99 * limit, 2000 * limit)
    assert breaks(n, "period", g, w, 1.01 * limit, 2000 * limit)


@pytest.mark.parametrize(("g", "w"), POINTS[:3])
@pytest.mark.parametrize("n", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_the_delay(n, g, w):
    limit = thresholds.critical_delay(g, w, RHO, SURFACES[n])
    held, lost = (factor * limit / 1.005 for factor in (0.99, 1.01))  # the hold of h / 100 is late by half of that
    assert not breaks(n, "delay", g, w, held, 400 * limit)
    assert breaks(n, "delay", g, w, lost, 400 * limit)


@pytest.mark.parametrize("g", [0.7, 3.0])
@pytest.mark.slow
@pytest.mark.parametrize("n", [2, 3])
def test_the_lag(n, g):
    """From very near rest: larger swings are lost before the linearised loop is.

    The hold of T / 2000 counts as a delay of half of that, for which the margin of 1 % has room."""
    limit = thresholds.critical_lag(g, 0.0, RHO, SURFACES[n])
    assert not breaks(n, "lag", g, 0.0, 0.99 * limit, 60 * limit, spread=1e-3)
    assert breaks(n, "lag", g, 0.0, 1.01 * limit, 60 * limit, spread=1e-3)


@pytest.mark.slow
def test_a_lag_alone_breaks_no_loop_of_order_1():
    """But for the shrinking of the funnel: there is no limit."""
    assert math.isinf(thresholds.critical_lag(1.0, 0.3, RHO))
    assert not breaks(1, "lag", 1.0, 0.3, 1.0, 40.0)


@pytest.mark.slow
@pytest.mark.parametrize(("g", "w"), POINTS[:2])
def test_the_frequency_of_an_actuator(g, w):
    limit = thresholds.critical_actuator_frequency(g, w, RHO, 0.7, SURFACES[2])
    assert not breaks(2, "actuator", g, w, 1.01 * limit, 400 / limit)
    assert breaks(2, "actuator", g, w, 0.99 * limit, 400 / limit)
