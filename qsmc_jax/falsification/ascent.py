"""One search from one start: steps by the gradient to the faces of the cube, then moves of single coordinates."""

from collections.abc import Generator, Iterator
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from qsmc_jax.falsification.cube import Cube
from qsmc_jax.falsification.evaluation import Answer, Ask

Search: TypeAlias = Generator[Ask, Answer, None]

# A gradient is taken so far off the faces: on one, the clipping of a quantile has no derivative.
_OFF = 1e-6
# How far to go from a point towards the corner that the gradient's signs point to.
_FRACTIONS = (1.0, 0.5, 0.15)
# Gradients of one search at most, before it moves coordinates one by one.
_GRADIENTS = 6
# What a move must gain, relatively, to count.
_GAIN = 1e-9
# Lengths of moves along a coordinate: to both faces, then shorter and shorter.
_FIRST, _LAST, _SHORTER = 0.25, 1e-5, 4.0


def ascend(x: Float[np.ndarray, " dim"], score: float, cube: Cube, has_gradient: bool) -> Search:
    """Makes a run worse, step by step; a generator of questions, sent the answers.

    Every step goes by signs, or by which of some points is worst: it is the same for any increasing function of the
    score, so that a score that flattens at the edge of a funnel leads as well as one that does not.

    Args:
        x: The start.
        score: How bad it is.
        cube: Where it may go.
        has_gradient: Whether the gradient can be trusted.
    """
    if has_gradient and cube.is_smooth.any():
        x, score = yield from _by_gradient(x, score, cube)
    yield from _by_coordinates(x, score, cube)


def _by_gradient(x: np.ndarray, score: float, cube: Cube) -> Generator[Ask, Answer, tuple[np.ndarray, float]]:
    alive = cube.is_smooth
    for _ in range(_GRADIENTS):
        near = np.where(alive, np.clip(x, cube.low + _OFF, cube.high - _OFF), x)
        found = yield Ask(near[None], np.flatnonzero(alive))
        slope = found.gradient
        assert slope is not None
        if not slope.any():
            break
        corner = np.where(slope > 0.0, cube.high, np.where(slope < 0.0, cube.low, x))
        tried = np.stack([x + part * (corner - x) for part in _FRACTIONS[1:]])
        tried = np.concatenate([corner[None], tried, near[None]])
        answer = yield Ask(tried)
        best = int(np.argmax(answer.scores))
        if not _gains(answer.scores[best], score):
            break
        x, score = tried[best], float(answer.scores[best])
    return x, score


def _by_coordinates(x: np.ndarray, score: float, cube: Cube) -> Search:
    length: float | None = None
    while length is None or length > _LAST:
        moves = list(_moves(x, cube, length))
        if not moves:
            return
        tried = np.repeat(x[None], len(moves), axis=0)
        for row, (coordinate, at) in zip(tried, moves, strict=True):
            row[coordinate] = at
        answer = yield Ask(tried)
        together = _together(x, score, moves, answer.scores, cube)
        if len(together):
            more = yield Ask(together)
            tried, scores = np.concatenate([tried, together]), np.concatenate([answer.scores, more.scores])
        else:
            scores = answer.scores
        best = int(np.argmax(scores))
        if _gains(scores[best], score):
            x, score = tried[best], float(scores[best])
        else:
            length = _FIRST if length is None else length / _SHORTER


def _moves(x: np.ndarray, cube: Cube, length: float | None) -> Iterator[tuple[int, float]]:
    """Moves of single coordinates: to other values and both faces, or by a length."""
    for i in np.flatnonzero(cube.is_free):
        if i in cube.options:
            ends = cube.options[int(i)] if length is None else ()
        elif length is None:
            ends = (cube.low[i], cube.high[i])
        else:
            ends = np.clip((x[i] - length, x[i] + length), cube.low[i], cube.high[i])
        yield from ((int(i), float(end)) for end in ends if end != x[i])


def _together(
    x: np.ndarray, score: float, moves: list[tuple[int, float]], scores: np.ndarray, cube: Cube
) -> Float[np.ndarray, "points dim"]:
    """All moves that gain at once; and each coordinate where a parabola through its three points is highest."""
    joined, turned = x.copy(), x.copy()
    for i in {coordinate for coordinate, _ in moves}:
        own = [(at, s) for (coordinate, at), s in zip(moves, scores, strict=True) if coordinate == i]
        at, best = max(own, key=lambda move: move[1])
        if _gains(best, score):
            joined[i] = at
        turned[i] = joined[i]
        if i not in cube.options and len(own) == 2 and np.isfinite([s for _, s in own]).all():
            turned[i] = _vertex(x[i], score, *own) if np.isfinite(score) else turned[i]
    found = [each for each in (joined, turned) if (each != x).sum() > 1 or each is turned]
    return np.stack([cube.inside(each) for each in found]) if found else np.empty((0, len(x)))


def _vertex(middle: float, height: float, one: tuple[float, float], other: tuple[float, float]) -> float:
    """Where the parabola through three points is highest, between the outer ones; the highest of them if nowhere."""
    (a, at_a), (b, at_b) = one, other
    first, second = (at_a - height) / (a - middle), (at_b - height) / (b - middle)
    bend = (second - first) / (b - a)
    if not bend < 0.0:
        return max((height, middle), (at_a, a), (at_b, b))[1]
    return float(np.clip(middle - (first - bend * (a - middle)) / (2.0 * bend), min(a, b), max(a, b)))


def _gains(new: float, old: float) -> bool:
    """Whether a score is worse by more than rounding."""
    return bool(new > old) and not (np.isfinite(old) and new - old <= _GAIN * abs(old))
