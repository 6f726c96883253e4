r"""Where in a step a function of the signals is highest, and how high it can be.

It is looked at, with its slope, at five nodes. Of the stretches between them in which it turns from rising to falling,
the one whose tangents meet highest is narrowed: in turns where the tangents of its ends meet, which is next to a kink,
and as far beyond that as the function lies below the tangents there, so that the stretch closes in from both sides; at
last where the cubic through its ends turns, which is next to a smooth peak.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.metrics.signals import Signals
from qsmc_jax.metrics.view import NODES, View
from qsmc_jax.numerics import pytrees
from qsmc_jax.numerics.hermite import Cubic
from qsmc_jax.numerics.lockstep import any_lane

# Where a stretch is narrowed in turn: from both sides twice before the cubic is asked.
_WHERE_TANGENTS_MEET, _WHERE_BEYOND, _WHERE_CUBIC_TURNS = range(3)
_TURNS = (*(_WHERE_TANGENTS_MEET, _WHERE_BEYOND) * 2, _WHERE_TANGENTS_MEET, _WHERE_CUBIC_TURNS)
# Part of a stretch by which every place keeps off its ends: one that lies next to a peak would never get closer.
_OFF = 0.02
# How much farther than the tangents say one goes to be on the other side.
_BEYOND = 2.5


class Summit(NamedTuple):
    """The highest point of a function in a step.

    Attributes:
        place: Where, from 0 to 1.
        height: How high it is there.
        bound: What it does not exceed, if it turns once at most between two nodes, and gets no steeper in the last bit
            that its peak was narrowed to.
    """

    place: RealScalarLike
    height: Float[Array, ""]
    bound: Float[Array, ""]


class Points(NamedTuple):
    """A function at some places in a step: with the places, its values and its slopes there."""

    place: Float[Array, "..."]
    value: Float[Array, "..."]
    slope: Float[Array, "..."]


def at_nodes(function: Callable[[Signals], Float[Array, ""]], view: View) -> Points:
    """A function of the signals at the nodes of a step.

    Args:
        function: The function.
        view: The step.
    """
    values, slopes = jax.vmap(lambda *now: jax.jvp(function, *((each,) for each in now)))(view.nodes, view.rates)
    return view.step.once(Points(jnp.array(NODES), values, jnp.nan_to_num(slopes)))


def summit(function: Callable[[Signals], Float[Array, ""]], view: View, above: RealScalarLike) -> Summit:
    """The highest point of a function of the signals in a step; NaN if it is no number at some place looked at.

    It is looked for between the nodes only if it may be of use, in some of the lanes that go in step under `vmap`.

    Args:
        function: The function.
        view: The step.
        above: What it must exceed to be of use: a lower one may come out too low.
    """
    nodes = at_nodes(function, view)
    best, reach = jnp.argmax(nodes.value), jax.lax.stop_gradient(_reach(*_stretches(nodes)))
    found = Summit(nodes.place[best], nodes.value[best], jax.lax.stop_gradient(nodes.value[best]))
    # What is no number is of use.
    is_of_use = any_lane(jax.lax.stop_gradient(~(reach.max() <= above)))
    return jax.lax.cond(is_of_use, lambda: _searched(function, view, nodes, reach), lambda: found)


def _stretches(nodes: Points) -> tuple[Points, Points]:
    """The left and the right ends of the stretches between the nodes."""
    return Points(*(each[:-1] for each in nodes)), Points(*(each[1:] for each in nodes))


def _searched(
    function: Callable[[Signals], Float[Array, ""]], view: View, nodes: Points, reach: Float[Array, " stretches"]
) -> Summit:
    """The highest point, given the nodes, and how high the function may reach in each stretch between them."""

    def at(place: Float[Array, ""], left: Points, right: Points) -> Points:
        off = _OFF * (right.place - left.place)
        place = jax.lax.stop_gradient(jnp.clip(place, left.place + off, right.place - off))
        value, slope = jax.jvp(lambda theta: function(view.step.at(theta)), (place,), (jnp.ones(()),))
        return view.step.once(Points(place, value, jnp.nan_to_num(slope)))

    lefts, rights = _stretches(nodes)
    tops = jax.lax.stop_gradient(_meeting(lefts, rights).value)
    # Of two as high, as neighbours of a node are, the one that has a peak inside.
    chosen = jnp.argmax(jnp.where(tops >= tops.max(), 1.0 + _has_peak(lefts, rights).astype(float), 0.0))
    left, right = Points(*(each[chosen] for each in lefts)), Points(*(each[chosen] for each in rights))

    # In a loop, so that the signals are written into the program once for all places.
    def narrowed(stretch: _Stretch, turn: RealScalarLike) -> tuple[_Stretch, Points]:
        left, right, beyond = stretch
        meeting, falls = _meeting(left, right), left.slope - right.slope
        place = jnp.where(turn == _WHERE_BEYOND, beyond, meeting.place)
        point = at(jnp.where(turn == _WHERE_CUBIC_TURNS, _cubic_turns(left, right), place), left, right)
        lack = _BEYOND * jnp.abs(meeting.value - point.value) / jnp.where(falls == 0.0, jnp.inf, falls)
        beyond = point.place + jnp.where(point.slope > 0.0, lack, -lack)
        return jax.lax.stop_gradient(_Stretch(*_narrowed(left, right, point), beyond)), point

    start = jax.lax.stop_gradient(_Stretch(left, right, left.place))
    (left, right, _), found = jax.lax.scan(narrowed, start, jnp.array(_TURNS))
    places = jnp.concatenate([nodes.place, found.place])
    heights = jnp.concatenate([nodes.value, found.value])
    best, others = jnp.argmax(heights), reach.at[chosen].set(-jnp.inf).max()
    bound = jnp.maximum(jnp.maximum(_reach(left, right), others), heights[best])
    return Summit(places[best], heights[best], jax.lax.stop_gradient(bound))


def _has_peak(left: Points, right: Points) -> Bool[Array, "..."]:
    return (left.slope > 0.0) & (right.slope < 0.0)


def _reach(left: Points, right: Points) -> Float[Array, "..."]:
    """What a function does not exceed between two points, if it turns once at most, and is steepest at the ends."""
    width, ends = right.place - left.place, jnp.maximum(left.value, right.value)
    steepest = jnp.maximum(left.value + left.slope * width, right.value - right.slope * width)
    return jnp.where(_has_peak(left, right), steepest, ends)


def _narrowed(left: Points, right: Points, point: Points) -> tuple[Points, Points]:
    """The part of a stretch in which the function still turns from rising to falling."""
    is_rising = point.slope > 0.0
    return pytrees.where(is_rising, point, left), pytrees.where(is_rising, right, point)


class _Stretch(NamedTuple):
    """A part of a step in which a function peaks, and the place where it may be on the other side of the peak."""

    left: Points
    right: Points
    beyond: Float[Array, ""]


class _Meeting(NamedTuple):
    place: Float[Array, "..."]
    value: Float[Array, "..."]


def _meeting(left: Points, right: Points) -> _Meeting:
    """Where the tangents meet, and how high: at least as high as the ends, and there if the function does not peak."""
    place = _tangents_meet(left, right)
    height, ends = left.value + left.slope * (place - left.place), jnp.maximum(left.value, right.value)
    return _Meeting(place, jnp.where(_has_peak(left, right), jnp.maximum(height, ends), ends))


def _tangents_meet(left: Points, right: Points) -> Float[Array, "..."]:
    falls = left.slope - right.slope
    lack = right.value - left.value - right.slope * (right.place - left.place)
    return jnp.clip(left.place + lack / jnp.where(falls == 0.0, jnp.inf, falls), left.place, right.place)


def _cubic_turns(left: Points, right: Points) -> Float[Array, "..."]:
    length = right.place - left.place
    low, high = Cubic(left.value, right.value, length * left.slope, length * right.slope).turning_points()
    return left.place + length * jnp.where(low > 0.0, low, high)
