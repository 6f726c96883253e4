"""Figures kept up step by step inside the solve: suprema, integrals, times, and how the premises fared.

They are read off each accepted step's own cubic Hermite interpolant, so nothing hides between the points of a save
grid, and they ride along in the integrated state, with no say in the step size, so that gradients reach them.
"""

import functools as ft
import itertools as it
import math
from collections.abc import Hashable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from qsmc_jax.base import trees
from qsmc_jax.base.fence import Fence
from qsmc_jax.base.gudermann import ratio, sinh_cosh
from qsmc_jax.base.hermite import Cubic, Quartic, cubics, integral_of_square
from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.metrics.accumulate import States, first_states
from qsmc_jax.metrics.accumulate import add_step as add_own
from qsmc_jax.metrics.metric import AbstractMeasure
from qsmc_jax.metrics.signals import AbstractStep, Signals
from qsmc_jax.simulation.coordinates import AbstractCoordinates
from qsmc_jax.simulation.quartic_interpolation import QuarticInterpolation

# Gauss-Lobatto rule with four nodes on [0, 1], exact for polynomials of degree 5: the ends and 1/2 -+ 1/(2 sqrt 5).
_LOBATTO_NODES = (0.5 - 0.1 * 5**0.5, 0.5 + 0.1 * 5**0.5)
_LOBATTO_END, _LOBATTO_INNER = 1.0 / 12.0, 5.0 / 12.0


class Problem(AbstractModule):
    """One loop to be solved, with the thresholds that the figures refer to.

    Attributes:
        loop: The closed loop.
        coordinates: In which it is integrated.
        bandwidth: The bandwidth of quasi-sliding mode, epsilon, of the sliding variable.
        reaching_time: t_r [s], after which errors count as steady; `inf` if there is none.
        error_bounds: What |sigma| < epsilon implies for each error, n scalars.
        settling_time: t_s [s], from which on the funnel guarantees that the errors keep their bounds; `inf` if never.
        fence: Around what is used more than once.
        made_of: What its functions read from outside, in so far as it is known; programs are kept by it too.
        rtol: Relative tolerance of the solve.
        measures: What the study wants to know besides.
    """

    loop: ClosedLoop
    coordinates: AbstractCoordinates
    bandwidth: RealScalarLike
    reaching_time: RealScalarLike
    error_bounds: Scalars
    settling_time: RealScalarLike
    fence: Fence
    made_of: Hashable = eqx.field(static=True, default=())
    rtol: RealScalarLike = 1e-6
    measures: tuple[AbstractMeasure, ...] = eqx.field(static=True, default=())

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        """Times [s] that steps must not cross: where the loop jumps, and where windows begin and end."""
        parts = it.chain.from_iterable(each.parts for each in self.measures)
        ends = {end for part in parts for end in (part.after, part.before)} - {0.0, math.inf}
        return jnp.concatenate([self.loop.break_times, jnp.array(sorted(ends))]) if ends else self.loop.break_times


class Peak(AbstractModule):
    """The peak of |s|: its height, its time [s] and the coordinates there."""

    height: RealScalarLike
    time: RealScalarLike
    y: Scalars


class OutsideStep(AbstractModule):
    """A step in which something was at least a level somewhere, such as |sigma| the bandwidth, and its course in it."""

    start: RealScalarLike
    length: RealScalarLike
    cubic: Cubic


class Span(AbstractModule):
    """A step by the times [s] at which it starts and ends; both are 0 if there is none."""

    start: RealScalarLike
    end: RealScalarLike


class Tally(AbstractModule):
    """The running figures of one run, all scalars; see `Figures` for what becomes of them.

    `u` and `gain` are |u| and the gain, times its sign, at the end of the last step; `unsettled` is the last step in
    which an error reached its bound.
    """

    errors: Scalars
    u: RealScalarLike
    peak: Peak
    outside: OutsideStep
    unsettled: Span
    peak_errors: Scalars
    total_variation: RealScalarLike
    energy: RealScalarLike
    squared_error: RealScalarLike
    gain: RealScalarLike
    least_gain: RealScalarLike
    largest_disturbance: RealScalarLike
    own: States


class Step(AbstractModule):
    """One step of the method, which starts at `t0` and ends at `t1` [s].

    Attributes:
        y0, y1: The coordinates at its ends.
        dy0, dy1: The derivatives of the dense output there.
        middle: The coordinates at its middle.
        derivative: The derivative of the coordinates at its end, by the vector field.
    """

    t0: RealScalarLike
    t1: RealScalarLike
    y0: Scalars
    y1: Scalars
    dy0: Scalars
    dy1: Scalars
    middle: Scalars
    derivative: Scalars


class _End(AbstractModule):
    """What the figures need at one end of a step: errors e^(0) ... e^(n), sigma and s with their rates, u = sinh s."""

    errors: Scalars
    sigma: RealScalarLike
    sigma_rate: RealScalarLike
    s: RealScalarLike
    s_rate: RealScalarLike
    u: RealScalarLike


def first_tally(problem: Problem, y0: Scalars) -> Tally:
    """The figures at time 0."""
    loop, zero = problem.loop, jnp.zeros(())
    x0 = problem.coordinates.state(loop, zero, y0)
    s0 = problem.coordinates.funnel_coordinate(loop, zero, y0)
    gain = jnp.asarray(loop.control.gain_sign * loop.plant.gain(zero, x0))
    return Tally(
        errors=_scalars(loop.errors(zero, x0)),
        u=sinh_cosh(s0)[0],
        peak=Peak(jnp.abs(s0), zero, _scalars(y0)),
        outside=OutsideStep(zero, zero, Cubic(zero, zero, zero, zero)),
        unsettled=Span(zero, zero),
        peak_errors=(zero,) * loop.order,
        total_variation=zero,
        energy=zero,
        squared_error=zero,
        gain=gain,
        least_gain=gain,
        largest_disturbance=jnp.asarray(jnp.abs(loop.disturbance(zero))),
        own=first_states(problem.measures, IdealStep(no_step(y0), problem)),
    )


def add_step(problem: Problem, tally: Tally, step: Step) -> Tally:
    """The figures after one more step."""
    loop, t1, h = problem.loop, step.t1, step.t1 - step.t0
    u1 = sinh_cosh(problem.coordinates.funnel_coordinate(loop, t1, step.y1))[0]
    errors = problem.coordinates.errors(loop, t1, step.y1, step.derivative)
    left = _end(problem, step.t0, tally.errors, tally.u, step.y0, step.dy0)
    right = _end(problem, t1, errors, u1, step.y1, step.dy1)
    s = Cubic(left.s, right.s, h * left.s_rate, h * right.s_rate)
    sigma = Cubic(left.sigma, right.sigma, h * left.sigma_rate, h * right.sigma_rate)
    steady_from = jnp.clip((problem.reaching_time - step.t0) / jnp.where(h > 0.0, h, 1.0), 0.0, 1.0)
    heights = problem.fence(tuple(cubic.largest(steady_from) for cubic in _error_cubics(left, right, h)))
    sigma_height = problem.fence(sigma.largest())
    exceeds = problem.fence.claim(_exceeds(problem, heights, left.errors))
    peak = _peak(problem, step, s)
    gain, disturbance = _premises(loop, t1, right.errors)
    return Tally(
        errors=_scalars(right.errors[:-1]),
        u=u1,
        peak=trees.where(peak.height > tally.peak.height, peak, tally.peak),
        outside=trees.where(sigma_height >= problem.bandwidth, OutsideStep(step.t0, h, sigma), tally.outside),
        unsettled=trees.where(exceeds, Span(step.t0, t1), tally.unsettled),
        peak_errors=trees.where(
            t1 > problem.reaching_time, tuple(map(jnp.maximum, heights, tally.peak_errors)), tally.peak_errors
        ),
        total_variation=tally.total_variation + _variation_of_input(left.u, s.stations()[1:-1], right.u),
        energy=tally.energy + h * _mean_square_of_input(left.u, s, right.u),
        squared_error=tally.squared_error + integral_of_square(h, left.errors[:2], right.errors[:2]),
        gain=jnp.asarray(gain),
        least_gain=jnp.minimum(tally.least_gain, gain),
        largest_disturbance=jnp.maximum(tally.largest_disturbance, disturbance),
        own=add_own(problem.measures, tally.own, IdealStep(step, problem)),
    )


class IdealStep(AbstractStep):
    """A step of the ideal loop as metrics see it."""

    data: Step
    problem: Problem

    @property
    def t0(self) -> RealScalarLike:
        return self.data.t0

    @property
    def t1(self) -> RealScalarLike:
        return self.data.t1

    def once(self, tree: Any) -> Any:
        return self.problem.fence(tree)

    def at(self, theta: RealScalarLike) -> Signals:
        step, ends = self.data, {"t0": self.data.t0, "t1": self.data.t1}
        rates = {"dy0": step.dy0, "dy1": step.dy1}
        dense = QuarticInterpolation(**ends, y0=step.y0, y1=step.y1, **rates, middle=step.middle)
        return ideal_signals(self.problem, step.t0 + theta * (step.t1 - step.t0), dense.at(theta))


def ideal_signals(problem: Problem, t: RealScalarLike, y: Scalars) -> Signals:
    """All signals of the ideal loop at one instant; sigma and u from the funnel coordinate."""
    loop, coordinates = problem.loop, problem.coordinates
    x, desired, rho = coordinates.state(loop, t, y), loop.desired(t), loop.control.funnel(t)
    s = coordinates.funnel_coordinate(loop, t, y)
    e = tuple(xi - di for xi, di in zip(x, desired, strict=False))
    balance, u = loop.balance(t, e, desired), -loop.control.gain_sign * sinh_cosh(s)[0]
    part, (d, w, g) = ratio(s), (balance.disturbance, balance.residual, balance.gain)
    return Signals(t, x, desired[:-1], e, rho * part, rho, part, u, d, w, g)


def no_step(y: Scalars) -> Step:
    """A step of no length at the start."""
    zero, rest = jnp.zeros(()), (jnp.zeros(()),) * len(y)
    y = _scalars(y)
    return Step(zero, zero, y, y, rest, rest, y, rest)


def _peak(problem: Problem, step: Step, s: Cubic) -> Peak:
    """The peak of |s| in the step, by the quartic through its ends and its middle."""
    h = step.t1 - step.t0
    middle = problem.coordinates.funnel_coordinate(problem.loop, step.t0 + 0.5 * h, step.middle)
    theta, height = problem.fence(Quartic(s, middle).highest())
    y = tuple(cubic(theta) for cubic in cubics(h, step.y0, step.y1, step.dy0, step.dy1))
    return Peak(height, step.t0 + theta * h, y)


def _end(problem: Problem, t: RealScalarLike, errors: Scalars, u: RealScalarLike, y: Scalars, dy: Scalars) -> _End:
    """One end of a step. The rate of sigma, and so e^(n), follows from that of s: right on either side of a jump."""
    surface = problem.loop.control.surface
    rho, rho_rate = problem.loop.control.funnel.width_and_rate(t)
    s, s_rate = problem.coordinates.funnel_motion(problem.loop, t, y, dy)
    sigma, cosh = surface(errors), jnp.sqrt(1.0 + u * u)
    sigma_rate = (2.0 / jnp.pi * rho * s_rate) / cosh + sigma * rho_rate / rho
    last = sigma_rate - surface((*errors[1:], 0.0))
    return _End((*errors, last), sigma, sigma_rate, s, s_rate, u)


def _premises(loop: ClosedLoop, t: RealScalarLike, errors: Scalars) -> tuple[RealScalarLike, RealScalarLike]:
    """gain_sign * g, which should be positive, and |d|, which should not exceed its bound."""
    x = loop.state(errors[:-1], loop.desired(t))
    return loop.control.gain_sign * loop.plant.gain(t, x), jnp.abs(loop.disturbance(t))


def _error_cubics(left: _End, right: _End, h: RealScalarLike) -> list[Cubic]:
    """Each error in the step; the slope of one is the value of the next."""
    return cubics(h, left.errors[:-1], right.errors[:-1], left.errors[1:], right.errors[1:])


def _exceeds(problem: Problem, heights: Scalars, left: Scalars) -> Bool[Array, ""]:
    """Whether any error reaches its bound at the start of the step, or in it (before t_r: at its ends)."""
    reaches = [
        (height >= bound) | (jnp.abs(start) >= bound)
        for height, start, bound in zip(heights, left, problem.error_bounds, strict=False)
    ]
    return jnp.asarray(ft.reduce(jnp.logical_or, reaches))


def _scalars(values: Any) -> Scalars:
    return tuple(jnp.asarray(value) for value in values)


def _variation_of_input(u0: RealScalarLike, turns: Scalars, u1: RealScalarLike) -> RealScalarLike:
    """The total variation of |u| = sinh s over the step: u is monotone between the turning points of s.

    No step is so long that the method would chatter (see `GuardedSolver`), which would be summed here.
    """
    inputs = [u0, *(sinh_cosh(s)[0] for s in turns), u1]
    return sum(jnp.abs(b - a) for a, b in it.pairwise(inputs))


def _mean_square_of_input(u0: RealScalarLike, s: Cubic, u1: RealScalarLike) -> RealScalarLike:
    """By Lobatto's rule on s, since u can be exponential in time where s is straight."""
    inner = sum(sinh_cosh(s(node))[0] ** 2 for node in _LOBATTO_NODES)
    return _LOBATTO_END * (u0**2 + u1**2) + _LOBATTO_INNER * inner
