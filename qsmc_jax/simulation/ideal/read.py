"""From the end of a solve to what a user reads: outcome, verdict per claim, and the metrics of one run."""

import dataclasses
import functools as ft

import diffrax as dfx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike, Scalars
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.metrics.accumulate import read_states
from qsmc_jax.metrics.metric import Extent
from qsmc_jax.metrics.standard import Metrics
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.model.unseen import is_consistent
from qsmc_jax.numerics.gudermann import margin, ratio, sinh_cosh
from qsmc_jax.simulation.ideal.accumulate import Peak, RunningMetrics
from qsmc_jax.simulation.ideal.barrier import barrier_bound
from qsmc_jax.simulation.ideal.guarded_solver import ESCAPE, Run
from qsmc_jax.simulation.ideal.input import law_of_coordinate, least_and_largest
from qsmc_jax.simulation.ideal.step import IdealStep, no_step
from qsmc_jax.simulation.ideal.step_size import UNRESOLVED
from qsmc_jax.simulation.joined import joined
from qsmc_jax.simulation.judge import first_to_apply, is_refused, later_verdicts
from qsmc_jax.simulation.outcome import Outcome
from qsmc_jax.simulation.problem import AbstractProblem, JointProblem, Problem
from qsmc_jax.simulation.spans import is_since, last_outside

# An instant, relative to the time: some ten thousand units in its last place.
_IMMINENT = 1e-12
# By what part of their size signals may be wrong, over the square root of the relative tolerance.
_RESOLUTION = 0.02
# By how much coordinates may disagree on sigma/rho.
_DRIFT = 1e-3
# Soon, also relative to the time: a run at the funnel's edge is outside if the gain is gone within that time.
_SOON = 1e-10

# Where around the edge a law is looked at, in parts of the half-width, and what is the same there.
_AROUND_EDGE = (-1e-6, -1e-7, -1e-8, -1e-9, 1e-9, 1e-8, 1e-7, 1e-6)
_SAME = 1e-3


class FinalState(AbstractModule):
    """What the solver hands over: whether the run was admissible, the horizon, and where and how the solve stopped.

    `rates` are those of the coordinates there, and `first_heights` |s| of each channel at time 0.
    """

    refused: Int[Array, ""]
    horizon: Float[Array, ""]
    end_time: Float[Array, ""]
    run: Run
    rates: Scalars
    result: dfx.RESULTS
    first_heights: Scalars
    steps: Int[Array, ""]


def read_metrics(problem: AbstractProblem, final: FinalState) -> Metrics:
    """Outcome first, then the verdicts, then the metrics: those of an unfinished run are masked."""
    running, leaving = final.run.running, [_leaves(each, final) for each in problem.channels]
    outcome = _outcome(final, ft.reduce(jnp.logical_or, leaving))
    is_complete, resolution = outcome == Outcome.COMPLETED, _RESOLUTION * jnp.sqrt(problem.rtol)
    extent = Extent(final.end_time, final.horizon, is_complete, ~is_refused(outcome), resolution)
    own = read_states(problem.measures, running.own, IdealStep(no_step(final.run.y), problem), extent)
    channels = []
    for i, each in enumerate(problem.channels):
        has_left = (outcome == Outcome.LEFT_FUNNEL) & leaving[i]
        channels.append(_of_channel(each, final, running.channels[i], final.first_heights[i], outcome, has_left))
    if not isinstance(problem, JointProblem) or running.barrier is None:
        return dataclasses.replace(channels[0], own=own)
    known = is_complete | (outcome == Outcome.LEFT_FUNNEL)
    barrier = (running.barrier.height, barrier_bound(problem, running.barrier))
    return joined(channels, tuple(jnp.where(known, each, jnp.nan) for each in barrier), own)


def _of_channel(
    problem: Problem,
    final: FinalState,
    running: RunningMetrics,
    first_height: RealScalarLike,
    outcome: Int[Array, ""],
    has_left: Bool[Array, ""],
) -> Metrics:
    """The metrics of a channel, which may be the only one."""
    peak, is_complete = running.peak, outcome == Outcome.COMPLETED
    reach_time = last_outside(running.outside, problem.bandwidth, final.end_time)
    settle_time = jnp.where(running.unsettled.end >= final.end_time, jnp.inf, running.unsettled.end)
    verdict, reaching, tracking = _verdicts(problem, outcome, has_left, final, running, reach_time, settle_time)
    is_steady = is_complete & (final.end_time > problem.reaching_time)
    is_papers = isinstance(problem.loop.control, QuasiSlidingControl)
    min_u, max_u = least_and_largest(problem, running.input)
    lowest_if_left, highest_if_left = _ends_of_input(problem, final)

    def known(value: RealScalarLike, where_left: RealScalarLike = jnp.nan) -> Float[Array, ""]:
        return jnp.where(is_complete, value, jnp.where(has_left, where_left, jnp.nan))

    return Metrics(
        verdict=verdict,
        verdict_reaching=reaching,
        verdict_tracking=tracking,
        outcome=outcome,
        end_time=final.end_time,
        peak_ratio=known(ratio(peak.height), 1.0),
        margin=known(margin(peak.height), 0.0),
        peak_time=known(peak.time, final.end_time),
        peak_u=known(_peak_input(problem, peak, min_u, max_u), jnp.inf if is_papers else jnp.nan),
        max_u=known(max_u, highest_if_left),
        min_u=known(min_u, lowest_if_left),
        peak_u_bound=known(_comparison_bound(problem, peak, first_height)),
        reach_time=known(reach_time, jnp.inf),
        violation_time=known(jnp.inf, _escape_time(problem, final, has_left)),
        settle_time=known(settle_time, jnp.inf),
        peak_errors=tuple(jnp.where(is_steady, peak, jnp.nan) for peak in running.peak_errors),
        rms_error=known(jnp.sqrt(running.squared_error / jnp.where(is_complete, final.end_time, 1.0))),
        energy_u=known(running.input.energy),
        total_variation_u=known(running.input.variation),
        least_gain=running.least_gain,
        largest_disturbance=running.largest_disturbance,
        steps=final.steps,
        coordinate_drift=None if running.drift is None else jnp.asarray(running.drift.largest),
    )


def _is_stuck(final: FinalState) -> Bool[Array, ""]:
    """Whether the steps became as short as time resolves."""
    return jnp.asarray((final.result == dfx.RESULTS.dt_min_reached) | (final.result == UNRESOLVED))


def _leaves(problem: Problem, final: FinalState) -> Bool[Array, ""]:
    """Whether a channel leaves its funnel where the solve stopped, if it stopped early."""
    s = problem.coordinates.funnel_motion(problem.loop, final.end_time, final.run.y, final.rates)[0]
    # Of several channels another may be the one that is followed to where the edge is no longer resolved.
    is_stuck, is_far = _is_stuck(final), (final.result == dfx.RESULTS.event_occurred) & (jnp.abs(s) > 0.5 * ESCAPE)
    leaves = (is_stuck | is_far) & _is_leaving(problem, final, is_far)
    return jnp.asarray(leaves | (is_stuck & _is_thrown_out(problem, final)))


def _outcome(final: FinalState, leaves: Bool[Array, ""]) -> Int[Array, ""]:
    """The code of how the solve ended; leaving the funnel is distinguished from a solve that failed near its edge."""
    result, is_stuck = final.result, _is_stuck(final)
    is_far = result == dfx.RESULTS.event_occurred
    cases = (
        (_has_drifted(final), Outcome.DRIFTED),
        (result == dfx.RESULTS.successful, Outcome.COMPLETED),
        (leaves, Outcome.LEFT_FUNNEL),
        (is_far, Outcome.BEYOND_RESOLUTION),
        (result == UNRESOLVED, Outcome.UNRESOLVED),
        (is_stuck, Outcome.STEP_TOO_SMALL),
    )
    return first_to_apply(final.refused, cases, Outcome.MAX_STEPS)


def _ends_of_input(problem: Problem, final: FinalState) -> tuple[RealScalarLike, RealScalarLike]:
    """The least and the largest input of a run that left: under the paper's law one of them grows beyond all bounds."""
    if not isinstance(problem.loop.control, QuasiSlidingControl):
        return jnp.nan, jnp.nan
    s = problem.coordinates.funnel_coordinate(problem.loop, final.end_time, final.run.y)
    grows_upwards = jnp.asarray(problem.loop.control.gain_sign * s < 0.0)
    return jnp.where(grows_upwards, jnp.nan, -jnp.inf), jnp.where(grows_upwards, jnp.inf, jnp.nan)


def _peak_input(problem: Problem, peak: Peak, min_u: RealScalarLike, max_u: RealScalarLike) -> RealScalarLike:
    """The peak of |u|: without an offset it is where |s| has its own, which is found best."""
    law, largest = law_of_coordinate(problem.loop.control), jnp.maximum(jnp.abs(min_u), jnp.abs(max_u))
    if law is None:
        return largest
    return jnp.where(law.offset == 0.0, law.gain * sinh_cosh(peak.height)[0], largest)


def _has_drifted(final: FinalState) -> Bool[Array, ""]:
    """Whether the coordinates disagree on the sliding variable by more than is allowed, however the run ended.

    A run that ended inside must also have had more margin than that all the time; one that leaves comes to have none.
    """
    has_drifted, is_inside = jnp.array(False), final.result == dfx.RESULTS.successful
    for drift in (each.drift for each in final.run.running.channels):
        if drift is not None:
            has_drifted = has_drifted | (drift.largest > _DRIFT) | (is_inside & (drift.room < 0.0))
    return jnp.asarray(has_drifted)


def _escape_time(problem: Problem, final: FinalState, has_left: Bool[Array, ""]) -> RealScalarLike:
    r"""The end of a run that left, with its derivative $-\partial_p s / \dot s$, s and its speed those at the end.

    The times of the steps have none; but a run ends where s, not the time, has a given value.
    """
    t, y, dy = final.end_time, final.run.y, final.rates
    # Where it did not leave s may be anything: not even zero times its derivative is to be had.
    s, s_rate = (jnp.where(has_left, each, 1.0) for each in problem.coordinates.funnel_motion(problem.loop, t, y, dy))
    return t - (s - jax.lax.stop_gradient(s)) / jax.lax.stop_gradient(s_rate)


def _is_leaving(problem: Problem, final: FinalState, is_far: BoolScalarLike) -> BoolScalarLike:
    r"""Whether $|s| \to \infty$ within an instant: outward, that fast, and with an input that does not push back.

    At speed $|\dot s|$ what is left to the edge, $\approx e^{-|s|}$ of the funnel, is gone after about $1 / |\dot s|$.
    An instant is twice that for a run that is followed to where the edge is no longer resolved; for one that stopped
    before, since its steps had become as short as time resolves, it is some thousands of these.
    """
    loop, t, y = problem.loop, final.end_time, final.run.y
    s, s_rate = problem.coordinates.funnel_motion(loop, t, y, final.rates)
    speed = jnp.abs(s_rate)
    left = 2.0 / jnp.where(speed > 0.0, speed, 1.0)
    instant = jnp.where(is_far, left, _IMMINENT * t)
    x = problem.coordinates.state(loop, t, y)
    pushes_back = _pushes_back(loop, t, x) & _pushes_back(loop, t + instant, loop.coasted(t, x, instant))
    is_fast = (s * s_rate > 0.0) & (speed * instant > 1.0)
    # A run that the input holds at the edge until the gain is gone creeps there, at a speed that rounding decides.
    soon, residual = _SOON * t, loop.balance(t, x, loop.errors(t, x), loop.desired(t, x)).residual
    pull = residual - loop.control.funnel.centre_and_rate(t)[1]
    is_carried_out = (s * pull > 0.0) & (margin(s) * loop.control.funnel(t) <= jnp.abs(pull) * soon)
    leaves = (is_fast & ~pushes_back) | (is_carried_out & ~_pushes_back(loop, t + soon, loop.coasted(t, x, soon)))
    if isinstance(loop.control, QuasiSlidingControl):
        return leaves
    # Under a law that knows no edge it crosses it if it moves out as fast as rounding is not.
    moves_out = (s * s_rate > 0.0) & (margin(s) <= jnp.abs(s_rate) / sinh_cosh(s)[1] * soon)
    return leaves | (moves_out & _knows_no_edge(loop, t, x, jnp.sign(s)))


def _knows_no_edge(loop: ClosedLoop, t: RealScalarLike, x: Scalars, side: RealScalarLike) -> BoolScalarLike:
    """Whether a law gives the same just inside and just outside the funnel's edge, and as near to it as one may look.

    One that has a pole there pushes back as hard as it takes, closer to the edge than it could be followed.
    """
    errors, desired, funnel = loop.errors(t, x), loop.desired(t, x), loop.control.funnel
    deviation = loop.control.surface(errors) - funnel.centre(t)

    def at(place: float) -> RealScalarLike:
        there = side * place * funnel(t)
        return loop.command(t, x, (*errors[:-1], errors[-1] + there - deviation), desired, there)

    inputs = jnp.stack([at(1.0 + gap) for gap in _AROUND_EDGE])
    spread = jnp.max(inputs) - jnp.min(inputs)  # NaN where the law is not defined
    return spread <= _SAME * (1.0 + jnp.max(jnp.abs(inputs)))


def _pushes_back(loop: ClosedLoop, t: RealScalarLike, x: Scalars) -> BoolScalarLike:
    return jnp.asarray(loop.control.gain_sign * loop.gain(t, x) > 0.0)


def _is_thrown_out(problem: Problem, final: FinalState) -> BoolScalarLike:
    """Whether the reference jumps where the run stopped, so far that the sliding variable is outside afterwards."""
    if is_consistent(problem.loop.reference):
        return jnp.array(False)
    loop, t, s = problem.loop, final.end_time, problem.coordinates.funnel_coordinate
    within = _IMMINENT * t
    before, after = loop.desired(t - within), loop.desired(t + within)
    jump = loop.control.surface(tuple(a - b for a, b in zip(before[:-1], after[:-1], strict=True)))
    rho = loop.control.funnel(t)
    return jnp.abs(rho * ratio(s(loop, t, final.run.y)) + jump) >= rho


def _verdicts(
    problem: Problem,
    outcome: Int[Array, ""],
    has_left: Bool[Array, ""],
    final: FinalState,
    running: RunningMetrics,
    reach_time: RealScalarLike,
    settle_time: RealScalarLike,
) -> tuple[Int[Array, ""], Int[Array, ""], Int[Array, ""]]:
    """The verdicts on the three claims of Theorem 1. Later claims need the earlier ones, and C2.

    A step that has t_s inside counts for tracking by its end alone: what exceeds a bound there begins the next step.
    """
    funnel = jnp.where(outcome == Outcome.COMPLETED, int(Verdict.HELD), int(Verdict.UNDECIDED))
    funnel = jnp.where(has_left, int(Verdict.VIOLATED), funnel)
    funnel = jnp.where(is_refused(outcome), int(Verdict.INADMISSIBLE), funnel)
    # A run that is still outside where the horizon ends before t_r has broken nothing yet.
    is_late = (reach_time >= problem.reaching_time) & (final.horizon > problem.reaching_time)
    is_broken = jnp.asarray(is_late), is_since(running.unsettled, problem.settling_time)
    later = later_verdicts(problem, final.horizon, is_broken, (jnp.array(True), jnp.isfinite(settle_time)))
    admits = problem.loop.control.funnel.admits(problem.bandwidth)
    is_open = (funnel == Verdict.HELD) | ~admits
    reaching, tracking = (jnp.where(is_open, verdict, funnel) for verdict in later)
    return funnel, reaching, tracking


def _comparison_bound(problem: Problem, peak: Peak, first_height: RealScalarLike) -> Float[Array, ""]:
    r"""The bound $\max(|u(0)|, (|w| + \mu(\rho - \rho_\infty)) / |g|)$ on sup|u|, with w, g, rho as at the peak.

    Where |z| = |sigma|/rho peaks after the start its derivative is not negative outwards, so
    $\tan(\pi |z| / 2) \le (|w| + |\dot\rho|) / |g|$ there: sharper than the supremum over time, and it needs no search.
    With a gain K and an offset $u_0$ of the law: $K \tan \le (|w + g u_0| + |\dot\rho|) / |g|$, and $|u_0|$ more.
    None is known of the scaled law, whose input peaks elsewhere.
    Source: the step "contradiction" in the proof of Theorem 1, made quantitative.
    """
    loop, law, t = problem.loop, law_of_coordinate(problem.loop.control), peak.time
    if law is None:
        return jnp.full((), jnp.nan)
    x = problem.coordinates.state(loop, t, peak.y)
    balance = loop.balance(t, x, loop.errors(t, x), loop.desired(t, x))
    gain = jnp.where(balance.gain == 0.0, 1.0, balance.gain)
    at_peak = law.funnel.load(t, loop.plain(t, balance).residual) / jnp.abs(gain)
    bound = jnp.maximum(law.gain * sinh_cosh(first_height)[0], jnp.where(balance.gain == 0.0, jnp.inf, at_peak))
    return bound + jnp.abs(law.offset)
