"""A loop at one instant, as far as the input has no say in it; and an open-loop cell, from one instant to another."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.channel import Channel
from qsmc_jax.implementation.swing import Swing, held_swing
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.metrics.signals import AbstractStep, Signals, joint_signals
from qsmc_jax.model.terms import OwnTerms, Terms
from qsmc_jax.numerics.hermite import Cubic, cubics
from qsmc_jax.numerics.linear import eliminate, substitute
from qsmc_jax.simulation.problem import AbstractProblem, Problem


class LoopPoint(AbstractModule):
    r"""Where a loop is, or one channel of several inputs, and what moves it apart from its input.

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
        row: With several inputs what a unit of each adds to the sliding variable's rate.
        balanced: With several inputs the one that would, together with the others, hold all sliding variables.
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
    row: Scalars = ()
    balanced: RealScalarLike | None = None

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
        if self.balanced is not None:
            return self.balanced
        has_gain = self.terms.gain != 0.0
        return jnp.where(has_gain, -self.residual / jnp.where(has_gain, self.terms.gain, 1.0), 0.0)


def loop_point(problem: Problem, t: RealScalarLike, x: Scalars) -> LoopPoint:
    """The loop at time t and state x; a channel with the other inputs left out."""
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


def loop_points(problem: AbstractProblem, t: RealScalarLike, x: Scalars) -> tuple[LoopPoint, ...]:
    """All channels of a loop at time t and state x, without inputs."""
    points = tuple(loop_point(each, t, x) for each in problem.channels)
    if len(points) == 1:
        return points
    reaches = [_own(point).reach for point in points]
    rows = problem.barrier([_row(each.loop, t, x, reaches) for each in problem.channels])
    held = substitute(eliminate([list(row) for row in rows]), tuple(-point.residual for point in points))
    held = (jnp.where(jnp.isfinite(u), u, 0.0) for u in held)  # 0 where the rows are no basis
    found = []
    for i, (point, row, u) in enumerate(zip(points, rows, held, strict=True)):
        terms = _own(point)._replace(disturbance=_own(point).disturbance[i])
        found.append(dataclasses.replace(point, terms=terms, row=row, balanced=u))
    return tuple(found)


def _row(loop: ClosedLoop, t: RealScalarLike, x: Scalars, reaches: Sequence[Scalars]) -> Scalars:
    """What a unit of each input adds to the rate of a channel's sliding variable."""
    plant = loop.plant
    assert isinstance(plant, Channel)
    return tuple(loop.control.surface(plant.outputs_in_motion(t, x, reach, 0.0)[1]) for reach in reaches)


def _own(point: LoopPoint) -> OwnTerms:
    """What moves a plant with several inputs, which is in its own coordinates."""
    assert isinstance(point.terms, OwnTerms)
    return point.terms


def rates(problem: AbstractProblem, t: RealScalarLike, x: Scalars, inputs: Scalars) -> Scalars:
    """The state's rates under the inputs."""
    loops = [each.loop for each in problem.channels]
    first, *others = (loop.terms(t, x) for loop in loops)
    found = loops[0].rates(first, x, inputs[0])
    for terms, u in zip(others, inputs[1:], strict=True):
        assert isinstance(terms, OwnTerms)
        found = tuple(rate + g * u for rate, g in zip(found, terms.reach, strict=True))
    return found


def seen(points: tuple[LoopPoint, ...], inputs: Scalars) -> tuple[LoopPoint, ...]:
    """Each channel as it is under the others' inputs."""
    found = []
    for i, point in enumerate(points):
        others = [(_own(other).reach, point.row[j], inputs[j]) for j, other in enumerate(points) if j != i]
        for reach, gain, u in others:
            free = tuple(rate + g * u for rate, g in zip(_own(point).free, reach, strict=True))
            drift, w = (*point.drift[:-1], point.drift[-1] + gain * u), point.residual + gain * u
            point = dataclasses.replace(point, terms=_own(point)._replace(free=free), drift=drift, residual=w)
        found.append(point)
    return tuple(found)


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

    def input_at(self, theta: RealScalarLike) -> RealScalarLike:
        """The input in it, by a parabola; `theta` is 0 at its beginning and 1 at its end."""
        bend = 2.0 * (self.u0 - 2.0 * self.middle + self.u1)
        return self.u0 + theta * (self.u1 - self.u0 + (theta - 1.0) * bend)

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
    """A cell, of each channel, as metrics see it: the state by the cubic through its ends, inputs by parabolas."""

    data: tuple[Cell, ...]
    problem: AbstractProblem

    @property
    def t0(self) -> RealScalarLike:
        return self.data[0].left.t

    @property
    def t1(self) -> RealScalarLike:
        return self.data[0].right.t

    def once(self, tree: Any) -> Any:
        return self.problem.barrier(tree)

    def at(self, theta: RealScalarLike) -> Signals:
        cell, loop = self.data[0], self.problem.channels[0].loop
        left, right, h = cell.left, cell.right, cell.length
        rates = (loop.rates(left.terms, left.x, cell.u0), loop.rates(right.terms, right.x, cell.u1))
        x = tuple(cubic(theta) for cubic in cubics(h, left.x, right.x, *rates))
        inputs = tuple(each.input_at(theta) for each in self.data)
        return sampled_signals(self.problem, loop_points(self.problem, left.t + theta * h, x), inputs)


def sampled_signals(problem: AbstractProblem, now: Sequence[LoopPoint], inputs: Scalars) -> Signals:
    """All signals of a loop with an implementation at one instant, under the inputs."""
    parts = zip(problem.channels, now, inputs, strict=True)
    channels = [_of_channel(each, point, u) for each, point, u in parts]
    if len(channels) == 1:
        return channels[0]
    return joint_signals(channels)


def _of_channel(problem: Problem, now: LoopPoint, u: RealScalarLike) -> Signals:
    desired = problem.loop.desired(now.t, now.x)[:-1]
    terms = now.terms
    gain = now.row or terms.gain
    return Signals(
        now.t, now.x, desired, now.errors, now.sigma, now.rho, now.ratio, u, terms.disturbance, now.residual, gain
    )


def no_cell(start: Sequence[LoopPoint]) -> tuple[Cell, ...]:
    """A cell of no length, without input, of each channel."""
    zero = jnp.zeros(())
    return tuple(Cell(each, each, zero, zero, zero, held_swing(zero, zero)) for each in start)
