"""The coordinates in which a loop is integrated: the funnel coordinate, and the physical states as a cross-check."""

import abc

import jax.numpy as jnp

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import RealScalarLike, Scalars, State
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.numerics.gudermann import funnel_coordinate, gd, sinh_cosh
from qsmc_jax.simulation.settings import SolverSettings


class AbstractCoordinates(AbstractModule):
    """A way to write the loop's state as n scalars `y`."""

    @abc.abstractmethod
    def start(self, loop: ClosedLoop, x0: State) -> Scalars:
        """The coordinates of the state `x0` at time 0, which must lie inside the funnel."""

    @abc.abstractmethod
    def state(self, loop: ClosedLoop, t: RealScalarLike, y: State) -> Scalars:
        """The physical state."""

    @abc.abstractmethod
    def vector_field(self, t: RealScalarLike, y: State, loop: ClosedLoop) -> Scalars:
        """The derivative of `y`."""

    @abc.abstractmethod
    def errors(self, loop: ClosedLoop, t: RealScalarLike, y: State, dy: State) -> Scalars:
        """The errors e^(0) ... e^(n-1), given `y` and its derivative `dy`."""

    @abc.abstractmethod
    def state_of(self, loop: ClosedLoop, t: RealScalarLike, y: State, errors: State) -> Scalars:
        """The physical state, given `y` and the errors."""

    @abc.abstractmethod
    def error_rates(
        self, loop: ClosedLoop, t: RealScalarLike, y: State, dy: State, errors: State, sigma_rate: RealScalarLike
    ) -> Scalars:
        """The rates of the errors, given these, `y` with its derivative `dy`, and the sliding variable's."""

    @abc.abstractmethod
    def drift(self, loop: ClosedLoop, t: RealScalarLike, y: State) -> RealScalarLike | None:
        """How far apart two ways to tell sigma/rho are; None if there is but one."""

    @abc.abstractmethod
    def funnel_coordinate(self, loop: ClosedLoop, t: RealScalarLike, y: State) -> RealScalarLike:
        """The funnel coordinate s."""

    @abc.abstractmethod
    def funnel_motion(
        self, loop: ClosedLoop, t: RealScalarLike, y: State, dy: State
    ) -> tuple[RealScalarLike, RealScalarLike]:
        """The funnel coordinate s and its derivative, given `y` and `dy`."""

    @abc.abstractmethod
    def tolerances(self, size: State, settings: SolverSettings) -> tuple[Scalars, Scalars]:
        """The error that one step may make in each coordinate, whose size is given: the relative part, the absolute."""


class AbstractFunnelCoordinates(AbstractCoordinates):
    """Coordinates of which one is the funnel coordinate."""

    @abc.abstractmethod
    def place(self, loop: ClosedLoop) -> int:
        """Which of them."""

    def funnel_coordinate(self, loop: ClosedLoop, t: RealScalarLike, y: State) -> RealScalarLike:
        return y[self.place(loop)]

    def funnel_motion(
        self, loop: ClosedLoop, t: RealScalarLike, y: State, dy: State
    ) -> tuple[RealScalarLike, RealScalarLike]:
        return y[self.place(loop)], dy[self.place(loop)]

    def tolerances(self, size: State, settings: SolverSettings) -> tuple[Scalars, Scalars]:
        return funnel_tolerances(size, settings)


def funnel_tolerances(size: State, settings: SolverSettings, channels: int = 1) -> tuple[Scalars, Scalars]:
    """What coordinates tolerate of which the last ones are funnel coordinates.

    Args:
        size: Their sizes.
        settings: The settings.
        channels: How many are funnel coordinates.
    """
    absolute = (*(settings.atol,) * (len(size) - channels), *(settings.funnel_atol,) * channels)
    return tuple(settings.rtol * each for each in size), absolute


class FunnelCoordinates(AbstractFunnelCoordinates):
    r"""$y = (e^{(0)}, \dots, e^{(n-2)}, s)$ with $s = \operatorname{asinh}\tan(\pi\sigma / 2\rho)$.

    In it the paper's law is $u = -\operatorname{sgn}(g) \sinh s$ and
    $\dot s = \cosh s \, [\frac{\pi}{2\rho} (w + g u) - \operatorname{gd}(s) \dot\rho / \rho]$, smooth everywhere: no
    pole to step over, and a loop that leaves the funnel shows as $|s| \to \infty$ in finite time. It is the same
    equation, not a way to enforce the claim.

    Source: paper, eqs. (4) and (9), transformed.
    """

    def place(self, loop: ClosedLoop) -> int:
        return -1

    def start(self, loop: ClosedLoop, x0: State) -> Scalars:
        return (*loop.errors(0.0, x0)[:-1], funnel_coordinate(loop.ratio(0.0, x0)))

    def state(self, loop: ClosedLoop, t: RealScalarLike, y: State) -> Scalars:
        return loop.state(_errors(loop, t, loop.control.funnel(t), y), loop.desired(t))

    def vector_field(self, t: RealScalarLike, y: State, loop: ClosedLoop) -> Scalars:
        control = loop.control
        rho, rho_rate = control.funnel.width_and_rate(t)
        errors = _errors(loop, t, rho, y)
        cosh, desired = sinh_cosh(y[-1])[1], loop.desired(t)
        x = loop.state(errors, desired)
        balance = loop.balance(t, x, errors, desired)
        _, centre_rate = control.funnel.centre_and_rate(t)
        sigma_rate = balance.residual - centre_rate + balance.gain * loop.input_at(t, x, errors, desired, y[-1])
        return (*errors[1:], cosh * (0.5 * jnp.pi * sigma_rate - gd(y[-1]) * rho_rate) / rho)

    def errors(self, loop: ClosedLoop, t: RealScalarLike, y: State, dy: State) -> Scalars:
        """Each error is the derivative of the one before."""
        return (y[0], *dy[:-1]) if loop.order > 1 else _errors(loop, t, loop.control.funnel(t), y)

    def state_of(self, loop: ClosedLoop, t: RealScalarLike, y: State, errors: State) -> Scalars:
        return loop.state(errors, loop.desired(t))

    def error_rates(
        self, loop: ClosedLoop, t: RealScalarLike, y: State, dy: State, errors: State, sigma_rate: RealScalarLike
    ) -> Scalars:
        return (*errors[1:], sigma_rate - loop.control.surface((*errors[1:], 0.0)))

    def drift(self, loop: ClosedLoop, t: RealScalarLike, y: State) -> RealScalarLike | None:
        return None


class PhysicalCoordinates(AbstractCoordinates):
    """`y = x`. The law is NaN outside the funnel, so a step with a stage out there is never kept."""

    def start(self, loop: ClosedLoop, x0: State) -> Scalars:
        return tuple(x0)

    def state(self, loop: ClosedLoop, t: RealScalarLike, y: State) -> Scalars:
        return tuple(y)

    def vector_field(self, t: RealScalarLike, y: State, loop: ClosedLoop) -> Scalars:
        return loop.vector_field(t, y)

    def errors(self, loop: ClosedLoop, t: RealScalarLike, y: State, dy: State) -> Scalars:
        return loop.errors(t, y)

    def state_of(self, loop: ClosedLoop, t: RealScalarLike, y: State, errors: State) -> Scalars:
        return tuple(y)

    def error_rates(
        self, loop: ClosedLoop, t: RealScalarLike, y: State, dy: State, errors: State, sigma_rate: RealScalarLike
    ) -> Scalars:
        return loop.errors_in_motion(t, y, dy)[1]

    def drift(self, loop: ClosedLoop, t: RealScalarLike, y: State) -> RealScalarLike | None:
        return None

    def funnel_coordinate(self, loop: ClosedLoop, t: RealScalarLike, y: State) -> RealScalarLike:
        return funnel_coordinate(loop.ratio(t, y))

    def funnel_motion(
        self, loop: ClosedLoop, t: RealScalarLike, y: State, dy: State
    ) -> tuple[RealScalarLike, RealScalarLike]:
        errors, rates = loop.errors_in_motion(t, y, dy)
        surface, (rho, rho_rate) = loop.control.surface, loop.control.funnel.width_and_rate(t)
        centre, centre_rate = loop.control.funnel.centre_and_rate(t)
        ratio = (surface(errors) - centre) / rho
        s = funnel_coordinate(ratio)
        ratio_rate = (surface(rates) - centre_rate - ratio * rho_rate) / rho
        return s, 0.5 * jnp.pi * sinh_cosh(s)[1] * ratio_rate

    def tolerances(self, size: State, settings: SolverSettings) -> tuple[Scalars, Scalars]:
        """A tenth of what is asked for: near the funnel's edge an error of the state is magnified in the input."""
        return tuple(0.1 * settings.rtol * each for each in size), (0.1 * settings.atol,) * len(size)


def _errors(loop: ClosedLoop, t: RealScalarLike, rho: RealScalarLike, y: State) -> Scalars:
    """The errors from the funnel coordinate: the last is what the others leave of sigma."""
    others = loop.control.surface((*y[:-1], 0.0)) - loop.control.funnel.centre(t)
    return (*y[:-1], 2.0 / jnp.pi * rho * gd(y[-1]) - others)
