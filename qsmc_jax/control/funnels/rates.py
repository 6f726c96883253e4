"""Whether the edges of a funnel go on without jumps, by the rates that are given."""

import functools as ft
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from qsmc_jax.base.checks import is_traced, require, show
from qsmc_jax.base.precision import entry_point
from qsmc_jax.control.funnel import AbstractFunnel, Funnel
from qsmc_jax.control.funnels.asymmetric import Asymmetric
from qsmc_jax.control.funnels.ending import AbstractEndingFunnel
from qsmc_jax.control.funnels.smooth import Smooth
from qsmc_jax.model.consistency import require_slopes
from qsmc_jax.model.crossings import first_jump, with_decisions
from qsmc_jax.model.kinks import as_times

_EXACT = (Funnel, AbstractEndingFunnel, Smooth)  # by their formulas
_TIMES, _NEAR = 400, 1e-6


def require_own_rates(funnel: AbstractFunnel, t1: Any) -> None:
    """Raises unless half-width and centre go on without jumps, by the rates that are given; traced numbers pass.

    The loop is integrated by the rates and judged by the edges. A jump is found if it shows at one of some hundred
    times, or next to a break time.

    Args:
        funnel: The funnel.
        t1: The horizon [s].
    """
    if isinstance(funnel, Asymmetric):
        require_own_rates(funnel.upper, t1)
        require_own_rates(funnel.lower, t1)
    elif not isinstance(funnel, _EXACT):
        name, mend = f"of `{type(funnel).__name__}`", "Mend its rate, or let `qj.funnels.Smooth(fn)` compute it."
        require_slopes(funnel, type(funnel).width_and_rate, t1, f"{name}, its half-width,", mend)
        require_slopes(funnel, type(funnel).centre_and_rate, t1, f"{name}, its centre,", mend)
        _require_no_jump(funnel, t1)


def _require_no_jump(funnel: AbstractFunnel, t1: Any) -> None:
    if is_traced(funnel, t1):
        return
    found = _first_jump(funnel, float(t1))
    require(
        found is None,
        f"Half-width and centre of `{type(funnel).__name__}` must not jump, but an edge does at t = "
        f"{'' if found is None else show(found)} s: a loop inside before may be outside after. Let it move in a short "
        "time, with both ends among `break_times`.",
    )


@entry_point
def _first_jump(funnel: AbstractFunnel, t1: float) -> Any:
    """When an edge jumps; None if no jump is found."""
    breaks = np.asarray(as_times(funnel.break_times))
    near = np.concatenate([breaks * (1.0 - _NEAR), breaks * (1.0 + _NEAR)])
    ts = np.sort(np.concatenate([t1 * np.linspace(0.0, 1.0, _TIMES), near[(near > 0.0) & (near < t1)]]))

    found = first_jump(ft.partial(_evaluated, funnel), ts[None, :, None], 0)
    return None if found is None else found[0][0]


@eqx.filter_jit
def _evaluated(funnel: AbstractFunnel, points: Any) -> tuple[Any, Any]:
    """Both edges and the decisions on the way, a row a time."""

    def edges(t: Any) -> Any:
        centre, width = (jnp.asarray(each, float) for each in (funnel.centre(t), funnel(t)))
        return jnp.stack([centre - width, centre + width])

    return jax.vmap(lambda t: with_decisions(edges, (t,)))(points[:, 0])
