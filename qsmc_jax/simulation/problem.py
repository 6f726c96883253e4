"""One loop to be solved, with all that a solve refers to."""

import itertools as it
import math
from collections.abc import Hashable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.metrics.metric import AbstractMeasure
from qsmc_jax.numerics.barrier import Barrier
from qsmc_jax.simulation.ideal.coordinates import AbstractCoordinates


class Problem(AbstractModule):
    """One loop to be solved, with the thresholds that the metrics refer to.

    Attributes:
        loop: The closed loop.
        coordinates: In which it is integrated.
        bandwidth: The bandwidth of quasi-sliding mode, epsilon, of the sliding variable.
        reaching_time: t_r [s], after which errors count as steady; `inf` if there is none.
        error_bounds: What |sigma| < epsilon implies for each error, n scalars.
        settling_time: t_s [s], from which on the funnel guarantees that the errors keep their bounds; `inf` if never.
        barrier: Around what is used more than once.
        made_of: What its functions read from outside, in so far as it is known; programs are kept by it too.
        rtol: Relative tolerance of the solve.
        measures: The study's own metrics and requirements.
    """

    loop: ClosedLoop
    coordinates: AbstractCoordinates
    bandwidth: RealScalarLike
    reaching_time: RealScalarLike
    error_bounds: Scalars
    settling_time: RealScalarLike
    barrier: Barrier
    made_of: Hashable = eqx.field(static=True, default=())
    rtol: RealScalarLike = 1e-6
    measures: tuple[AbstractMeasure, ...] = eqx.field(static=True, default=())

    @property
    def break_times(self) -> list[Array]:
        """Times [s] that steps must not cross: where parts of the loop jump, and where windows begin and end."""
        parts = it.chain.from_iterable(each.parts for each in self.measures)
        ends = {end for part in parts for end in (part.after, part.before)} - {0.0, math.inf}
        return [*self.loop.breaks_by_part, jnp.array(sorted(ends), float)]
