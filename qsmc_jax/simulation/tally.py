"""Figures kept up step by step inside the solve: suprema, integrals, times, and how the premises fared.

They are read off each accepted step's own cubic Hermite interpolant, so nothing hides between the points of a save
grid, and they ride along in the integrated state, with no say in the step size, so that gradients reach them.
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool

from qsmc_jax.base import trees
from qsmc_jax.base.gudermann import sinh_cosh
from qsmc_jax.base.hermite import Cubic
from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.simulation.coordinates import AbstractCoordinates, Scalars

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
    """

    loop: ClosedLoop
    coordinates: AbstractCoordinates
    bandwidth: RealScalarLike
    reaching_time: RealScalarLike
    error_bounds: Scalars


class PeakStep(AbstractModule):
    """The step with the highest |s| so far: height by the cubic, start and length [s], coordinates at both ends."""

    height: RealScalarLike
    start: RealScalarLike
    length: RealScalarLike
    y0: Scalars
    y1: Scalars


class OutsideStep(AbstractModule):
    """The last step in which |sigma| was at least the bandwidth somewhere: its start, length and sigma in it."""

    start: RealScalarLike
    length: RealScalarLike
    sigma: Cubic


class Tally(AbstractModule):
    """The running figures of one run, all scalars; see `Figures` for what becomes of them."""

    errors: Scalars
    peak: PeakStep
    outside: OutsideStep
    unsettled_time: RealScalarLike
    peak_errors: Scalars
    total_variation: RealScalarLike
    energy: RealScalarLike
    squared_error: RealScalarLike
    least_gain: RealScalarLike
    largest_disturbance: RealScalarLike


class Step(AbstractModule):
    """One step of the method: its ends [s], and the coordinates and their derivatives there."""

    t0: RealScalarLike
    t1: RealScalarLike
    y: tuple[Scalars, Scalars]
    dy: tuple[Scalars, Scalars]


class _End(AbstractModule):
    """What the figures need at one end of a step: errors e^(0) ... e^(n), sigma, s, and the rates of these two."""

    errors: Scalars
    sigma: RealScalarLike
    sigma_rate: RealScalarLike
    s: RealScalarLike
    s_rate: RealScalarLike


def first_tally(problem: Problem, y0: Scalars) -> Tally:
    """The figures at time 0."""
    loop, zero = problem.loop, jnp.zeros(())
    x0 = problem.coordinates.state(loop, zero, y0)
    s0 = problem.coordinates.funnel_coordinate(loop, zero, y0)
    return Tally(
        errors=_scalars(loop.errors(zero, x0)),
        peak=PeakStep(jnp.abs(s0), zero, zero, _scalars(y0), _scalars(y0)),
        outside=OutsideStep(zero, zero, Cubic(zero, zero, zero, zero)),
        unsettled_time=zero,
        peak_errors=(zero,) * loop.order,
        total_variation=zero,
        energy=zero,
        squared_error=zero,
        least_gain=jnp.asarray(loop.control.gain_sign * loop.plant.gain(zero, x0)),
        largest_disturbance=jnp.asarray(jnp.abs(loop.disturbance(zero))),
    )


def add_step(problem: Problem, tally: Tally, step: Step) -> Tally:
    """The figures after one more step."""
    loop, t1, h = problem.loop, step.t1, step.t1 - step.t0
    x1 = problem.coordinates.state(loop, t1, step.y[1])
    left = _end(problem, step.t0, tally.errors, step.y[0], step.dy[0])
    right = _end(problem, t1, loop.errors(t1, x1), step.y[1], step.dy[1])
    s = Cubic(left.s, right.s, h * left.s_rate, h * right.s_rate)
    sigma = Cubic(left.sigma, right.sigma, h * left.sigma_rate, h * right.sigma_rate)
    errors = _error_cubics(left, right, h)
    steady_from = jnp.clip((problem.reaching_time - step.t0) / jnp.where(h > 0.0, h, 1.0), 0.0, 1.0)
    steady = tuple(
        jnp.maximum(cubic.largest(steady_from), p) for cubic, p in zip(errors, tally.peak_errors, strict=True)
    )
    peak = PeakStep(s.largest(), step.t0, h, *map(_scalars, step.y))
    return Tally(
        errors=_scalars(right.errors[:-1]),
        peak=trees.where(peak.height > tally.peak.height, peak, tally.peak),
        outside=trees.where(sigma.largest() >= problem.bandwidth, OutsideStep(step.t0, h, sigma), tally.outside),
        unsettled_time=jnp.where(_exceeds(errors, problem.error_bounds), t1, tally.unsettled_time),
        peak_errors=trees.where(t1 > problem.reaching_time, steady, tally.peak_errors),
        total_variation=tally.total_variation + _variation_of_input(s),
        energy=tally.energy + h * _mean_square_of_input(s),
        squared_error=tally.squared_error + h * _mean_square(errors[0]),
        least_gain=jnp.minimum(tally.least_gain, loop.control.gain_sign * loop.plant.gain(t1, x1)),
        largest_disturbance=jnp.maximum(tally.largest_disturbance, jnp.abs(loop.disturbance(t1))),
    )


def _end(problem: Problem, t: RealScalarLike, errors: Scalars, y: Scalars, dy: Scalars) -> _End:
    """One end of a step. The rate of sigma, and so e^(n), follows from that of s: right on either side of a jump."""
    surface = problem.loop.control.surface
    rho, rho_rate = problem.loop.control.funnel.width_and_rate(t)
    s, s_rate = problem.coordinates.funnel_motion(problem.loop, t, y, dy)
    sigma = surface(errors)
    sigma_rate = 2.0 / jnp.pi * rho * s_rate / sinh_cosh(s)[1] + sigma * rho_rate / rho
    last = sigma_rate - surface((*errors[1:], 0.0))
    return _End((*errors, last), sigma, sigma_rate, s, s_rate)


def _error_cubics(left: _End, right: _End, h: RealScalarLike) -> list[Cubic]:
    """Each error in the step; the slope of one is the value of the next."""
    ends = zip(left.errors[:-1], right.errors[:-1], left.errors[1:], right.errors[1:], strict=True)
    return [Cubic(y0, y1, h * m0, h * m1) for y0, y1, m0, m1 in ends]


def _exceeds(errors: list[Cubic], bounds: Scalars) -> Bool[Array, ""]:
    """Whether any error reaches its bound in the step."""
    return jnp.any(jnp.stack([error.largest() >= bound for error, bound in zip(errors, bounds, strict=True)]))


def _scalars(values: Any) -> Scalars:
    return tuple(jnp.asarray(value) for value in values)


def _variation_of_input(s: Cubic) -> RealScalarLike:
    """The total variation of u = -+sinh(s) over the step: u is monotone between the turning points of s."""
    inputs = [sinh_cosh(value)[0] for value in (s.y0, *map(s, s.turning_points()), s.y1)]
    return sum(jnp.abs(b - a) for a, b in zip(inputs[:-1], inputs[1:], strict=True))


def _mean_square_of_input(s: Cubic) -> RealScalarLike:
    ends = sinh_cosh(s.y0)[0] ** 2 + sinh_cosh(s.y1)[0] ** 2
    return _LOBATTO_END * ends + _LOBATTO_INNER * sum(sinh_cosh(s(node))[0] ** 2 for node in _LOBATTO_NODES)


def _mean_square(p: Cubic) -> RealScalarLike:
    return _LOBATTO_END * (p.y0**2 + p.y1**2) + _LOBATTO_INNER * sum(p(node) ** 2 for node in _LOBATTO_NODES)
