"""Small studies whose answers are known: a scalar loop s' = d + g u, quick to compile."""

from typing import ClassVar

import qsmc_jax as qj


class Integrator(qj.AbstractPlant):
    """x' = g u + d."""

    g: float

    order: ClassVar[int] = 1

    def drift(self, t, x):
        """None."""
        return 0.0 * x[0]

    def gain(self, t, x):
        """Constant."""
        return self.g


def scenario(draw):
    """A constant reference and disturbance: the equilibrium is z = (2/pi) atan(d/g)."""
    funnel = qj.Funnel(rho0=1.0, mu=draw.parameter("mu", 1.0, bounds=(0.5, 4.0)), rho_inf=0.1)
    gain_sign = draw.parameter("gain_sign", 1.0, bounds=(-1.0, 1.0))
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), funnel, gain_sign)
    disturbance = qj.disturbances.Constant(draw.uniform("d", -1.0, 1.0))
    plant = Integrator(draw.uniform("g", 1.0, 2.0))
    loop = qj.ClosedLoop(plant, qj.references.Constant(0.0), disturbance, control)
    return qj.Scenario(
        loop, x0=draw.uniform("x0", -1.0, 1.2, shape=(1,)), t1=draw.parameter("t1", 6.0, bounds=(0.1, 20.0))
    )


study = qj.Study(scenario, bandwidth=0.2)
