r"""How imperfectly the law may be implemented: limits on saturation, sampling, delay, actuator and noise.

Notation: $\dot\sigma = w + g u$ with the residual w (all that is not the input: drift, reference, disturbance,
$\sum_j c_j e^{(j)}$) and the gain g, here $|g|$; $z = \sigma / \rho$; $u = -\tan(\pi z / 2)$. Against a constant w the
law rests at $|u| = |w| / g$, where its slope makes the loop gain $k' = \frac{\pi g}{2 \rho} (1 + (w / g)^2)$ [1/s].

Each limit says what it is worth:

- LOCAL: exact for the loop linearised there, with w, g and $\rho$ frozen and the loop transfer function
  $L(s) = k' p(s) / s^n$, p the polynomial of the surface. It is where stability is first lost, counted from the ideal
  loop. That one is stable for n = 1 and 2, but for n >= 3 only if $k'$ is large enough; otherwise nothing is left to
  lose, and periods, delays and lags are 0, the actuator frequency is `inf`.
- SUFFICIENT: every run that meets the bounds keeps the funnel.
- NECESSARY: beyond it some admissible run leaves the funnel.

Numbers only, nothing traced; results are Python floats. Arguments out of range raise `InputError`.
"""

from qsmc_jax.control.thresholds.local import critical_actuator_frequency as critical_actuator_frequency
from qsmc_jax.control.thresholds.local import critical_delay as critical_delay
from qsmc_jax.control.thresholds.local import critical_lag as critical_lag
from qsmc_jax.control.thresholds.local import critical_period as critical_period
from qsmc_jax.control.thresholds.local import escape_time as escape_time
from qsmc_jax.control.thresholds.local import noise_gain as noise_gain
from qsmc_jax.control.thresholds.local import small_signal_gain as small_signal_gain
from qsmc_jax.control.thresholds.sufficient import SufficientPeriod as SufficientPeriod
from qsmc_jax.control.thresholds.sufficient import necessary_saturation as necessary_saturation
from qsmc_jax.control.thresholds.sufficient import sufficient_period as sufficient_period
from qsmc_jax.control.thresholds.sufficient import sufficient_saturation as sufficient_saturation
