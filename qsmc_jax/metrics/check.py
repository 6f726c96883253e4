"""Whether metrics of one's own can be kept up at all, and what they compute, said before anything is solved."""

import dataclasses
from collections.abc import Callable, Collection, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qsmc_jax.base.checks import nearest, require, require_kind
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.names import require_name
from qsmc_jax.base.programs import Program
from qsmc_jax.base.traceable import require_number, trace
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.metrics.metric import AbstractMetric, AbstractOfSignals, View
from qsmc_jax.metrics.record import Record
from qsmc_jax.metrics.signals import AbstractStep, Signals


class _Straight(AbstractStep):
    """A step, from 0 to 1 s, on which every signal is a straight line: those at its beginning, and at its end."""

    @property
    def t0(self) -> RealScalarLike:
        return jnp.zeros(())

    @property
    def t1(self) -> RealScalarLike:
        return jnp.ones(())

    def at(self, theta: RealScalarLike) -> Signals:
        return jax.tree.map(lambda a, b: a + theta * (b - a), *self.data)


def check_metrics(metrics: Sequence[Any], start: Signals, horizon: float, taken: Collection[str]) -> None:
    """Raises unless metrics of a study can be kept up.

    Args:
        metrics: The metrics.
        start: The signals at the start of the nominal run.
        horizon: Its horizon [s].
        taken: Names that columns have already.

    Raises:
        InputError: A metric is none, its name is taken, its window lies beyond the horizon, or its function does not
            make one number of the signals.
    """
    names = set(taken)
    for metric in metrics:
        require_kind("metrics", metric, AbstractMetric, "Use those of `qj.metrics`, such as `qj.metrics.Peak`.")
        require_name(metric.name)
        require(
            metric.name not in names,
            f"Argument `name` of a metric must be new, but `{metric.name}` is the name of a column already.",
        )
        names.add(metric.name)
        require(
            metric.after < horizon,
            f"Argument `after` of metric `{metric.name}` must lie before the horizon, {horizon:g} s, but is "
            f"{metric.after:g} s.",
        )
        try:
            hash(metric)
        except TypeError:
            raise InputError(
                f"Metric `{metric.name}` must be made of plain functions, by which programs are kept, but has no hash. "
                "Close over numbers, `lambda s: abs(s.u) - limit`, instead of `eqx.Partial`."
            ) from None
        program_of(metric, len(start.x))
        if isinstance(metric, AbstractOfSignals):
            value = float(np.asarray(metric.of(start), float))
            require(
                not np.isnan(value),
                f"Function `of` of metric `{metric.name}` must return a number, but returns nan at the start of the "
                "nominal run. Keep it defined wherever a run may be, say by `jnp.where`.",
            )


def record_in(metric: AbstractMetric, order: int) -> Record:
    """The record of a metric in a study; what is true or false has no derivative.

    Args:
        metric: The metric, checked.
        order: Order of the plant.
    """
    is_claim = isinstance(metric, AbstractOfSignals) and jax.eval_shape(metric.of, _stand_ins(order)).dtype == bool
    return dataclasses.replace(metric.record, has_gradient=metric.has_gradient and not is_claim)


def program_of(metric: AbstractMetric, order: int) -> Program:
    """The program of what the user wrote of a metric.

    Args:
        metric: The metric.
        order: Order of the plant.
    """
    if not isinstance(metric, AbstractOfSignals):
        return _traced(f"Metric `{metric.name}`", lambda *ends: _once(metric, _Straight(ends)), order, 2)
    what = f"Function `of` of metric `{metric.name}`"
    require(callable(metric.of), f"{what} must be a function of the signals, but is {metric.of!r}.")
    return _traced(what, lambda now: _result(what, metric.of(now)), order, 1)


def _traced(what: str, call: Callable[..., Any], order: int, instants: int) -> Program:
    """The program of what makes one number of the signals at so many instants."""
    try:
        signals = (_stand_ins(order),) * instants
        program, result = trace(what, "the signals at one instant", (), lambda _, *given: call(*given), *signals)
    except AttributeError as error:
        if "'Signals' object" not in str(error):
            raise
        name = str(error).rpartition("'")[0].rpartition("'")[2]
        raise InputError(
            f"{what} must take the signals at one instant, which have {', '.join(Signals._fields)}, but asks for "
            f"`{name}`.{nearest(name, Signals._fields)}"
        ) from error
    require_number(what, result)
    return program


def _stand_ins(order: int) -> Signals:
    """Shapes of the signals at one instant."""
    number = jax.ShapeDtypeStruct((), np.float64)
    several = (number,) * order
    return Signals(number, several, several, several, *(number,) * 7)


def _result(what: str, result: Any) -> Any:
    """What a function returned, unless JAX has no words for it."""
    require(not isinstance(result, str), f"{what} must return one number, but returns the text {result!r}.")
    return result


def _once(metric: AbstractMetric, step: AbstractStep) -> Any:
    """The metric after one step."""
    state, view = metric.first(step), View.of(step)
    kept = metric.add(state, view)
    before, after = (jax.tree.map(jnp.shape, each) for each in (state, kept))
    require(before == after, f"Metric `{metric.name}` must keep what `start` returns, {before}, but makes it {after}.")
    return jnp.asarray(metric.read(kept, step))
