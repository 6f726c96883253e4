"""A law that is given estimates: output feedback by a high-gain observer."""

import math
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.module import float_field
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.control.control import AbstractControl, Sample
from qsmc_jax.control.controllers.wrapping import AbstractWrappingControl


class HighGainObserver(AbstractWrappingControl):
    r"""Another law on errors that are estimated from the measured output alone.

    $\dot{\hat e}_i = \hat e_{i+1} + \binom{n}{i+1} \omega^{i+1} (e - \hat e_0)$, i = 0 ... n - 1, $\hat e_n = 0$: all
    poles at $-\omega$. It starts from the first sample, $\hat e = (e, 0, \dots, 0)$, and takes the output as constant
    over the period that has passed, which is solved exactly. As $\omega$ grows the loop comes to that with measured
    errors, in proportion to $1 / \omega$; noise grows with $\omega^{n-1}$.

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

    law: AbstractControl
    frequency: Float[Array, ""] = float_field()

    positive: ClassVar[tuple[str, ...]] = ("frequency",)

    def first_memory(self) -> Scalars:
        """Whether there was a sample, the estimates, and what the law keeps."""
        return (0.0, *(0.0,) * self.surface.order, *self.law.first_memory())

    def command(self, sample: Sample, memory: Scalars) -> tuple[RealScalarLike, Scalars]:
        n, measured = self.surface.order, sample.errors[0]
        known = self.estimated(memory[1 : n + 1], measured, sample.period)
        first = (measured, *(0.0,) * (n - 1))
        estimates = tuple(jnp.where(memory[0] > 0.0, *each) for each in zip(known, first, strict=True))
        given = sample._replace(errors=estimates, sigma=self.surface(estimates))
        u, kept = self.law.command(given, memory[n + 1 :])
        return u, (jnp.ones(()), *estimates, *kept)

    def estimated(self, estimates: Scalars, measured: RealScalarLike, period: RealScalarLike) -> Scalars:
        """The estimates one period later.

        Args:
            estimates: n scalars.
            measured: The error of the output, as measured now.
            period: Time that has passed [s].
        """
        # In units of 1 / omega the matrix has the one eigenvalue -1: its exponential is a finite sum.
        n, x = len(estimates), self.frequency * period
        matrix = np.eye(n, k=1)
        matrix[:, 0] -= [math.comb(n, i + 1) for i in range(n)]
        rest = matrix + np.eye(n)
        powers = [np.linalg.matrix_power(rest, k) / math.factorial(k) for k in range(n)]
        scaled = [each / self.frequency**i for i, each in enumerate((estimates[0] - measured, *estimates[1:]))]
        moved = [
            jnp.exp(-x) * sum(x**k * power[i, j] * scaled[j] for k, power in enumerate(powers) for j in range(n))
            for i in range(n)
        ]
        found = [value * self.frequency**i for i, value in enumerate(moved)]
        return (found[0] + measured, *found[1:])
