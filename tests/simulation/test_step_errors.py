"""Steps and cells are as good as was asked for where the sliding variable tells nothing of their errors.

The plant x_1'' = u + d - c x_1' under the surface sigma = c x_1 + x_2 has sigma' = u + d: sigma does not depend on how
fast the plant moves, and the exponential by which it slides has to be solved for its own sake.
"""

import math
from typing import ClassVar

import numpy as np
import pytest
import scipy.optimize

import problems
import qsmc_jax as qj

C, MU, RHO0, RHO_INF = 10.0, 2.0, 1.0, 0.1
HORIZON = 0.5
SPEEDS = pytest.mark.parametrize("speed", [100.0, -30.0])


class Damped(qj.AbstractPlant):
    """x_1'' = u - c x_1', and a push that keeps sigma / rho at z under the ideal law; none for z = 0."""

    z: float = 0.0

    order: ClassVar[int] = 2

    def drift(self, t, x):
        """The damping and the push."""
        return -C * x[1] + self.z * FUNNEL.width_and_rate(t)[1] + math.tan(0.5 * math.pi * self.z)

    def gain(self, t, x):
        """One."""
        return 1.0


FUNNEL = qj.Funnel(RHO0, MU, RHO_INF)


def last_state(plant, implementation, sigma0, speed):
    """The state at the horizon, of a run that begins with this sliding variable and this speed."""
    control = qj.QuasiSlidingControl(qj.SlidingSurface([C]), FUNNEL)
    loop = qj.ClosedLoop(plant, qj.references.Constant(0.0), qj.disturbances.Zero(), control, implementation)
    # A cell ends at each time that is saved.
    settings = qj.SolverSettings(method="tsit5")
    run = qj.simulate(loop, [(sigma0 - speed) / C, speed], HORIZON, ts=np.array([0.0, HORIZON]), settings=settings)
    return run.x[-1]


@SPEEDS
def test_an_ideal_run_is_solved_well_where_the_funnel_coordinate_stands_still(speed):
    """With sigma = z rho, x_1' = z rho - c x_1 is linear."""
    z = 0.4
    rest, fading = z * RHO_INF / C, z * RHO0 / (C - MU)
    start = (z * (RHO0 + RHO_INF) - speed) / C - rest - fading
    x1 = start * math.exp(-C * HORIZON) + rest + fading * math.exp(-MU * HORIZON)
    x2 = z * (RHO0 * math.exp(-MU * HORIZON) + RHO_INF) - C * x1
    found = last_state(Damped(z), None, z * (RHO0 + RHO_INF), speed)
    # Each of some thirty steps may add 1e-6 of |x_1|, which decays as fast as the errors made before, and 1e-8.
    allowed = 30.0 * (1e-6 * abs(speed) * math.exp(-C * HORIZON) + 1e-8)
    np.testing.assert_allclose(found, [x1, x2], rtol=0.0, atol=allowed)


@SPEEDS
@pytest.mark.parametrize("holds", [1, 3, 125, 500])
def test_a_sampled_run_is_solved_well_whatever_the_period(holds, speed):
    """In a hold x_2 tends to u / c, and sigma grows by u tau; a cell is a part of a hold or the whole of it."""
    period = HORIZON / holds
    sigma0 = sigma = -0.5 * (RHO0 + RHO_INF)
    x2 = speed
    for k in range(holds):
        u = -math.tan(0.5 * math.pi * sigma / (RHO0 * math.exp(-MU * k * period) + RHO_INF))
        sigma += u * period
        x2 = u / C + (x2 - u / C) * math.exp(-C * period)
    found = last_state(Damped(), qj.Implementation(period), sigma0, speed)
    # Each cell may add 1e-6 of the funnel and of sigma, in all 1.6e-6 at the start, which decays by exp(-c t).
    np.testing.assert_allclose(found, [(sigma - x2) / C, x2], rtol=0.0, atol=3e-6)


@pytest.mark.parametrize("level", [0.5, -2.0, 10.0])
@pytest.mark.parametrize("part", [0.3, 1.0, 3.0])
def test_the_first_steps_after_a_jump_are_as_good_as_any(level, part):
    """At rest until a push begins, with phi = pi sigma / 2 rho: phi' = pi (d - tan phi) / 2 rho, which is separable."""
    start = 20.0  # the funnel is as narrow as it gets, and steps have grown
    pace = (1.0 + level**2) * math.pi / (2.0 * RHO_INF)
    width = part / pace
    d = abs(level)
    lasts = lambda phi: (d * phi - math.log(math.cos(phi) - math.sin(phi) / d)) / pace  # noqa: E731
    phi = scipy.optimize.brentq(lambda phi: lasts(phi) - width, 0.0, math.atan(d) * (1.0 - 1e-12), xtol=1e-14)
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), FUNNEL)
    push = qj.disturbances.Telegraph([start, start + width], [0.0, level, 0.0])
    loop = qj.ClosedLoop(problems.chain(1)(), qj.references.Constant(0.0), push, control)
    run = qj.simulate(loop, [0.0], 21.0, ts=np.array([0.0, 21.0]), settings=qj.SolverSettings(method="tsit5"))
    assert float(run.metrics.peak_ratio) == pytest.approx(2.0 * phi / math.pi, abs=2e-7)
