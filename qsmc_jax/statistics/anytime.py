r"""Statistics that stay valid while you look: a confidence sequence, and Wald's sequential test.

An interval for a fixed number of runs is missed more often than it says once its width, or a look at it, decides when
to stop. A confidence sequence covers the probability at all numbers of runs together.
"""

import math

import numpy as np
from scipy import special

from qsmc_jax.base.checks import require, require_fraction

# Weight of the atom at p = 0, and the Beta(a, b) distribution of the rest, in the mixture.
_ATOM, _A, _B = 0.5, 0.5, 0.5
# Logits between which every probability is sought: as far as exp goes.
_FAR = 700.0


def confidence_sequence(violated: int, undecided: int, total: int, confidence: float) -> tuple[float, float]:
    r"""Interval of the violation probability that holds for all numbers of runs at once.

    With k violations in N runs, the ratio of a mixture's likelihood to that of p,
    $M_N(p) = \frac{w 1_{k = 0} + (1 - w) B(a + k, b + N - k) / B(a, b)}{p^k (1 - p)^{N - k}}$, is at the true p a
    nonnegative martingale of mean 1, so that it ever reaches $1/\alpha$ with probability at most $\alpha$ (Ville). The
    interval is all p with $M_N(p) < 1/\alpha$. The atom w = 1/2 at p = 0 makes it 3.69/N at 95 % as long as nothing is
    violated. Both ends grow with k, so an undecided run counts as held in the lower and as violated in the upper.

    Args:
        violated: Runs that violated the claim.
        undecided: Runs without a verdict.
        total: All runs, decided or not; with none the interval is (0, 1).
        confidence: Probability that every interval on the way covers, strictly between 0 and 1.

    Returns:
        Lower and upper end.

    Raises:
        InputError: A count is negative, or there are more than `total`, or the confidence is out of range.

    Examples:
        >>> import qsmc_jax as qj
        >>> [round(end, 5) for end in qj.confidence_sequence(violated=0, undecided=0, total=1000, confidence=0.95)]
        [0.0, 0.00366]

    Source: Robbins, Ann. Math. Stat. 41 (1970); Howard, Ramdas, McAuliffe and Sekhon, Ann. Stat. 49 (2021).
    """
    require_fraction("confidence", confidence)
    worst = violated + undecided
    require(
        min(violated, undecided) >= 0 and worst <= total,
        f"Arguments `violated` = {violated} and `undecided` = {undecided} must not be negative, nor together more than "
        f"`total` = {total}.",
    )
    level = -math.log1p(-confidence)
    low = 0.0 if violated == 0 else _end(violated, total, level, -_FAR)
    high = 1.0 if worst == total else _end(worst, total, level, _FAR)
    return low, high


def _end(k: int, n: int, level: float, far: float) -> float:
    """The probability on one side of k/n at which log M reaches the level."""
    from scipy import optimize  # only stopping rules need it: every command would wait for it

    middle = float(np.clip(special.logit(k / n), -_FAR, _FAR))
    return float(special.expit(optimize.brentq(lambda x: _log_mixture_ratio(x, k, n) - level, middle, far, xtol=1e-12)))


def _log_mixture_ratio(x: float, k: int, n: int) -> float:
    """Log M_n at the probability with logit `x`."""
    rest = math.log1p(-_ATOM) + special.betaln(_A + k, _B + n - k) - special.betaln(_A, _B)
    mixture = rest if k else np.logaddexp(math.log(_ATOM), rest)
    return float(mixture - k * special.log_expit(x) - (n - k) * special.log_expit(-x))


def sequential_test(violated: int, total: int, probability: float, alternative: float, risk: float) -> float:
    r"""Wald's statistic of p <= `alternative` against p >= `probability`, in units of what decides.

    $\Lambda = k \ln(p_1/p_0) + (N - k) \ln((1 - p_1)/(1 - p_0))$ with $p_1 < p_0$, divided by
    $\ln((1 - \alpha)/\alpha)$ when both errors have the same risk.

    Args:
        violated: Runs that violated the claim.
        total: All runs.
        probability: p0, that is to be refuted.
        alternative: p1 < p0, where it should be refuted; between the two either answer is right.
        risk: Probability of either error, strictly between 0 and 1/2.

    Returns:
        1 or more: p < p0 is accepted; -1 or less: p > p1 is; between them nothing yet.

    Source: Wald, Ann. Math. Stat. 16 (1945); Younes and Simmons, Inf. Comput. 204 (2006).
    """
    evidence = special.xlogy(violated, alternative / probability)
    evidence += (total - violated) * (math.log1p(-alternative) - math.log1p(-probability))
    return float(evidence / math.log((1.0 - risk) / risk))
