"""Quantile functions that JAX lacks, as piecewise polynomials that are as exact as the function that they stand for."""

import dataclasses
import functools as ft
import math
import pickle
import warnings
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import scipy.special
from jaxtyping import Float
from numpy.polynomial import chebyshev

from qsmc_jax.base.checks import is_traced, require

Quantile: TypeAlias = Callable[[np.ndarray], np.ndarray]

# The smallest probability, and that of the complement: no design has a coordinate nearer to the ends of the cube.
LEAST = 2.0**-53
# How exact: in the value, or else in the odds u / (1 - u), relative; or else in the probability, absolute. In the upper
# tail, where a coordinate itself has no more digits than the first; in both, where SciPy's own function has not.
_RELATIVE = 1e-13
_EXACT, _ROUGH = (0.0, 2.0**-52), (1e-14, 1e-14)
# Probabilities in either tail at which SciPy's functions are held against each other, and by how much they may differ.
_COMPARED = np.append(np.logspace(-15, -1, 29), [0.2, 0.3, 0.4, 0.5])
_AGREEMENT, _ROUNDING = 1e-8, 1e-15
_DEGREE, _FIRST, _MOST, _HALVINGS = 15, 16, 1024, 60

_NODES = np.cos(np.pi * (np.arange(_DEGREE + 1) + 0.5) / (_DEGREE + 1))
_FIT = np.linalg.inv(chebyshev.chebvander(_NODES, _DEGREE)).T
# Where a piece is compared: its ends and the extrema of a polynomial of twice the degree.
_PROBES = np.cos(np.pi * np.arange(2 * _DEGREE + 3) / (2 * _DEGREE + 2))
_VALUES = chebyshev.chebvander(_PROBES, _DEGREE).T
_SLOPES = chebyshev.chebval(_PROBES, chebyshev.chebder(np.eye(_DEGREE + 1)))


@dataclasses.dataclass(frozen=True, eq=False)
class Tabulated:
    """A quantile function over the log-odds w = log(u / (1 - u)), a polynomial a piece.

    Attributes:
        edges: Ends of the pieces, ascending.
        coefficients: Of Chebyshev polynomials on each piece.
    """

    edges: Float[np.ndarray, " edges"]
    coefficients: Float[np.ndarray, "pieces terms"]


def tabulate(lower: Quantile, upper: Quantile, rooms: tuple[float, float] = _EXACT) -> Tabulated | None:
    """The table of a distribution, each piece halved until it is exact.

    The relative error is at most 1e-13 in the value or in the odds u / (1 - u), or the probability is missed by no more
    than is left.

    Args:
        lower: Value of a probability that it is not exceeded.
        upper: Value of a probability that it is exceeded.
        rooms: By how much the probability may be missed in the lower and in the upper half.

    Returns:
        The table; None if the function is too rough. A jump becomes a ramp as narrow as the probability is exact.
    """
    end = math.log1p(-LEAST) - math.log(LEAST)
    ends = np.linspace(-end, end, _FIRST + 1)
    pending, done = np.stack([ends[:-1], ends[1:]], axis=1), []
    for _ in range(_HALVINGS):
        low, high = pending.T
        middle, half = (low + high)[:, None] / 2, (high - low)[:, None] / 2
        fitted = _at(lower, upper, middle + half * _NODES) @ _FIT
        w = middle + half * _PROBES
        exact, slope = _at(lower, upper, w), abs(fitted @ _SLOPES) / half
        absolute = np.where(w < 0, *rooms) / scipy.special.expit(-abs(w))
        allowed = np.maximum(_RELATIVE * abs(exact), np.maximum(_RELATIVE, absolute) * slope)
        is_exact = (abs(fitted @ _VALUES - exact) <= allowed).all(axis=1)
        done += [(low[i], high[i], fitted[i]) for i in np.flatnonzero(is_exact)]
        pending = np.concatenate(
            [np.stack([low, middle[:, 0]], 1)[~is_exact], np.stack([middle[:, 0], high], 1)[~is_exact]]
        )
        if not len(pending):
            lows, highs, coefficients = zip(*sorted(done, key=lambda piece: piece[0]), strict=True)
            return Tabulated(np.array([*lows, highs[-1]]), np.array(coefficients))
        if len(done) + len(pending) > _MOST:
            return None
    return None


def _at(lower: Quantile, upper: Quantile, w: np.ndarray) -> np.ndarray:
    """The values at log-odds, each from the tail in which its probability keeps its digits."""
    tail = scipy.special.expit(-abs(w))
    values, is_lower = np.empty_like(w), w < 0
    values[is_lower], values[~is_lower] = lower(tail[is_lower]), upper(tail[~is_lower])
    return values


@ft.lru_cache(maxsize=64)
def gamma(k: float) -> Tabulated | None:
    """Of the gamma distribution with unit scale."""
    return tabulate(ft.partial(scipy.special.gammaincinv, k), ft.partial(scipy.special.gammainccinv, k))


@ft.lru_cache(maxsize=64)
def beta(a: float, b: float) -> Tabulated | None:
    """Of the beta distribution on [0, 1]."""
    return tabulate(ft.partial(scipy.special.betaincinv, a, b), ft.partial(scipy.special.betainccinv, a, b))


def frozen(name: str, distribution: Any) -> tuple[Tabulated, tuple[float, float]]:
    """Of a frozen continuous distribution of SciPy, and its support.

    Raises:
        InputError: It is none, or its arguments are out of range or depend on draws, or it has no such table.
    """
    kind = type(distribution).__name__
    is_frozen = all(hasattr(distribution, each) for each in ("ppf", "isf", "pdf", "support", "dist"))
    require(
        is_frozen,
        f"Argument `frozen` of `{name}` must be a frozen continuous distribution, but is of class `{kind}`. Write "
        "`scipy.stats.gumbel_r(loc, scale)`, with its arguments.",
    )
    require(
        not is_traced(distribution.args, distribution.kwds),
        f"Argument `frozen` of `{name}` must have fixed arguments, but they depend on other names of the scenario.",
    )
    try:
        pickled = pickle.dumps(distribution)
    except (pickle.PicklingError, AttributeError, TypeError):  # of a class that is defined within a function, say
        table, fault = _examined(distribution)
    else:
        table, fault = _unpickled(type(distribution.dist), pickled)
    require(
        table is not None,
        f"Argument `frozen` of `{name}` must have quantiles that SciPy works out to 1e-14, but those of "
        f"`{type(distribution.dist).__name__}` {fault}. Use another distribution, or `draw.empirical` of its values.",
    )
    assert table is not None
    low, high = distribution.support()
    return table, (float(low), float(high))


@ft.lru_cache(maxsize=64)
def _unpickled(kind: type, pickled: bytes) -> tuple[Tabulated | None, str]:
    """By its class too: one that is defined again has the same name."""
    return _examined(pickle.loads(pickled))


def _examined(distribution: Any) -> tuple[Tabulated | None, str]:
    """The table of a distribution of SciPy, as exact as SciPy is; or else None and what is wrong."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):  # SciPy warns of values that underflow, say
        warnings.simplefilter("ignore")
        if not np.isfinite(distribution.ppf([0.25, 0.5, 0.75])).all():
            return None, "are not finite: are its arguments in range?"
        for probability, quantile in ((distribution.cdf, distribution.ppf), (distribution.sf, distribution.isf)):
            x = quantile(_COMPARED)
            # By what the last digits of a value make of its probability.
            rounding = np.nan_to_num(_ROUNDING * abs(x) * distribution.pdf(x), nan=0.0, posinf=np.inf)
            is_near = abs(probability(x) - _COMPARED) <= _AGREEMENT * _COMPARED + 10 * max(_ROUGH) + rounding
            if not is_near.all():  # of `beta(0.5, 3)` far out
                return None, f"are not the inverse of its probabilities, at {_COMPARED[is_near.argmin()]:.3g}"
        for rooms in (_EXACT, _ROUGH):
            table = tabulate(distribution.ppf, distribution.isf, rooms)
            if table is not None:
                return table, ""
    return None, "are rough"
