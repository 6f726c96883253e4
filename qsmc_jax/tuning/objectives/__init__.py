"""What to make small, and what to keep: statistics over runs of a column of their table, to be added and compared.

`cvar("peak_error[0]", 0.9) + 0.01 * mean("energy_u")` is an objective; `worst("peak_u") <= 20` is a constraint.

A run whose metric is not known (an ideal loop that left the funnel, a solve that could not decide) is never passed
over: every statistic over it is infinite, an objective upwards and a constraint beyond its bound. Only `violation <= p`
counts such a run by a number: more than 1, by what it lost of its horizon.
"""

from qsmc_jax.tuning.objectives.objective import Constraint as Constraint
from qsmc_jax.tuning.objectives.objective import Objective as Objective
from qsmc_jax.tuning.objectives.parser import parse_constraint as parse_constraint
from qsmc_jax.tuning.objectives.parser import parse_objective as parse_objective
from qsmc_jax.tuning.objectives.statistics import cvar as cvar
from qsmc_jax.tuning.objectives.statistics import least as least
from qsmc_jax.tuning.objectives.statistics import mean as mean
from qsmc_jax.tuning.objectives.statistics import violation as violation
from qsmc_jax.tuning.objectives.statistics import worst as worst
from qsmc_jax.tuning.terms import METRICS as METRICS
