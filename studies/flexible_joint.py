"""A plant in its own coordinates: a motor turns a link through a spring, and a load pushes on the link.

Question: does the law track the link's angle, four integrators behind the voltage, if spring, link and motor are known
to 20 %, and how far does the spring bend meanwhile?
Claim: the funnel HELD in every run, and the spring bends by less than 1 rad. Theorem 1 says nothing of the errors here,
since the load enters before the voltage does (it is not matched): their bounds are exceeded in most runs.
Time: 1 000 runs in a few seconds on two cores, after some 40 s of compilation.
"""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

import qsmc_jax as qj
from qsmc_jax.base.module import float_field


class FlexibleJoint(qj.AbstractStateSpace):
    """Motor angle, bending of the spring [rad] and their rates [rad/s]; input: voltage [V]; output: angle of the link.

    stiffness of the spring [N m/rad], inertias of hub and link [kg m^2], torque of gravity on the link [N m], constant
    of the motor [V s/rad] with its gear [-] and resistance [Ohm]. The disturbance is a torque on the link [N m].
    """

    stiffness: Float[Array, ""] = float_field(default=1.61)
    hub: Float[Array, ""] = float_field(default=0.0021)
    link: Float[Array, ""] = float_field(default=0.0059)
    gravity: Float[Array, ""] = float_field(default=0.237)
    motor: Float[Array, ""] = float_field(default=0.00767)
    gear: Float[Array, ""] = float_field(default=70.0)
    resistance: Float[Array, ""] = float_field(default=2.6)

    states: ClassVar[int] = 4
    relative_degrees: ClassVar[tuple[int, ...]] = (4,)

    def vector_field(self, t, x, d):
        """The hub turns by the spring, against the motor's back voltage; the link by spring, gravity and load."""
        angle, bend, rate, bend_rate = x
        hub = self.stiffness / self.hub * bend - self._torque() * self.gear * self.motor * rate
        link = (-self.stiffness * bend - self.gravity * jnp.sin(angle + bend) + d) / self.link
        return rate, bend_rate, hub, link - hub

    def input_matrix(self, t, x):
        """The voltage turns the hub, and so bends the spring the other way."""
        return 0.0, 0.0, self._torque(), -self._torque()

    def output(self, t, x):
        """Where the link points."""
        return x[0] + x[1]

    def _torque(self):
        """Angular acceleration of the hub by a volt [rad/s^2/V]."""
        return self.motor * self.gear / (self.resistance * self.hub)


def scenario(draw: qj.Draw) -> qj.Scenario:
    """A link that should swing by half a radian, from rest."""
    plant = FlexibleJoint(
        stiffness=draw.uniform("stiffness", 1.3, 1.9),
        link=draw.uniform("link", 0.0048, 0.007),
        motor=draw.uniform("motor", 0.0062, 0.0092),
    )
    funnel = qj.Funnel(rho0=200.0, mu=2.0, rho_inf=draw.parameter("rho_inf", 2.0, bounds=(0.2, 4.5)))
    control = qj.QuasiSlidingControl(qj.SlidingSurface.binomial(5.0, 4), funnel)
    load = qj.disturbances.random_sine(draw, "load", bound=0.05, frequencies=(0.1, 3.0))
    loop = qj.ClosedLoop(plant, qj.references.SumOfSines([0.5], [1.0]), load, control)
    start = draw.uniform("start", -0.2, 0.2)
    return qj.Scenario(loop, x0=jnp.stack([start, 0.0 * start, 0.0 * start, 0.0 * start]), t1=8.0)


study = qj.Study(
    scenario,
    bandwidth=5.0,
    requirements={"spring": qj.always(lambda s: 1.0 - jnp.abs(s.x[1]), unit="rad")},
)
