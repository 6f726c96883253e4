"""Coordinates for plants in their own: the state as it is, and the funnel coordinate beside it."""

import jax.numpy as jnp

from qsmc_jax.base.types import RealScalarLike, Scalars, State
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.model.state_space import AbstractStateSpace
from qsmc_jax.numerics.gudermann import funnel_coordinate, gd, ratio, sinh_cosh
from qsmc_jax.simulation.ideal.coordinates import (
    AbstractCoordinates,
    AbstractFunnelCoordinates,
    FunnelCoordinates,
    PhysicalCoordinates,
)


class LiftedCoordinates(AbstractFunnelCoordinates):
    r"""$y = (x_1, \dots, x_N, s)$ with $s = \operatorname{asinh}\tan(\pi\sigma / 2\rho)$.

    The paper's law acts on s, $u = -\operatorname{sgn}(g) \sinh s$, so that there is no pole to step over; and
    $\dot s = \cosh s \, [\frac{\pi}{2\rho} (\dot\sigma + \mu (\sigma(t, x) - \rho z)) - \operatorname{gd}(s)
    \dot\rho / \rho]$, where $z = \frac{2}{\pi} \operatorname{gd}(s)$. What x and s say of the sliding variable is the
    same but for errors of the solve, which the term with the funnel's rate $\mu$ keeps from adding up.
    """

    def start(self, loop: ClosedLoop, x0: State) -> Scalars:
        return (*x0, funnel_coordinate(loop.ratio(0.0, x0)))

    def state(self, loop: ClosedLoop, t: RealScalarLike, y: State) -> Scalars:
        return tuple(y[:-1])

    def vector_field(self, t: RealScalarLike, y: State, loop: ClosedLoop) -> Scalars:
        control, x, s = loop.control, tuple(y[:-1]), y[-1]
        rho, rho_rate = control.funnel.width_and_rate(t)
        centre, centre_rate = control.funnel.centre_and_rate(t)
        cosh, errors = sinh_cosh(s)[1], loop.errors(t, x)
        rates = loop.driven(t, x, loop.input_at(t, errors, loop.desired(t), s))
        sigma, sigma_rate = map(control.surface, loop.errors_in_motion(t, x, rates))
        pull = control.funnel.rate * (sigma - centre - rho * ratio(s)) - centre_rate
        return (*rates, cosh * (0.5 * jnp.pi * (sigma_rate + pull) - gd(s) * rho_rate) / rho)

    def errors(self, loop: ClosedLoop, t: RealScalarLike, y: State, dy: State) -> Scalars:
        return loop.errors(t, tuple(y[:-1]))

    def state_of(self, loop: ClosedLoop, t: RealScalarLike, y: State, errors: State) -> Scalars:
        return tuple(y[:-1])

    def error_rates(
        self, loop: ClosedLoop, t: RealScalarLike, y: State, dy: State, errors: State, sigma_rate: RealScalarLike
    ) -> Scalars:
        return loop.errors_in_motion(t, tuple(y[:-1]), tuple(dy[:-1]))[1]

    def drift(self, loop: ClosedLoop, t: RealScalarLike, y: State) -> RealScalarLike | None:
        return jnp.abs(loop.ratio(t, tuple(y[:-1])) - ratio(y[-1]))


def named_coordinates(name: str, loop: ClosedLoop) -> AbstractCoordinates:
    """The coordinates that `SolverSettings.coordinates` names, for a loop."""
    if name == "physical":
        return PhysicalCoordinates()
    return LiftedCoordinates() if isinstance(loop.plant, AbstractStateSpace) else FunnelCoordinates()
