"""Whether metrics of one's own can be kept up at all, and what they compute, said before anything is solved."""

import dataclasses
from collections.abc import Collection, Sequence
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
    """The program of all that a metric does in a step.

    Args:
        metric: The metric.
        order: Order of the plant.
    """
    signals = _stand_ins(order)
    what, takes = f"Metric `{metric.name}`", "the signals at one instant"
    try:
        if isinstance(metric, AbstractOfSignals):
            what = f"Function `of` of metric `{metric.name}`"
            require(callable(metric.of), f"{what} must be a function of the signals, but is {metric.of!r}.")
            require_number(what, trace(what, takes, (), lambda _, now: _result(what, metric.of(now)), signals)[1])
        program, result = trace(what, takes, (), lambda _, *ends: _once(metric, _Straight(ends)), signals, signals)
    except AttributeError as error:
        name = str(error).rpartition("'")[0].rpartition("'")[2]
        listed = ", ".join(Signals._fields)
        raise InputError(
            f"{what} must take the signals at one instant, which have {listed}, but asks for `{name}`."
            f"{nearest(name, Signals._fields)}"
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
