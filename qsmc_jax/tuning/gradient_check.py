"""Whether the gradient of a study can be trusted: what has none is refused, and the rest is tried by a difference."""

import numpy as np
from jaxtyping import Float

from qsmc_jax.base.checks import require
from qsmc_jax.base.errors import InputError
from qsmc_jax.study.study import Study
from qsmc_jax.tuning.batch import Batch, Evaluation

# Steps of the difference, in the unit cube, and how far gradient and difference may lie apart: a sampled loop is only
# piecewise smooth, and its mean over some hundred runs nearly.
_STEPS, _APART, _ROUNDING = (1e-3, 1e-2), 0.25, 1e-4


def refuse_jumps(study: Study) -> None:
    """Raises if the loop's derivative by its gains is zero almost everywhere, or misses what its jumps do.

    Raises:
        InputError: The law switches, or a signal is rounded.
    """
    loop = study.nominal.loop
    for law in (channel.control for channel in loop.channels):
        require(
            law.has_derivative,
            f"The gradient of this study can't be trusted: `{type(law).__name__}` switches by the sign of sigma, which "
            "has no derivative. Tune `BoundaryLayer` or the quasi-sliding law.",
        )
    made = loop.implementation
    for name in ("measurement_resolution", "input_resolution"):
        require(
            made is None or getattr(made, name) is None,
            f"The gradient of this study can't be trusted: `{name}` of the implementation rounds, which has no "
            "derivative. Tune without it, and verify with it.",
        )


def check_start(batch: Batch, v: Float[np.ndarray, " names"]) -> Evaluation:
    """The training runs at the start, where the gradient is compared with a central difference along it.

    Where runs are lost the objective is not known, and nothing is compared: a search has to leave such gains first.

    Raises:
        InputError: The objective is known in no run, though none is lost, or gradient and difference disagree.
    """
    made, _, slopes = batch.differentiate(v, 0.0, -1)
    require(
        made.unknown < 1.0 or made.lost > 0.0,
        f"The objective at the start must be finite, but is {made.objective:g} (constraints {made.excess}); a metric "
        f"is not known in {100 * made.unknown:.3g} % of the runs. Start elsewhere (`study.substitute`), or choose "
        "metrics that are known: those of the steady phase need a horizon beyond the reaching time.",
    )
    if not np.isfinite(made.objective):
        return made
    size = float(np.linalg.norm(slopes[0]))
    direction = slopes[0] / size if size > 0.0 else np.full(len(v), len(v) ** -0.5)
    rounding, found = _ROUNDING * abs(made.objective), []
    for step in _STEPS:
        ahead, behind = (np.clip(v + sign * step * direction, 0.0, 1.0) for sign in (1.0, -1.0))
        length = float((ahead - behind) @ direction)
        ends = [batch.evaluate(end).objective for end in (ahead, behind)]
        if not np.isfinite(ends).all():  # runs are lost that near: no difference is to be had
            return made
        along = (ends[0] - ends[1]) / length
        slope = float(slopes[0] @ (ahead - behind)) / length
        found.append(along)
        if abs(along - slope) <= _APART * max(abs(along), abs(slope)) + rounding:
            return made
    raise InputError(
        f"The gradient of this study can't be trusted: along itself it is {size:.4g}, but central differences give "
        f"{found[0]:.4g} and {found[1]:.4g}. A plant, law or disturbance that jumps with the state has a derivative "
        "that misses the jump: smooth it, or search without gradients."
    )
