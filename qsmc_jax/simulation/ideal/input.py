"""The input of the ideal loop inside the steps: its extremes, its variation and its energy.

Under the paper's law it is monotone in the funnel coordinate s, whose extremes and turning points in a step are known.
What another law, or the scaled one, does in a step is read off the quartic through five instants of it, within the
law's limits if it has any: there it has kinks, past which a quartic shoots.
"""

import itertools as it

import jax.numpy as jnp
import numpy as np

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.control.control import AbstractControl
from qsmc_jax.control.controllers.saturated import limits_of
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.numerics.gudermann import sinh_cosh
from qsmc_jax.numerics.hermite import Cubic, Quartic
from qsmc_jax.simulation.ideal.step import IdealStep
from qsmc_jax.simulation.problem import Problem

# Gauss-Lobatto rule with four nodes on [0, 1], exact for polynomials of degree 5: the ends and 1/2 -+ 1/(2 sqrt 5).
_LOBATTO_NODES = (0.5 - 0.1 * 5**0.5, 0.5 + 0.1 * 5**0.5)
_LOBATTO_END, _LOBATTO_INNER = 1.0 / 12.0, 5.0 / 12.0
# That with five nodes, exact to degree 7, and the values at 33 places of the quartic through them.
_FIVE = 0.5 + 0.5 * np.array([-1.0, -((3.0 / 7.0) ** 0.5), 0.0, (3.0 / 7.0) ** 0.5, 1.0])
_FIVE_WEIGHTS = np.array([0.05, 49.0 / 180.0, 16.0 / 45.0, 49.0 / 180.0, 0.05])
_PLACES = np.linspace(0.0, 1.0, 33)
_AT_PLACES = np.linalg.solve(np.vander(_FIVE).T, np.vander(_PLACES, 5).T)


class RunningInput(AbstractModule):
    """The running metrics of the input.

    `u` is the input at the end of the last step, and `sinh` that of the funnel coordinate; `low` and `high` are the
    extremes, under the paper's law of s, else of u.
    """

    u: RealScalarLike
    sinh: RealScalarLike
    low: RealScalarLike
    high: RealScalarLike
    variation: RealScalarLike
    energy: RealScalarLike


def law_of_coordinate(law: AbstractControl) -> QuasiSlidingControl | None:
    """The law if its input is a function of the funnel coordinate alone, else None."""
    return law if isinstance(law, QuasiSlidingControl) and not law.is_scaled else None


def first_input(problem: Problem, u0: RealScalarLike, s0: RealScalarLike) -> RunningInput:
    """What is known at time 0."""
    first = jnp.asarray(u0 if law_of_coordinate(problem.loop.control) is None else s0)
    zero = jnp.zeros(())
    return RunningInput(jnp.asarray(u0), sinh_cosh(s0)[0], first, first, zero, zero)


def add_input(
    problem: Problem,
    running: RunningInput,
    step: IdealStep,
    s: Cubic,
    path: Quartic,
    end: tuple[RealScalarLike, RealScalarLike],
) -> RunningInput:
    """The same after one more step.

    Args:
        problem: The loop.
        running: What is known before.
        step: The step.
        s: The funnel coordinate in it.
        path: The same, better.
        end: The input, and sinh s, at its end.
    """
    law, h, (u1, sinh1) = law_of_coordinate(problem.loop.control), step.t1 - step.t0, end
    if law is not None:
        low, high = problem.barrier(path.extremes())
        variation = _variation(running.u, tuple(law.at(turn, step.t1) for turn in s.stations()[1:-1]), u1)
        inner = sum(law.at(s(node), step.t1) ** 2 for node in _LOBATTO_NODES)
        mean_square = _LOBATTO_END * (running.u**2 + u1**2) + _LOBATTO_INNER * inner
    else:
        us = jnp.stack([running.u, *(step.at(float(theta)).u for theta in _FIVE[1:-1]), u1])
        along = jnp.clip(us @ _AT_PLACES, *limits_of(problem.loop.control))
        low, high, variation = jnp.min(along), jnp.max(along), jnp.sum(jnp.abs(jnp.diff(along)))
        mean_square = us**2 @ _FIVE_WEIGHTS
    low, high = jnp.minimum(running.low, low), jnp.maximum(running.high, high)
    return RunningInput(u1, sinh1, low, high, running.variation + variation, running.energy + h * mean_square)


def least_and_largest(problem: Problem, running: RunningInput) -> tuple[RealScalarLike, RealScalarLike]:
    """The extremes of the input."""
    ends, law = (running.low, running.high), law_of_coordinate(problem.loop.control)
    if law is not None:
        ends = tuple(law.at(end, 0.0) for end in ends)
    return jnp.minimum(*ends), jnp.maximum(*ends)


def _variation(u0: RealScalarLike, turns: Scalars, u1: RealScalarLike) -> RealScalarLike:
    """The total variation of u over the step: it is monotone between the turning points of s.

    No step is so long that the method would chatter (see `GuardedSolver`), which would be summed here.
    """
    return sum(jnp.abs(b - a) for a, b in it.pairwise([u0, *turns, u1]))
