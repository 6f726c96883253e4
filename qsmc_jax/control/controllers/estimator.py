"""What laws have in common that give another law estimates in place of measured errors."""

import abc
import math
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.module import as_float64, float_field
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.control.control import AbstractControl, Sample
from qsmc_jax.control.controllers.wrapping import AbstractWrappingControl
from qsmc_jax.control.dynamic_control import AbstractDynamicControl, memory_at_start, memory_rates


class AbstractEstimator(AbstractWrappingControl, AbstractDynamicControl):
    r"""Another law on errors that are estimated from the output's alone, by n linear states with all poles at -omega.

    In units of $\omega$, $\hat e_i = \omega^i v_i$, they follow $\dot v = \omega A (v - (e, 0, \dots, 0))$. From sample
    to sample the output counts as constant over the period that has passed, which is solved exactly. It starts from the
    first measurement, $\hat e = (e, 0, \dots, 0)$. The memory is whether there was one, the estimates, and what the law
    keeps.

    Attributes:
        law: The law that is given the estimates.
        frequency: $\omega$ [rad/s], positive.
    """

    law: AbstractControl
    frequency: Float[Array, ""] = float_field()

    positive: ClassVar[tuple[str, ...]] = ("frequency",)

    # Written out for type checkers, which would take what is the law's own for arguments.
    def __init__(self, law: AbstractControl, frequency: Any):
        self.law, self.frequency = law, as_float64(frequency)

    @abc.abstractmethod
    def matrix(self, n: int) -> Float[np.ndarray, "n n"]:
        """The matrix A, whose only eigenvalue is -1.

        Args:
            n: The number of errors.
        """

    def first_memory(self) -> Scalars:
        """Whether there was a sample, the estimates, and what the law keeps."""
        return (0.0, *(0.0,) * self.surface.order, *self.law.first_memory())

    def command(self, sample: Sample, memory: Scalars) -> tuple[RealScalarLike, Scalars]:
        n, measured = self.surface.order, sample.errors[0]
        known = self.estimated(memory[1 : n + 1], measured, sample.period)
        estimates = tuple(jnp.where(memory[0] > 0.0, *each) for each in zip(known, self._first(sample), strict=True))
        u, kept = self.law.command(self._given(sample, estimates), memory[n + 1 :])
        return u, (jnp.ones(()), *estimates, *kept)

    def memory_at_start(self, sample: Sample) -> Scalars:
        first = self._first(sample)
        return (1.0, *first, *memory_at_start(self.law, self._given(sample, first)))

    def memory_rates(self, sample: Sample, memory: Scalars) -> Scalars:
        n, omega = self.surface.order, self.frequency
        estimates, of_law = memory[1 : n + 1], memory[n + 1 :]
        off = _minus(self._scaled(estimates), sample.errors[0])
        moved = [omega * sum(a * v for a, v in zip(row, off, strict=True)) for row in self.matrix(n)]
        return (0.0, *self._unscaled(moved), *memory_rates(self.law, self._given(sample, estimates), of_law))

    def estimated(self, estimates: Scalars, measured: RealScalarLike, period: RealScalarLike) -> Scalars:
        """The estimates one period later.

        Args:
            estimates: n scalars.
            measured: The error of the output, as measured now.
            period: Time that has passed [s].
        """
        # The matrix has the one eigenvalue -1: its exponential is a finite sum.
        n, x = len(estimates), self.frequency * period
        rest = self.matrix(n) + np.eye(n)
        powers = [np.linalg.matrix_power(rest, k) / math.factorial(k) for k in range(n)]
        off = _minus(self._scaled(estimates), measured)
        moved = [
            jnp.exp(-x) * sum(x**k * power[i, j] * off[j] for k, power in enumerate(powers) for j in range(n))
            for i in range(n)
        ]
        found = self._unscaled(moved)
        return (found[0] + measured, *found[1:])

    def _first(self, sample: Sample) -> Scalars:
        """The estimates at the first measurement."""
        return (sample.errors[0], *(0.0,) * (self.surface.order - 1))

    def _given(self, sample: Sample, estimates: Scalars) -> Sample:
        return sample._replace(errors=estimates, sigma=self.surface(estimates))

    def _scaled(self, estimates: Scalars) -> list[RealScalarLike]:
        return [each / self.frequency**i for i, each in enumerate(estimates)]

    def _unscaled(self, scaled: list[RealScalarLike]) -> Scalars:
        return tuple(each * self.frequency**i for i, each in enumerate(scaled))


def _minus(scaled: list[RealScalarLike], measured: RealScalarLike) -> list[RealScalarLike]:
    """How far the states are from where they rest for a constant output."""
    return [scaled[0] - measured, *scaled[1:]]
