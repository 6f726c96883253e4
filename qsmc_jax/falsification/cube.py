"""Where a search may go: the unit cube of a study within the supports of its draws."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float

from qsmc_jax.base.checks import require
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.precision import entry_point
from qsmc_jax.falsification.adversary import bound_of, without_disturbance
from qsmc_jax.study.draw import Draw
from qsmc_jax.study.specs import DrawSpec
from qsmc_jax.study.study import Scenario, Study

# The ends of the cube, as near to 0 and 1 as a design may have them.
LEAST = 2.0**-53
# Distributions that have no end on a side where their bounds say so: others have ends that depend on other numbers.
_ENDLESS = ("normal", "lognormal", "exponential", "weibull", "gamma", "from_scipy", "multivariate_normal")
# How many rows of data are tried where a name is drawn from them.
_ROWS = 32
# How often a coordinate is moved to see whether anything but the disturbance depends on it.
_TRIES = 2


@dataclasses.dataclass(frozen=True)
class Cube:
    """The part of the unit cube that is searched.

    Attributes:
        low: Lower end of each coordinate.
        high: Upper end.
        centre: Where coordinates stay that are not searched; 0.5 for others.
        is_free: Which coordinates are searched.
        options: Coordinates of all values of those that have but a few.
        replaced: Names of which nothing but the disturbance that an adversary replaced depends.
        cut: Names whose distributions have no end on some side, and are cut off there.
        outside: Probability of what was cut off, all names together.
    """

    low: Float[np.ndarray, " dim"]
    high: Float[np.ndarray, " dim"]
    centre: Float[np.ndarray, " dim"]
    is_free: Bool[np.ndarray, " dim"]
    options: Mapping[int, Float[np.ndarray, " options"]]
    replaced: tuple[str, ...]
    cut: tuple[str, ...]
    outside: float

    @property
    def is_smooth(self) -> Bool[np.ndarray, " dim"]:
        """Coordinates that are searched and move by any distance."""
        smooth = self.is_free.copy()
        smooth[list(self.options)] = False
        return smooth

    def inside(self, points: Float[np.ndarray, "*runs dim"]) -> Float[np.ndarray, "*runs dim"]:
        """The nearest points that are searched."""
        return np.where(self.is_free, np.clip(points, self.low, self.high), self.centre)


def cube_of(study: Study, plain: Study | None, tail: float) -> Cube:
    """The cube of a study.

    Args:
        study: The study.
        plain: The same with its own disturbance, which has the first of its coordinates, if an adversary replaced that.
        tail: Probability that is cut off at each end where a distribution has none.
    """
    dim = study.dimension
    low, high = np.full(dim, LEAST), np.full(dim, 1.0 - LEAST)
    centre, is_free, options, replaced = np.full(dim, 0.5), np.ones(dim, bool), {}, []
    cut: dict[str, int] = {}
    drawn = [spec for spec in study.specs if spec.is_drawn]
    for spec in drawn:
        options.update(_options(study, spec))
    for spec in (spec for spec in drawn if spec.name in study.values):
        is_free[_own(spec)] = False
    if plain is not None:
        for coordinate, at in _of_the_disturbance(plain, is_free[: plain.dimension], options).items():
            is_free[coordinate], centre[coordinate] = False, at
    for spec in drawn:
        own = _own(spec)
        if not is_free[own].any():
            replaced += [spec.name] if spec.name not in study.values else []
            continue
        is_open = [spec.kind in _ENDLESS and bool(np.isinf(bound)) for bound in spec.bounds]
        low[own] = tail if is_open[0] else LEAST
        high[own] = 1.0 - tail if is_open[1] else 1.0 - LEAST
        if any(is_open):
            cut[spec.name] = spec.size * sum(is_open)
    options = {i: each for i, each in options.items() if is_free[i]}
    outside = float(-np.expm1(sum(cut.values()) * np.log1p(-tail)))
    return Cube(low, high, centre, is_free, options, tuple(replaced), tuple(cut), outside)


def _own(spec: DrawSpec) -> slice:
    """The coordinates of a name."""
    return slice(spec.start, spec.start + spec.size)


def _options(study: Study, spec: DrawSpec) -> dict[int, np.ndarray]:
    """The coordinates of all values of a name that has but a few; of rows of data some."""
    coordinates = range(spec.start, spec.start + spec.size)
    if spec.kind == "empirical":
        return dict.fromkeys(coordinates, (np.arange(_ROWS) + 0.5) / _ROWS)
    solved = [_coordinates_of(study, spec, level) for level in spec.levels]
    places = [each for each in solved if each is not None]
    return {i: np.unique([each[i] for each in places]) for i in coordinates if places}


def _coordinates_of(study: Study, spec: DrawSpec, level: float) -> list[float] | None:
    """Where in the cube a name has a value; None where it never does."""
    others = {each.name: each.nominal for each in study.specs if each.is_drawn and each.name not in study.values}
    draw = Draw(None, study.values, {**others, spec.name: np.full(spec.shape, level)})
    try:
        _call(study, draw)
    except InputError:
        return None
    return draw.solved


def _of_the_disturbance(
    study: Study, is_free: Bool[np.ndarray, " dim"], options: Mapping[int, np.ndarray]
) -> dict[int, float]:
    """Coordinates on which nothing but the disturbance depends, each where the bound is largest.

    Found by moving each: one that looks as if it did not matter costs the search a coordinate, and no more.
    """
    rng, found = np.random.default_rng(0), {}
    bases = rng.uniform(0.05, 0.95, (_TRIES, study.dimension))
    before = [without_disturbance(_at(study, base)) for base in bases]
    for i in np.flatnonzero(is_free):
        # A value of small weight is met by its own coordinate alone, and what a threshold does next to an end.
        places = options.get(int(i), np.array([LEAST, 1.0 - LEAST, *rng.uniform(0.0, 1.0, _TRIES)]))
        moved = [np.where(np.arange(study.dimension) == i, at, base) for base in bases for at in places]
        old = (each for each in before for _ in places)
        if all(_same(one, without_disturbance(_at(study, new))) for one, new in zip(old, moved, strict=True)):
            found[int(i)] = 0.5
    point = np.full(study.dimension, 0.5)
    for i in found:
        tried = [LEAST, 0.5, 1.0 - LEAST]
        bounds = []
        for at in tried:
            point[i] = at
            bounds.append(bound_of(_at(study, point)))
        best = int(np.argmax(bounds))
        point[i] = found[i] = tried[1] if bounds[1] == bounds[best] else tried[best]
    widest = bound_of(_at(study, point))
    require(
        widest > 0.0,
        "Argument `adversary` must take the place of a disturbance, but the study's has the bound 0: leave it out.",
    )
    return found


def _at(study: Study, point: np.ndarray) -> Scenario:
    return _call(study, Draw(point, study.values))


@entry_point
def _call(study: Study, draw: Draw) -> Scenario:
    return study.scenario(draw)


def _same(one: Any, other: Any) -> bool:
    """Whether two scenarios hold the same numbers in the same places."""
    (first, shape), (second, other_shape) = jax.tree.flatten(one), jax.tree.flatten(other)
    is_like = str(shape) == str(other_shape) and len(first) == len(second)
    return is_like and all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))
