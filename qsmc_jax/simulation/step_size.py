"""The length of the steps: adaptive, on the error of the coordinates alone, stopping where the disturbance breaks."""

from typing import Any

import diffrax as dfx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float

from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.simulation.guarded_solver import Run

# The least step, relative to the horizon: some five units in the last place of t. A loop that leaves its funnel ends
# there.
_LEAST_STEP = 1e-15
# The longest step, relative to the horizon: at rest nothing else keeps a step from passing over what is short and rare.
_LONGEST_STEP = 0.005
# The first step, relative to the horizon: small, so that no start is too stiff for it. It grows tenfold with every step
# kept.
_FIRST_STEP = 1e-6
# Grains of the error that the controller sees, in its 16th root: too coarse for rounding, too fine to cost a step.
_GRAINS = 1024.0
# Break times closer than this, relative to the horizon, are one and the same up to rounding.
_SAME_TIME = 1e-13


def controller(break_times: Float[Array, " breaks"], horizon: RealScalarLike) -> dfx.AbstractStepSizeController:
    """PI control of errors in units of what is tolerated, with exponents 1/8 and -1/16 for this step and the last."""
    adaptive = dfx.PIDController(
        rtol=0.0,
        atol=1.0,
        norm=_norm,
        pcoeff=1.0,
        icoeff=1.0,
        error_order=1.0,
        dtmin=_LEAST_STEP * horizon,
        dtmax=_LONGEST_STEP * horizon,
        force_dtmin=False,
    )
    breaks, first = jnp.sort(jnp.asarray(break_times)), _FIRST_STEP * horizon
    if breaks.size == 0:
        return _Started(adaptive, first)
    is_new = jnp.concatenate([jnp.ones(1, bool), jnp.diff(breaks) > _SAME_TIME * horizon])
    stopping = dfx.ClipStepSizeController(adaptive, jump_ts=jnp.where(is_new, breaks, jnp.inf))
    return _Started(stopping, first)


def _norm(error: Run) -> Float[Array, ""]:
    """The 16th root of the largest error, rounded up: the controller's powers are then 2 and -1, which cost nothing.

    Rounded, it is the same in programs that differ in the last place. Where stability limits the steps these are a
    chaotic sequence otherwise: reverse mode, which makes parts of a run again, would differentiate another run.
    """
    root = jax.lax.stop_gradient(optx.max_norm(error.y))
    for _ in range(4):
        root = jnp.sqrt(root)
    return jnp.ceil(root * _GRAINS) / _GRAINS


class _Started(dfx.AbstractStepSizeController):
    """Another controller with its first step given.

    Given to `diffeqsolve` instead, a first step that is being traced is checked by a callback to Python, with which no
    compiled program can be cached.
    """

    inner: dfx.AbstractStepSizeController
    first: RealScalarLike

    def wrap(self, direction: Any) -> dfx.AbstractStepSizeController:
        return _Started(self.inner.wrap(direction), self.first)

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
    ) -> tuple[RealScalarLike, Any]:
        return self.inner.init(terms, t0, t1, y0, self.first, args, func, error_order)

    def adapt_step_size(
        self,
        t0: RealScalarLike,
        t1: RealScalarLike,
        y0: Any,
        y1_candidate: Any,
        args: Any,
        y_error: Any,
        error_order: RealScalarLike,
        controller_state: Any,
    ) -> tuple[Any, ...]:
        return self.inner.adapt_step_size(t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state)
