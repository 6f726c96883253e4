"""A law whose input is limited."""

import math
from typing import Any, ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require_range
from qsmc_jax.base.module import as_float64, float_field
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.control.control import AbstractControl, Sample
from qsmc_jax.control.controllers.estimator import AbstractEstimator
from qsmc_jax.control.controllers.wrapping import AbstractWrappingControl
from qsmc_jax.control.dynamic_control import AbstractDynamicControl, memory_at_start, memory_rates
from qsmc_jax.control.law import QuasiSlidingControl


class Saturated(AbstractWrappingControl, AbstractDynamicControl):
    r"""Another law between two numbers, in continuous time too: $u = \operatorname{clip}(u_1, u_\min, u_\max)$.

    So the ideal loop tells what a limit alone does, without a sampling period. `Implementation.input_range` limits the
    command of a sampled loop. What keeps the funnel for certain: `qj.thresholds.sufficient_saturation`.

    Attributes:
        law: The law.
        input_range: Least and largest input; one may be infinite.

    Examples:
        >>> import qsmc_jax as qj
        >>> inner = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(rho0=1.0, mu=1.0, rho_inf=0.1))
        >>> law = qj.controllers.Saturated(inner, input_range=(0.0, 5.0))
        >>> [float(law.command(qj.Sample(0.0, 0.0, s, 1.0, (0.0, 0.0)), ())[0].round(3)) for s in (0.5, -0.5, -0.99)]
        [0.0, 1.0, 5.0]
    """

    law: AbstractControl
    input_range: Float[Array, " 2"] = float_field()

    positive: ClassVar[tuple[str, ...]] = ("room",)

    # Written out for type checkers, which would take what is the law's own for arguments.
    def __init__(self, law: AbstractControl, input_range: Any):
        self.law, self.input_range = law, as_float64(input_range)

    def __check_init__(self):
        require_range("input_range", self.input_range)

    @property
    def room(self) -> RealScalarLike:
        """Between the limits, at most 1: positive."""
        return jnp.minimum(self.input_range[1] - self.input_range[0], 1.0)

    def first_memory(self) -> Scalars:
        return self.law.first_memory()

    def command(self, sample: Sample, memory: Scalars) -> tuple[RealScalarLike, Scalars]:
        # What the law would give beyond its edge is of no account: it is at its limit there.
        u, kept = self.law.command(sample._replace(beyond="saturate"), memory)
        return jnp.clip(u, self.input_range[0], self.input_range[1]), kept

    def memory_at_start(self, sample: Sample) -> Scalars:
        return memory_at_start(self.law, sample)

    def memory_rates(self, sample: Sample, memory: Scalars) -> Scalars:
        return memory_rates(self.law, sample, memory)


def is_of_coordinate(law: AbstractControl) -> bool:
    """Whether an input is a known function of the funnel coordinate and time: the quasi-sliding law's, limited or not.

    Args:
        law: The law.
    """
    return isinstance(law, QuasiSlidingControl) or (isinstance(law, Saturated) and is_of_coordinate(law.law))


def limits_of(law: AbstractControl) -> tuple[RealScalarLike, RealScalarLike]:
    """Between which numbers the input of any law lies for certain; infinite ones if none are known.

    Args:
        law: The law.
    """
    if isinstance(law, Saturated):
        return law.input_range[0], law.input_range[1]
    # An estimator hands on what the law inside gives.
    return limits_of(law.law) if isinstance(law, AbstractEstimator) else (-math.inf, math.inf)
