"""How stiff a loop will be, from its numbers alone, and the method for it."""

import math
from typing import Any

from qsmc_jax.base.checks import is_traced
from qsmc_jax.base.precision import entry_point
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.simulation.settings import Method, SolverSettings

# Up to this stiffness an explicit method's steps are short for accuracy, not for stability, and half as dear. Measured
# at rtol 1e-6: the two methods take the same time at some 700 in Example 1 of the paper, 1500 in Example 2.
EXPLICIT_UP_TO = 1000.0

# Methods that stand for one of two, by the stiffness of each run.
BY_STIFFNESS = ("auto", "other")

# The method that shares no step with a given one: an explicit one against an implicit one.
OTHER: dict[str, Method] = {
    "auto": "other",
    "other": "auto",
    "tsit5": "rodas5p",
    "rodas4": "tsit5",
    "rodas5p": "tsit5",
}


@entry_point
def stiffness(loop: ClosedLoop, x0: Any, t1: RealScalarLike) -> RealScalarLike:
    r"""Decay times of the sliding variable in a run to `t1`, $|g| \frac{\pi}{2 \rho_\infty} t_1$ [-], at u = 0.

    An explicit method needs about a third as many steps at the least, and $1 + u^2$ times as many under an input u. A
    loop with an implementation is open between samples: 0.
    """
    if loop.implementation is not None:
        return 0.0
    gain = loop.plant.gain(0.0, tuple(x0[i] for i in range(loop.order)))
    return abs(gain) * (0.5 * math.pi) / loop.control.funnel.rho_inf * t1


def method_for(stiffness: float, nominal: float, asked_for: Method = "auto") -> Method:
    """The method for a run of the given stiffness, in a study whose nominal run has the other.

    A second method is a second program to compile: only runs that are much stiffer than the nominal one are worth it.
    """
    if asked_for not in BY_STIFFNESS:
        return asked_for
    is_stiff = nominal > EXPLICIT_UP_TO or stiffness > 3.0 * EXPLICIT_UP_TO
    return "rodas5p" if is_stiff == (asked_for == "auto") else "tsit5"


def with_method(
    settings: SolverSettings, loop: ClosedLoop, x0: Any, t1: RealScalarLike, nominal: float | None = None
) -> SolverSettings:
    """The settings with a method in place of `"auto"` or `"other"`; as for a loop that is not stiff while it is traced.

    Args:
        settings: The settings.
        loop: The loop.
        x0: Its start, n numbers.
        t1: The horizon [s].
        nominal: Stiffness of the nominal run of the study; None for a run on its own.
    """
    if settings.method not in BY_STIFFNESS:
        return settings
    own = 0.0 if is_traced(loop, x0, t1) else float(stiffness(loop, x0, t1))
    return settings.replace(method=method_for(own, own if nominal is None else nominal, settings.method))
