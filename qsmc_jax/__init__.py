"""Batched simulation and verification of quasi-sliding-mode control loops, in JAX.

See `simulate` for one run, `Study` and `monte_carlo` for many, `verify` for a verdict with its confidence.
"""

from qsmc_jax.control.funnel import Funnel as Funnel
from qsmc_jax.control.law import QuasiSlidingControl as QuasiSlidingControl
from qsmc_jax.control.surface import SlidingSurface as SlidingSurface
from qsmc_jax.loop import ClosedLoop as ClosedLoop
from qsmc_jax.model import disturbances as disturbances
from qsmc_jax.model import plants as plants
from qsmc_jax.model import references as references
from qsmc_jax.model.disturbances import AbstractDisturbance as AbstractDisturbance
from qsmc_jax.model.plants import AbstractPlant as AbstractPlant
from qsmc_jax.model.references import AbstractReference as AbstractReference
from qsmc_jax.simulate.figures import Figures as Figures
from qsmc_jax.simulate.outcome import Outcome as Outcome
from qsmc_jax.simulate.outcome import Verdict as Verdict
from qsmc_jax.simulate.settings import SolverSettings as SolverSettings
from qsmc_jax.simulate.trajectory import Trajectory as Trajectory
from qsmc_jax.simulate.trajectory import simulate as simulate
from qsmc_jax.study.monte_carlo import monte_carlo as monte_carlo
from qsmc_jax.study.runs import Runs as Runs
from qsmc_jax.study.sampling import LatinHypercube as LatinHypercube
from qsmc_jax.study.sampling import Random as Random
from qsmc_jax.study.sampling import Sobol as Sobol
from qsmc_jax.study.study import Scenario as Scenario
from qsmc_jax.study.study import Study as Study
