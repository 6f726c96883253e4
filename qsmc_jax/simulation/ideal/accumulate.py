"""Metrics kept up step by step inside the solve: suprema, integrals, times, and how the premises fared.

They are read off each accepted step's own cubic Hermite interpolant, so nothing hides between the points of a save
grid, and they ride along in the integrated state, with no say in the step size, so that gradients reach them.
"""

import functools as ft

import jax.numpy as jnp
from jaxtyping import Array, Bool

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.metrics.accumulate import States, first_states
from qsmc_jax.metrics.accumulate import add_step as add_own
from qsmc_jax.numerics import pytrees
from qsmc_jax.numerics.gudermann import margin, sinh_cosh
from qsmc_jax.numerics.hermite import Cubic, Quartic, cubics, integral_of_square
from qsmc_jax.simulation.ideal.barrier import RunningBarrier, add_barrier, first_barrier
from qsmc_jax.simulation.ideal.input import RunningInput, add_input, first_input
from qsmc_jax.simulation.ideal.step import IdealStep, Step, as_scalars, no_step
from qsmc_jax.simulation.problem import AbstractProblem, JointProblem, Problem
from qsmc_jax.simulation.spans import OutsideStep, Span


class Peak(AbstractModule):
    """The peak of |s|: its height, its time [s] and the coordinates there."""

    height: RealScalarLike
    time: RealScalarLike
    y: Scalars


class Drift(AbstractModule):
    """How far apart the coordinates' two ways to tell sigma/rho got at most, and the least margin beyond that."""

    largest: RealScalarLike
    room: RealScalarLike


class RunningMetrics(AbstractModule):
    """The running metrics of one channel, all scalars; see `Metrics` for what becomes of them.

    `gain` is the gain, times its sign, at the end of the last step; `unsettled` is the last step in which an error
    reached its bound; `drift` is None where the coordinates can't.
    """

    errors: Scalars
    input: RunningInput
    peak: Peak
    outside: OutsideStep
    unsettled: Span
    peak_errors: Scalars
    squared_error: RealScalarLike
    gain: RealScalarLike
    least_gain: RealScalarLike
    largest_disturbance: RealScalarLike
    drift: Drift | None = None


class Running(AbstractModule):
    """The running metrics of one run: of each channel, of the study, and of several channels together."""

    channels: tuple[RunningMetrics, ...]
    own: States
    barrier: RunningBarrier | None = None


class _End(AbstractModule):
    """What the metrics need at one end of a step: errors, sigma and s with their rates."""

    errors: Scalars
    error_rates: Scalars
    sigma: RealScalarLike
    sigma_rate: RealScalarLike
    s: RealScalarLike
    s_rate: RealScalarLike


def first_metrics(problem: AbstractProblem, y0: Scalars) -> Running:
    """The metrics at time 0."""
    own = first_states(problem.measures, IdealStep(no_step(y0), problem))
    barrier = first_barrier(problem, y0) if isinstance(problem, JointProblem) else None
    return Running(tuple(_first_of_channel(each, y0) for each in problem.channels), own, barrier)


def add_step(problem: AbstractProblem, running: Running, step: Step) -> Running:
    """The metrics after one more step."""
    channels = zip(problem.channels, running.channels, strict=True)
    own = add_own(problem.measures, running.own, IdealStep(step, problem))
    barrier = running.barrier
    if isinstance(problem, JointProblem) and barrier is not None:
        barrier = add_barrier(problem, barrier, step)
    return Running(tuple(_add_to_channel(*each, step) for each in channels), own, barrier)


def _first_of_channel(problem: Problem, y0: Scalars) -> RunningMetrics:
    loop, zero = problem.loop, jnp.zeros(())
    x0 = problem.coordinates.state(loop, zero, y0)
    s0 = problem.coordinates.funnel_coordinate(loop, zero, y0)
    gain, errors = jnp.asarray(loop.control.gain_sign * loop.gain(zero, x0)), as_scalars(loop.errors(zero, x0))
    return RunningMetrics(
        errors=errors,
        input=first_input(problem, loop.input_at(zero, x0, errors, loop.desired(zero, x0), s0), s0),
        peak=Peak(jnp.abs(s0), zero, as_scalars(y0)),
        outside=OutsideStep(zero, zero, Cubic(zero, zero, zero, zero)),
        unsettled=Span(zero, zero),
        peak_errors=(zero,) * loop.order,
        squared_error=zero,
        gain=gain,
        least_gain=gain,
        largest_disturbance=jnp.asarray(jnp.abs(loop.disturbance(zero))),
        drift=_first_drift(problem, y0, s0),
    )


def _add_to_channel(problem: Problem, running: RunningMetrics, step: Step) -> RunningMetrics:
    loop, t1, h = problem.loop, step.t1, step.t1 - step.t0
    s1 = problem.coordinates.funnel_coordinate(loop, t1, step.y1)
    sinh1 = sinh_cosh(s1)[0]
    errors = problem.coordinates.errors(loop, t1, step.y1, step.derivative)
    left = _end(problem, step.t0, running.errors, running.input.sinh, step.y0, step.dy0)
    right = _end(problem, t1, errors, sinh1, step.y1, step.dy1)
    s = Cubic(left.s, right.s, h * left.s_rate, h * right.s_rate)
    sigma = Cubic(left.sigma, right.sigma, h * left.sigma_rate, h * right.sigma_rate)
    steady_from = jnp.clip((problem.reaching_time - step.t0) / jnp.where(h > 0.0, h, 1.0), 0.0, 1.0)
    error_cubics = cubics(h, left.errors, right.errors, left.error_rates, right.error_rates)
    heights = problem.barrier(tuple(cubic.largest(steady_from) for cubic in error_cubics))
    sigma_height = problem.barrier(sigma.largest())
    exceeds = problem.barrier.claim(_exceeds(problem, heights, left.errors))
    middle = problem.coordinates.funnel_coordinate(loop, step.t0 + 0.5 * h, step.middle)
    path = Quartic(s, middle)
    peak = _peak(problem, step, path)
    x1 = problem.coordinates.state_of(loop, t1, step.y1, right.errors)
    end = loop.input_at(t1, x1, right.errors, loop.desired(t1, x1), s1), sinh1
    gain, disturbance = loop.control.gain_sign * loop.gain(t1, x1), jnp.abs(loop.disturbance(t1))
    return RunningMetrics(
        errors=as_scalars(right.errors),
        input=add_input(problem, running.input, IdealStep(step, problem), s, path, end),
        peak=pytrees.where(peak.height > running.peak.height, peak, running.peak),
        outside=pytrees.where(sigma_height >= problem.bandwidth, OutsideStep(step.t0, h, sigma), running.outside),
        unsettled=pytrees.where(exceeds, Span(step.t0, t1), running.unsettled),
        peak_errors=pytrees.where(
            t1 > problem.reaching_time, tuple(map(jnp.maximum, heights, running.peak_errors)), running.peak_errors
        ),
        squared_error=running.squared_error + _squared_error(h, left, right),
        gain=jnp.asarray(gain),
        least_gain=jnp.minimum(running.least_gain, gain),
        largest_disturbance=jnp.maximum(running.largest_disturbance, disturbance),
        drift=_drift(problem, running.drift, step, peak),
    )


def _first_drift(problem: Problem, y0: Scalars, s0: RealScalarLike) -> Drift | None:
    drift = problem.coordinates.drift(problem.loop, jnp.zeros(()), y0)
    return None if drift is None else Drift(drift, margin(s0) - drift)


def _drift(problem: Problem, running: Drift | None, step: Step, peak: Peak) -> Drift | None:
    drift = problem.coordinates.drift(problem.loop, step.t1, step.y1)
    if drift is None or running is None:
        return None
    return Drift(jnp.maximum(drift, running.largest), jnp.minimum(margin(peak.height) - drift, running.room))


def _peak(problem: Problem, step: Step, s: Quartic) -> Peak:
    """The peak of |s| in the step."""
    h = step.t1 - step.t0
    theta, height = problem.barrier(s.highest())
    y = tuple(cubic(theta) for cubic in cubics(h, step.y0, step.y1, step.dy0, step.dy1))
    return Peak(height, step.t0 + theta * h, y)


def _end(problem: Problem, t: RealScalarLike, errors: Scalars, sinh: RealScalarLike, y: Scalars, dy: Scalars) -> _End:
    """One end of a step. The rate of sigma, and so those of the errors, follow from that of s, at jumps too."""
    surface = problem.loop.control.surface
    rho, rho_rate = problem.loop.control.funnel.width_and_rate(t)
    s, s_rate = problem.coordinates.funnel_motion(problem.loop, t, y, dy)
    sigma, cosh = surface(errors), jnp.sqrt(1.0 + sinh * sinh)
    centre, centre_rate = problem.loop.control.funnel.centre_and_rate(t)
    sigma_rate = (2.0 / jnp.pi * rho * s_rate) / cosh + (sigma - centre) * rho_rate / rho + centre_rate
    rates = problem.coordinates.error_rates(problem.loop, t, y, dy, errors, sigma_rate)
    return _End(errors, rates, sigma, sigma_rate, s, s_rate)


def _squared_error(h: RealScalarLike, left: _End, right: _End) -> RealScalarLike:
    """The integral of e^2 over the step."""
    return integral_of_square(h, *((end.errors[0], end.error_rates[0]) for end in (left, right)))


def _exceeds(problem: Problem, heights: Scalars, left: Scalars) -> Bool[Array, ""]:
    """Whether any error reaches its bound at the start of the step, or in it (before t_r: at its ends)."""
    reaches = [
        (height >= bound) | (jnp.abs(start) >= bound)
        for height, start, bound in zip(heights, left, problem.error_bounds, strict=False)
    ]
    return jnp.asarray(ft.reduce(jnp.logical_or, reaches))
