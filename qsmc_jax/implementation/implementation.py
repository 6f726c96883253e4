"""The implementation of a controller: what of the paper's continuous, unlimited, exact input reality leaves."""

import dataclasses
import functools as ft
import math
from typing import Any, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import (
    is_traced,
    require,
    require_count,
    require_finite,
    require_nonnegative,
    require_positive,
    require_range,
    show,
)
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.module import AbstractModule, float_field
from qsmc_jax.base.types import BoolScalarLike, DrawLike, RealScalarLike, Scalars
from qsmc_jax.control.control import Beyond
from qsmc_jax.implementation.actuators import AbstractActuator
from qsmc_jax.implementation.noises import AbstractNoise
from qsmc_jax.implementation.rng import Consumer, uniforms
from qsmc_jax.model.disturbances import AbstractDisturbance
from qsmc_jax.model.disturbances.disturbance import require_disturbances
from qsmc_jax.model.kinks import as_times


class Jitter(AbstractModule):
    """Samples that come late by a random part of the period, independent from sample to sample.

    Attributes:
        fraction: Largest delay of a sample, as a fraction of the period [-], in [0, 1).
        seed: The realisation, a number in [0, 1).

    Examples:
        Samples that come up to a fifth of the period late:

        >>> import jax
        >>> import qsmc_jax as qj
        >>> jitter = qj.Jitter(fraction=0.2)
        >>> with jax.enable_x64(True):
        ...     late = [float(jitter(k)) for k in range(4)]
        >>> 0.0 <= min(late) and max(late) < 0.2
        True
    """

    fraction: Float[Array, ""] = float_field()
    seed: Float[Array, ""] = float_field(default=0.0)

    def __check_init__(self):
        if not is_traced(self.fraction):
            ok = bool(0.0 <= self.fraction < 1.0)
            require(ok, f"Argument `fraction` must be in [0, 1), but is {show(self.fraction)}.")

    def __call__(self, k: RealScalarLike) -> RealScalarLike:
        """By how much sample k is late, in periods [-]."""
        return 0.5 * self.fraction * (1.0 + uniforms(Consumer.JITTER, self.seed, k, 1)[0])

    def is_valid(self) -> BoolScalarLike:
        """Whether the fraction is in range: what the constructor checks, for a traced one."""
        return (self.fraction >= 0.0) & (self.fraction < 1.0)


class GainFault(AbstractModule):
    """A gain that is not what it should be for a while: g is multiplied by a factor on [start, end).

    Attributes:
        start: When it begins [s].
        end: When it ends [s].
        factor: The factor [-]: -1 for a loss of sign, 0 for a loss of the input.

    Examples:
        >>> import qsmc_jax as qj
        >>> fault = qj.GainFault(start=2.0, end=3.0)
        >>> [float(fault(t)) for t in (1.0, 2.0, 3.0)]
        [1.0, -1.0, 1.0]
    """

    start: Float[Array, ""] = float_field()
    end: Float[Array, ""] = float_field()
    factor: Float[Array, ""] = float_field(default=-1.0)

    def __check_init__(self):
        for name in ("start", "end", "factor"):
            require_finite(name, getattr(self, name))
        if not is_traced(self.start, self.end):
            ok = bool(self.start <= self.end)
            require(ok, f"Argument `end` must not be before `start` = {show(self.start)}, but is {show(self.end)}.")

    def __call__(self, t: RealScalarLike) -> RealScalarLike:
        """The factor on g at time t."""
        return jnp.where((t >= self.start) & (t < self.end), self.factor, 1.0)

    def is_valid(self) -> BoolScalarLike:
        """Whether it does not end before it begins: what the constructor checks, for traced times."""
        return jnp.asarray(self.start <= self.end)

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        """When it begins and ends."""
        return jnp.stack([jnp.asarray(self.start, float), jnp.asarray(self.end, float)])


class Implementation(AbstractModule):
    r"""A controller in a computer: sampled, and, as far as asked for, late, limited, coarse, noisy and slow.

    At the instant $t_k = (k + j_k)\tau$ the controller has the states as they were `measurement_delay` before (at
    time 0 at the earliest), plus noise, rounded; the reference and the funnel it knows exactly. From them it computes a
    command, which is rounded, kept in its range and limited in its rate, in this order. The command arrives at the
    actuator `delay` later and is held until the next one. Before the first arrives, it is 0. Everything but the period
    is off by default, at no cost; every number may be drawn.

    In a loop with several inputs each channel is computed so, of one measurement of the states: what is marked by m is
    one number for all channels, or m of them (`input_range`: m pairs; actuator and fault: a tuple).

    Attributes:
        sample_period: The period $\tau$ [s] of the zero-order hold, positive; m.
        jitter: How late samples come.
        delay: Time [s] from a sample to the input it leads to: of computation or transport; any number, not negative;
            m.
        measurement_delay: Age [s] of what is measured, not negative; m.
        saturation: Largest absolute command, positive; m.
        input_range: Least and largest command, such as (0, 4) for a magnet that can only pull; they may be infinite; m.
        rate_limit: Largest change of the command per time, positive; before the first sample it was 0. That of the
            actuator itself is one of `qj.actuators.RateLimited`; m.
        measurement_resolution: Steps to which the states are rounded, n numbers, not negative; 0 for none.
        input_resolution: Step to which the command is rounded, not negative; 0 for none; m.
        noise: Noise on the measured states.
        actuator: What is between the command and the plant's input: a lag, a rate limit, stops, a dead zone; m.
        gain_fault: A gain that is wrong for a while; with several inputs what each input adds to the rates; m.
        unmatched: Disturbances of the first n - 1 states, $\dot x_i = x_{i+1} + d_i(t)$, which the paper excludes:
            n - 1 of them, or none.
        beyond: What the law does outside the funnel, where the paper does not define it: `"saturate"` (it holds the
            value it has just inside) or `"wrap"` (a fault: the tangent as it stands, which points the wrong way).
        cutoff: Angular frequency [rad/s] above which power of the input counts as high-frequency, positive; None stands
            for five times the faster of mu and the surface's mean rate; m.
        queue: Samples under way from measurement to input at most; a longer total delay leaves the run UNDECIDED.

    Raises:
        InputError: A number is out of range, or a part is of the wrong kind.

    Examples:
        >>> import qsmc_jax as qj
        >>> plan = qj.Implementation(sample_period=0.25, saturation=2.0, rate_limit=4.0)
        >>> float(plan.instant(3)), float(plan.limited(5.0, last=0.0)), float(plan.limited(5.0, last=1.5))
        (0.75, 1.0, 2.0)
    """

    sample_period: Float[Array, "..."] = float_field()
    jitter: Jitter | None = None
    delay: Float[Array, "..."] | None = float_field(default=None)
    measurement_delay: Float[Array, "..."] | None = float_field(default=None)
    saturation: Float[Array, "..."] | None = float_field(default=None)
    input_range: Float[Array, "... 2"] | None = float_field(default=None)
    rate_limit: Float[Array, "..."] | None = float_field(default=None)
    measurement_resolution: Float[Array, " n"] | None = float_field(default=None)
    input_resolution: Float[Array, "..."] | None = float_field(default=None)
    noise: AbstractNoise | None = None
    actuator: Any = None
    gain_fault: Any = None
    unmatched: tuple[AbstractDisturbance, ...] = eqx.field(converter=tuple, default=())
    beyond: Beyond = eqx.field(static=True, default="saturate")
    cutoff: Float[Array, "..."] | None = float_field(default=None)
    queue: int = eqx.field(static=True, default=16)

    def __check_init__(self):
        for name in _POSITIVE:
            if getattr(self, name) is not None:
                require_positive(name, getattr(self, name))
        for name in _NOT_NEGATIVE:
            if getattr(self, name) is not None:
                require_nonnegative(name, getattr(self, name))
        for name, kind in _PARTS.items():
            part = getattr(self, name)
            parts = part if name in _BY_CHANNEL and isinstance(part, tuple) else (part,)
            ok = all(each is None or isinstance(each, kind) for each in parts)
            require(ok, f"Argument `{name}` must be {_KINDS[name]} or None, but is {part!r}.")
        if self.input_range is not None:
            for limits in self.input_range if np.ndim(self.input_range) == 2 else (self.input_range,):
                require_range("input_range", limits)
        if self.unmatched:
            require_disturbances("unmatched", self.unmatched)
        known = get_args(Beyond)
        require(self.beyond in known, f"Argument `beyond` must be one of {list(known)}, but is {self.beyond!r}.")
        require_count("queue", self.queue)
        if self.is_late and not is_traced(self.sample_period, self.delay, self.measurement_delay, self.jitter):
            needed = self._most_under_way()
            require(
                self.queue >= needed,
                f"Argument `queue` must be at least {needed}, as many samples are under way, but is {self.queue}. "
                f"Give `queue={needed}`, or more if delay or period are drawn.",
            )

    @property
    def by_channel(self) -> dict[str, Any]:
        """What there is for each of several channels, by its name."""
        given = {name: getattr(self, name) for name in _BY_CHANNEL}
        ranks = {name: int(name == "input_range") for name in given}
        return {name: each for name, each in given.items() if isinstance(each, tuple) or np.ndim(each) > ranks[name]}

    def of_channels(self, channels: int) -> "tuple[Implementation, ...]":
        """That of each channel of a loop with several inputs.

        Args:
            channels: How many there are.

        Raises:
            InputError: Of something there are not as many.
        """
        found = self.by_channel
        for name, value in found.items():
            require(
                len(value) == channels,
                f"Argument `{name}` of the implementation must be one for all of the {channels} inputs, or {channels}, "
                f"but has {len(value)}.",
            )
        if not found:
            return (self,) * channels
        parts = ({name: value[i] for name, value in found.items()} for i in range(channels))
        return tuple(dataclasses.replace(self, **each) for each in parts)

    @property
    def is_late(self) -> bool:
        """Whether commands arrive later than they are measured for, and so have to be kept."""
        return self.delay is not None or self.measurement_delay is not None

    def _most_under_way(self) -> int:
        """Samples that can be under way at once."""
        flight = sum(np.asarray(part) for part in (self.delay, self.measurement_delay) if part is not None)
        late = 0.0 if self.jitter is None else float(self.jitter.fraction)
        return math.floor(np.max(flight / np.asarray(self.sample_period)) + late) + 1

    def instant(self, k: RealScalarLike) -> RealScalarLike:
        """The time [s] of sample k = 0, 1, ...

        Args:
            k: Number of the sample.
        """
        late = 0.0 if self.jitter is None else self.jitter(k)
        return (k + late) * self.sample_period

    def measured(self, x: Scalars, t: RealScalarLike, k: RealScalarLike) -> Scalars:
        """What is read of the state `x` in sample `k` at time `t`: with noise, then rounded.

        Args:
            x: State, n scalars.
            t: Time of the sample [s].
            k: Number of the sample.
        """
        if self.noise is not None:
            x = tuple(xi + noise for xi, noise in zip(x, self.noise(t, k), strict=True))
        if self.measurement_resolution is not None:
            x = tuple(_rounded(xi, self.measurement_resolution[i]) for i, xi in enumerate(x))
        return x

    def limited(self, command: RealScalarLike, last: RealScalarLike) -> RealScalarLike:
        """The command that is sent, given what the law wants and what was sent last.

        Args:
            command: What the law wants.
            last: What was sent in the sample before; 0 before the first.
        """
        if self.input_resolution is not None:
            command = _rounded(command, self.input_resolution)
        if self.saturation is not None:
            command = jnp.clip(command, -self.saturation, self.saturation)
        if self.input_range is not None:
            command = jnp.clip(command, self.input_range[0], self.input_range[1])
        if self.rate_limit is not None:
            reach = self.rate_limit * self.sample_period
            command = jnp.clip(command, last - reach, last + reach)
        return command

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        """Times [s] at which something jumps or kinks that is not a sample."""
        parts = [as_times(signal.break_times) for signal in self.unmatched]
        parts += [] if self.gain_fault is None else [self.gain_fault.break_times]
        return jnp.concatenate([jnp.zeros((0,)), *parts])

    def is_valid(self, horizon: RealScalarLike) -> BoolScalarLike:
        """Whether every number is in range, and no delay longer than the horizon: as checked, for traced ones.

        Args:
            horizon: The horizon [s].
        """
        claims = [getattr(self, name) > 0.0 for name in _POSITIVE if getattr(self, name) is not None]
        claims += [] if self.input_range is None else [self.input_range[0] < self.input_range[1]]
        claims += [jnp.all(getattr(self, name) >= 0.0) for name in _NOT_NEGATIVE if getattr(self, name) is not None]
        claims += [getattr(self, name) <= horizon for name in _DELAYS if getattr(self, name) is not None]
        claims += [getattr(self, name).is_valid() for name in _PARTS if getattr(self, name) is not None]
        return ft.reduce(jnp.logical_and, claims)

    def check(self, states: int, horizon: RealScalarLike) -> None:
        """Raises `InputError` unless it fits a plant with so many states and a horizon [s]; traced numbers pass.

        Args:
            states: How many states the plant has.
            horizon: The horizon [s].
        """
        counts = {
            "measurement_resolution": None
            if self.measurement_resolution is None
            else np.shape(self.measurement_resolution)[0],
            "noise": None if self.noise is None else len(self.noise.bounds()),
            "unmatched": len(self.unmatched) + 1 if self.unmatched else None,
        }
        for name, count in counts.items():
            ok = count in (None, states)
            require(ok, f"Argument `{name}` must fit a plant with {states} states, but is for {count}.")
        for name in _DELAYS:
            delay = getattr(self, name)
            if delay is not None and not is_traced(delay, horizon):
                require(
                    bool(np.all(delay <= horizon)),
                    f"Argument `{name}` must not be longer than the horizon, {show(horizon)} s, but is {show(delay)}.",
                )


_POSITIVE = ("sample_period", "saturation", "rate_limit", "cutoff")
_NOT_NEGATIVE = ("delay", "measurement_delay", "measurement_resolution", "input_resolution")
_DELAYS = ("delay", "measurement_delay")
_BY_CHANNEL = (
    *("sample_period", "delay", "measurement_delay", "saturation", "input_range", "rate_limit", "input_resolution"),
    *("actuator", "gain_fault", "cutoff"),
)
_PARTS = {"jitter": Jitter, "noise": AbstractNoise, "actuator": AbstractActuator, "gain_fault": GainFault}
_KINDS = {
    "jitter": "a `Jitter`",
    "noise": "one of `qsmc_jax.noises`",
    "actuator": "one of `qsmc_jax.actuators` (`FirstOrderLag`, `SecondOrderLag`, `RateLimited`, `DeadZone`)",
    "gain_fault": "a `GainFault`",
}


def require_one_input(made: Implementation | None) -> None:
    """Raises `InputError` unless everything is one, not a list with one for each of several channels."""
    for name in () if made is None else made.by_channel:
        raise InputError(f"Argument `{name}` of the implementation must be one, no list, for a single input.")


def random_jitter(draw: DrawLike, name: str, fraction: RealScalarLike) -> Jitter:
    """Jitter of up to the given fraction of the period; the realisation is drawn as `<name>.seed`.

    Args:
        draw: The scenario's source of named numbers.
        name: Prefix of the name `.seed`.
        fraction: Largest delay of a sample, as a fraction of the period [-], in [0, 1).

    Returns:
        A `Jitter`.

    Examples:
        >>> import dataclasses
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     plan = qj.Implementation(sample_period=2e-3, jitter=qj.random_jitter(draw, "jitter", 0.1))
        ...     loop = dataclasses.replace(qj.paper.example1(), implementation=plan)
        ...     return qj.Scenario(loop, x0=[0.9, 0.9], t1=20.0)
        >>> [spec.name for spec in qj.Study(scenario, bandwidth=0.1).specs]
        ['jitter.seed']
    """
    return Jitter(fraction, draw.uniform(f"{name}.seed", 0.0, 1.0))


def _rounded(value: RealScalarLike, step: Any) -> RealScalarLike:
    """To the nearest multiple of `step`; as it is if that is 0."""
    is_on = step > 0.0
    size = jnp.where(is_on, step, 1.0)
    return jnp.where(is_on, jnp.round(value / size) * size, value)
