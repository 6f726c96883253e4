"""One loop to be solved, with all that a solve refers to."""

import abc
import itertools as it
import math
from collections.abc import Hashable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import RealScalarLike, Scalars, State
from qsmc_jax.channel import Channel
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.metrics.metric import AbstractMeasure
from qsmc_jax.multivariable import MultivariableLoop
from qsmc_jax.numerics.barrier import Barrier
from qsmc_jax.numerics.gudermann import funnel_coordinate
from qsmc_jax.simulation.ideal.coordinates import AbstractCoordinates, funnel_tolerances
from qsmc_jax.simulation.ideal.lifted import funnel_rate
from qsmc_jax.simulation.settings import SolverSettings


class AbstractProblem(AbstractModule):
    """What is to be solved: a loop with one input, or several channels that belong together.

    Attributes:
        barrier: Around what is used more than once.
        rtol: Relative tolerance of the solve.
        measures: The study's own metrics and requirements.
    """

    barrier: eqx.AbstractVar[Barrier]
    rtol: eqx.AbstractVar[RealScalarLike]
    measures: eqx.AbstractVar[tuple[AbstractMeasure, ...]]

    @property
    @abc.abstractmethod
    def channels(self) -> "tuple[Problem, ...]":
        """Each channel as a problem; of a loop with one input itself."""

    @property
    @abc.abstractmethod
    def breaks_by_part(self) -> list[Array]:
        """Times [s] at which a part of the loop jumps."""

    @abc.abstractmethod
    def start(self, x0: State) -> Scalars:
        """The coordinates at time 0."""

    @abc.abstractmethod
    def vector_field(self, t: RealScalarLike, y: State) -> Scalars:
        """Their derivative."""

    @abc.abstractmethod
    def tolerances(self, size: State, settings: SolverSettings) -> tuple[Scalars, Scalars]:
        """The error that one step may make in each, whose size is given: the relative part, the absolute."""

    @property
    def break_times(self) -> list[Array]:
        """Times [s] that steps must not cross: where parts of the loop jump, and where windows begin and end."""
        parts = it.chain.from_iterable(each.parts for each in self.measures)
        ends = {end for part in parts for end in (part.after, part.before)} - {0.0, math.inf}
        return [*self.breaks_by_part, jnp.array(sorted(ends), float)]


class Problem(AbstractProblem):
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
    def channels(self) -> "tuple[Problem, ...]":
        return (self,)

    @property
    def breaks_by_part(self) -> list[Array]:
        return self.loop.breaks_by_part

    def start(self, x0: State) -> Scalars:
        return self.coordinates.start(self.loop, x0)

    def vector_field(self, t: RealScalarLike, y: State) -> Scalars:
        return self.coordinates.vector_field(t, y, self.loop)

    def tolerances(self, size: State, settings: SolverSettings) -> tuple[Scalars, Scalars]:
        return self.coordinates.tolerances(size, settings)


class JointProblem(AbstractProblem):
    r"""Several channels to be solved together, in $y = (x_1, \dots, x_N, s_1, \dots, s_m)$.

    What laws keep stands between states and funnel coordinates.

    Attributes:
        loop: The loop of all of them.
        parts: Each channel as a problem, in `ChannelCoordinates`.
        barrier: Around what is used more than once.
        rtol: Relative tolerance of the solve.
        measures: The study's own metrics and requirements.
    """

    loop: MultivariableLoop
    parts: tuple[Problem, ...]
    barrier: Barrier
    rtol: RealScalarLike = 1e-6
    measures: tuple[AbstractMeasure, ...] = eqx.field(static=True, default=())

    @property
    def channels(self) -> tuple[Problem, ...]:
        return self.parts

    @property
    def breaks_by_part(self) -> list[Array]:
        return self.loop.breaks_by_part

    def start(self, x0: State) -> Scalars:
        return (*x0, *(funnel_coordinate(each.loop.ratio(0.0, x0)) for each in self.channels))

    def vector_field(self, t: RealScalarLike, y: State) -> Scalars:
        once, loop = self.barrier, self.loop
        y = once(tuple(y))
        x = y[: loop.plant.states]
        first = self.channels[0].loop.plant
        assert isinstance(first, Channel)
        free, rows = once((tuple(loop.plant.vector_field(t, x, first.disturbed(t))), loop.plant.input_matrix(t, x)))
        inputs = once(first.inputs(t, y))
        rates = once(
            tuple(
                each + sum(entry * u for entry, u in zip(row, inputs, strict=True))
                for each, row in zip(free, rows, strict=True)
            )
        )
        turns = (
            funnel_rate(each.loop, t, y, each.coordinates.funnel_coordinate(each.loop, t, y), rates)
            for each in self.channels
        )
        return (*rates, *first.memory_rates(t, y), *turns)

    def tolerances(self, size: State, settings: SolverSettings) -> tuple[Scalars, Scalars]:
        return funnel_tolerances(size, settings, len(self.channels))
