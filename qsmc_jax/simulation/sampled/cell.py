"""A loop at one instant, as far as the input has no say in it; and an open-loop cell, from one instant to another."""

from typing import Any

import jax.numpy as jnp

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.implementation.swing import Swing, held_swing
from qsmc_jax.metrics.signals import AbstractStep, Signals
from qsmc_jax.model.terms import OwnTerms, Terms
from qsmc_jax.numerics.hermite import Cubic, cubics
from qsmc_jax.simulation.problem import Problem


class LoopPoint(AbstractModule):
    r"""Where a loop is, and what moves it apart from the input.

    Attributes:
        t: Time [s].
        x: State, n scalars.
        terms: What moves the plant.
        errors: $e^{(0)} \dots e^{(n-1)}$.
        drift: The errors' rates under no input.
        sigma: Sliding variable.
        residual: $w$ in $\dot\sigma = w + g u$.
        rho: Half-width of the funnel.
        rho_rate: Its rate.
        centre: Centre of the funnel.
        centre_rate: Its rate.
    """

    t: RealScalarLike
    x: Scalars
    terms: Terms | OwnTerms
    errors: Scalars
    drift: Scalars
    sigma: RealScalarLike
    residual: RealScalarLike
    rho: RealScalarLike
    rho_rate: RealScalarLike
    centre: RealScalarLike
    centre_rate: RealScalarLike

    @property
    def ratio(self) -> RealScalarLike:
        r"""Where in the funnel it is, $z = (\sigma - m) / \rho$."""
        return (self.sigma - self.centre) / self.rho

    def sigma_rate(self, u: RealScalarLike) -> RealScalarLike:
        """The rate of the sliding variable under the input u."""
        return self.residual + self.terms.gain * u

    def error_rates(self, u: RealScalarLike) -> Scalars:
        """The rates of the errors under the input u."""
        return (*self.drift[:-1], self.drift[-1] + self.terms.gain * u)

    @property
    def equivalent_input(self) -> RealScalarLike:
        r"""$u_{eq} = -w / g$, which would hold the sliding variable where it is; 0 where g is."""
        has_gain = self.terms.gain != 0.0
        return jnp.where(has_gain, -self.residual / jnp.where(has_gain, self.terms.gain, 1.0), 0.0)


def loop_point(problem: Problem, t: RealScalarLike, x: Scalars) -> LoopPoint:
    """The loop at time t and state x."""
    loop, barrier, terms = problem.loop, problem.barrier, problem.loop.terms(t, x)
    if isinstance(terms, OwnTerms):
        terms = OwnTerms(*barrier(tuple(terms)))
        errors, rates = barrier(loop.errors_in_motion(t, x, terms.free))
    else:
        desired = barrier(loop.desired(t))
        drift, gain, disturbance = barrier((terms.drift, terms.gain, terms.disturbance))
        terms = terms._replace(drift=drift, gain=gain, disturbance=disturbance)
        errors = tuple(xi - di for xi, di in zip(x, desired, strict=False))
        rates = tuple(rate - di for rate, di in zip(loop.rates(terms, x, 0.0), desired[1:], strict=True))
    surface, funnel = loop.control.surface, loop.control.funnel
    rho, rho_rate = funnel.width_and_rate(t)
    rho = barrier(rho)
    centre = funnel.centre_and_rate(t)
    return LoopPoint(t, x, terms, errors, rates, surface(errors), surface(rates), rho, rho_rate, *centre)


class Cell(AbstractModule):
    """A stretch of time in which nothing jumps: the loop is open and smooth.

    Attributes:
        left: Its beginning.
        right: Its end.
        u0: The plant's input at its beginning.
        middle: The plant's input at its middle.
        u1: The plant's input at its end.
        swing: What the input does in it.
    """

    left: LoopPoint
    right: LoopPoint
    u0: RealScalarLike
    middle: RealScalarLike
    u1: RealScalarLike
    swing: Swing

    @property
    def length(self) -> RealScalarLike:
        """Its length [s]."""
        return self.right.t - self.left.t

    def sigma(self) -> Cubic:
        """The sliding variable in it."""
        left, right, h = self.left, self.right, self.length
        return Cubic(left.sigma, right.sigma, h * left.sigma_rate(self.u0), h * right.sigma_rate(self.u1))

    def errors(self) -> list[Cubic]:
        """Each error in it."""
        rates = self.left.error_rates(self.u0), self.right.error_rates(self.u1)
        return cubics(self.length, self.left.errors, self.right.errors, *rates)

    def ratio(self) -> Cubic:
        r"""$z = (\sigma - m)/\rho$ in it, with $\dot z = (\dot\sigma - \dot m - z \dot\rho)/\rho$."""
        left, right, h, sigma = self.left, self.right, self.length, self.sigma()
        z0, z1 = left.ratio, right.ratio
        m0 = (sigma.m0 - h * left.centre_rate - h * z0 * left.rho_rate) / left.rho
        m1 = (sigma.m1 - h * right.centre_rate - h * z1 * right.rho_rate) / right.rho
        return Cubic(z0, z1, m0, m1)


class CellStep(AbstractStep):
    """A cell as metrics see it: the state by the cubic through its ends, the input by a parabola."""

    data: Cell
    problem: Problem

    @property
    def t0(self) -> RealScalarLike:
        return self.data.left.t

    @property
    def t1(self) -> RealScalarLike:
        return self.data.right.t

    def once(self, tree: Any) -> Any:
        return self.problem.barrier(tree)

    def at(self, theta: RealScalarLike) -> Signals:
        cell, loop = self.data, self.problem.loop
        left, right, h = cell.left, cell.right, cell.length
        rates = (loop.rates(left.terms, left.x, cell.u0), loop.rates(right.terms, right.x, cell.u1))
        x = tuple(cubic(theta) for cubic in cubics(h, left.x, right.x, *rates))
        bend = 2.0 * (cell.u0 - 2.0 * cell.middle + cell.u1)
        u = cell.u0 + theta * (cell.u1 - cell.u0 + (theta - 1.0) * bend)
        return sampled_signals(self.problem, loop_point(self.problem, left.t + theta * h, x), u)


def sampled_signals(problem: Problem, now: LoopPoint, u: RealScalarLike) -> Signals:
    """All signals of a loop with an implementation at one instant, under the input u."""
    desired = problem.loop.desired(now.t, now.x)[:-1]
    terms = now.terms
    return Signals(
        now.t, now.x, desired, now.errors, now.sigma, now.rho, now.ratio, u, terms.disturbance, now.residual, terms.gain
    )


def no_cell(start: LoopPoint) -> Cell:
    """A cell of no length, without input."""
    zero = jnp.zeros(())
    return Cell(start, start, zero, zero, zero, held_swing(zero, zero))
