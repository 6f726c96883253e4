"""A law that is given estimates: output feedback by a high-gain observer."""

import math

import numpy as np
from jaxtyping import Float

from qsmc_jax.control.controllers.estimator import AbstractEstimator


class HighGainObserver(AbstractEstimator):
    r"""Another law on errors that are estimated from the measured output alone.

    $\dot{\hat e}_i = \hat e_{i+1} + \binom{n}{i+1} \omega^{i+1} (e - \hat e_0)$, i = 0 ... n - 1, $\hat e_n = 0$: all
    poles at $-\omega$. It starts from the first measurement, $\hat e = (e, 0, \dots, 0)$; in a sampled loop it takes
    the output as constant over the period that has passed, which is solved exactly. As $\omega$ grows the loop comes to
    that with measured errors, in proportion to $1 / \omega$; noise grows with $\omega^{n-1}$. At first estimates peak,
    and a law that is made for the funnel may ask for very much: limit it, `Saturated(HighGainObserver(...), ...)`.

    Attributes:
        law: The law that is given the estimates.
        frequency: $\omega$ [rad/s], positive.

    Examples:
        A ramp is told from its samples:

        >>> import qsmc_jax as qj
        >>> inner = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> observer = qj.controllers.HighGainObserver(inner, frequency=50.0)
        >>> estimates = (0.0, 0.0)
        >>> for k in range(40):
        ...     estimates = observer.estimated(estimates, measured=0.01 * k, period=0.01)
        >>> [round(float(value), 2) for value in estimates]
        [0.39, 0.98]

    Source: Khalil and Praly, High-gain observers in nonlinear feedback control, Int. J. Robust Nonlinear Control 24
    (2014).
    """

    def matrix(self, n: int) -> Float[np.ndarray, "n n"]:
        matrix = np.eye(n, k=1)
        matrix[:, 0] -= [math.comb(n, i + 1) for i in range(n)]
        return matrix
