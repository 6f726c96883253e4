"""How far a function of time can go between the instants at which it was looked at."""

import dataclasses
import functools as ft
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.enclosures.each import enclose_each
from qsmc_jax.enclosures.enclosure import CannotEncloseError, Enclosure
from qsmc_jax.enclosures.intervals import Interval, interval, is_point

# Instants at which a function is looked at that cannot be enclosed.
_PROBES = 33
# Over a time so short, relative to itself, what has no bound, such as x / |x|, is believed to be what the nodes show.
_FINEST = 2.0**-40
# What is raised where a function has no forward derivative, or one that can't be enclosed.
_NO_SLOPE = TypeError, NotImplementedError, CannotEncloseError


@dataclasses.dataclass(frozen=True)
class Nodes:
    r"""Where in a step a method looks at its right-hand side.

    Attributes:
        places: As fractions of the step, in order, with 0 and 1.
        few: Some of these, with 0 and 1, few enough to look there once more.
    """

    places: tuple[float, ...]
    few: tuple[float, ...]

    @ft.cached_property
    def remainder(self) -> float:
        r"""$\max_\theta \prod_i |\theta - \theta_i| / m!$: what the polynomial through m nodes can miss.

        Times the m-th derivative and the m-th power of the step it bounds the error of that polynomial.
        """
        theta = np.linspace(0.0, 1.0, 2001)[:, None]
        return float(np.max(np.prod(np.abs(theta - np.asarray(self.places)), axis=1))) / math.factorial(self.order)

    @property
    def order(self) -> int:
        """The number m of nodes."""
        return len(self.places)

    @ft.cached_property
    def gap(self) -> float:
        """The widest gap between nodes, as a fraction of the step."""
        return max(b - a for a, b in zip(self.places, self.places[1:], strict=False))


@dataclasses.dataclass(frozen=True)
class Step:
    """A step, and where in it a method looks.

    Attributes:
        t0: Its start [s].
        t1: Its end [s].
        nodes: Where in it the method looks.
    """

    t0: RealScalarLike
    t1: RealScalarLike
    nodes: Nodes

    @property
    def length(self) -> RealScalarLike:
        """Its length [s]."""
        return self.t1 - self.t0

    def beyond_polynomial(self, derivative: Callable[[int], RealScalarLike]) -> RealScalarLike:
        """What a smooth function can do that the polynomial through the nodes does not show.

        Args:
            derivative: `derivative(m)` bounds the m-th derivative.
        """
        m = self.nodes.order
        return self.nodes.remainder * derivative(m) * self.length**m

    def beyond_chords(self, curvature: RealScalarLike) -> RealScalarLike:
        """What a function can rise above its values at the nodes, given a bound of its second derivative."""
        return 0.125 * curvature * (self.nodes.gap * self.length) ** 2


@dataclasses.dataclass(frozen=True)
class Unseen:
    """What may hide between the instants at which a function was looked at.

    Attributes:
        amount: By how much it may pass the highest or the lowest value seen; a plain 0.0 for what is constant.
        low: The least value that it may take; NaN where nobody asks for it.
        high: The highest value that it may take, in the same units.
        probed: Primitives without a rule, for which it is not enclosed for certain.
    """

    amount: RealScalarLike
    low: RealScalarLike
    high: RealScalarLike
    probed: tuple[str, ...] = ()


def unseen(fn: Callable[[RealScalarLike], Any], step: Step) -> Unseen:
    """By how much a function of time may pass, within a step, what it takes at the nodes.

    Args:
        fn: The function, traceable, of a time [s].
        step: The step.
    """
    return unseen_each(lambda t: (fn(t),), step)[0]


def unseen_each(
    fn: Callable[[RealScalarLike], Sequence[Any]], step: Step, once: Callable[[Any], Any] | None = None
) -> list[Unseen]:
    """The same of several numbers, which share what they have in common.

    The lesser of two bounds holds: its enclosure over the whole step; and, unless it may jump, what its steepest rise
    and fall there allow in the widest gap.

    Args:
        fn: The function, traceable, of a time [s]: so many numbers.
        step: The step.
        once: As for `enclose_each`.
    """
    stretch = Interval(jnp.asarray(step.t0, float), jnp.asarray(step.t1, float))
    scalars = lambda t: tuple(jnp.asarray(each, float) for each in fn(t))  # noqa: E731
    try:
        wholes = enclose_each(scalars, stretch, once=once)
    except CannotEncloseError as unknown:
        count = len(jax.eval_shape(scalars, stretch.lo))
        if count > 1:
            return [unseen(lambda t, i=i: fn(t)[i], step) for i in range(count)]
        wholes = (_probed(scalars, stretch, unknown.args),)
    if all(is_point(whole.values[0]) for whole in wholes):
        return [Unseen(0.0, whole.values[0], whole.values[0]) for whole in wholes]
    times = [stretch.lo, *(step.t0 + place * step.length for place in step.nodes.few[1:-1]), stretch.hi]
    seen, slopes = [_kept(once, scalars(time)) for time in times], _slopes(scalars, stretch, wholes, once)
    is_fine, gap = step.length <= _FINEST * jnp.abs(stretch.hi), _widest(times)
    found = []
    for i, whole in enumerate(wholes):
        if is_point(whole.values[0]):
            found.append(Unseen(0.0, whole.values[0], whole.values[0]))
            continue
        low, high = (ft.reduce(least, [values[i] for values in seen]) for least in (jnp.minimum, jnp.maximum))
        amount = _beyond(interval(whole.values[0]), low, high)
        if not whole.unknown:
            amount = jnp.minimum(amount, _climb(slopes[i], gap, whole))
        amount = _kept(once, jnp.where(is_fine & jnp.isinf(amount), 0.0, amount))
        found.append(Unseen(amount, low - amount, high + amount, whole.unknown))
    return found


def _kept(once: Callable[[Any], Any] | None, values: Any) -> Any:
    """Values that are used more than once."""
    return values if once is None else once(values)


def _probed(fn: Callable[[Array], Sequence[Array]], stretch: Interval, unknown: tuple[str, ...]) -> Enclosure:
    """The range of a function at evenly spaced instants, where there can be no enclosure."""
    places = stretch.lo + np.linspace(0.0, 1.0, _PROBES) * (stretch.hi - stretch.lo)
    probes = jax.vmap(lambda t: fn(t)[0])(places)
    return Enclosure((Interval(jnp.min(probes), jnp.max(probes)),), jnp.ones((), bool), unknown)


def _slopes(
    fn: Callable[[Array], Sequence[Array]],
    stretch: Interval,
    wholes: Sequence[Enclosure],
    once: Callable[[Any], Any] | None,
) -> Sequence[Enclosure | None]:
    """Enclosures of the derivatives; None where there is none."""
    is_wanted = [not (whole.unknown or is_point(whole.values[0])) for whole in wholes]

    def each(i: int) -> Enclosure | None:
        try:
            slope = lambda t: jax.jvp(lambda t: fn(t)[i], (t,), (jnp.ones_like(t),))[1]  # noqa: E731
            return enclose_each(lambda t: (slope(t),), stretch)[0]
        except _NO_SLOPE:
            return None

    if not any(is_wanted):
        return [None] * len(wholes)
    try:
        return enclose_each(lambda t: jax.jvp(fn, (t,), (jnp.ones_like(t),))[1], stretch, once=once)
    except _NO_SLOPE:
        return [each(i) if is_wanted[i] else None for i in range(len(wholes))]


def _beyond(range_: Interval, low: Array, high: Array) -> Float[Array, ""]:
    """By how much a range passes what was seen; a range that is not known passes it without bound."""
    beyond = jnp.maximum(jnp.maximum(range_.hi - high, low - range_.lo), 0.0)
    return jnp.where(jnp.isnan(beyond), jnp.inf, beyond)


def _widest(times: Sequence[RealScalarLike]) -> RealScalarLike:
    return ft.reduce(jnp.maximum, [b - a for a, b in zip(times, times[1:], strict=False)])


def _climb(slope: Enclosure | None, gap: RealScalarLike, whole: Enclosure) -> Float[Array, ""]:
    """How far up or down a path can lead that comes back at the end of the widest gap."""
    if slope is None or slope.unknown:
        return jnp.full((), jnp.inf)
    steepest = interval(slope.values[0])
    rise, fall = jnp.maximum(steepest.hi, 0.0), jnp.maximum(-steepest.lo, 0.0)
    less, more = jnp.minimum(rise, fall), jnp.maximum(rise, fall)
    share = 1.0 / (1.0 + less / jnp.where(more > 0.0, more, 1.0))
    height = jnp.where(less > 0.0, less * share * gap, 0.0)
    return jnp.where(whole.jumps | jnp.isnan(height), jnp.inf, height)
