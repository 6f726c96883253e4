"""Tubes guessed slab by slab in floating point, many boxes at once: what a checker is then asked about.

Nothing rests on what is computed here. The checker's own bounds of the rates are evaluated by JAX, without regard to
rounding, and each face is given the least slope that outruns what it bounds on the slab that this slope makes.
"""

import functools as ft
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qsmc_jax.base.precision import in_64_bits
from qsmc_jax.proof.arithmetic import Arithmetic, Interval
from qsmc_jax.proof.checker import Tube, start_of
from qsmc_jax.proof.field import Frame, Loop, Slab, applied, face_rates, flow, frame_rates, inside

_POINTS = {"exp": jnp.exp, "log": jnp.log, "sin": jnp.sin, "cos": jnp.cos, "tan": jnp.tan, "atan": jnp.arctan}
# Slopes of a slab are found by this many evaluations, and raised by so many more where they are too small for it.
_ROUNDS, _SURE = 4, 3
# What is added to a slope, and of it, so that rounding and slopes of other faces do not undo it.
_ROOM, _SHARE = 1e-8, 1e-4
# Slabs in which the law acts so many times over are stiff.
_STIFF = 0.5
# In no slab does it act more often; and faces rise so much further than to where they would rest.
_STIFFEST, _AHEAD = 3000.0, 1.25
# By how much more a slope is raised than Newton's step says.
_SURER = 1.5
# Slabs are at most so many times as long as the one before, and at least this part of the longest for what comes.
_LONGER, _LEAST = 2.0, 0.1
# How often as far as it should a face may move in a slab, before that is made shorter.
_TOO_FAR = 2.0
# Slabs and boxes that a program is compiled for; more slabs are several calls, as are those of faces that come to rest.
SLABS, SIZES, _LAST = 256, (16, 128), 8
_SIDES = np.array([-1.0, 1.0])
_AR = Arithmetic(jnp, _POINTS)

# Knots, or how fast they move outward: of z by box and side, and of v by box, coordinate and side.
Faces = tuple[Any, Any]


class Pace(NamedTuple):
    """How long slabs are where they are chosen: by time, and by how far faces move.

    Attributes:
        first: The first slab [s].
        growth: How slabs grow, as a share of the time.
        longest: The longest [s].
        move: How far a face may move in a slab, as a share of its distance from the funnel's edge.
    """

    first: float
    growth: float
    longest: float
    move: float

    def finer(self, share: float) -> "Pace":
        """Slabs that are shorter in time by this share, and in what faces move by its root."""
        return Pace(self.first, share * self.growth, share * self.longest, math.sqrt(share) * self.move)


class Guess:
    """Guesses tubes of a loop."""

    def __init__(self, loop: Loop, frame: Frame):
        self._loop, self._march = loop, jax.jit(ft.partial(_march, loop, frame))

    def along(
        self, start: Faces, boxes: np.ndarray, span: tuple[float, float], pace: Pace, slabs: int
    ) -> tuple[Tube, np.ndarray]:
        """Tubes on knots that are chosen as it goes.

        Args:
            start: Faces at the first knot, of z and v.
            boxes: The boxes, as many as the largest of `SIZES` at most.
            span: First and last time.
            pace: How long slabs are.
            slabs: How many at most, a multiple of `SLABS`; the last ones may be empty.

        Returns:
            The tubes, and bounds of |u| slab by slab, NaN from where a tube leaves the funnel.
        """
        return self._run(start, boxes, (*span, *pace), math.nan, slabs)

    def steady(self, start: Faces, boxes: np.ndarray, since: float, horizon: float, pace: Pace) -> Faces:
        """Where faces come to rest if each slab is taken to hold all times from one on; NaN if they don't.

        Args:
            start: As for `along`.
            boxes: As for `along`.
            since: The time.
            horizon: How long they move [s].
            pace: As for `along`.
        """
        tube, u = self._run(start, boxes, (0.0, horizon, *pace), since, SLABS * _LAST)
        is_whole = np.all(np.isfinite(u)) and tube.times[0, -1] == horizon
        return (tube.z[:, -1], tube.v[:, -1]) if is_whole else (start[0] * math.nan, start[1] * math.nan)

    def _run(self, start: Faces, boxes: np.ndarray, pace: Any, since: float, slabs: int) -> tuple[Tube, np.ndarray]:
        count = len(boxes)
        more = min(size for size in SIZES if size >= count) - count
        errors = [tuple(end[:, 0] for end in each) for each in start_of(Arithmetic(), self._loop, boxes)[1]]
        filled = lambda a: np.concatenate([a, np.repeat(a[-1:], more, 0)])  # noqa: E731
        begin = np.full(count, pace[0])
        carried, boxes, errors = jax.tree.map(filled, ((begin, tuple(start)), boxes, errors))
        knots, bounds = [jax.tree.map(lambda a: np.asarray(a)[None], carried)], []
        carried = (*carried, np.full(len(boxes), np.inf))
        with in_64_bits(), jax.numpy_rank_promotion("allow"):
            for _ in range(0, slabs, SLABS):
                carried, (after, u) = self._march(carried, boxes, errors, pace[1:], since)
                knots.append(jax.tree.map(np.asarray, after))
                bounds.append(np.asarray(u))
                # All are through, or out of the funnel.
                if np.all((knots[-1][0][-1] == pace[1]) | ~np.isfinite(bounds[-1][-1])):
                    break
        times, (z, v) = jax.tree.map(lambda *a: np.moveaxis(np.concatenate(a), 0, 1)[:count], *knots)
        return Tube(times, z, v), np.concatenate(bounds).T[:count]


def _march(loop: Loop, frame: Frame, start: Any, boxes: Any, errors: Any, pace: Any, since: Any) -> Any:
    """The knots of `SLABS` slabs one after the other."""
    errors = [Interval(*each) for each in errors]
    values = {name: Interval(boxes[:, i, 0], boxes[:, i, 1]) for i, name in enumerate(loop.names)}
    until, *pace = pace

    def rates_of(begin: Any, end: Any, knots: Any, slopes: Any, span: Any) -> Any:
        ever = jnp.isfinite(since)
        time = Interval(jnp.where(ever, since, begin), jnp.where(ever, jnp.inf, end))
        return _rates(loop, frame, _slab(frame, time, (knots, _moved(knots, slopes, span)), values, errors))

    def step(carried: Any, _: None) -> Any:
        now, knots, before = carried
        knots = jax.tree.map(lambda a: jnp.where(jnp.isfinite(a), a, jnp.nan), knots)
        still, nothing = jax.tree.map(jnp.zeros_like, knots), jnp.zeros_like(now)
        tangents = jnp.tan(0.5 * math.pi * knots[0]) * _SIDES
        far = pace[3] * (1.0 - jnp.abs(knots[0]))
        longest = jnp.minimum(jnp.minimum(pace[0] + pace[1] * now, pace[2]), _LONGER * before)

        def refine(turn: Any, carried: Any) -> Any:
            slopes, stiff, away, _, span = carried
            # The first looks at the slab and the one after it: where faces would rest; the second how long it may be.
            is_first, is_second = turn == 0, turn == 1
            ahead = jnp.where(is_first, 2.0 * longest, jnp.where(is_second, longest, span))
            rates, strength, u = rates_of(now, now + ahead, knots, slopes, span)
            stiff = jnp.where(is_first, 0.5 * math.pi * (1.0 + tangents**2) * strength, stiff)
            rest = jnp.arctan(tangents + rates[0] / strength) / (0.5 * math.pi)
            away = jnp.where(is_first, rest - knots[0] * _SIDES, away)
            free = _span(rates[0], away, stiff, far, longest)
            # Found too long once the slab is known as it is, for a face that was not far enough ahead.
            shorter = jnp.min(_TOO_FAR * far / jnp.maximum(rates[0], 1e-300), axis=-1)
            shorter = jnp.where(turn <= 1 + _ROUNDS, jnp.minimum(shorter, span), span)
            span = jnp.minimum(jnp.where(is_first, span, jnp.where(is_second, free, shorter)), until - now)
            # Where the law is faster than the slab, a face that rises to meet what comes must be there already.
            rise = jnp.where(away > 0.0, _AHEAD, 1.0) * away / span[:, None]
            is_lifted = (span[:, None] * stiff > _STIFF) | ((away > 0.0) & (_AHEAD * away <= far))
            lift = jnp.where(is_lifted & (span[:, None] > 0.0), rise, -jnp.inf)
            found = _sloped(turn, slopes, jax.tree.map(_with_room, rates), span[:, None] * stiff, lift)
            slopes = jax.tree.map(lambda a, b: jnp.where(turn <= 1, a, b), slopes, found)
            return slopes, stiff, away, u, span

        first = still, still[0], still[0], nothing, nothing
        slopes, _, _, u, span = jax.lax.fori_loop(0, 2 + _ROUNDS + _SURE, refine, first)
        after = jnp.where(span >= until - now, until, now + span), _moved(knots, slopes, span)
        return (*after, jnp.where(span > 0.0, span, jnp.inf)), (after, u)

    return jax.lax.scan(step, start, None, length=SLABS)


def _with_room(rates: Any) -> Any:
    return rates + _ROOM + _SHARE * jnp.abs(rates)


def _sloped(turn: Any, slopes: Faces, rates: Faces, stiffness: Any, lift: Any) -> Faces:
    """Slopes that outrun rates, better in each turn; in the last ones they are only raised.

    A face that goes inward resists less at its end than where it begins: Newton's step finds how far it may go.
    """
    slope, lacks = slopes[0], rates[0] - slopes[0]
    near = slope + jnp.where(lacks > 0.0, _SURER, 1.0) * lacks / (1.0 + stiffness)
    inward = jnp.minimum(near, 0.0)
    face = jnp.where(slope < 0.0, inward, jnp.where(rates[0] >= 0.0, rates[0], near))
    kept = jnp.where(slope < 0.0, jnp.where(lacks > 0.0, inward, slope), jnp.maximum(slope, rates[0]))
    found = jnp.maximum(face, lift), rates[1]
    safe = jnp.maximum(kept, lift), jnp.maximum(slopes[1], rates[1])
    return jax.tree.map(lambda a, b: jnp.where(turn <= 1 + _ROUNDS, a, b), found, safe)


def _span(rates: Any, away: Any, stiff: Any, far: Any, longest: Any) -> Any:
    """How long a slab may be in which no face moves too far: outward as fast as it begins, inward slowed by the law."""
    short = far / jnp.maximum(jnp.where(rates > 0.0, rates, -rates - stiff * far), 1e-300)
    short = jnp.minimum(short, _STIFFEST / stiff)
    # Where a face is at rest, it will rest the further away the longer the slab is.
    ahead = longest[:, None] * jnp.clip(far / jnp.maximum(_AHEAD * away, 1e-300), _LEAST, 1.0)
    return jnp.min(jnp.minimum(short, jnp.where(rates <= 0.0, ahead, longest[:, None])), axis=-1)


def _moved(knots: Faces, slopes: Faces, span: Any) -> Faces:
    """Where faces are after a slab, from how fast they move outward."""
    return jax.tree.map(lambda k, s: k + jnp.reshape(span, (-1, *(1,) * (k.ndim - 1))) * s * _SIDES, knots, slopes)


def _slab(frame: Frame, time: Interval, knots: tuple[Faces, Faces], values: dict[str, Interval], errors: Any) -> Slab:
    """The slab between some knots."""
    low, high = (jax.tree.map(join, *knots) for join in (jnp.minimum, jnp.maximum))
    faces = Interval(low[0][:, 0], high[0][:, 0]), Interval(low[0][:, 1], high[0][:, 1])
    pair = lambda j: tuple(Interval(low[1][:, j, side], high[1][:, j, side]) for side in (0, 1))  # noqa: E731
    phi, misses = flow(_AR, frame, time)
    return Slab(time, faces, [pair(j) for j in range(len(errors))], values, errors, phi, applied(_AR, misses, errors))


def _rates(loop: Loop, frame: Frame, slab: Slab) -> tuple[Faces, Any, Any]:
    """How fast faces must move outward at least, how strong the law is, and the bound of the input."""
    faces = Interval(*(jnp.stack(ends) for ends in zip(*slab.faces, strict=True)))
    z = face_rates(_AR, loop, frame, slab, _SIDES[:, None], faces).T
    found = inside(_AR, loop, frame, slab)
    rates = [jnp.stack([-r.lo, r.hi], -1) for r in frame_rates(_AR, frame, slab, found["sigma"])]
    v = jnp.stack(jnp.broadcast_arrays(*rates), 1) if rates else jnp.zeros((len(z), 0, 2))
    strength = jnp.broadcast_to(found["gain"].hi / found["rho"].lo, z.shape[:1])[:, None]
    return (z, v), strength, jnp.broadcast_to(jnp.maximum(abs(found["u"].lo), abs(found["u"].hi)), z.shape[:1])
