r"""How probable a violation is at most if the draws have another distribution than the study says.

With P the study's distribution, P(violated) <= p, and Q the true one, each bound is the largest Q(violated) over all Q
within a distance of P: it is sharp, whatever the runs look like.
"""

import math
from typing import NamedTuple

from scipy import special

from qsmc_jax.base.checks import require


class Shift(NamedTuple):
    """How far the distribution of the draws may be off, by three measures.

    Attributes:
        divergence: Kullback-Leibler divergence KL(Q | P) [nat].
        variation: Total variation, the largest difference of any probability.
        ratio: Density ratio, the most times as probable that anything may be.

    Examples:
        >>> import qsmc_jax as qj
        >>> qj.Shift(divergence=0.01, variation=0.05, ratio=2.0).ratio
        2.0
    """

    divergence: float
    variation: float
    ratio: float


def under_divergence(probability: float, divergence: float) -> float:
    r"""The largest probability over all distributions within a Kullback-Leibler divergence.

    It is the q >= p at which $q \ln(q/p) + (1-q) \ln((1-q)/(1-p))$ is the divergence, or 1 if it stays below.

    Args:
        probability: p, in [0, 1].
        divergence: KL(Q | P) at most [nat], at least 0.

    Source: the data processing inequality: no event tells two distributions apart better than they differ; equality by
        a Q that weighs the event and its complement by a constant each.
    """
    _require_probability(probability)
    require(bool(divergence >= 0.0), f"Argument `divergence` must not be negative, but is {divergence!r}.")
    if probability in (0.0, 1.0) or divergence == 0.0:
        return float(probability)
    if -math.log(probability) <= divergence:
        return 1.0
    low, high = probability, 1.0
    while True:  # the upper end of the bracket is returned, to the last bit
        middle = 0.5 * (low + high)
        if not low < middle < high:
            return high
        low, high = (middle, high) if binary_divergence(middle, probability) <= divergence else (low, middle)


def under_variation(probability: float, variation: float) -> float:
    """The largest probability over all distributions within a total variation: p + it, at most 1.

    Args:
        probability: p, in [0, 1].
        variation: Total variation at most, at least 0.
    """
    _require_probability(probability)
    require(bool(variation >= 0.0), f"Argument `variation` must not be negative, but is {variation!r}.")
    return min(1.0, probability + variation)


def under_ratio(probability: float, ratio: float) -> float:
    """The largest probability over all distributions within a density ratio: it times p, at most 1.

    Args:
        probability: p, in [0, 1].
        ratio: How many times as probable anything may be, at least 1.
    """
    _require_probability(probability)
    require(bool(ratio >= 1.0), f"Argument `ratio` must be at least 1, but is {ratio!r}.")
    return min(1.0, ratio * probability)


def survived(probability: float, below: float) -> Shift:
    """The largest shifts under which a probability is at most `below`; those of a probability above it are NaN.

    Args:
        probability: p, in [0, 1].
        below: What it must not exceed, strictly between 0 and 1.
    """
    _require_probability(probability)
    require(0.0 < below < 1.0, f"Argument `below` must lie strictly between 0 and 1, but is {below!r}.")
    if probability > below:
        return Shift(math.nan, math.nan, math.nan)
    ratio = below / probability if probability else math.inf
    return Shift(binary_divergence(below, probability), below - probability, ratio)


def binary_divergence(q: float, p: float) -> float:
    """Kullback-Leibler divergence [nat] of two coins, of which the first has probability q and the other p."""
    return float(special.rel_entr(q, p) + special.rel_entr(1.0 - q, 1.0 - p))


def _require_probability(probability: float) -> None:
    is_one = bool(0.0 <= probability <= 1.0)
    require(is_one, f"Argument `probability` must lie in [0, 1], but is {probability!r}.")
