r"""Intervals that hold together, and the interval of a median. All are exact, for any distribution.

Several intervals hold together with probability $1 - \alpha$ when each of m is missed with probability at most
$\alpha / m$ (Bonferroni), however they depend on one another, as those from common random numbers do.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from qsmc_jax.statistics.intervals import clopper_pearson


def each_of(count: int, confidence: float) -> float:
    """The confidence of each of `count` intervals that makes them hold together with the given one."""
    return 1.0 - (1.0 - confidence) / count


def simultaneous_intervals(
    violated: Int[np.ndarray, "*cells"],
    undecided: Int[np.ndarray, "*cells"],
    total: Int[np.ndarray, "*cells"],
    confidence: float,
) -> tuple[Float[np.ndarray, "*cells"], Float[np.ndarray, "*cells"]]:
    """Intervals of the violation probabilities of all cells that hold together, each by Clopper and Pearson.

    Args:
        violated: Violated runs of each cell.
        undecided: Undecided runs, counted both ways.
        total: All admissible runs.
        confidence: That all intervals hold, strictly between 0 and 1.

    Returns:
        Lower and upper ends.
    """
    each = each_of(max(violated.size, 1), confidence)
    counts = zip(violated.flat, undecided.flat, total.flat, strict=True)
    ends = np.array([clopper_pearson(v, m, n, each) for v, m, n in counts]).reshape(-1, 2)
    return ends[:, 0].reshape(violated.shape), ends[:, 1].reshape(violated.shape)


def median_interval(values: Float[np.ndarray, " runs"], confidence: float) -> tuple[float, float]:
    r"""Two-sided interval of the median of independent values, from their order statistics.

    With k the largest number for which $P(B < k) \le \alpha/2$, B binomial (N, 1/2), it is $[x_{(k)}, x_{(N+1-k)}]$.
    It holds for any distribution, also one with ties.

    Args:
        values: The values; infinities are allowed.
        confidence: Confidence of the interval, strictly between 0 and 1.

    Returns:
        Lower and upper end; infinite if there are too few values.

    Source: Thompson, Ann. Math. Stat. 7 (1936).
    """
    rank = int(stats.binom.ppf((1.0 - confidence) / 2.0, values.size, 0.5)) if values.size else 0
    if rank == 0:
        return -np.inf, np.inf
    ordered = np.sort(values)
    return float(ordered[rank - 1]), float(ordered[values.size - rank])
