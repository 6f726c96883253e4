"""A law that is given filtered errors: nothing is differentiated."""

import math

import numpy as np
from jaxtyping import Float

from qsmc_jax.control.controllers.estimator import AbstractEstimator


class StateVariableFilter(AbstractEstimator):
    r"""Another law on the states of a low-pass filter of the measured output, which needs no derivative of it.

    $(1 + s / \omega)^n \hat e_0 = e$ and $\hat e_i = \hat e_0^{(i)}$: the estimates are the errors of a filtered
    output, late by some $n / \omega$. The highest is that of `HighGainObserver` with the same poles; the lower ones are
    smoother than there, and later. As $\omega$ grows the loop comes to that with measured errors, in proportion to
    $1 / \omega$.

    Attributes:
        law: The law that is given the estimates.
        frequency: $\omega$ [rad/s], positive.

    Examples:
        A ramp is told from its samples, late by 2 / 50 s:

        >>> import qsmc_jax as qj
        >>> inner = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> filtered = qj.controllers.StateVariableFilter(inner, frequency=50.0)
        >>> estimates = (0.0, 0.0)
        >>> for k in range(40):
        ...     estimates = filtered.estimated(estimates, measured=0.01 * k, period=0.01)
        >>> [round(float(value), 2) for value in estimates]
        [0.35, 0.98]

    Source: Young, Parameter estimation for continuous-time models, Automatica 17 (1981).
    """

    def matrix(self, n: int) -> Float[np.ndarray, "n n"]:
        matrix = np.eye(n, k=1)
        matrix[-1] -= [math.comb(n, i) for i in range(n)]
        return matrix
