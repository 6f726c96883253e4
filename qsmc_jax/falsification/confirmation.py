"""No finding is believed from one solve: what another way of solving it does not confirm is not reported as one."""

import dataclasses
import functools as ft

import numpy as np
from jaxtyping import Bool, Float

from qsmc_jax.falsification.objective import Objective
from qsmc_jax.metrics.claims import gravest
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.study.batches import LANE_MULTIPLE
from qsmc_jax.study.monte_carlo import stream
from qsmc_jax.study.runs import Runs, concatenate
from qsmc_jax.study.sampling import Table
from qsmc_jax.study.study import Study
from qsmc_jax.verification.escalation import Escalation, said
from qsmc_jax.verification.numerical_error import solved_again
from qsmc_jax.verification.tiers import Tiers

# How far two solves of a metric may lie apart, relatively: ten times what it is good to.
_APART = 1e-3


@dataclasses.dataclass(frozen=True)
class Confirmed:
    """A run that two ways of solving it agree on.

    Attributes:
        point: Its point of the unit cube.
        value: The column of the objective: of the two solves the less bad number.
        change: How far the two lie apart.
        verdict: The verdict on the claims by which it is judged, of both.
        unconfirmed: How many runs that looked worse were not confirmed.
    """

    point: Float[np.ndarray, " dim"]
    value: float
    change: float
    verdict: Verdict
    unconfirmed: int


def confirm(
    study: Study, objective: Objective, rows: Runs, points: Float[np.ndarray, "runs dim"], tiers: Tiers
) -> Confirmed | None:
    """Decides the worst runs as a verification does, and checks them by another method; the worst that stands.

    Args:
        study: The study.
        objective: What was searched.
        rows: The worst runs, the very worst first; their `index` is a row of `points`.
        points: Their points.
        tiers: Settings of their solve, and of firmer ones.

    Returns:
        The worst run on which both ways agree; None if there is none.
    """
    solve = ft.partial(stream, study, seed=0, sampling=Table(points), block=LANE_MULTIPLE)
    escalation = Escalation(solve, tiers, LANE_MULTIPLE)
    decided = concatenate([*escalation.feed(rows), *escalation.finish()])
    pair = solved_again(decided, solve, tiers)
    if pair is None:
        return None
    before, after = pair
    judged = [list(before.claims).index(claim) for claim in objective.claims]
    was, now = before.verdicts[judged], said(after)[judged]
    values = np.stack([before[objective.column], after[objective.column]])
    agree = (was == now).all(axis=0) & (objective.is_claim | _is_near(values) | (was == Verdict.VIOLATED).any(axis=0))
    scores = np.where(agree, objective.scores(before), -np.inf)
    if not agree.any() or np.isneginf(scores.max()):
        return None
    best = int(np.argmax(scores))
    looked = objective.scores(rows)
    less_bad = np.max if objective.is_low_worse else np.min
    return Confirmed(
        point=points[before["index"][best]],
        value=float(less_bad(values[:, best])),
        change=float(abs(values[0, best] - values[1, best])),
        verdict=gravest([Verdict(int(each)) for each in was[:, best]]),
        unconfirmed=int(np.sum(looked > looked[rows["index"] == before["index"][best]])),
    )


def _is_near(values: Float[np.ndarray, "2 runs"]) -> Bool[np.ndarray, " runs"]:
    """Where two solves say the same number, or the same infinity."""
    first, second = values
    with np.errstate(invalid="ignore"):
        apart = np.abs(first - second)
    return (first == second) | (apart <= _APART * np.fmax(np.abs(first), np.abs(second)))
