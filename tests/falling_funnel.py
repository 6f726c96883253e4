"""A loop of order 1 whose quantities are known in closed form as functions of time."""

import qsmc_jax as qj
from studies_for_tests import Integrator

STEP = qj.disturbances.Piecewise([1.0], (qj.disturbances.Zero(), qj.disturbances.Constant(0.4)))


def falling(draw):
    """x' = 2 u + d, x_des = 0: rho = exp(-t) + 0.1, and the disturbance steps from 0 to 0.4 at t = 1."""
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, 1.0, 0.1))
    loop = qj.ClosedLoop(Integrator(2.0), qj.references.Constant(0.0), STEP, control)
    return qj.Scenario(loop, x0=[draw.uniform("x0", 0.2, 0.4)], t1=2.0)
