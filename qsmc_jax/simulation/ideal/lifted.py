"""Coordinates for plants in their own: the state as it is, and the funnel coordinates beside it."""

import jax.numpy as jnp

from qsmc_jax.base.types import RealScalarLike, Scalars, State
from qsmc_jax.channel import Channel
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.model.own_coordinates import AbstractOwnCoordinates
from qsmc_jax.numerics.gudermann import funnel_coordinate, gd, ratio, sinh_cosh
from qsmc_jax.simulation.ideal.coordinates import (
    AbstractCoordinates,
    AbstractFunnelCoordinates,
    FunnelCoordinates,
    PhysicalCoordinates,
)


class AbstractLiftedCoordinates(AbstractFunnelCoordinates):
    r"""The states of a plant $x_1, \dots, x_N$, and beside them $s = \operatorname{asinh}\tan(\pi z/2)$.

    The paper's law acts on s, $u = -\operatorname{sgn}(g) \sinh s$, so that there is no pole to step over; and
    $\dot s = \cosh s \, [\frac{\pi}{2\rho} (\dot\sigma + \mu (\sigma(t, x) - \rho z)) - \operatorname{gd}(s)
    \dot\rho / \rho]$, where $z = \frac{2}{\pi} \operatorname{gd}(s)$. What x and s say of the sliding variable is the
    same but for errors of the solve, which the term with the funnel's rate $\mu$ keeps from adding up.
    """

    def errors(self, loop: ClosedLoop, t: RealScalarLike, y: State, dy: State) -> Scalars:
        return loop.errors(t, self.state(loop, t, y))

    def state_of(self, loop: ClosedLoop, t: RealScalarLike, y: State, errors: State) -> Scalars:
        return self.state(loop, t, y)

    def error_rates(
        self, loop: ClosedLoop, t: RealScalarLike, y: State, dy: State, errors: State, sigma_rate: RealScalarLike
    ) -> Scalars:
        return loop.errors_in_motion(t, self.state(loop, t, y), self.state(loop, t, dy))[1]

    def drift(self, loop: ClosedLoop, t: RealScalarLike, y: State) -> RealScalarLike | None:
        return jnp.abs(loop.ratio(t, self.state(loop, t, y)) - ratio(y[self.place(loop)]))


class LiftedCoordinates(AbstractLiftedCoordinates):
    r"""Those of a plant with one input: $y = (x_1, \dots, x_N, s)$."""

    def place(self, loop: ClosedLoop) -> int:
        return -1

    def start(self, loop: ClosedLoop, x0: State) -> Scalars:
        return (*x0, funnel_coordinate(loop.ratio(0.0, x0)))

    def state(self, loop: ClosedLoop, t: RealScalarLike, y: State) -> Scalars:
        return tuple(y[:-1])

    def vector_field(self, t: RealScalarLike, y: State, loop: ClosedLoop) -> Scalars:
        x, s = tuple(y[:-1]), y[-1]
        rates = loop.driven(t, x, loop.input_at(t, x, loop.errors(t, x), loop.desired(t, x), s))
        return (*rates, funnel_rate(loop, t, x, s, rates))


class ChannelCoordinates(AbstractLiftedCoordinates):
    r"""Those of a channel of several: $y = (x_1, \dots, x_N, s_1, \dots, s_m)$, all of which is its state.

    What laws keep counts among the states.
    """

    def place(self, loop: ClosedLoop) -> int:
        channel = loop.plant
        assert isinstance(channel, Channel)
        return channel.states - len(channel.laws) + channel.index

    def start(self, loop: ClosedLoop, x0: State) -> Scalars:
        return tuple(x0)

    def state(self, loop: ClosedLoop, t: RealScalarLike, y: State) -> Scalars:
        return tuple(y)

    def vector_field(self, t: RealScalarLike, y: State, loop: ClosedLoop) -> Scalars:
        u = loop.input_at(t, y, loop.errors(t, y), loop.desired(t), y[self.place(loop)])
        return loop.driven(t, tuple(y), u)


def funnel_rate(loop: ClosedLoop, t: RealScalarLike, x: State, s: RealScalarLike, rates: Scalars) -> RealScalarLike:
    """The rate of the funnel coordinate beside a state.

    Args:
        loop: The loop.
        t: Time [s].
        x: State.
        s: Funnel coordinate [-].
        rates: The state's rates.
    """
    funnel, cosh = loop.control.funnel, sinh_cosh(s)[1]
    rho, rho_rate = funnel.width_and_rate(t)
    centre, centre_rate = funnel.centre_and_rate(t)
    sigma, sigma_rate = map(loop.control.surface, loop.errors_in_motion(t, x, rates))
    pull = funnel.rate * (sigma - centre - rho * ratio(s)) - centre_rate
    return cosh * (0.5 * jnp.pi * (sigma_rate + pull) - gd(s) * rho_rate) / rho


def named_coordinates(name: str, loop: ClosedLoop) -> AbstractCoordinates:
    """The coordinates that `SolverSettings.coordinates` names, for a loop."""
    if name == "physical":
        return PhysicalCoordinates()
    return LiftedCoordinates() if isinstance(loop.plant, AbstractOwnCoordinates) else FunnelCoordinates()
