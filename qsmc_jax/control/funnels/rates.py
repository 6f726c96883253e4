"""Whether the rates of a funnel are those of its edges."""

from typing import Any

from qsmc_jax.control.funnel import AbstractFunnel, Funnel
from qsmc_jax.control.funnels.asymmetric import Asymmetric
from qsmc_jax.control.funnels.ending import AbstractEndingFunnel
from qsmc_jax.control.funnels.smooth import Smooth
from qsmc_jax.model.consistency import require_slopes

_EXACT = (Funnel, AbstractEndingFunnel, Smooth)  # by their formulas


def require_own_rates(funnel: AbstractFunnel, t1: Any) -> None:
    """Raises unless the rates of half-width and centre are their derivatives in time; traced numbers pass.

    The loop is integrated by the rates and judged by the edges.

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
