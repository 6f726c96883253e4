"""A step of the ideal loop, and the signals in it."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.metrics.signals import AbstractStep, Signals, joint_signals
from qsmc_jax.multivariable import MultivariableLoop
from qsmc_jax.numerics.gudermann import ratio
from qsmc_jax.simulation.problem import AbstractProblem, JointProblem, Problem
from qsmc_jax.solvers.quartic_interpolation import QuarticInterpolation


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


class IdealStep(AbstractStep):
    """A step of the ideal loop as metrics see it."""

    data: Step
    problem: AbstractProblem

    @property
    def t0(self) -> RealScalarLike:
        return self.data.t0

    @property
    def t1(self) -> RealScalarLike:
        return self.data.t1

    def once(self, tree: Any) -> Any:
        return self.problem.barrier(tree)

    def at(self, theta: RealScalarLike) -> Signals:
        step, ends = self.data, {"t0": self.data.t0, "t1": self.data.t1}
        rates = {"dy0": step.dy0, "dy1": step.dy1}
        dense = QuarticInterpolation(**ends, y0=step.y0, y1=step.y1, **rates, middle=step.middle)
        return ideal_signals(self.problem, step.t0 + theta * (step.t1 - step.t0), dense.at(theta))


def ideal_signals(problem: AbstractProblem, t: RealScalarLike, y: Scalars) -> Signals:
    """All signals of the ideal loop at one instant; sigma and u from the funnel coordinate."""
    of_channels = [_of_channel(each, t, y) for each in problem.channels]
    if not isinstance(problem, JointProblem):
        return of_channels[0]
    return joint_ideal_signals(problem.loop, t, y[: problem.loop.states], of_channels)


def _of_channel(problem: Problem, t: RealScalarLike, y: Scalars) -> Signals:
    loop, coordinates = problem.loop, problem.coordinates
    x, rho = coordinates.state(loop, t, y), loop.control.funnel(t)
    desired = loop.desired(t, x)
    centre = loop.control.funnel.centre(t)
    s = coordinates.funnel_coordinate(loop, t, y)
    e = loop.errors(t, x)
    balance, u = loop.balance(t, x, e, desired), loop.input_at(t, x, e, desired, s)
    part, (d, w, g) = ratio(s), (balance.disturbance, balance.residual, balance.gain)
    return Signals(t, x, desired[:-1], e, rho * part + centre, rho, part, u, d, w, g)


def joint_ideal_signals(
    loop: MultivariableLoop, t: RealScalarLike, x: Scalars, of_channels: Sequence[Signals]
) -> Signals:
    """The signals of several channels of an ideal loop together, at the state `x`."""
    w, g = loop.drive(t, x)
    return joint_signals(of_channels)._replace(x=x, d=of_channels[0].d, w=w, g=g)


def no_step(y: Scalars) -> Step:
    """A step of no length at the start."""
    zero, rest = jnp.zeros(()), (jnp.zeros(()),) * len(y)
    y = as_scalars(y)
    return Step(zero, zero, y, y, rest, rest, y, rest)


def as_scalars(values: Any) -> Scalars:
    """Numbers as arrays, which a carry must be made of from the start."""
    return tuple(jnp.asarray(value) for value in values)
