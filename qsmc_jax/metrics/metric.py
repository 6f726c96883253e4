"""Metrics of one's own: a function of the signals at one instant, and what is kept of it over a run.

What is kept is brought up to date step by step inside the solve, by the step's dense output, so that nothing hides
between the points of a grid and gradients reach it.
"""

import abc
import dataclasses
import math
from collections.abc import Callable
from numbers import Real
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from qsmc_jax.base.checks import is_hashable, require
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.metrics.record import Record, Worse
from qsmc_jax.metrics.signals import AbstractStep, Signals
from qsmc_jax.metrics.summit import Summit, summit
from qsmc_jax.metrics.view import View
from qsmc_jax.numerics import pytrees


class Extent(NamedTuple):
    """How far a run was followed, and how closely.

    Attributes:
        time: When it ended [s].
        horizon: When it should have [s].
        is_complete: Whether it was solved up to there.
        is_admitted: Whether the premises held, so that it was begun.
        resolution: By what part of their size signals may be wrong.
    """

    time: RealScalarLike
    horizon: RealScalarLike
    is_complete: Bool[Array, ""]
    is_admitted: Bool[Array, ""]
    resolution: RealScalarLike


@dataclasses.dataclass(frozen=True)
class AbstractMeasure(abc.ABC):
    """What a study wants to know of each run: one or more columns of its tables.

    Attributes:
        name: Its name, unlike any other in the study.
    """

    name: str

    @property
    @abc.abstractmethod
    def records(self) -> tuple[Record, ...]:
        """What tables, files and pictures say of its columns."""

    @property
    @abc.abstractmethod
    def parts(self) -> "tuple[AbstractKept, ...]":
        """What has to be kept of a run for it."""

    @property
    @abc.abstractmethod
    def form(self) -> str:
        """What it makes of its parts, in a text that no other measure of these parts has."""

    @abc.abstractmethod
    def report(self, kept: tuple[Any, ...], step: AbstractStep, extent: Extent) -> dict[str, Array]:
        """Its columns.

        Args:
            kept: What was kept in the end, for each of its parts.
            step: Any step; with other data it is another one.
            extent: How far the run was followed.
        """


@dataclasses.dataclass(frozen=True)
class AbstractKept(abc.ABC):
    """Something that is kept of a run over a window of time, step by step.

    Attributes:
        after: Where the window begins [s].
        before: Where it ends [s]; `inf` for the horizon.
    """

    after: float = dataclasses.field(default=0.0, kw_only=True)
    before: float = dataclasses.field(default=math.inf, kw_only=True)

    def __post_init__(self):
        window, name = (self.after, self.before), getattr(self, "name", "of")
        is_window = all(isinstance(end, Real) for end in window) and 0.0 <= self.after < self.before
        require(
            bool(is_window),
            f"Arguments `after` and `before` of `{name}` must be a window of times, 0 <= after < before, but are "
            f"{self.after!r} and {self.before!r}.",
        )
        require(
            is_hashable(self),
            f"`{name}` must be made of plain functions, by which programs are kept, but has no hash. Close over "
            "numbers, `lambda s: limit - abs(s.u)`, instead of `eqx.Partial`.",
        )

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

    def add_if_inside(self, state: Any, view: View) -> Any:
        """What is kept after one more step, in which the window neither begins nor ends."""
        return pytrees.where(self.is_inside(view.step), self.add(state, view), state)

    def is_inside(self, step: AbstractStep) -> Bool[Array, ""]:
        """Whether a step is in the window."""
        middle, has_length = 0.5 * (step.t0 + step.t1), jnp.asarray(step.t1 > step.t0)
        return has_length & (middle > self.after) & (middle < self.before)


@dataclasses.dataclass(frozen=True)
class AbstractMetric(AbstractKept, AbstractMeasure):
    """One number of a run: a column of its table.

    Runs that were not followed to the end of the window have none, NaN.

    Attributes:
        name: Name of the column.
        unit: Its unit, "-" for a pure number.
        after: Where the window begins [s].
        before: Where it ends [s]; `inf` for the horizon.
        meaning: What it is, in a sentence.
    """

    unit: str = dataclasses.field(default="", kw_only=True)
    meaning: str = dataclasses.field(default="", kw_only=True)

    has_gradient: ClassVar[bool] = True
    may_jump: ClassVar[bool] = False
    worse: ClassVar[Worse | None] = None

    @property
    def record(self) -> Record:
        """What tables, files and pictures say of it."""
        about = {"has_gradient": self.has_gradient, "may_jump": self.may_jump, "worse": self.worse}
        return Record(self.name, self.meaning or f"{type(self).__name__} of the study", self.unit, **about)

    @property
    def records(self) -> tuple[Record, ...]:
        return (self.record,)

    @property
    def parts(self) -> tuple[AbstractKept, ...]:
        return (self,)

    @property
    def form(self) -> str:
        return type(self).__name__

    def report(self, kept: tuple[Any, ...], step: AbstractStep, extent: Extent) -> dict[str, Array]:
        # A window without an end is up to the horizon.
        horizon = extent.horizon
        is_whole = horizon > self.after if math.isinf(self.before) else horizon >= self.before
        return {self.name: jnp.where(extent.is_complete & is_whole, self.read(kept[0], step), jnp.nan)}

    @abc.abstractmethod
    def read(self, state: Any, step: AbstractStep) -> RealScalarLike:
        """The metric.

        Args:
            state: What was kept in the end.
            step: Any step; with other data it is another one.
        """


@dataclasses.dataclass(frozen=True)
class AbstractFunction(AbstractKept):
    """What is kept of a function of the signals at one instant.

    Attributes:
        of: The function, `of(signals)`, written with `jax.numpy`; see `Signals`.
        jumps: Whether it may jump inside steps, and what is kept of it need be right to the step only.
    """

    of: Callable[[Signals], Any]
    jumps: bool = dataclasses.field(default=False, kw_only=True)

    def values(self, view: View) -> Float[Array, " nodes"]:
        """The function at the nodes."""
        return jax.vmap(self.value)(view.nodes)

    def value(self, signals: Signals) -> Float[Array, ""]:
        """The function at one instant."""
        return jnp.asarray(self.of(signals), float)

    def summit(self, view: View, above: RealScalarLike, sign: float = 1.0) -> Summit:
        """The highest point of the function, times the sign, in a step, if it is in the window and exceeds something.

        Args:
            view: The step.
            above: What it must exceed to be of use.
            sign: 1 or -1.
        """
        above = jnp.where(self.is_inside(view.step), above, jnp.inf)
        return summit(lambda signals: sign * self.value(signals), view, above)

    def value_in(self, step: AbstractStep, theta: RealScalarLike) -> Float[Array, ""]:
        """The function at a place in a step."""
        return self.value(step.at(theta))


@dataclasses.dataclass(frozen=True)
class AbstractOfSignals(AbstractFunction, AbstractMetric):
    """A metric of a function of the signals at one instant.

    A function that is found to jump is refused: inside a step nothing looks for its jumps. Those in time are for
    windows, others for `qj.smoothed`, or for `jumps=True`.

    Attributes:
        of: The function, `of(signals)`, written with `jax.numpy`; see `Signals`.
        jumps: Whether it may jump; then its metric is right to the length of a step only.
    """
