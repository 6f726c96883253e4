"""A ship that changes its heading by a rudder which is slow, and stops at 35 degrees.

Question: over speeds, loads and waves, does the heading stay within its funnel though the rudder turns by 5 degrees a
    second at most?
Claim: HELD in every run. With a rudder that turns by 1 degree a second (`-S rate=0.0175`) all of 256 runs leave it, and
    `max_u` and `min_u` show it at its stops, 0.61 rad.
Time: a few seconds for 1 000 runs on two cores.
"""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np

import qsmc_jax as qj

DEGREE = np.pi / 180.0


class Ship(qj.AbstractPlant):
    """Heading x_0 and rate of turn x_1 [rad, rad/s] of Nomoto's model: T x_1' + x_1 = K u, order 2.

    gain K [1/s], time_constant T [s]; u is the rudder's angle [rad], and a disturbance acts on x_1'.
    """

    turning: float
    time_constant: float

    order: ClassVar[int] = 2

    def drift(self, t, x):
        """The hull's resistance."""
        return -x[1] / self.time_constant

    def gain(self, t, x):
        """The rudder's moment."""
        return self.turning / self.time_constant


def scenario(draw):
    """A turn by 40 degrees within half a minute, from a heading that is off by up to 3."""
    ship = Ship(draw.uniform("turning", 0.15, 0.25), draw.uniform("time_constant", 15.0, 25.0))
    funnel = qj.Funnel(rho0=draw.parameter("rho0", 0.1, bounds=(0.01, 1.0)), mu=0.1, rho_inf=0.004)
    control = qj.QuasiSlidingControl(qj.SlidingSurface([draw.parameter("c", 0.1, bounds=(0.01, 1.0))]), funnel)
    rudder = qj.actuators.RateLimited(
        draw.parameter("lag", 0.5, bounds=(0.0, 10.0)),
        draw.parameter("rate", 5.0 * DEGREE, bounds=(0.1 * DEGREE, 1.0)),
        travel=(-35.0 * DEGREE, 35.0 * DEGREE),
    )
    implementation = qj.Implementation(draw.parameter("sample_period", 0.2, bounds=(0.01, 5.0)), actuator=rudder)
    reference = qj.references.Smooth(lambda t: 20.0 * DEGREE * (1.0 + jnp.tanh((t - 60.0) / 12.0)))
    waves = qj.disturbances.random_sines(draw, "waves", bound=4e-4, terms=4, frequencies=(0.3, 1.2))
    loop = qj.ClosedLoop(ship, reference, waves, control, implementation)
    return qj.Scenario(loop, x0=jnp.stack([draw.uniform("off", -3.0, 3.0) * DEGREE, jnp.zeros(())]), t1=200.0)


study = qj.Study(scenario, bandwidth=0.01)
