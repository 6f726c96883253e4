"""What a run of a sampled loop carries from cell to cell."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike, Scalars
from qsmc_jax.implementation.implementation import Implementation
from qsmc_jax.metrics.accumulate import States
from qsmc_jax.simulation.break_times import Cursor
from qsmc_jax.simulation.problem import Problem
from qsmc_jax.simulation.sampled.accumulate import RunningCellMetrics, RunningCommandMetrics
from qsmc_jax.simulation.sampled.cell import LoopPoint
from qsmc_jax.simulation.sampled.computer import Computer

# A run is lost once it is this many funnel widths away, or this many times as far as it started.
_LOST = 1000.0


class Saved(AbstractModule):
    """States and inputs at the times asked for, `ts`, and how many there are so far."""

    ts: Float[Array, " times"]
    x: tuple[Float[Array, " times"], ...]
    u: tuple[Float[Array, " times"], ...]
    count: Int[Array, ""]


class ChannelState(AbstractModule):
    """What one channel carries, or the only one.

    Attributes:
        now: Where it is, without inputs.
        actuator: State of the actuator; empty if there is none.
        computer: The controller's side.
        first_ratio: |z| at the start, z where in the funnel the sliding variable is.
        cells: Metrics of the plant.
        commands: Metrics of the commands.
    """

    now: LoopPoint
    actuator: Scalars
    computer: Computer
    first_ratio: RealScalarLike
    cells: RunningCellMetrics
    commands: RunningCommandMetrics

    @property
    def starts_outside(self) -> BoolScalarLike:
        """Whether it started outside the funnel."""
        return jnp.asarray(self.first_ratio >= 1.0)

    @property
    def farthest(self) -> RealScalarLike:
        """How far out, in funnel widths, it counts as lost."""
        return _LOST * jnp.maximum(1.0, self.first_ratio)

    @property
    def is_lost(self) -> BoolScalarLike:
        """Whether it is that far out."""
        return jnp.abs(self.now.ratio) >= self.farthest

    @property
    def goes_on(self) -> BoolScalarLike:
        """Whether it can be followed further: it is not that far out, and its queue has held all commands."""
        return (jnp.abs(self.now.ratio) < self.farthest) & ~self.computer.has_overflown


class LoopState(AbstractModule):
    """Everything that a run carries.

    Attributes:
        channels: What each channel carries.
        own: Metrics and requirements of the study.
        step: Length [s] of the longest cell that the tolerance allows, as far as is known.
        steps: Cells tried so far.
        cursor: Which breaks are still ahead.
        is_running: Whether the run goes on.
        saved: States and inputs at the times asked for.
    """

    channels: tuple[ChannelState, ...]
    own: States
    step: RealScalarLike
    steps: RealScalarLike
    cursor: Cursor
    is_running: Bool[Array, ""]
    saved: Saved | None

    @property
    def t(self) -> RealScalarLike:
        """The time [s] up to which it has got."""
        return self.channels[0].now.t

    @property
    def points(self) -> tuple[LoopPoint, ...]:
        """Where each channel is."""
        return tuple(each.now for each in self.channels)


def implementation_of(problem: Problem) -> Implementation:
    """The implementation of a channel, which has one."""
    assert problem.loop.implementation is not None
    return problem.loop.implementation
