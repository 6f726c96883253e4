"""What can be kept of a function of the signals: its supremum, integral, mean, variation, last value, or anything."""

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.metrics.metric import AbstractMetric, AbstractOfSignals
from qsmc_jax.metrics.record import Worse
from qsmc_jax.metrics.signals import AbstractStep, Signals
from qsmc_jax.metrics.view import WEIGHTS, View


@dataclasses.dataclass(frozen=True)
class Peak(AbstractOfSignals):
    """The supremum of a function of the signals over its window; of |x|, give `lambda s: jnp.abs(s.x[0])`.

    Good to 1e-5 relative to the size of the function, as `peak_ratio` is, at kinks such as those of `abs` too. The
    loop's signals choose the steps: what the function alone has of time, if shorter than a step, may be missed. The
    infimum is minus the peak of minus the function.

    Examples:
        >>> import jax.numpy as jnp
        >>> import qsmc_jax as qj
        >>> lateral = qj.metrics.Peak("lateral", lambda s: jnp.abs(s.x[0]), unit="m")
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=2.0)
        >>> runs = qj.monte_carlo(qj.Study(scenario, bandwidth=0.1, metrics=[lateral]), runs=64, block=64)
        >>> bool((runs["lateral"] >= runs["x0[0]"]).all())
        True
    """

    worse: ClassVar[Worse | None] = "high"

    def first(self, step: AbstractStep) -> Float[Array, ""]:
        return jnp.full((), -jnp.inf)

    def add(self, state: Float[Array, ""], view: View) -> Float[Array, ""]:
        return jnp.maximum(state, self.summit(view, state).height)

    def read(self, state: Float[Array, ""], step: AbstractStep) -> RealScalarLike:
        return state


@dataclasses.dataclass(frozen=True)
class Final(AbstractOfSignals):
    """A function of the signals at the end of its window.

    Examples:
        >>> import qsmc_jax as qj
        >>> qj.metrics.Final("where", lambda s: s.x[0], unit="m").record.unit
        'm'
    """

    def first(self, step: AbstractStep) -> Float[Array, ""]:
        return jnp.zeros(())

    def add(self, state: Float[Array, ""], view: View) -> Float[Array, ""]:
        return self.values(view)[-1]

    def read(self, state: Float[Array, ""], step: AbstractStep) -> RealScalarLike:
        return state


@dataclasses.dataclass(frozen=True)
class Integral(AbstractOfSignals):
    """The integral over time of a function of the signals, by a rule of degree 7 in each step.

    Where the function has a kink, as |e| has where e crosses zero, one step is good to the square of its length only.

    Examples:
        >>> import jax.numpy as jnp
        >>> import qsmc_jax as qj
        >>> qj.metrics.Integral("iae", lambda s: jnp.abs(s.e[0]), unit="m s").record.unit
        'm s'
    """

    worse: ClassVar[Worse | None] = "high"

    def first(self, step: AbstractStep) -> Float[Array, ""]:
        return jnp.zeros(())

    def add(self, state: Float[Array, ""], view: View) -> Float[Array, ""]:
        return state + _integral(self, view)

    def read(self, state: Float[Array, ""], step: AbstractStep) -> RealScalarLike:
        return state


class _Total(NamedTuple):
    """A sum, and the time that it is of [s]."""

    sum: Float[Array, ""]
    time: Float[Array, ""]


@dataclasses.dataclass(frozen=True)
class Mean(AbstractOfSignals):
    """The mean over time of a function of the signals; see `Integral`.

    Examples:
        >>> import qsmc_jax as qj
        >>> qj.metrics.Mean("power", lambda s: s.u**2, after=2.0).after
        2.0
    """

    def first(self, step: AbstractStep) -> _Total:
        return _Total(jnp.zeros(()), jnp.zeros(()))

    def add(self, state: _Total, view: View) -> _Total:
        return _Total(state.sum + _integral(self, view), state.time + view.length)

    def read(self, state: _Total, step: AbstractStep) -> RealScalarLike:
        return state.sum / jnp.where(state.time > 0.0, state.time, 1.0)


class _Course(NamedTuple):
    """A total variation so far, the last value, and whether there is one."""

    total: Float[Array, ""]
    last: Float[Array, ""]
    has_begun: Array


@dataclasses.dataclass(frozen=True)
class Variation(AbstractOfSignals):
    """The total variation of a function of the signals, jumps between steps included.

    In a step it is that of the function at five instants, one peak and one valley: good to 1e-4 of itself where it
    turns at most once up and once down within a step.

    Examples:
        >>> import qsmc_jax as qj
        >>> qj.metrics.Variation("travel", lambda s: s.x[0], unit="m").worse
        'high'
    """

    worse: ClassVar[Worse | None] = "high"

    def first(self, step: AbstractStep) -> _Course:
        return _Course(jnp.zeros(()), jnp.zeros(()), jnp.array(False))

    def add(self, state: _Course, view: View) -> _Course:
        values = self.values(view)
        ups, downs = (self.summit(view, (sign * values).max(), sign).height for sign in (1.0, -1.0))
        jump = jnp.where(state.has_begun, jnp.abs(values[0] - state.last), 0.0)
        hidden = jnp.maximum(ups - values.max(), 0.0) + jnp.maximum(downs + values.min(), 0.0)
        change = jnp.abs(jnp.diff(values)).sum() + 2.0 * hidden
        return _Course(state.total + jump + change, values[-1], jnp.array(True))

    def read(self, state: _Course, step: AbstractStep) -> RealScalarLike:
        return state.total


@dataclasses.dataclass(frozen=True)
class Custom(AbstractMetric):
    """Whatever can be kept up step by step.

    Attributes:
        start: `start(signals)` gives what is kept at first, a pytree of arrays; the signals are those at time 0.
        advance: `advance(state, step)` gives what is kept after one more step, which has `t0`, `t1` and `at(theta)`,
            the signals at a place from 0 to 1 in it.
        result: `result(state)` gives the metric.

    Examples:
        The distance travelled by the state of a first-order loop:

        >>> import jax.numpy as jnp
        >>> import qsmc_jax as qj
        >>> travel = qj.metrics.Custom(
        ...     "travel",
        ...     start=lambda signals: jnp.zeros(()),
        ...     advance=lambda state, step: state + jnp.abs(step.at(1.0).x[0] - step.at(0.0).x[0]),
        ...     result=lambda state: state,
        ...     unit="m",
        ... )
        >>> travel.name
        'travel'
    """

    start: Callable[[Signals], Any]
    advance: Callable[[Any, AbstractStep], Any]
    result: Callable[[Any], Any]

    def first(self, step: AbstractStep) -> Any:
        return self.start(step.at(0.0))

    def add(self, state: Any, view: View) -> Any:
        return self.advance(state, view.step)

    def read(self, state: Any, step: AbstractStep) -> RealScalarLike:
        return self.result(state)


def _integral(metric: AbstractOfSignals, view: View) -> RealScalarLike:
    return view.length * jnp.sum(jnp.array(WEIGHTS) * metric.values(view))
