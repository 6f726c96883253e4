"""The length of the steps: adaptive, on the error that the solver reports, ending where the loop breaks."""

from typing import Any

import diffrax as dfx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.types import BoolScalarLike, RealScalarLike
from qsmc_jax.numerics.barrier import Barrier
from qsmc_jax.simulation.break_times import BreakTimes, Cursor

# By how much a step may shrink or grow from one to the next, and what is aimed for below the tolerance.
_SHRINKS_BY, _GROWS_BY, _SAFETY = 0.2, 10.0, 0.9
# Grains of the error that the controller sees, in its 16th root: too coarse for rounding, too fine to cost a step.
_GRAINS = 1024.0
# Part of a step by which it is stretched to end on a break rather than just before.
_STRETCH = 1e-3
# Break times closer than this, relative to themselves, are one and the same up to rounding.
SAME_TIME = 1e-13
# A step of so many units in the last place of time, relative to it, is the shortest.
_SHORTEST = 8.0 * float(np.finfo(float).eps)
# So is one of this part of the first, at time 0, where time itself resolves any.
_LEAST = 1e-20
# Power of what a step hides that counts as an error: the step then changes by about its root.
_STEEPNESS = 4
# What a run ends with whose shortest step still hides something.
UNRESOLVED = dfx.RESULTS.nonlinear_divergence


class StepSize(dfx.AbstractStepSizeController):
    """PI control of errors in units of what is tolerated, with exponents 1/8 and -1/16 for this step and the last.

    Steps end just before a break, and the next begins just after it, whether the function jumps from the left or from
    the right. The controller's state is the error of the last step kept, and which breaks are still ahead.

    Attributes:
        breaks: Break times [s].
        first: Length of the first step [s].
    """

    breaks: BreakTimes
    first: RealScalarLike

    def wrap(self, direction: Any) -> "StepSize":
        return self

    def init(
        self,
        terms: Any,
        t0: RealScalarLike,
        t1: RealScalarLike,
        y0: Any,
        dt0: None,
        args: Any,
        func: Any,
        error_order: RealScalarLike | None,
    ) -> tuple[RealScalarLike, tuple[RealScalarLike, Cursor]]:
        cursor = self.breaks.start(t0)
        return self._end(cursor, t0, self.first), (jnp.ones(()), cursor)

    def adapt_step_size(
        self,
        t0: RealScalarLike,
        t1: RealScalarLike,
        y0: Any,
        y1_candidate: Any,
        args: Any,
        y_error: Any,
        error_order: RealScalarLike,
        controller_state: tuple[RealScalarLike, Cursor],
    ) -> tuple[Any, ...]:
        barrier: Barrier = args.barrier
        error = barrier(_root(jnp.maximum(y_error.local, y_error.hidden**_STEEPNESS)))
        last, cursor = controller_state
        is_kept = error < 1.0
        factor = _SAFETY * last / jnp.maximum(error, 1e-30) ** 2
        low, high = jnp.where(is_kept, 1.0, _SHRINKS_BY), jnp.where(is_kept, _GROWS_BY, _SAFETY)
        factor = eqxi.nondifferentiable(jnp.clip(factor, low, high))
        start, made_jump = self._start(cursor, jnp.where(is_kept, t1, t0), is_kept)
        start = barrier(start)
        cursor = self.breaks.moved(cursor, start)
        # An error of zero says nothing of how the next step should be.
        told = jnp.where(is_kept & (error > 0.0), error, jnp.where(is_kept, 1.0, last))
        # A step that is refused though time resolves none much shorter is the last one.
        is_last = ~is_kept & (t1 - t0 <= jnp.maximum(_SHORTEST * jnp.abs(t1), _LEAST * self.first))
        cause = dfx.RESULTS.where(y_error.local < 1.0, UNRESOLVED, dfx.RESULTS.dt_min_reached)
        result = dfx.RESULTS.where(is_last, cause, dfx.RESULTS.successful)
        end = barrier(self._end(cursor, start, (t1 - t0) * factor))
        return is_kept, start, end, made_jump, (told, cursor), result

    def _start(self, cursor: Cursor, t: RealScalarLike, is_kept: BoolScalarLike) -> tuple[RealScalarLike, Any]:
        """Where a step begins that follows one which ended at `t`: past a break that ended it."""
        if self.breaks.is_empty:
            return t, False
        reached = eqxi.nextafter(t)
        nearly = reached + SAME_TIME * jnp.abs(reached)
        ends_here, last = is_kept & self.breaks.has(cursor, reached), self.breaks.until(cursor, nearly)
        return jnp.where(ends_here, eqxi.nextafter(jnp.where(ends_here, last, 0.0)), t), ends_here

    def _end(self, cursor: Cursor, start: RealScalarLike, length: RealScalarLike) -> RealScalarLike:
        """Where a step ends that should have a certain length: before the next break at the latest."""
        end = jnp.maximum(start + length, eqxi.nextafter(start))
        if self.breaks.is_empty:
            return end
        ahead = self.breaks.after(cursor, start)
        is_cut = end + _STRETCH * length >= ahead
        return jnp.where(is_cut, eqxi.prevbefore(jnp.where(is_cut, ahead, 0.0)), end)


def _root(error: RealScalarLike) -> Float[Array, ""]:
    """The 16th root of an error, rounded up: the controller's powers are then 2 and -1, which cost nothing.

    Rounded, it is the same in programs that differ in the last place. Where stability limits the steps these are a
    chaotic sequence otherwise: reverse mode, which makes parts of a run again, would differentiate another run.
    """
    error = jax.lax.stop_gradient(error)
    root = jnp.where(jnp.isnan(error), jnp.inf, error)
    for _ in range(4):
        root = jnp.sqrt(root)
    return jnp.ceil(root * _GRAINS) / _GRAINS
