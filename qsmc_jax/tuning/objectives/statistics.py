"""The statistics over runs of which objectives and constraints are made."""

from qsmc_jax.tuning.objectives.objective import Constraint, Objective
from qsmc_jax.tuning.terms import METRICS as METRICS
from qsmc_jax.tuning.terms import Term


def mean(metric: str) -> Objective:
    """The mean of a column over the runs.

    Args:
        metric: The column, one of `METRICS` or `peak_error[i]`.

    Examples:
        >>> import numpy as np
        >>> import qsmc_jax as qj
        >>> columns = {"peak_u": np.array([1.0, 2.0, 3.0, 6.0])}
        >>> qj.objectives.mean("peak_u").evaluate(columns)[0]
        3.0
    """
    return Objective((Term("mean", metric),))


def cvar(metric: str, level: float = 0.9) -> Objective:
    """The mean of the largest 1 - `level` of a column: conditional value at risk.

    Args:
        metric: The column, one of `METRICS` or `peak_error[i]`.
        level: Part of the runs that is left out, in [0, 1).

    Examples:
        >>> import numpy as np
        >>> import qsmc_jax as qj
        >>> columns = {"peak_u": np.array([1.0, 2.0, 3.0, 6.0])}
        >>> qj.objectives.cvar("peak_u", 0.5).evaluate(columns)[0]
        4.5

    Source: Rockafellar and Uryasev, J. Risk 2 (2000).
    """
    return Objective((Term("cvar", metric, level=level),))


def worst(metric: str) -> Objective:
    """The largest of a column.

    Args:
        metric: The column, one of `METRICS` or `peak_error[i]`.

    Examples:
        >>> import numpy as np
        >>> import qsmc_jax as qj
        >>> columns = {"peak_u": np.array([1.0, 2.0, 3.0, 6.0])}
        >>> qj.objectives.worst("peak_u").evaluate(columns)[0]
        6.0
    """
    return Objective((Term("worst", metric),))


def least(metric: str) -> Objective:
    """The smallest of a column.

    Args:
        metric: The column, one of `METRICS` or `peak_error[i]`.

    Examples:
        >>> import numpy as np
        >>> import qsmc_jax as qj
        >>> columns = {"peak_u": np.array([1.0, 2.0, 3.0, 6.0])}
        >>> qj.objectives.least("peak_u").evaluate(columns)[0]
        1.0
    """
    return Objective((Term("least", metric),))


def violation(probability: float | int) -> Constraint:
    r"""A constraint that implies a probability of at most `probability` of leaving the funnel, over the training runs.

    $\mathrm{CVaR}_{1-p}(\sup|\sigma|/\rho) \le 1$ implies $P(\sup|\sigma|/\rho \ge 1) \le p$, and has a derivative. A
    run that left counts as 0.01 beyond its peak; one that ended there, or could not be decided, as 1.01 and the part of
    its horizon that it lost, so that leaving later is better, and every run that held is better still.

    Args:
        probability: What it may be at most, above 0.

    Examples:
        >>> import qsmc_jax as qj
        >>> str(qj.objectives.violation(0.01))
        'cvar(peak_ratio, 0.99) <= 1'
    """
    return cvar("peak_ratio", 1.0 - probability) <= 1.0
