"""Whether what a study asks of its runs can be kept up at all, and what it computes, said before any is solved."""

import dataclasses
import math
from collections.abc import Callable, Collection, Sequence
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from qsmc_jax.base.checks import nearest, require
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.names import require_name
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.metrics.claims import require_no_claim
from qsmc_jax.metrics.jumps import require_no_jump
from qsmc_jax.metrics.metric import AbstractFunction, AbstractKept, AbstractMeasure, AbstractMetric, Extent
from qsmc_jax.metrics.record import Record
from qsmc_jax.metrics.signals import AbstractStep, Signals
from qsmc_jax.metrics.view import View
from qsmc_jax.tracing.programs import Program
from qsmc_jax.tracing.traceable import require_number, trace

# Numbers of states and of errors; with several inputs of the errors of each channel.
Sizes: TypeAlias = tuple[int, int | tuple[int, ...]]


class _Straight(AbstractStep):
    """A step, from 0 to 1 s, on which every signal is a straight line: those at its beginning, and at its end."""

    @property
    def t0(self) -> RealScalarLike:
        return jnp.zeros(())

    @property
    def t1(self) -> RealScalarLike:
        return jnp.ones(())

    def once(self, tree: Any) -> Any:
        return tree

    def at(self, theta: RealScalarLike) -> Signals:
        return jax.tree.map(lambda a, b: a + theta * (b - a), *self.data)


def check_measures(measures: Sequence[AbstractMeasure], start: Signals, horizon: float, taken: Collection[str]) -> None:
    """Raises unless the metrics and requirements of a study can be kept up.

    Args:
        measures: Metrics and requirements.
        start: The signals at the start of the nominal run.
        horizon: The longest horizon of any run [s].
        taken: Names that columns have already.

    Raises:
        InputError: A name is taken, a window lies beyond the horizon, or a function does not make one number of the
            signals.
    """
    names = set(taken)
    for measure in measures:
        require_name(measure.name)
        require_no_claim(measure.name)
        for column in (record.name for record in measure.records):
            require(
                column not in names,
                f"Argument `name` of a {kind_of(measure)} must be new, but `{column}` is the name of a column already.",
            )
            names.add(column)
        for part in measure.parts:
            _check_part(measure, part, start, horizon)


def _sizes_of(signals: Signals) -> Sizes:
    several = isinstance(signals.sigma, tuple)
    return len(signals.x), tuple(map(len, signals.e)) if several else len(signals.e)


def kind_of(measure: AbstractMeasure) -> str:
    """What users call it."""
    return "metric" if isinstance(measure, AbstractMetric) else "requirement"


def _check_part(measure: AbstractMeasure, part: AbstractKept, start: Signals, horizon: float) -> None:
    """Raises unless a part of a measure can be kept up."""
    kind, name = kind_of(measure), measure.name
    require(
        part.after < horizon,
        f"Argument `after` of {kind} `{name}` must lie before the horizon, {horizon:g} s, but is {part.after:g} s.",
    )
    require(
        part.before <= horizon or math.isinf(part.before),
        f"Argument `before` of {kind} `{name}` must not lie beyond the horizon, {horizon:g} s, but is {part.before:g} "
        "s: leave it out for the horizon, or make `t1` longer.",
    )
    sizes = _sizes_of(start)
    program = program_of(measure, part, sizes)
    if isinstance(part, AbstractFunction):
        value = float(np.asarray(part.of(start), float))
        require(
            not np.isnan(value),
            f"Function `of` of {kind} `{name}` must return a number, but returns nan at the start of the nominal run. "
            "Keep it defined wherever a run may be, say by `jnp.where`.",
        )
        if not _is_claim(part, sizes):
            require_no_jump(f"Function `of` of {kind} `{name}`", part, program, start, horizon)


def records_in(measure: AbstractMeasure, sizes: Sizes) -> dict[str, Record]:
    """The records of a measure in a study, by column; what is true or false has no derivative.

    Args:
        measure: The measure, checked.
        sizes: Numbers of states and of errors.
    """
    is_claim = any(isinstance(part, AbstractFunction) and _is_claim(part, sizes) for part in measure.parts)
    known = measure.records
    return {each.name: dataclasses.replace(each, has_gradient=each.has_gradient and not is_claim) for each in known}


def program_of(measure: AbstractMeasure, part: AbstractKept, sizes: Sizes) -> Program:
    """The program of what the user wrote of a part of a measure.

    Args:
        measure: The measure.
        part: The part.
        sizes: Numbers of states and of errors.
    """
    kind = kind_of(measure)
    if not isinstance(part, AbstractFunction):
        named = f"{kind.capitalize()} `{measure.name}`"
        return _traced(named, lambda *ends: _once(named, measure, part, _Straight(ends)), sizes, 2)
    what = f"Function `of` of {kind} `{measure.name}`"
    require(callable(part.of), f"{what} must be a function of the signals, but is {part.of!r}.")
    program = _traced(what, lambda now: _result(what, part.of(now)), sizes, 1)
    is_answer = kind == "requirement" and _is_claim(part, sizes)
    require(
        not is_answer,
        f"{what} must return a number that is positive where it is as it should be, but returns true or false. Write "
        "`limit - abs(s.u)` instead of `abs(s.u) < limit`.",
    )
    return program


def _is_claim(part: AbstractFunction, sizes: Sizes) -> bool:
    return jax.eval_shape(part.of, _stand_ins(sizes)).dtype == bool


def _traced(what: str, call: Callable[..., Any], sizes: Sizes, instants: int) -> Program:
    """The program of what makes one number of the signals at so many instants."""
    try:
        signals = (_stand_ins(sizes),) * instants
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


def _stand_ins(sizes: Sizes) -> Signals:
    """Shapes of the signals at one instant."""
    number = jax.ShapeDtypeStruct((), np.float64)
    states, errors = sizes
    x = (number,) * states
    if isinstance(errors, int):
        e = (number,) * errors
        return Signals(number, x, e, e, *(number,) * 7)
    e, each = tuple((number,) * size for size in errors), (number,) * len(errors)
    return Signals(number, x, e, e, each, each, each, each, each, each, (each,) * len(errors))


def _result(what: str, result: Any) -> Any:
    """What a function returned, unless JAX has no words for it."""
    require(not isinstance(result, str), f"{what} must return one number, but returns the text {result!r}.")
    return result


def _once(named: str, measure: AbstractMeasure, part: AbstractKept, step: AbstractStep) -> Any:
    """The measure after one step."""
    state = part.first(step)
    kept = part.add(state, View(step))
    before, after = (jax.tree.map(jnp.shape, each) for each in (state, kept))
    require(before == after, f"{named} must keep what `start` returns, {before}, but makes it {after}.")
    extent = Extent(jnp.ones(()), jnp.ones(()), jnp.array(True), jnp.array(True), jnp.zeros(()))
    return jnp.asarray(measure.report((kept,), step, extent)[measure.name])
