r"""What a step of the ideal loop could hide, in units of what is tolerated.

A method looks at the loop at a few instants of a step. Between these the disturbance, the reference, the drift or the
gain may do what none of them shows: a push, a jump, a gain that reverses for a while. How far they can go there is
bounded (`model/unseen.py`), and with it what that does to the funnel coordinate: by $\dot s = \cosh s\,[k (w + g u) -
\dots]$ with $k = \pi / 2\rho$ an amount $a$ of $w$ moves s by no more than $h k a \cosh s$ in a step of length h, and,
as long as the gain pushes back, by no more than $a / (g \cosh s)$: u = sinh s balances it then (K sinh s, with the
gain K of the law; of a law of the user's nobody knows). An amount of the gain counts |u| times as much.
"""

import dataclasses
import functools as ft
import itertools as it
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import jax.numpy as jnp

from qsmc_jax.accompanied import Accompanied
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.channel import Channel
from qsmc_jax.control.controllers.saturated import is_of_coordinate
from qsmc_jax.control.funnel import AbstractFunnel, Funnel
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.enclosures.unseen import Step, Unseen, unseen, unseen_each
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.model.plants import AbstractPlant
from qsmc_jax.model.reference_model import AbstractReferenceModel
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
from qsmc_jax.numerics.barrier import Barrier
from qsmc_jax.simulation.problem import AbstractProblem, Problem

Path: TypeAlias = Callable[[RealScalarLike], Scalars]

# By how much s may move unseen in a step, relative to the tolerance: 1e-3 at the default one, which moves the peak by
# less than that.
_WORTH = 1e3
_LEAST_WORTH, _LARGEST_WORTH = 1e-6, 1e-2
# Rounding of a reference's derivatives, in units in the last place.
_ROUNDING = 256.0


class Hiding(NamedTuple):
    """What may hide in a step in plant and disturbance.

    Attributes:
        moved: For each channel by how much what drives its sliding variable may pass what was seen, without the input.
        gains: For each channel the same of its gain, times its sign.
        in_states: How far a state could move, in parts of its size; 0.0 in chains.
    """

    moved: tuple[Unseen, ...]
    gains: tuple[Unseen, ...]
    in_states: RealScalarLike


def hidden(
    problem: AbstractProblem,
    step: Step,
    ys: tuple[Scalars, Scalars, Scalars],
    sinhs: Sequence[tuple[RealScalarLike, RealScalarLike]],
    us: Sequence[tuple[RealScalarLike, RealScalarLike]],
    rtol: RealScalarLike,
    least: RealScalarLike,
) -> RealScalarLike:
    """How far a step could move a funnel coordinate unseen, in units of what is tolerated; 0.0 if nothing can hide.

    Args:
        problem: The loop.
        step: The step.
        ys: The coordinates at its start, middle and end.
        sinhs: For each channel sinh |s| at its start and end, s the funnel coordinate.
        us: For each channel the input's size there.
        rtol: The relative tolerance.
        least: Size below which a state counts as this large, as for the tolerances of the solve.
    """
    problem, (t0, t1), ys, sinhs, us = pytrees.stop_gradient((problem, (step.t0, step.t1), ys, sinhs, us))
    step, channels = Step(t0, t1, step.nodes), problem.channels
    at, largest = _path(channels[0], step, ys), [jnp.maximum(*each) for each in us]
    loops, barrier = [each.loop for each in channels], problem.barrier
    hiding = _once(barrier, _hiding(loops, step, at, largest, least, barrier))
    found = [_hidden_in(loop, step, at, hiding, i, sinhs[i], largest[i], barrier) for i, loop in enumerate(loops)]
    moves = [each for each, _ in found] + ([] if is_nothing(hiding.in_states) else [_or_all(hiding.in_states)])
    in_tolerances = [each / _worth(rtol) for each in moves if not is_nothing(each)]
    return ft.reduce(jnp.maximum, [*(growth for _, growth in found), *in_tolerances])


def _once(barrier: Barrier, hiding: Hiding) -> Hiding:
    """The same, worked out once: all of it in one piece is more than XLA makes good code of."""

    def amount(value: RealScalarLike) -> RealScalarLike:
        return value if is_nothing(value) else barrier(value)

    def seen(found: Unseen) -> Unseen:
        return dataclasses.replace(found, amount=amount(found.amount), low=barrier(found.low))

    return Hiding(tuple(map(seen, hiding.moved)), tuple(map(seen, hiding.gains)), amount(hiding.in_states))


def _hidden_in(
    loop: ClosedLoop,
    step: Step,
    at: Path,
    hiding: Hiding,
    channel: int,
    sinhs: tuple[RealScalarLike, RealScalarLike],
    largest: RealScalarLike,
    barrier: Barrier,
) -> tuple[RealScalarLike, RealScalarLike]:
    """How far a channel's funnel coordinate could move unseen, 0.0 if nothing can hide, and by what exponent grow."""
    pushes = joined([hiding.moved[channel], *_asked(loop, step)])
    amount_of_gain, lowest = hiding.gains[channel].amount, hiding.gains[channel].low
    jump, of_law = _discontinuity(loop, step), _of_law(loop, step, at, barrier)
    k = 0.5 * jnp.pi / _narrowest(loop.control.funnel, step)
    # By an exponent of 1 at most may a small s grow in a step in which the gain may push outwards.
    growth = step.length * k * jnp.maximum(-lowest, 0.0)
    if all(map(is_nothing, (pushes.amount, amount_of_gain, jump, of_law))):
        return 0.0, growth
    cosh, least_cosh = (jnp.sqrt(1.0 + bound(*sinhs) ** 2) for bound in (jnp.maximum, jnp.minimum))
    amount = pushes.amount + amount_of_gain * largest + of_law
    moves = step.length * k * cosh * amount
    if isinstance(loop.control, QuasiSlidingControl):
        is_held = lowest > 0.0
        stiffness = _least_gain(loop.control, step) * jnp.where(is_held, lowest, 1.0) * least_cosh
        moves = jnp.minimum(moves, jnp.where(is_held, amount / stiffness, jnp.inf))
    return _or_all(moves + k * cosh * jump), growth


def hidden_in_cell(
    problem: AbstractProblem,
    step: Step,
    at: Path,
    us: Sequence[RealScalarLike],
    rtol: RealScalarLike,
    least: RealScalarLike,
) -> RealScalarLike:
    """How far an open-loop cell could move a sliding variable unseen, in units of what is tolerated.

    Args:
        problem: The loop.
        step: The cell.
        at: The state in it, as a function of time.
        us: For each channel the largest size of the input in it.
        rtol: The relative tolerance.
        least: As for `hidden`.
    """
    problem, (t0, t1), us = pytrees.stop_gradient((problem, (step.t0, step.t1), us))
    step, loops = Step(t0, t1, step.nodes), [each.loop for each in problem.channels]
    hiding = _hiding(loops, step, at, us, least, problem.barrier)
    moves = [_hidden_in_held(loop, step, hiding, i, us[i]) for i, loop in enumerate(loops)]
    moves += [] if is_nothing(hiding.in_states) else [hiding.in_states]
    return _or_all(ft.reduce(jnp.maximum, moves)) / _worth(rtol)


def _hidden_in_held(loop: ClosedLoop, step: Step, hiding: Hiding, channel: int, u: RealScalarLike) -> RealScalarLike:
    """How far one sliding variable could move unseen under held inputs, in parts of its funnel."""
    # A known gain counts as nothing, a constant of the library's own.
    pushes = hiding.moved[channel].amount + hiding.gains[channel].amount * u
    unmatched = () if loop.implementation is None else loop.implementation.unmatched
    for c, signal in zip(loop.control.surface.c, unmatched, strict=False):
        pushes = pushes + c * unseen_in_signal(signal, step).amount
    wander = loop.control.surface([unseen_in_reference(loop.reference, i, step).amount for i in range(loop.order)])
    funnel = loop.control.funnel
    wander = wander + unseen_in_funnel(funnel, step, is_rate=False).amount
    return (step.length * pushes + wander) / _narrowest(funnel, step)


def _or_all(moves: RealScalarLike) -> RealScalarLike:
    """How far something moves; all the way where that is not known."""
    return jnp.where(jnp.isnan(moves), jnp.inf, moves)


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


def _least_gain(law: QuasiSlidingControl, step: Step) -> RealScalarLike:
    """The least that the law multiplies its tangent by in a step: where the funnel is widest, if it is scaled."""
    if not law.is_scaled:
        return law.gain
    widest = law.funnel(step.t0) if isinstance(law.funnel, Funnel) else unseen(law.funnel, step).high
    return law.gain / widest


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


def _asked(loop: ClosedLoop, step: Step) -> list[Unseen]:
    """What may hide in the part of w that does not come from the plant."""
    parts = [unseen_in_reference(loop.reference, loop.order, step)]
    return [*parts, unseen_in_funnel(loop.control.funnel, step, is_rate=True)]


def _hiding(
    loops: Sequence[ClosedLoop],
    step: Step,
    at: Path,
    largest: Sequence[RealScalarLike],
    least: RealScalarLike,
    barrier: Barrier,
) -> Hiding:
    """What may hide in the plant and in the disturbance: of a plant in its own coordinates all at once."""
    loop, plant = loops[0], loops[0].plant
    if not isinstance(plant, AbstractPlant):
        return _hiding_in_own(loops, step, at, largest, least, barrier)
    disturbance, sign = unseen_in_signal(loop.disturbance, step), loop.control.gain_sign
    if is_known(plant):
        low, high = gain_range(plant)
        gain = Unseen(0.0, jnp.minimum(sign * low, sign * high), jnp.nan)
        return Hiding((disturbance,), (gain,), 0.0)
    drift, gain = unseen_each(lambda t: (plant.drift(t, at(t)), sign * loop.gain(t, at(t))), step, barrier)
    return Hiding((joined([disturbance, drift]),), (gain,), 0.0)


def _hiding_in_own(
    loops: Sequence[ClosedLoop],
    step: Step,
    at: Path,
    largest: Sequence[RealScalarLike],
    least: RealScalarLike,
    barrier: Barrier,
) -> Hiding:
    """The same of a plant in its own coordinates. The disturbance is in its rates, wherever it enters.

    Inputs of other channels under the paper's law, limited or not, hide nothing themselves: each is a known function of
    its funnel coordinate, which is guarded. What another law may hide pushes all channels. What enters a state where
    the sliding variable does not see it yet would be found too late there.
    """
    first, m, d = loops[0].plant, len(loops), _disturbed(loops[0], step)
    own = first.plant if isinstance(first, Channel) else first
    assert isinstance(own, AbstractStateSpace | Accompanied)
    states, has_model = own.states, isinstance(loops[0].reference, AbstractReferenceModel)
    laws = first.laws if isinstance(first, Channel) else ()
    given = [j for j, law in enumerate(laws) if not is_of_coordinate(law)]

    def numbers(t: RealScalarLike) -> tuple[RealScalarLike, ...]:
        y = at(t)
        x = y[:states]
        free, (columns, by_input) = own.vector_field(t, x, d(t)), _reach(first, t, x, m)
        moved, gains = [], []
        for i, loop in enumerate(loops):
            surface, sign = loop.control.surface, loop.control.gain_sign
            in_motion = loop.errors_in_motion if has_model else loop.plant.outputs_in_motion
            moved.append(surface(in_motion(t, x, free)[1]))
            gains += [sign * surface(each) for each in by_input[i]]
        kept = first.memory_rates(t, y) if isinstance(first, Channel) else ()
        beside = *(loops[j].input(t, y) for j in given), *kept
        return (*free, *(entry for column in columns for entry in column), *moved, *gains, *beside)

    found = iter(unseen_each(numbers, step, barrier))
    free, columns = list(it.islice(found, states)), [list(it.islice(found, states)) for _ in range(m)]
    moved, gains = list(it.islice(found, m)), [list(it.islice(found, m)) for _ in range(m)]
    inputs, kept = dict(zip(given, it.islice(found, len(given)), strict=True)), list(found)
    with_others = []
    for i in range(m):
        others = [_times(gains[i][j], largest[j]) for j in range(m) if j != i]
        with_others.append(joined([moved[i], *others, *(_times(u, _top(gains[i][j])) for j, u in inputs.items())]))
    moves = []
    for i, (each, *ends) in enumerate(zip([*free, *kept], at(step.t0), at(step.t1), strict=False)):
        size = ft.reduce(jnp.maximum, map(jnp.abs, ends), least)
        parts = [each]
        if i < states:
            parts += [_times(column[i], u) for column, u in zip(columns, largest, strict=True)]
            parts += [_times(u, _top(columns[j][i])) for j, u in inputs.items()]
        moves.append(step.length * joined(parts).amount / size)
    return Hiding(tuple(with_others), tuple(gains[i][i] for i in range(m)), ft.reduce(jnp.maximum, moves))


def _top(found: Unseen) -> RealScalarLike:
    """The largest size that something may have."""
    return jnp.maximum(jnp.abs(found.low), jnp.abs(found.high))


def _reach(plant: Any, t: RealScalarLike, x: Scalars, inputs: int) -> tuple[list[Scalars], list[list[Scalars]]]:
    """What a unit of each input adds to each rate; and for each output, and each input, to the rates of the errors."""
    if not isinstance(plant, Channel):
        return [tuple(plant.input_matrix(t, x))], [[plant.gains(t, x)]]
    rows, all_of_them = plant.plant.input_matrix(t, x), range(inputs)
    columns = [tuple(row[j] for row in rows) for j in all_of_them]
    return columns, [[plant.plant.gains(t, x, i, j) for j in all_of_them] for i in all_of_them]


def _times(found: Unseen, size: RealScalarLike) -> Unseen:
    """What may hide in something times a number."""
    return found if is_nothing(found.amount) else dataclasses.replace(found, amount=found.amount * size)


def _disturbed(loop: ClosedLoop, step: Step) -> Callable[[RealScalarLike], Any]:
    """The value of the disturbance as it is around a step, or those of several."""
    plant, middle = loop.plant, 0.5 * (step.t0 + step.t1)
    if not isinstance(plant, Channel):
        return within(loop.disturbance, middle)
    signals = [within(each, middle) for each in plant.disturbances]
    return lambda t: tuple(signal(t) for signal in signals)


def _of_law(loop: ClosedLoop, step: Step, at: Path, barrier: Barrier) -> RealScalarLike:
    """What may hide in what a law of the user's contributes to the sliding variable's rate; 0.0 for the paper's.

    Of several channels that of all laws is part of what moves each.
    """
    if isinstance(loop.control, QuasiSlidingControl) or isinstance(loop.plant, Channel):
        return 0.0
    return unseen_each(lambda t: (loop.gain(t, at(t)) * loop.input(t, at(t)),), step, barrier)[0].amount


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
