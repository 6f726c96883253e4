"""Which runs statistics are over, which of their metrics are known, and what a run lost that has none."""

from collections.abc import Iterable, Mapping

import numpy as np
from jaxtyping import Float

from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.simulation.outcome import Outcome

# The name, among columns, of what each run lost: 0 for one that was solved to its end.
LOSS = "loss"
# What a run loses at least: as far beyond a bound as counts, however late it left.
BEYOND = 0.01
# Columns that tell what was lost, in addition to verdict and outcome.
NEEDED = ("peak_ratio", "violation_time", "end_time")


def counted(
    table: Mapping[str, np.ndarray], metrics: Iterable[str], horizon: float
) -> dict[str, Float[np.ndarray, " admissible"]]:
    """The columns that objectives and constraints are evaluated on, over the admissible runs.

    A metric counts as known if its run was decided and solved to its end. Any other run lost 0.01 and, if it left the
    funnel or could not be followed further, the part of its horizon that was left; if it went far outside, that.

    Args:
        table: Columns by name: verdict, outcome, `NEEDED`, and the metrics.
        metrics: The metrics.
        horizon: Horizon of the nominal run [s]; longer ones among the runs that were solved to the end count too.

    Returns:
        The metrics, NaN where they are not known; and `LOSS`.
    """
    is_admissible = table["verdict"] != Verdict.INADMISSIBLE
    rows = {name: np.asarray(table[name])[is_admissible] for name in ("verdict", "outcome", *NEEDED, *metrics)}
    is_solved = is_solved_to_its_end(rows)
    columns = {metric: np.where(is_solved, rows[metric], np.nan) for metric in metrics}
    if "peak_ratio" in columns:  # the verdict decides, not the last digit of the peak
        least = np.where(rows["verdict"] == Verdict.VIOLATED, 1.0, 0.0)
        columns["peak_ratio"] = np.maximum(columns["peak_ratio"], least)
    horizon = max([horizon, *rows["end_time"]])
    early, far = 1.0 - _left(rows) / horizon, _far(rows)
    columns[LOSS] = np.where(is_solved, 0.0, BEYOND + np.maximum(early, far))
    return columns


def slopes(
    table: Mapping[str, np.ndarray], by_name: Mapping[str, Float[np.ndarray, "runs names"]], horizon: float
) -> Float[np.ndarray, "admissible names"]:
    """The derivative of `LOSS`, given those of `peak_ratio` and `violation_time`; 0 for undecided runs.

    Args:
        table: As for `counted`.
        by_name: Derivatives of each column by names of the study.
        horizon: As for `counted`.
    """
    is_admissible = table["verdict"] != Verdict.INADMISSIBLE
    rows = {name: np.asarray(table[name])[is_admissible] for name in ("verdict", "outcome", *NEEDED)}
    horizon = max([horizon, *rows["end_time"]])
    is_far = _far(rows) > 1.0 - _left(rows) / horizon
    has_left = np.isfinite(rows["violation_time"])
    by_time = np.where(has_left[:, None], by_name["violation_time"][is_admissible], 0.0) / -horizon
    found = np.where(is_far[:, None], by_name["peak_ratio"][is_admissible], by_time)
    return np.where(is_solved_to_its_end(rows)[:, None], 0.0, found)


def is_unknown(columns: Mapping[str, np.ndarray], metrics: Iterable[str]) -> np.ndarray:
    """The runs in which one of the metrics is not known, (runs,)."""
    return ~np.all([np.isfinite(columns[metric]) for metric in metrics], axis=0)


def mean_loss(columns: Mapping[str, np.ndarray], metrics: Iterable[str]) -> tuple[float, dict[str, np.ndarray]]:
    """The mean over all runs of what those lost in which a metric is not known, and its derivative by `LOSS`.

    Args:
        columns: Columns by name; `LOSS`, if it is among them, as `counted` has it.
        metrics: The metrics.

    Returns:
        0 if all are known, 1 if there is no run; and the derivative.
    """
    is_lost = is_unknown(columns, metrics)
    if not is_lost.size:
        return 1.0, {LOSS: np.zeros(0)}
    lost = np.where(is_lost, np.maximum(columns.get(LOSS, 0.0), BEYOND), 0.0)
    return float(lost.mean()), {LOSS: is_lost / len(is_lost)}


def is_solved_to_its_end(rows: Mapping[str, np.ndarray]) -> np.ndarray:
    """The runs whose metrics are those of the whole horizon, and believed."""
    return (rows["outcome"] == Outcome.COMPLETED) & (rows["verdict"] != Verdict.UNDECIDED)


def _left(rows: Mapping[str, np.ndarray]) -> np.ndarray:
    """When the run left the funnel, or else when its solve ended [s]."""
    return np.where(np.isfinite(rows["violation_time"]), rows["violation_time"], rows["end_time"])


def _far(rows: Mapping[str, np.ndarray]) -> np.ndarray:
    """How far outside the funnel it was followed, in half-widths; 0 if it was not."""
    return np.where(np.isfinite(rows["peak_ratio"]), rows["peak_ratio"] - 1.0, 0.0)
