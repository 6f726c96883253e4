"""What both loops share in their judgement of a run: the first outcome that applies, the claims that need C2."""

from collections.abc import Iterable

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from qsmc_jax.base.types import BoolScalarLike, RealScalarLike
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.simulation.outcome import Outcome
from qsmc_jax.simulation.problem import Problem


def first_to_apply(
    refused: Int[Array, ""], cases: Iterable[tuple[BoolScalarLike, Outcome]], otherwise: Outcome
) -> Int[Array, ""]:
    """The code of the first case that applies to a run that was not refused, which keeps its code."""
    code, is_open = refused, refused == Outcome.COMPLETED
    for applies, outcome in (*cases, (jnp.array(True), otherwise)):
        code = jnp.where(is_open & applies, int(outcome), code)
        is_open = is_open & ~applies
    return code


def is_refused(outcome: Int[Array, ""]) -> Bool[Array, ""]:
    """Whether a run was not solved at all, since a premise does not hold."""
    return (outcome == Outcome.STARTED_OUTSIDE) | (outcome == Outcome.BAD_PARAMETERS)


def later_verdicts(
    problem: Problem,
    horizon: RealScalarLike,
    is_broken: tuple[Bool[Array, ""], Bool[Array, ""]],
    is_known: tuple[Bool[Array, ""], Bool[Array, ""]],
) -> tuple[Int[Array, ""], Int[Array, ""]]:
    """The verdicts on reaching and tracking, which need C2: claims on all times from t_r, or t_s, on.

    Args:
        problem: The loop and its thresholds.
        horizon: The horizon [s].
        is_broken: Whether |sigma| reached the bandwidth at some time from t_r on, an error its bound from t_s on.
        is_known: Whether the run was followed to the horizon without that, if not.
    """
    held, violated, undecided, inadmissible = (int(verdict) for verdict in Verdict)
    admits = problem.loop.control.funnel.admits(problem.bandwidth)
    since = problem.reaching_time, problem.settling_time

    def verdict(since: RealScalarLike, is_broken: Bool[Array, ""], is_known: Bool[Array, ""]) -> Int[Array, ""]:
        unbroken = jnp.where(is_known & (horizon > since), held, undecided)
        return jnp.where(admits, jnp.where(is_broken, violated, unbroken), inadmissible)

    reaching, tracking = (verdict(*claim) for claim in zip(since, is_broken, is_known, strict=True))
    return reaching, tracking
