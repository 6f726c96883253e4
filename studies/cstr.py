"""A stirred reactor that goes out or runs away by itself, started up by a coolant that has a coldest and a hottest.

Question: a thermometer and a limited coolant should bring a cold reactor into its unstable middle state and hold it
there, whatever feed is left in it: how often is the coolant not cold, or not hot, enough?
Claim: of 1 000 runs 983 HELD, though some 400 need the hottest coolant for a while and 24 the coldest. Ten can't be
heated as fast as the funnel narrows, and seven run away (`temperature` VIOLATED): feed that has not reacted goes off at
once. Without limits (`-S coldest=-20 -S hottest=20`) all runs HELD. A law that does not cool in advance (`-S offset=0`)
loses 61 runs to the same limits, 53 of them by running away.
Time: 1 000 runs in some twenty seconds on two cores, after a minute of compilation.
"""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

import qsmc_jax as qj
from qsmc_jax.base.module import float_field


class Reactor(qj.AbstractStateSpace):
    r"""Conversion $x_0$ and temperature $x_1$ above the feed's; input: temperature of the coolant above the feed's.

    All is dimensionless: time is in residence times, a unit of temperature the feed's over `activation`, 17 K at 340 K.
    damkoehler: speed of the reaction at the feed's temperature; heat of reaction; cooling: heat transfer; activation:
    energy of activation. The disturbance is the feed's temperature. Conversion is internal dynamics.

    Source: Uppal, Ray and Poore (1974), On the dynamic behavior of continuous stirred tank reactors.
    """

    damkoehler: Float[Array, ""] = float_field(default=0.072)
    heat: Float[Array, ""] = float_field(default=8.0)
    cooling: Float[Array, ""] = float_field(default=0.3)
    activation: Float[Array, ""] = float_field(default=20.0)

    states: ClassVar[int] = 2
    relative_degrees: ClassVar[tuple[int, ...]] = (1,)

    def vector_field(self, t, x, d):
        """A reaction that is the faster the hotter; the feed, and the coolant, take its heat away."""
        conversion, temperature = x
        reaction = self.damkoehler * (1.0 - conversion) * jnp.exp(temperature / (1.0 + temperature / self.activation))
        return reaction - conversion, self.heat * reaction - (1.0 + self.cooling) * temperature + d

    def input_matrix(self, t, x):
        """A warmer coolant warms the reactor."""
        return 0.0, self.cooling

    def output(self, t, x):
        """What a thermometer shows."""
        return x[1]


def scenario(draw: qj.Draw) -> qj.Scenario:
    """A cold reactor that should go to the middle one of its three resting states, and stay."""
    plant = Reactor(damkoehler=draw.uniform("damkoehler", 0.065, 0.079), heat=draw.uniform("heat", 7.5, 8.5))
    funnel = qj.Funnel(rho0=2.5, mu=draw.parameter("mu", 0.3, bounds=(0.05, 2.0)), rho_inf=0.3)
    offset = draw.parameter("offset", -0.5, bounds=(-3.0, 2.0))
    law = qj.QuasiSlidingControl(qj.SlidingSurface([]), funnel, gain=1.0, offset=offset)
    # Cooling water of 289 K and hot water of 370 K: far from symmetric.
    coldest = draw.parameter("coldest", -3.0, bounds=(-20.0, -0.5))
    hottest = draw.parameter("hottest", 1.75, bounds=(0.5, 20.0))
    limits = jnp.stack([coldest, hottest])
    control = qj.controllers.Saturated(law, input_range=limits)
    feed = qj.disturbances.random_sine(draw, "feed", 0.1, (0.3, 3.0))
    loop = qj.ClosedLoop(plant, qj.references.Constant(2.75), feed, control)
    start = draw.uniform("conversion_0", 0.2, 0.4), draw.uniform("temperature_0", 0.5, 2.0)
    return qj.Scenario(loop, x0=jnp.stack(start), t1=20.0)


study = qj.Study(
    scenario,
    bandwidth=0.5,
    requirements={
        "temperature": qj.always(lambda s: 3.5 - s.x[1]),
        "conversion": qj.always(lambda s: 0.1 - jnp.abs(s.x[0] - 0.45), after=12.0),
    },
)
