"""A plant that is not the paper's: a chaotic Duffing oscillator is made to follow a smooth step.

Question: how does one bring one's own plant, and does the guarantee hold for it?
Claim: HELD in every run, although the free oscillator is chaotic and its parameters are uncertain.
Time: 1 000 runs in a few seconds on two cores.
"""

from typing import ClassVar

import jax.numpy as jnp

import qsmc_jax as qj


class Duffing(qj.AbstractPlant):
    r"""A driven oscillator with a double well, $\ddot x = -\delta \dot x + x - \beta x^3 + 0.3 \cos t + b u$.

    A field is a number of the plant; write the two methods with `jax.numpy` and index the state.
    """

    damping: float
    stiffening: float
    input_gain: float

    order: ClassVar[int] = 2

    def drift(self, t, x):
        """Everything that happens without input."""
        return -self.damping * x[1] + x[0] - self.stiffening * x[0] ** 3 + 0.3 * jnp.cos(t)

    def gain(self, t, x):
        """What one unit of input does."""
        return self.input_gain


def scenario(draw: qj.Draw) -> qj.Scenario:
    """An oscillator at rest near a well, told to move to the other one."""
    plant = Duffing(
        damping=draw.uniform("damping", 0.1, 0.3),
        stiffening=draw.uniform("stiffening", 0.8, 1.2),
        input_gain=draw.uniform("input_gain", 0.8, 1.2),
    )
    reference = qj.references.Smooth(lambda t: jnp.tanh(t - 5.0))
    control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=3.0, mu=2.0, rho_inf=0.05))
    disturbance = qj.disturbances.random_noise(draw, "d", bound=0.5, cutoff=10.0, terms=16)
    loop = qj.ClosedLoop(plant, reference, disturbance, control)
    return qj.Scenario(loop, x0=draw.uniform("x0", -1.3, -0.7, shape=(2,)) * jnp.array([1.0, 0.0]), t1=15.0)


study = qj.Study(scenario, bandwidth=0.1)
