r"""What a step of the ideal loop could hide, in units of what is tolerated.

A method looks at the loop at a few instants of a step. Between these the disturbance, the reference, the drift or the
gain may do what none of them shows: a push, a jump, a gain that reverses for a while. How far they can go there is
bounded (`model/unseen.py`), and with it what that does to the funnel coordinate: by $\dot s = \cosh s\,[k (w + g u) -
\dots]$ with $k = \pi / 2\rho$ an amount $a$ of $w$ moves s by no more than $h k a \cosh s$ in a step of length h, and,
as long as the gain pushes back, by no more than $a / (g \cosh s)$: u = sinh s balances it then (K sinh s, with the
gain K of the law; of a law of the user's nobody knows). An amount of the gain counts |u| times as much.
"""

import functools as ft
from collections.abc import Callable
from typing import TypeAlias

import jax.numpy as jnp

from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.control.funnel import AbstractFunnel, Funnel
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.enclosures.unseen import Step, Unseen, unseen
from qsmc_jax.implementation.implementation import Implementation
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.model.state_space import AbstractStateSpace
from qsmc_jax.model.unseen import (
    gain_range,
    is_consistent,
    is_known,
    is_nothing,
    joined,
    unseen_in_reference,
    unseen_in_signal,
    within,
)
from qsmc_jax.numerics import pytrees
from qsmc_jax.simulation.problem import Problem

Path: TypeAlias = Callable[[RealScalarLike], Scalars]

# By how much s may move unseen in a step, relative to the tolerance: 1e-3 at the default one, which moves the peak by
# less than that.
_WORTH = 1e3
_LEAST_WORTH, _LARGEST_WORTH = 1e-6, 1e-2
# Rounding of a reference's derivatives, in units in the last place.
_ROUNDING = 256.0


def hidden(
    problem: Problem,
    step: Step,
    ys: tuple[Scalars, Scalars, Scalars],
    sinhs: tuple[RealScalarLike, RealScalarLike],
    us: tuple[RealScalarLike, RealScalarLike],
    rtol: RealScalarLike,
    least: RealScalarLike,
) -> RealScalarLike:
    """How far a step could move the funnel coordinate unseen, in units of what is tolerated; 0.0 if nothing can hide.

    Args:
        problem: The loop.
        step: The step.
        ys: The coordinates at its start, middle and end.
        sinhs: sinh |s| there, s the funnel coordinate.
        us: The input's size there.
        rtol: The relative tolerance.
        least: Size below which a state counts as this large, as for the tolerances of the solve.
    """
    problem, (t0, t1), ys, sinhs, us = pytrees.stop_gradient((problem, (step.t0, step.t1), ys, sinhs, us))
    step, loop = Step(t0, t1, step.nodes), problem.loop
    at = _path(problem, step, ys)
    pushes = _pushes(loop, step, at)
    amount_of_gain, lowest = _gain(loop, step, at)
    largest = jnp.maximum(*us)
    jump, in_states = _discontinuity(loop, step), _in_states(loop, step, at, largest, least)
    of_law = _of_law(loop, step, at)
    k = 0.5 * jnp.pi / _narrowest(loop.control.funnel, step)
    # By an exponent of 1 at most may a small s grow in a step in which the gain may push outwards.
    growth = step.length * k * jnp.maximum(-lowest, 0.0)
    if all(map(is_nothing, (pushes.amount, amount_of_gain, jump, in_states, of_law))):
        return growth
    cosh, least_cosh = (jnp.sqrt(1.0 + bound(*sinhs) ** 2) for bound in (jnp.maximum, jnp.minimum))
    amount = pushes.amount + amount_of_gain * largest + of_law
    moves = step.length * k * cosh * amount
    if isinstance(loop.control, QuasiSlidingControl):
        is_held = lowest > 0.0
        stiffness = loop.control.gain * jnp.where(is_held, lowest, 1.0) * least_cosh
        moves = jnp.minimum(moves, jnp.where(is_held, amount / stiffness, jnp.inf))
    moves = moves + k * cosh * jump
    moves = moves if is_nothing(in_states) else jnp.maximum(moves, in_states)
    moves = jnp.where(jnp.isnan(moves), jnp.inf, moves)
    return jnp.maximum(moves / _worth(rtol), growth)


def hidden_in_cell(
    problem: Problem,
    implementation: Implementation,
    step: Step,
    at: Path,
    u: RealScalarLike,
    rtol: RealScalarLike,
    least: RealScalarLike,
) -> RealScalarLike:
    """How far an open-loop cell could move the sliding variable unseen, in units of what is tolerated.

    Args:
        problem: The loop.
        implementation: Its implementation.
        step: The cell.
        at: The state in it, as a function of time.
        u: Largest input in it.
        rtol: The relative tolerance.
        least: As for `hidden`.
    """
    problem, implementation, (t0, t1), u = pytrees.stop_gradient((problem, implementation, (step.t0, step.t1), u))
    step, loop = Step(t0, t1, step.nodes), problem.loop
    plant = loop.plant
    gain = joined([]) if is_known(plant) else unseen(lambda t: loop.gain(t, at(t)), step)
    pushes = _moved(loop, step, at).amount + gain.amount * jnp.abs(u)
    for c, signal in zip(loop.control.surface.c, implementation.unmatched, strict=False):
        pushes = pushes + c * unseen_in_signal(signal, step).amount
    wander = loop.control.surface([unseen_in_reference(loop.reference, i, step).amount for i in range(loop.order)])
    funnel = loop.control.funnel
    wander = wander + unseen_in_funnel(funnel, step, is_rate=False).amount
    moves = (step.length * pushes + wander) / _narrowest(funnel, step)
    in_states = _in_states(loop, step, at, jnp.abs(u), least)
    moves = moves if is_nothing(in_states) else jnp.maximum(moves, in_states)
    return jnp.where(jnp.isnan(moves), jnp.inf, moves) / _worth(rtol)


def _worth(rtol: RealScalarLike) -> RealScalarLike:
    return jnp.clip(_WORTH * rtol, _LEAST_WORTH, _LARGEST_WORTH)


def unseen_in_funnel(funnel: AbstractFunnel, step: Step, *, is_rate: bool) -> Unseen:
    """What may hide in how far an edge of the funnel is from 0, or in its rate; nothing in the paper's funnel."""
    if isinstance(funnel, Funnel):
        return joined([])
    place = int(is_rate)
    parts = funnel.centre_and_rate, funnel.width_and_rate
    return joined([unseen(lambda t, part=part: part(t)[place], step) for part in parts])


def _narrowest(funnel: AbstractFunnel, step: Step) -> RealScalarLike:
    """The least half-width that a step may have; 0 if it may have none."""
    if isinstance(funnel, Funnel):
        return funnel(step.t1)
    return jnp.maximum(unseen(funnel, step).low, 0.0)


def _path(problem: Problem, step: Step, ys: tuple[Scalars, Scalars, Scalars]) -> Path:
    """The state along the step, by the parabola through its start, middle and end."""
    loop, t0, h = problem.loop, step.t0, step.length
    inverse = jnp.where(h > 0.0, 1.0 / jnp.where(h > 0.0, h, 1.0), 0.0)
    times = (t0, t0 + 0.5 * h, step.t1)
    points = [problem.coordinates.state(loop, t, y) for t, y in zip(times, ys, strict=True)]

    def state(t: RealScalarLike) -> Scalars:
        theta = (t - t0) * inverse
        bends = [2.0 * (a - 2.0 * b + c) for a, b, c in zip(*points, strict=True)]
        ends = zip(points[0], points[2], bends, strict=True)
        return tuple(a + theta * (c - a - bend + theta * bend) for a, c, bend in ends)

    return state


def _pushes(loop: ClosedLoop, step: Step, at: Path) -> Unseen:
    """What may hide in w, which pushes the sliding variable."""
    parts = [_moved(loop, step, at), unseen_in_reference(loop.reference, loop.order, step)]
    return joined([*parts, unseen_in_funnel(loop.control.funnel, step, is_rate=True)])


def _moved(loop: ClosedLoop, step: Step, at: Path) -> Unseen:
    """What may hide in the part of it that comes from plant and disturbance."""
    plant = loop.plant
    if isinstance(plant, AbstractStateSpace):
        # The disturbance is in it, wherever it enters.
        d = within(loop.disturbance, 0.5 * (step.t0 + step.t1))
        free = lambda t: plant.vector_field(t, at(t), d(t))  # noqa: E731
        return unseen(lambda t: loop.control.surface(plant.outputs_in_motion(t, at(t), free(t))[1]), step)
    disturbance = unseen_in_signal(loop.disturbance, step)
    if is_known(plant):
        return disturbance
    return joined([disturbance, unseen(lambda t: plant.drift(t, at(t)), step)])


def _in_states(loop: ClosedLoop, step: Step, at: Path, u: RealScalarLike, least: RealScalarLike) -> RealScalarLike:
    """How far a state of a plant in its own coordinates could move unseen, in parts of its size; 0.0 in chains.

    What enters where the sliding variable does not see it yet would be found too late there. `u` is the largest input.
    """
    plant = loop.plant
    if not isinstance(plant, AbstractStateSpace):
        return 0.0
    found, d = [], within(loop.disturbance, 0.5 * (step.t0 + step.t1))
    for i, ends in enumerate(zip(at(step.t0), at(step.t1), strict=True)):
        size = ft.reduce(jnp.maximum, map(jnp.abs, ends), least)
        rate = lambda t, i=i: plant.vector_field(t, at(t), d(t))[i]  # noqa: E731
        reach = lambda t, i=i: plant.input_matrix(t, at(t))[i]  # noqa: E731
        found.append(step.length * (unseen(rate, step).amount + unseen(reach, step).amount * u) / size)
    return ft.reduce(jnp.maximum, found)


def _gain(loop: ClosedLoop, step: Step, at: Path) -> tuple[RealScalarLike, RealScalarLike]:
    """What may hide in the gain, and the least it may be, times its sign."""
    sign = loop.control.gain_sign
    if is_known(loop.plant):
        low, high = gain_range(loop.plant)
        return 0.0, jnp.minimum(sign * low, sign * high)
    found = unseen(lambda t: sign * loop.gain(t, at(t)), step)
    return found.amount, found.low


def _of_law(loop: ClosedLoop, step: Step, at: Path) -> RealScalarLike:
    """What may hide in what a law of the user's contributes to the sliding variable's rate; 0.0 for the paper's."""
    if isinstance(loop.control, QuasiSlidingControl):
        return 0.0
    return unseen(lambda t: loop.gain(t, at(t)) * loop.input(t, at(t)), step).amount


def _discontinuity(loop: ClosedLoop, step: Step) -> RealScalarLike:
    """By how much the sliding variable jumps in the step, or just before it, since the reference does.

    A derivative that rises by more than the next one allows has jumped, and the plant with it, or that is not its own.
    """
    if is_consistent(loop.reference):
        return 0.0
    before = step.t0 - 4.0 * jnp.finfo(jnp.result_type(float)).eps * jnp.abs(step.t0)
    start, end = loop.desired(before), loop.desired(step.t1)
    jumps = []
    for i in range(loop.order):
        slope = unseen_in_reference(loop.reference, i + 1, step)
        rise, h = end[i] - start[i], step.t1 - before
        size = jnp.abs(end[i]) + jnp.abs(start[i]) + jnp.abs(step.t1) * (jnp.abs(end[i + 1]) + jnp.abs(start[i + 1]))
        slack = _ROUNDING * jnp.finfo(jnp.result_type(float)).eps * size
        jumps.append(jnp.maximum(jnp.maximum(rise - h * slope.high, h * slope.low - rise) - slack, 0.0))
    return loop.control.surface(tuple(jumps))
