"""The signals of a loop at one instant, as functions of metrics see them, and one step of a solve, as metrics do."""

import abc
from collections.abc import Sequence
from typing import Any, NamedTuple

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import RealScalarLike, Scalars


class Signals(NamedTuple):
    r"""A loop at one instant: scalars, and tuples of n scalars.

    With several inputs `sigma`, `rho`, `ratio`, `u`, `d` and `w` are tuples of a scalar for each channel, `desired` and
    `e` of a tuple for each, and `g` is the rows of the decoupling matrix.

    Attributes:
        t: Time [s].
        x: State: n scalars, or as many as a plant in its own coordinates has.
        desired: Desired output and its first n - 1 derivatives.
        e: Errors e^(0) ... e^(n-1).
        sigma: Sliding variable.
        rho: Half-width of the funnel.
        ratio: sigma/rho [-].
        u: Input of the plant.
        d: Disturbance, matched in a chain.
        w: What drives the sliding variable apart from the input, in $\dot\sigma = w + g u$.
        g: Gain, by which the input drives the sliding variable.

    Examples:
        >>> import qsmc_jax as qj
        >>> qj.metrics.Signals._fields
        ('t', 'x', 'desired', 'e', 'sigma', 'rho', 'ratio', 'u', 'd', 'w', 'g')
    """

    t: RealScalarLike
    x: Scalars
    desired: Any
    e: Any
    sigma: Any
    rho: Any
    ratio: Any
    u: Any
    d: Any
    w: Any
    g: Any


def joint_signals(channels: Sequence[Signals]) -> Signals:
    """The signals of several channels as one, each with a number for each channel.

    Args:
        channels: Those of each, at the same time and state; `g` is a row of the decoupling matrix.
    """
    first = channels[0]
    each = {name: tuple(getattr(channel, name) for channel in channels) for name in Signals._fields[2:]}
    return Signals(first.t, first.x, **each)


class AbstractStep(AbstractModule):
    """One step of a solve, on which nothing jumps, and all signals in it.

    Attributes:
        data: Arrays that it is made of; the same step with other ones is another step.
    """

    data: Any

    @property
    @abc.abstractmethod
    def t0(self) -> RealScalarLike:
        """When it begins [s]."""

    @property
    @abc.abstractmethod
    def t1(self) -> RealScalarLike:
        """When it ends [s]."""

    @abc.abstractmethod
    def once(self, tree: Any) -> Any:
        """The same numbers, which the compiler works out once however many use them; see `Barrier`."""

    @abc.abstractmethod
    def at(self, theta: RealScalarLike) -> Signals:
        """The signals in it, by its dense output.

        Args:
            theta: Where, 0 at its beginning and 1 at its end.
        """
