"""The coordinates in which a loop is integrated: the funnel coordinate, and the physical states as a cross-check."""

import abc
from typing import TypeAlias

import jax.numpy as jnp

from qsmc_jax.base.gudermann import funnel_coordinate, gd, sinh_cosh
from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import RealScalarLike, State
from qsmc_jax.loop import ClosedLoop

Scalars: TypeAlias = tuple[RealScalarLike, ...]


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
    def funnel_coordinate(self, loop: ClosedLoop, t: RealScalarLike, y: State) -> RealScalarLike:
        """The funnel coordinate s."""

    @abc.abstractmethod
    def funnel_motion(
        self, loop: ClosedLoop, t: RealScalarLike, y: State, dy: State
    ) -> tuple[RealScalarLike, RealScalarLike]:
        """The funnel coordinate s and its derivative, given `y` and `dy`."""


class FunnelCoordinates(AbstractCoordinates):
    r"""$y = (x_1, \dots, x_{n-1}, s)$ with $s = \operatorname{asinh}\tan(\pi\sigma / 2\rho)$, the inverse Gudermannian.

    In it the law is $u = -\operatorname{sgn}(g) \sinh s$ and
    $\dot s = \cosh s \, [\frac{\pi}{2\rho} (w + g u) - \operatorname{gd}(s) \dot\rho / \rho]$, smooth everywhere: no
    pole to step over, and a loop that leaves the funnel shows as $|s| \to \infty$ in finite time. It is the same
    equation, not a way to enforce the claim.

    Source: paper, eqs. (4) and (9), transformed.
    """

    def start(self, loop: ClosedLoop, x0: State) -> Scalars:
        ratio = loop.sliding_variable(0.0, x0) / loop.control.funnel(0.0)
        return (*x0[:-1], funnel_coordinate(ratio))

    def state(self, loop: ClosedLoop, t: RealScalarLike, y: State) -> Scalars:
        return _state(loop, loop.control.funnel(t), y, loop.desired(t))

    def vector_field(self, t: RealScalarLike, y: State, loop: ClosedLoop) -> Scalars:
        control, desired = loop.control, loop.desired(t)
        rho, rho_rate = control.funnel.width_and_rate(t)
        x = _state(loop, rho, y, desired)
        sinh, cosh = sinh_cosh(y[-1])
        balance = loop.balance(t, x, desired)
        sigma_rate = balance.residual - balance.gain * control.gain_sign * sinh
        return (*x[1:], cosh * (0.5 * jnp.pi * sigma_rate - gd(y[-1]) * rho_rate) / rho)

    def funnel_coordinate(self, loop: ClosedLoop, t: RealScalarLike, y: State) -> RealScalarLike:
        return y[-1]

    def funnel_motion(
        self, loop: ClosedLoop, t: RealScalarLike, y: State, dy: State
    ) -> tuple[RealScalarLike, RealScalarLike]:
        return y[-1], dy[-1]


class PhysicalCoordinates(AbstractCoordinates):
    """`y = x`. The law is NaN outside the funnel, so a step with a stage out there is never kept."""

    def start(self, loop: ClosedLoop, x0: State) -> Scalars:
        return tuple(x0)

    def state(self, loop: ClosedLoop, t: RealScalarLike, y: State) -> Scalars:
        return tuple(y)

    def vector_field(self, t: RealScalarLike, y: State, loop: ClosedLoop) -> Scalars:
        return loop.vector_field(t, y)

    def funnel_coordinate(self, loop: ClosedLoop, t: RealScalarLike, y: State) -> RealScalarLike:
        return funnel_coordinate(loop.sliding_variable(t, y) / loop.control.funnel(t))

    def funnel_motion(
        self, loop: ClosedLoop, t: RealScalarLike, y: State, dy: State
    ) -> tuple[RealScalarLike, RealScalarLike]:
        desired = loop.desired(t)
        errors = tuple(yi - di for yi, di in zip(y, desired, strict=False))
        rates = tuple(dyi - di for dyi, di in zip(dy, desired[1:], strict=True))
        surface, (rho, rho_rate) = loop.control.surface, loop.control.funnel.width_and_rate(t)
        ratio = surface(errors) / rho
        s = funnel_coordinate(ratio)
        ratio_rate = (surface(rates) - ratio * rho_rate) / rho
        return s, 0.5 * jnp.pi * sinh_cosh(s)[1] * ratio_rate


def _state(loop: ClosedLoop, rho: RealScalarLike, y: State, desired: State) -> Scalars:
    """The physical state from the funnel coordinate: the last error is what the others leave of sigma."""
    errors = [yi - di for yi, di in zip(y[:-1], desired, strict=False)]
    others = loop.control.surface((*errors, 0.0))
    last_error = 2.0 / jnp.pi * rho * gd(y[-1]) - others
    return (*y[:-1], desired[loop.order - 1] + last_error)


def named_coordinates(name: str) -> AbstractCoordinates:
    """The coordinates that `SolverSettings.coordinates` names."""
    return {"funnel": FunnelCoordinates, "physical": PhysicalCoordinates}[name]()
