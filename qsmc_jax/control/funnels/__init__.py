r"""Funnels of other shapes than the paper's; what the law does in them is the same, on $(\sigma - m) / \rho$.

`FiniteTime` and `PrescribedTime` end at a time that is chosen. `Asymmetric` has two edges of its own, say to bound the
overshoot. `Smooth` is any smooth function of time.
"""

from qsmc_jax.control.funnels.asymmetric import Asymmetric as Asymmetric
from qsmc_jax.control.funnels.finite_time import FiniteTime as FiniteTime
from qsmc_jax.control.funnels.prescribed_time import PrescribedTime as PrescribedTime
from qsmc_jax.control.funnels.smooth import Smooth as Smooth
