"""The controller's side of a sampled loop: what it keeps, and what it does at a sample."""

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.control.control import Sample
from qsmc_jax.implementation.implementation import Implementation
from qsmc_jax.simulation.problem import Problem
from qsmc_jax.simulation.sampled.accumulate import RunningCommandMetrics, add_command
from qsmc_jax.simulation.sampled.cell import LoopPoint


class Computer(AbstractModule):
    """The controller's side: what it keeps, and the commands under way.

    Attributes:
        memory: The law's own memory.
        sent: The last command computed.
        held: The command that the actuator has.
        sample: Number of the next sample.
        arrival: Number of the next command to arrive.
        queue: Commands under way, that of sample k at k modulo the length; None if none are ever.
        has_overflown: Whether more commands were under way than the queue holds.
    """

    memory: Scalars
    sent: RealScalarLike
    held: RealScalarLike
    sample: RealScalarLike
    arrival: RealScalarLike
    queue: Float[Array, " queue"] | None
    has_overflown: Bool[Array, ""]


def sample(
    problem: Problem,
    implementation: Implementation,
    now: LoopPoint,
    computer: Computer,
    commands: RunningCommandMetrics,
) -> tuple[Computer, RunningCommandMetrics]:
    """The computer after one more sample, and the metrics of its commands.

    Args:
        problem: The loop.
        implementation: Its implementation.
        now: Where the loop is.
        computer: The computer before.
        commands: The metrics before.
    """
    loop, k = problem.loop, computer.sample
    is_old = implementation.measurement_delay is not None
    is_exact = implementation.noise is None and implementation.measurement_resolution is None
    t = implementation.instant(k) if is_old else now.t
    funnel = loop.control.funnel
    rho, centre = (funnel(t), funnel.centre(t)) if is_old else (now.rho, now.centre)
    desired = loop.desired(t, now.x)
    if is_old or not is_exact:
        # What runs beside the plant is the controller's own.
        measured = (*implementation.measured(now.x[: loop.measured], t, k), *now.x[loop.measured :])
        errors = loop.errors(t, measured)
        sigma = loop.control.surface(errors)
    else:
        errors, sigma = now.errors, now.sigma
    given = Sample(t, implementation.sample_period, sigma, rho, desired, implementation.beyond, centre, errors)
    wanted, memory = loop.control.command(given, computer.memory)
    command = problem.barrier(implementation.limited(wanted, computer.sent))
    is_steady = t >= problem.reaching_time
    accumulated = add_command(commands, command, computer.sent, implementation.sample_period, is_steady)
    new = dataclasses.replace(computer, memory=memory, sent=command, sample=k + 1.0)
    if computer.queue is None:
        return dataclasses.replace(new, held=command), accumulated
    place = place_in(computer.queue, k)
    is_full = k - computer.arrival >= computer.queue.shape[0]
    queue, has_overflown = computer.queue.at[place].set(command), computer.has_overflown | is_full
    return dataclasses.replace(new, queue=queue, has_overflown=has_overflown), accumulated


def place_in(queue: Float[Array, " queue"], k: RealScalarLike) -> Int[Array, ""]:
    """Where in the queue the command of sample k lies."""
    return jnp.asarray(k % queue.shape[0]).astype(int)
