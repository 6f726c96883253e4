"""Measurement noise: what the controller reads is the state plus this, one number for each state."""

import abc
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require_nonnegative
from qsmc_jax.base.module import AbstractModule, as_float64, float_field
from qsmc_jax.base.types import BoolScalarLike, DrawLike, RealScalarLike, Scalars
from qsmc_jax.implementation.rng import Consumer, normals, uniforms
from qsmc_jax.model.disturbances import AbstractDisturbance, random_sines
from qsmc_jax.model.disturbances.disturbance import require_disturbances


class AbstractNoise(AbstractModule):
    """Noise on the measured states, fixed for a run: a run can be solved again, noise and all.

    Examples:
        >>> import qsmc_jax as qj
        >>> noise = qj.noises.Uniform([0.5, 0.0])
        >>> isinstance(noise, qj.noises.AbstractNoise), noise.bounds().tolist()
        (True, [0.5, 0.0])
    """

    @abc.abstractmethod
    def __call__(self, t: RealScalarLike, k: RealScalarLike) -> Scalars:
        """The noise on each state in sample `k` = 0, 1, ..., taken at time `t` [s]; in units of the state."""

    @abc.abstractmethod
    def bounds(self) -> Float[Array, " n"]:
        """A bound on the absolute noise of each state; `inf` if there is none."""

    @abc.abstractmethod
    def is_valid(self) -> BoolScalarLike:
        """Whether its numbers are in range: what the constructor checks, for traced ones."""


class White(AbstractNoise):
    """Gaussian, independent from sample to sample and from state to state.

    Attributes:
        std: Standard deviation for each state, not negative.
        seed: The realisation, a number in [0, 1).

    Examples:
        >>> import qsmc_jax as qj
        >>> qj.noises.White(std=[0.01, 0.0]).bounds().tolist()
        [inf, 0.0]
    """

    std: Float[Array, " n"] = float_field()
    seed: Float[Array, ""] = float_field(default=0.0)

    def __check_init__(self):
        require_nonnegative("std", self.std)

    def __call__(self, t: RealScalarLike, k: RealScalarLike) -> Scalars:
        return _scaled(self.std, normals(Consumer.WHITE, self.seed, k, np.shape(self.std)[0]))

    def bounds(self) -> Float[Array, " n"]:
        return jnp.where(self.std > 0.0, jnp.inf, 0.0)

    def is_valid(self) -> BoolScalarLike:
        return jnp.all(self.std >= 0.0)


class Uniform(AbstractNoise):
    """Uniform in an interval around zero, independent from sample to sample and from state to state.

    Attributes:
        amplitude: Largest absolute noise on each state, not negative.
        seed: The realisation, a number in [0, 1).

    Examples:
        A noise is computed in 64 bits, as every solve sees to by itself:

        >>> import jax
        >>> import qsmc_jax as qj
        >>> noise = qj.noises.Uniform(amplitude=[0.5, 0.0])
        >>> with jax.enable_x64(True):
        ...     first, second = (float(value) for value in noise(t=0.0, k=0))
        >>> abs(first) <= 0.5, abs(second)
        (True, 0.0)
    """

    amplitude: Float[Array, " n"] = float_field()
    seed: Float[Array, ""] = float_field(default=0.0)

    def __check_init__(self):
        require_nonnegative("amplitude", self.amplitude)

    def __call__(self, t: RealScalarLike, k: RealScalarLike) -> Scalars:
        return _scaled(self.amplitude, uniforms(Consumer.UNIFORM, self.seed, k, np.shape(self.amplitude)[0]))

    def bounds(self) -> Float[Array, " n"]:
        return jnp.asarray(self.amplitude)

    def is_valid(self) -> BoolScalarLike:
        return jnp.all(self.amplitude >= 0.0)


class Signals(AbstractNoise):
    """A bounded function of time for each state: coloured, or as smooth as one likes.

    Attributes:
        signals: One signal a state; any disturbance will do. `Zero()` for a state that is read exactly.

    Examples:
        >>> import qsmc_jax as qj
        >>> noise = qj.noises.Signals((qj.disturbances.Sine(0.5, 50.0), qj.disturbances.Zero()))
        >>> noise.bounds().tolist(), [float(value) for value in noise(t=0.0, k=0)]
        ([0.5, 0.0], [0.0, 0.0])
    """

    signals: tuple[AbstractDisturbance, ...] = eqx.field(converter=tuple)

    def __check_init__(self):
        require_disturbances("signals", self.signals)

    def __call__(self, t: RealScalarLike, k: RealScalarLike) -> Scalars:
        return tuple(signal(t) for signal in self.signals)

    def bounds(self) -> Float[Array, " n"]:
        return jnp.stack([jnp.asarray(signal.bound, float) for signal in self.signals])

    def is_valid(self) -> BoolScalarLike:
        return jnp.array(True)


def white(draw: DrawLike, name: str, std: Sequence[Any] | np.ndarray | Array) -> White:
    """White Gaussian noise of the given standard deviations; the realisation is drawn as `<name>.seed`.

    Args:
        draw: The scenario's source of named numbers.
        name: Prefix of the name `.seed`.
        std: Standard deviation for each state, not negative.

    Returns:
        A `White`.

    Examples:
        >>> import dataclasses
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     plan = qj.Implementation(sample_period=2e-3, noise=qj.noises.white(draw, "noise", [1e-3, 1e-2]))
        ...     loop = dataclasses.replace(qj.paper.example1(), implementation=plan)
        ...     return qj.Scenario(loop, x0=[0.9, 0.9], t1=20.0)
        >>> [spec.name for spec in qj.Study(scenario, bandwidth=0.1).specs]
        ['noise.seed']
    """
    return White(as_float64(std), draw.uniform(f"{name}.seed", 0.0, 1.0))


def uniform(draw: DrawLike, name: str, amplitude: Sequence[Any] | np.ndarray | Array) -> Uniform:
    """White noise of the given amplitudes; the realisation is drawn as `<name>.seed`.

    Args:
        draw: The scenario's source of named numbers.
        name: Prefix of the name `.seed`.
        amplitude: Largest absolute noise on each state, not negative.

    Returns:
        A `Uniform`.

    Examples:
        >>> import dataclasses
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     plan = qj.Implementation(sample_period=2e-3, noise=qj.noises.uniform(draw, "noise", [1e-3, 1e-2]))
        ...     loop = dataclasses.replace(qj.paper.example1(), implementation=plan)
        ...     return qj.Scenario(loop, x0=[0.9, 0.9], t1=20.0)
        >>> [spec.name for spec in qj.Study(scenario, bandwidth=0.1).specs]
        ['noise.seed']
    """
    return Uniform(as_float64(amplitude), draw.uniform(f"{name}.seed", 0.0, 1.0))


def coloured(
    draw: DrawLike,
    name: str,
    amplitude: Sequence[Any] | np.ndarray | Array,
    terms: int = 8,
    frequencies: tuple[float, float] = (1.0, 100.0),
) -> Signals:
    """Smooth noise with sharp bounds: for each state a sum of sines with random weights, frequencies and phases.

    Args:
        draw: The scenario's source of named numbers.
        name: Prefix of the names `[i].amplitude`, `[i].frequency` [rad/s], `[i].phase` [rad].
        amplitude: Largest absolute noise on each state, not negative.
        terms: Number of sines a state, at least 1.
        frequencies: Lowest and highest angular frequency [rad/s], log-uniform between.

    Returns:
        `Signals` whose bounds are the given amplitudes.

    Examples:
        >>> import dataclasses
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     plan = qj.Implementation(sample_period=2e-3, noise=qj.noises.coloured(draw, "noise", [0.5, 0.25]))
        ...     loop = dataclasses.replace(qj.paper.example1(), implementation=plan)
        ...     return qj.Scenario(loop, x0=[0.9, 0.9], t1=20.0)
        >>> qj.Study(scenario, bandwidth=0.1).nominal.loop.implementation.noise.bounds().round(6).tolist()
        [0.5, 0.25]
    """
    sizes = as_float64(amplitude)
    require_nonnegative("amplitude", sizes)
    sines = (random_sines(draw, f"{name}.{i}", 1.0, terms, frequencies) for i in range(sizes.shape[0]))
    return Signals(signals=tuple(sizes[i] * sine for i, sine in enumerate(sines)))


def _scaled(scales: Float[Array | np.ndarray, " n"], values: Scalars) -> Scalars:
    return tuple(scales[i] * value for i, value in enumerate(values))
