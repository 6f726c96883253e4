"""A plant whose input works the other way, g < 0: opening the valve of a cooler lowers the temperature.

Question: does the law hold a reactor on its temperature profile while the heat of reaction switches at random?
Claim: HELD in every run, with `gain_sign=-1`.
Time: 1 000 runs in a few seconds on two cores.
"""

from typing import ClassVar

import qsmc_jax as qj


class CooledReactor(qj.AbstractPlant):
    """Temperature above ambient x [K] of a stirred reactor: x' = heat - loss x - cooling u, order 1.

    heat [K/s], loss [1/s], cooling [K/s per unit of valve].
    """

    heat: float
    loss: float
    cooling: float

    order: ClassVar[int] = 1

    def drift(self, t, x):
        """Heating and losses."""
        return self.heat - self.loss * x[0]

    def gain(self, t, x):
        """The valve cools, the more the hotter the reactor is: negative throughout."""
        return -self.cooling * (1.0 + 0.02 * x[0] ** 2)


def scenario(draw: qj.Draw) -> qj.Scenario:
    """A reactor that should swing around 10 K above ambient."""
    plant = CooledReactor(
        heat=draw.uniform("heat", 1.5, 2.5),
        loss=draw.uniform("loss", 0.05, 0.15),
        cooling=draw.uniform("cooling", 0.5, 1.0),
    )
    funnel = qj.Funnel(rho0=5.0, mu=1.0, rho_inf=0.2)
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), funnel, gain_sign=-1)
    disturbance = qj.disturbances.random_telegraph(draw, "reaction", bound=0.5, rate=0.5, horizon=20.0)
    reference = qj.references.SumOfSines([1.0], [0.5], offset=10.0)
    loop = qj.ClosedLoop(plant, reference, disturbance, control)
    return qj.Scenario(loop, x0=draw.uniform("x0", 6.0, 14.0, shape=(1,)), t1=20.0)


study = qj.Study(scenario, bandwidth=0.4)
