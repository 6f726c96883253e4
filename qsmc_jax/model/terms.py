"""What moves a plant, and its sliding variable, at one instant."""

from typing import Any, NamedTuple

from qsmc_jax.base.types import RealScalarLike, Scalars


class Balance(NamedTuple):
    r"""What drives the sliding variable, $\dot\sigma = w + g u$, paper eq. (9).

    Attributes:
        residual: $w = f - x_{des}^{(n)} + d + \sum_j c_j e^{(j)}$.
        gain: $g$.
        disturbance: $d$; in a channel of several inputs those of all.
    """

    residual: RealScalarLike
    gain: RealScalarLike
    disturbance: Any


class Terms(NamedTuple):
    """What moves the plant at one instant, apart from the input.

    Attributes:
        drift: f.
        gain: g, with the fault on it if there is one.
        disturbance: d.
        unmatched: What is added to the rates of the first n - 1 states.
    """

    drift: RealScalarLike
    gain: RealScalarLike
    disturbance: RealScalarLike
    unmatched: Scalars


class OwnTerms(NamedTuple):
    """The same of a plant in its own coordinates.

    Attributes:
        free: Rates of the states without input.
        reach: What an input of 1 adds to them.
        gain: The gain of the sliding variable's derivative.
        disturbance: d; in a channel of several inputs those of all.
    """

    free: Scalars
    reach: Scalars
    gain: RealScalarLike
    disturbance: Any
