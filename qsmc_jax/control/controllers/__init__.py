r"""Controllers to compare the quasi-sliding-mode law with, on its sliding variable and judged by its funnel.

They read what that law reads, $\sigma$ with $\dot\sigma = w + g u$. `Sign`, `BoundaryLayer`, `SuperTwisting` and
`ProportionalDerivative` are defined everywhere, so that `Sample.beyond` makes no difference; the other two are made
for the funnel, as that law is.

A comparison is worth something on equal terms only. So each class makes its controller from the quasi-sliding-mode one
that it is to be compared with, by a stated rule: the same slope at $\sigma = 0$, the same error at rest, or gains from
a bound on what they have to overcome. Traced numbers will do.

`HighGainObserver` and `StateVariableFilter` give any of them, or the quasi-sliding-mode law, estimates in place of
measured errors; `Saturated` limits their input.
"""

from qsmc_jax.control.controllers.boundary_layer import BoundaryLayer as BoundaryLayer
from qsmc_jax.control.controllers.funnel_control import FunnelControl as FunnelControl
from qsmc_jax.control.controllers.high_gain_observer import HighGainObserver as HighGainObserver
from qsmc_jax.control.controllers.prescribed_performance import PrescribedPerformance as PrescribedPerformance
from qsmc_jax.control.controllers.proportional_derivative import ProportionalDerivative as ProportionalDerivative
from qsmc_jax.control.controllers.saturated import Saturated as Saturated
from qsmc_jax.control.controllers.sign import Sign as Sign
from qsmc_jax.control.controllers.state_variable_filter import StateVariableFilter as StateVariableFilter
from qsmc_jax.control.controllers.super_twisting import SuperTwisting as SuperTwisting
