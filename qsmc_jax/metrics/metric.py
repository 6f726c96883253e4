"""Metrics of one's own: a function of the signals at one instant, and what is kept of it over a run.

What is kept is brought up to date step by step inside the solve, by the step's dense output, so that nothing hides
between the points of a grid and gradients reach it.
"""

import abc
import dataclasses
import functools as ft
import math
from collections.abc import Callable
from numbers import Real
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require
from qsmc_jax.base.trees import stop_gradient
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.metrics.record import Record, Worse
from qsmc_jax.metrics.signals import AbstractStep, Signals

# Gauss-Lobatto rule with five nodes on [0, 1], exact for polynomials of degree 7.
_INNER = 0.5 * (1.0 - math.sqrt(3.0 / 7.0))
NODES = (0.0, _INNER, 0.5, 1.0 - _INNER, 1.0)
WEIGHTS = (1.0 / 20.0, 49.0 / 180.0, 16.0 / 45.0, 49.0 / 180.0, 1.0 / 20.0)
# Part of a step in which a peak is looked for once more.
_NEAR = 0.05


@dataclasses.dataclass(frozen=True)
class View:
    """A step as a metric looks at it.

    Attributes:
        step: The step.
        nodes: The signals at `NODES`, each with the nodes as its first axis.
    """

    step: AbstractStep
    nodes: Signals

    @classmethod
    def of(cls, step: AbstractStep) -> "View":
        """The view of a step."""
        return cls(step, jax.vmap(step.at)(jnp.array(NODES)))

    @property
    def length(self) -> RealScalarLike:
        """Its length [s]."""
        return self.step.t1 - self.step.t0


@dataclasses.dataclass(frozen=True)
class AbstractMetric(abc.ABC):
    """One number of a run: a column of its table.

    Runs that were not followed to the end of the window have none, NaN.

    Attributes:
        name: Name of the column.
        unit: Its unit, "-" for a pure number.
        after: Where the window begins [s].
        before: Where it ends [s]; `inf` for the horizon.
        meaning: What it is, in a sentence.
    """

    name: str
    unit: str = dataclasses.field(default="", kw_only=True)
    after: float = dataclasses.field(default=0.0, kw_only=True)
    before: float = dataclasses.field(default=math.inf, kw_only=True)
    meaning: str = dataclasses.field(default="", kw_only=True)

    has_gradient: ClassVar[bool] = True
    may_jump: ClassVar[bool] = False
    worse: ClassVar[Worse | None] = None

    def __post_init__(self):
        window = (self.after, self.before)
        is_window = all(isinstance(end, Real) for end in window) and 0.0 <= self.after < self.before
        require(
            is_window,
            f"Arguments `after` and `before` of `{self.name}` must be a window of times, 0 <= after < before, but are "
            f"{self.after!r} and {self.before!r}.",
        )

    @property
    def record(self) -> Record:
        """What tables, files and pictures say of it."""
        about = {"has_gradient": self.has_gradient, "may_jump": self.may_jump, "worse": self.worse}
        return Record(self.name, self.meaning or f"{type(self).__name__} of the study", self.unit, **about)

    @abc.abstractmethod
    def first(self, step: AbstractStep) -> Any:
        """What is kept before the first step: a pytree of arrays.

        Args:
            step: A step of no length at the start.
        """

    @abc.abstractmethod
    def add(self, state: Any, view: View) -> Any:
        """What is kept after one more step in the window.

        Args:
            state: What was kept before.
            view: The step.
        """

    @abc.abstractmethod
    def read(self, state: Any, step: AbstractStep) -> RealScalarLike:
        """The metric.

        Args:
            state: What was kept in the end.
            step: Any step; with other data it is another one.
        """


@dataclasses.dataclass(frozen=True)
class AbstractOfSignals(AbstractMetric):
    """A metric of a function of the signals at one instant.

    Attributes:
        of: The function, `of(signals)`, written with `jax.numpy`; see `Signals`.
    """

    of: Callable[[Signals], Any]

    def values(self, view: View) -> Float[Array, " nodes"]:
        """The function at the nodes."""
        return jax.vmap(self.value)(view.nodes)

    def value(self, signals: Signals) -> Float[Array, ""]:
        """The function at one instant."""
        return jnp.asarray(self.of(signals), float)

    def value_in(self, step: AbstractStep, theta: RealScalarLike) -> Float[Array, ""]:
        """The function at a place in a step."""
        return self.value(step.at(theta))

    def highest(self, view: View) -> tuple[RealScalarLike, Float[Array, ""]]:
        """Where in a step the function is highest, and how high: the highest node, improved by two parabolas."""
        values, nodes, at = self.values(view), jnp.array(NODES), ft.partial(self.value_in, view.step)
        around = jnp.clip(jnp.argmax(values), 1, len(NODES) - 2) + jnp.arange(-1, 2)
        centre = jnp.clip(_turn(nodes[around], values[around]), _NEAR, 1.0 - _NEAR)
        near = centre + _NEAR * jnp.arange(-1.0, 2.0)
        heights = jax.vmap(at)(near)
        turn = jnp.clip(_turn(near, heights), 0.0, 1.0)
        # A value that is not known counts as the highest: nothing is known of the maximum then.
        places = jnp.concatenate([nodes, near, turn[None]])
        all_values = jnp.concatenate([values, heights, at(turn)[None]])
        best = jnp.argmax(all_values)
        return places[best], all_values[best]


def _turn(places: Float[Array, " 3"], values: Float[Array, " 3"]) -> Float[Array, ""]:
    """Where the parabola through three points turns; the middle one where they lie on a line."""
    (a, b, c), (p, q, r) = places, stop_gradient(values)
    left, right = (b - a) * (q - r), (b - c) * (q - p)
    bend = left - right
    shift = 0.5 * ((b - a) * left - (b - c) * right) / jnp.where(bend == 0.0, jnp.inf, bend)
    return b - jnp.where(jnp.isfinite(shift), shift, 0.0)
