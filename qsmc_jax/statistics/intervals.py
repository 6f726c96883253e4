r"""Exact statistics of counted runs: intervals, planned numbers of runs, and what the worst run says.

All assume independent runs. Notation: N runs, $\alpha = 1 - $ confidence, $I^{-1}(a, b; q)$ the q-quantile of the
Beta(a, b) distribution. Only NumPy and SciPy are used; results are Python floats.
"""

from typing import TypeAlias

import numpy as np
from scipy import special

from qsmc_jax.base.checks import require, require_fraction

Count: TypeAlias = int | np.integer

_MOST_RUNS = 2**53  # above it, counts are no longer exact in float64


def clopper_pearson(violated: Count, undecided: Count, total: Count, confidence: float) -> tuple[float, float]:
    r"""Two-sided interval of the violation probability that counts every undecided run both ways.

    The lower end counts them as held, the upper as violated:
    $[I^{-1}(v, N - v + 1; \alpha/2),\ I^{-1}(v + m + 1, N - v - m; 1 - \alpha/2)]$ for v violated and m undecided runs.
    Each end is missed with probability at most $\alpha/2$, whatever the undecided runs would have been, for every N.

    Args:
        violated: Runs that violated the claim.
        undecided: Runs without a verdict.
        total: All runs, decided or not; with none the interval is (0, 1).
        confidence: Confidence of the interval, strictly between 0 and 1.

    Returns:
        Lower and upper end, to 7 digits or more; 0 if nothing is violated, 1 if everything may be.

    Source: Clopper and Pearson, Biometrika 26 (1934); worst case over the undecided as in Horowitz and Manski, J. Am.
        Stat. Assoc. 95 (2000).
    """
    require_fraction("confidence", confidence)
    violated, undecided, total = int(violated), int(undecided), int(total)
    for name, count in {"violated": violated, "undecided": undecided, "total": total}.items():
        require(count >= 0, f"Argument `{name}` must not be negative, but is {count}.")
    worst = violated + undecided
    require(worst <= total, f"Argument `total` must be at least `violated` + `undecided` = {worst}, but is {total}.")
    tail = (1.0 - confidence) / 2.0
    low = 0.0 if violated == 0 else special.betaincinv(violated, total - violated + 1, tail)
    high = 1.0 if worst == total else special.betainccinv(worst + 1, total - worst, tail)
    return float(low), float(high)


def runs_needed(probability: float, confidence: float, violations: Count = 0) -> int:
    r"""Smallest number of runs that can show the violation probability to be at most `probability`.

    It serves the two-sided interval of `clopper_pearson`, which `verify` prints: with this many runs, none undecided,
    and `violations` violated, its upper end is at most `probability`; with one run less it is not. For none violated
    this is $\lceil \ln(\alpha/2) / \ln(1 - p) \rceil$. A one-sided claim at confidence c is planned with `2 * c - 1`:
    `runs_needed(1e-3, 0.90)` is the familiar 2995 for one-sided 95 %.

    Args:
        probability: Violation probability p to be shown, strictly between 0 and 1.
        confidence: Confidence of the two-sided interval, strictly between 0 and 1.
        violations: Violated or undecided runs to be allowed for.

    Returns:
        The number of runs.

    Raises:
        InputError: An argument is out of range, or more than 2**53 runs are needed.

    Examples:
        >>> import qsmc_jax as qj
        >>> qj.runs_needed(1e-3, 0.95), qj.runs_needed(1e-3, 0.90)
        (3688, 2995)
    """
    require_fraction("probability", probability)
    require_fraction("confidence", confidence)
    require(bool(violations >= 0), f"Argument `violations` must not be negative, but is {violations}.")
    too_few, enough = int(violations), int(violations) + 1
    while clopper_pearson(violations, 0, enough, confidence)[1] > probability:
        too_few, enough = enough, 2 * enough
        require(
            enough <= _MOST_RUNS,
            f"Argument `probability` must be showable by 2**53 runs, but is {probability}. Choose a larger one.",
        )
    while enough - too_few > 1:
        middle = (too_few + enough) // 2
        is_enough = clopper_pearson(violations, 0, middle, confidence)[1] <= probability
        too_few, enough = (too_few, middle) if is_enough else (middle, enough)
    return enough


def zero_failure_bound(total: Count, confidence: float) -> float:
    r"""Upper end of `clopper_pearson` when no run is violated or undecided, $1 - (\alpha/2)^{1/N}$.

    About 3.69/N at 95 %. The one-sided bound, about 3/N, is `worst_case_coverage`.

    Args:
        total: Number of runs N, at least 1.
        confidence: Confidence of the two-sided interval, strictly between 0 and 1.

    Returns:
        The bound on the violation probability.
    """
    _require_runs(total)
    require_fraction("confidence", confidence)
    return float(-np.expm1(np.log((1.0 - confidence) / 2.0) / total))


def worst_case_coverage(total: Count, confidence: float, rank: Count = 1) -> float:
    r"""How probably a further run exceeds the worst of N, at most: $1 - \alpha^{1/N}$, one-sided.

    With the given confidence (over the N runs), a further run exceeds the worst seen with no more than this
    probability. For the `rank`-th worst instead of the worst it is $I^{-1}(r, N - r + 1; 1 - \alpha)$. It holds for any
    distribution of any number, such as peak control or margin.

    Args:
        total: Number of runs N, at least 1.
        confidence: Confidence, strictly between 0 and 1.
        rank: Which of the worst, 1 for the very worst, at most N.

    Returns:
        The bound on the probability of exceedance.

    Source: Tempo, Bai and Dabbene, Syst. Control Lett. 30 (1997); ranks: Wilks, Ann. Math. Stat. 12 (1941).
    """
    _require_runs(total)
    require_fraction("confidence", confidence)
    require(bool(1 <= rank <= total), f"Argument `rank` must be in [1, {total}], but is {rank}.")
    return float(special.betainccinv(rank, total - rank + 1, 1.0 - confidence))


def cdf_band(total: Count, confidence: float) -> float:
    r"""Half-width of a band around the empirical CDF of N runs that holds the true CDF everywhere.

    It is $\sqrt{\ln(2/\alpha) / (2N)}$, for any distribution.

    Args:
        total: Number of runs N, at least 1.
        confidence: Confidence of the whole band, strictly between 0 and 1.

    Returns:
        The half-width, in units of probability; above 1 it says nothing.

    Source: Dvoretzky, Kiefer and Wolfowitz (1956), constant by Massart, Ann. Probab. 18 (1990).
    """
    _require_runs(total)
    require_fraction("confidence", confidence)
    return float(np.sqrt(np.log(2.0 / (1.0 - confidence)) / (2.0 * total)))


def _require_runs(total: Count) -> None:
    """Raises unless there is a run."""
    require(bool(total >= 1), f"Argument `total` must be at least 1, but is {total}.")
