"""Requirements of one's own: what must always be so, or at some time, in what window, and by what margin it is.

Margins are those of signal temporal logic with time windows that are not nested. Source: Donze and Maler, Robust
satisfaction of temporal logic over real-valued signals, FORMATS 2010. What a solve knows of a margin is an interval:
half of it is open where the run was not followed to the end of the window.
"""

import abc
import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.metrics.claims import margin_column, verdict_column
from qsmc_jax.metrics.metric import AbstractFunction, AbstractMeasure, Extent
from qsmc_jax.metrics.record import Record
from qsmc_jax.metrics.signals import AbstractStep, Signals
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.metrics.view import View


class Margin(NamedTuple):
    """What is known of a margin.

    Attributes:
        low: It is not below this.
        value: What it is; NaN if it was not followed to the end of the window.
        high: It is not above this.
    """

    low: RealScalarLike
    value: RealScalarLike
    high: RealScalarLike

    def merge(self, other: "Margin", choose: Callable[..., Any]) -> "Margin":
        """The smaller or the larger of two."""
        return Margin(*map(choose, self, other))

    def negative(self) -> "Margin":
        """Minus the margin."""
        return Margin(-self.high, -self.value, -self.low)


class Requirement(abc.ABC):
    """Something required of a run; `&`, `|`, `~` and `implies` make new ones.

    Examples:
        >>> import jax.numpy as jnp
        >>> import qsmc_jax as qj
        >>> settled = qj.always(lambda s: 0.02 - jnp.abs(s.e[0]), after=2.0, unit="m")
        >>> quick = qj.eventually(lambda s: s.x[0] - 0.9, before=0.5, unit="m")
        >>> len((settled & ~quick).parts), settled.implies(quick).parts == (settled, quick)
        (2, True)
    """

    @property
    @abc.abstractmethod
    def parts(self) -> "tuple[AbstractExtreme, ...]":
        """What it is made of, from left to right."""

    @property
    @abc.abstractmethod
    def form(self) -> str:
        """How its parts are joined."""

    @abc.abstractmethod
    def margin(self, of: Mapping["AbstractExtreme", Margin]) -> Margin:
        """Its margin, positive where it holds.

        Args:
            of: The margins of its parts.
        """

    def implies(self, other: "Requirement") -> "Requirement":
        """Required is `other` of the runs in which this holds.

        Args:
            other: The other one.
        """
        return _Either(_Not(self), _checked(other))

    def __and__(self, other: "Requirement") -> "Requirement":
        return _Not(_Either(_Not(self), _Not(_checked(other))))

    def __or__(self, other: "Requirement") -> "Requirement":
        return _Either(self, _checked(other))

    def __invert__(self) -> "Requirement":
        return _Not(self)

    def __bool__(self) -> bool:
        raise InputError("Requirements are joined by `&`, `|` and `~`, not by `and`, `or` and `not`.")


def _checked(other: Any) -> Requirement:
    found = type(other).__name__
    require(isinstance(other, Requirement), f"A requirement can be joined with another one only, not with a `{found}`.")
    return other


@dataclasses.dataclass(frozen=True)
class _Either(Requirement):
    first: Requirement
    second: Requirement

    @property
    def parts(self) -> "tuple[AbstractExtreme, ...]":
        return self.first.parts + self.second.parts

    @property
    def form(self) -> str:
        return f"either({self.first.form}, {self.second.form})"

    def margin(self, of: Mapping["AbstractExtreme", Margin]) -> Margin:
        return self.first.margin(of).merge(self.second.margin(of), jnp.maximum)


@dataclasses.dataclass(frozen=True)
class _Not(Requirement):
    it: Requirement

    @property
    def parts(self) -> "tuple[AbstractExtreme, ...]":
        return self.it.parts

    @property
    def form(self) -> str:
        return f"not({self.it.form})"

    def margin(self, of: Mapping["AbstractExtreme", Margin]) -> Margin:
        return self.it.margin(of).negative()


class Highest(NamedTuple):
    """What is kept of a function: how high it got, what it did not exceed, and its largest size."""

    height: Float[Array, ""]
    bound: Float[Array, ""]
    size: Float[Array, ""]


@dataclasses.dataclass(frozen=True)
class AbstractExtreme(AbstractFunction, Requirement):
    """A requirement on one function of the signals in one window."""

    unit: str = dataclasses.field(default="", kw_only=True)

    sign: ClassVar[float]

    @property
    def parts(self) -> "tuple[AbstractExtreme, ...]":
        return (self,)

    @property
    def form(self) -> str:
        return type(self).__name__

    def margin(self, of: Mapping["AbstractExtreme", Margin]) -> Margin:
        return of[self]

    def first(self, step: AbstractStep) -> Highest:
        lowest = jnp.full((), -jnp.inf)
        return Highest(lowest, lowest, jnp.zeros(()))

    def add(self, state: Highest, view: View) -> Highest:
        _, height, bound = self.summit(view, state.height, self.sign)
        size = jnp.abs(self.values(view)).max()
        return Highest(*map(jnp.maximum, state, (height, bound, size)))

    def known(self, state: Highest, extent: Extent) -> Margin:
        """What is known of the margin at the end of a run.

        Args:
            state: What was kept.
            extent: How far the run was followed.
        """
        is_whole = extent.is_complete & (extent.horizon > self.after)
        if not math.isinf(self.before):
            is_whole = jnp.asarray(extent.time >= self.before)
        # Nothing is known of a window that no step was seen in.
        is_whole = is_whole & (state.height > -jnp.inf)
        owed = extent.resolution * state.size
        low, high = state.height - owed, jnp.where(is_whole, state.bound + owed, jnp.inf)
        highest = Margin(low, jnp.where(is_whole, state.height, jnp.nan), high)
        return highest if self.sign > 0.0 else highest.negative()


@dataclasses.dataclass(frozen=True)
class _Always(AbstractExtreme):
    sign: ClassVar[float] = -1.0


@dataclasses.dataclass(frozen=True)
class _Eventually(AbstractExtreme):
    sign: ClassVar[float] = 1.0


def always(
    of: Callable[[Signals], Any], *, after: float = 0.0, before: float = math.inf, unit: str = ""
) -> Requirement:
    """Required is that a function of the signals is positive at all times of a window.

    Its margin is the infimum of the function in the window, inside steps too, to 1e-5 of its largest value, where it is
    concave or convex between the five places in a step that are looked at; kinks such as those of `abs` are found. What
    the function alone has of time, if shorter than a step, may be missed. Where the function jumps at an end of the
    window, its values inside count.

    Args:
        of: `of(signals)`, written with `jax.numpy`: a number that is positive where it is as it should be, such as
            `limit - jnp.abs(signals.u)`; see `qj.metrics.Signals`.
        after: Where the window begins [s].
        before: Where it ends [s]; `inf` for the horizon.
        unit: Unit of the function.

    Returns:
        The requirement, for `Study(requirements={"name": ...})`.

    Examples:
        >>> import jax.numpy as jnp
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=2.0)
        >>> limits = {"input": qj.always(lambda s: 9.0 - jnp.abs(s.u)), "weak": qj.always(lambda s: 0.1 - jnp.abs(s.u))}
        >>> runs = qj.monte_carlo(qj.Study(scenario, bandwidth=0.1, requirements=limits), runs=64, block=64)
        >>> [runs.counts(name)[qj.Verdict.HELD] for name in limits]
        [64, 0]
        >>> bool(abs(runs["margin_input"] - (9.0 - runs["peak_u"])).max() < 1e-4)
        True
    """
    return _Always(of, after=after, before=before, unit=unit)


def eventually(
    of: Callable[[Signals], Any], *, after: float = 0.0, before: float = math.inf, unit: str = ""
) -> Requirement:
    """Required is that a function of the signals is positive at some time of a window; its margin is the supremum.

    Args:
        of: `of(signals)`; see `always`, also for how good the margin is.
        after: Where the window begins [s].
        before: Where it ends [s]; `inf` for the horizon.
        unit: Unit of the function.

    Returns:
        The requirement, for `Study(requirements={"name": ...})`.

    Examples:
        >>> import jax.numpy as jnp
        >>> import qsmc_jax as qj
        >>> near = qj.eventually(lambda s: 0.1 - jnp.abs(s.e[0]), before=2.0, unit="m")
        >>> near.parts[0].before
        2.0
    """
    return _Eventually(of, after=after, before=before, unit=unit)


@dataclasses.dataclass(frozen=True)
class Required(AbstractMeasure):
    """A requirement under its name in a study: the columns `verdict_NAME` and `margin_NAME`.

    Attributes:
        name: The name.
        requirement: What is required.
    """

    requirement: Requirement

    @property
    def parts(self) -> tuple[AbstractExtreme, ...]:
        return tuple(dict.fromkeys(self.requirement.parts))

    @property
    def records(self) -> tuple[Record, ...]:
        units, label = {part.unit for part in self.requirement.parts}, f"margin of {self.name}"
        unit = units.pop() if len(units) == 1 else ""
        meaning = (
            f"Margin of requirement {self.name}: positive where it held; of a run not followed to its end, a bound"
        )
        return (
            Record(verdict_column(self.name), f"Verdict on requirement {self.name}"),
            Record(margin_column(self.name), meaning, unit, label, worse="low", has_gradient=True, may_jump=False),
        )

    @property
    def form(self) -> str:
        # Of parts that are there twice, which is which.
        order = [self.parts.index(part) for part in self.requirement.parts]
        return f"{self.requirement.form} of {order}"

    def report(self, kept: tuple[Any, ...], step: AbstractStep, extent: Extent) -> dict[str, Array]:
        known = {part: part.known(state, extent) for part, state in zip(self.parts, kept, strict=True)}
        low, value, high = self.requirement.margin(known)
        held, violated = jnp.asarray(low > 0.0), jnp.asarray(high < 0.0)
        verdict = jnp.where(held, int(Verdict.HELD), jnp.where(violated, int(Verdict.VIOLATED), int(Verdict.UNDECIDED)))
        # Of a margin that is not known to its end the bound that decides is worth telling.
        bound = jnp.where(held, low, jnp.where(violated, high, jnp.nan))
        margin = jnp.where(jnp.isnan(value), bound, value)
        return {
            verdict_column(self.name): jnp.where(extent.is_admitted, verdict, int(Verdict.INADMISSIBLE)),
            margin_column(self.name): jnp.where(extent.is_admitted, margin, jnp.nan),
        }
