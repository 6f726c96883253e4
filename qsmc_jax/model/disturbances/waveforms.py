"""Smooth disturbances made of sines."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import is_traced, require, require_finite, require_positive, require_shape
from qsmc_jax.base.module import as_float64, float_field
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.model.disturbances.disturbance import AbstractDisturbance, no_breaks


class Zero(AbstractDisturbance):
    r"""No disturbance, $d(t) = 0$.

    Examples:
        >>> import qsmc_jax as qj
        >>> float(qj.disturbances.Zero()(1.0))
        0.0
    """

    def __call__(self, t: RealScalarLike) -> RealScalarLike:
        return jnp.zeros(())

    @property
    def bound(self) -> RealScalarLike:
        return jnp.zeros(())

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        return no_breaks()


class Sine(AbstractDisturbance):
    r"""A sine, $d(t) = a \sin(\omega t + \varphi)$, $\bar d = |a|$.

    Attributes:
        amplitude: Amplitude a.
        frequency: Angular frequency $\omega$ [rad/s].
        phase: Phase $\varphi$ [rad]; $\pi/2$ makes it a cosine.

    Examples:
        >>> from math import pi
        >>> import qsmc_jax as qj
        >>> d = qj.disturbances.Sine(amplitude=0.5, frequency=pi, phase=pi / 2)
        >>> round(float(d(0.0)), 3), round(float(d(1.0)), 3), float(d.bound)
        (0.5, -0.5, 0.5)
    """

    amplitude: Float[Array, ""] = float_field()
    frequency: Float[Array, ""] = float_field()
    phase: Float[Array, ""] = float_field(default=0.0)

    def __check_init__(self):
        require_finite("amplitude", self.amplitude)
        require_finite("frequency", self.frequency)
        require_finite("phase", self.phase)

    def __call__(self, t: RealScalarLike) -> RealScalarLike:
        return self.amplitude * jnp.sin(self.frequency * t + self.phase)

    @property
    def bound(self) -> RealScalarLike:
        return jnp.abs(self.amplitude)

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        return no_breaks()


class SumOfSines(AbstractDisturbance):
    r"""A sum of sines, $d(t) = \sum_j a_j \sin(\omega_j t + \varphi_j)$, $\bar d = \sum_j |a_j|$.

    The bound is the supremum when the frequencies have no integer relation; else it may be larger. Where the sum is
    known beforehand, whatever the amplitudes, it may be given.

    Attributes:
        amplitudes: Amplitudes $a_j$.
        frequencies: Angular frequencies $\omega_j$ [rad/s].
        phases: Phases $\varphi_j$ [rad]; None means zero.
        limit: What the amplitudes add up to at most; the argument `bound`, None for their sum.

    Examples:
        >>> import qsmc_jax as qj
        >>> d = qj.disturbances.SumOfSines(amplitudes=[0.5, 0.25], frequencies=[1.0, 7.0])
        >>> float(d(0.0)), float(d.bound)
        (0.0, 0.75)
    """

    amplitudes: Float[Array, " terms"] = float_field()
    frequencies: Float[Array, " terms"] = float_field()
    phases: Float[Array, " terms"] = float_field()
    limit: Float[Array, ""] | None = float_field()

    def __init__(self, amplitudes: Any, frequencies: Any, phases: Any = None, bound: Any = None):
        self.amplitudes = as_float64(amplitudes)
        self.frequencies = as_float64(frequencies)
        self.phases = as_float64(np.zeros(np.shape(self.amplitudes)) if phases is None else phases)
        self.limit = as_float64(bound)

    def __check_init__(self):
        _require_sines(self.amplitudes, self.frequencies, self.phases)
        if self.limit is not None and not is_traced(self.limit, self.amplitudes):
            total = float(np.sum(np.abs(self.amplitudes)))
            require(
                total <= (1.0 + 1e-9) * float(self.limit),
                f"Argument `bound` must be at least the sum of the amplitudes, {total:.6g}, but is {self.limit:.6g}.",
            )

    def __call__(self, t: RealScalarLike) -> RealScalarLike:
        return jnp.sum(self.amplitudes * jnp.sin(self.frequencies * t + self.phases))

    @property
    def bound(self) -> RealScalarLike:
        return jnp.sum(jnp.abs(self.amplitudes)) if self.limit is None else jnp.asarray(self.limit)

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        return no_breaks()


class BandLimitedNoise(AbstractDisturbance):
    r"""Noise by spectral representation, bounded smoothly, $d(t) = \bar d \tanh(d_0(t) / \bar d)$.

    $d_0(t) = \sum_j a_j \cos(\omega_j t + \varphi_j)$.

    With many terms and random phases $d_0$ is nearly Gaussian with variance $\sum_j a_j^2/2$; the $\tanh$ keeps it
    below $\bar d$ without a kink, and lowers the variance a little.

    Attributes:
        amplitudes: Amplitudes $a_j$ before bounding.
        frequencies: Angular frequencies $\omega_j$ [rad/s].
        phases: Phases $\varphi_j$ [rad].
        limit: The bound $\bar d$, positive; the argument `bound`.

    Examples:
        >>> import qsmc_jax as qj
        >>> d = qj.disturbances.BandLimitedNoise([100.0], [1.0], [0.0], bound=0.5)
        >>> round(float(d(0.0)), 3), float(d.bound)
        (0.5, 0.5)

    Source: Shinozuka and Deodatis (1991), Simulation of stochastic processes by spectral representation; the
    $\tanh$ is ours.
    """

    amplitudes: Float[Array, " terms"] = float_field()
    frequencies: Float[Array, " terms"] = float_field()
    phases: Float[Array, " terms"] = float_field()
    limit: Float[Array, ""] = float_field()

    def __init__(self, amplitudes: Any, frequencies: Any, phases: Any, bound: Any):
        self.amplitudes = as_float64(amplitudes)
        self.frequencies = as_float64(frequencies)
        self.phases = as_float64(phases)
        self.limit = as_float64(bound)

    def __check_init__(self):
        _require_sines(self.amplitudes, self.frequencies, self.phases)
        require_positive("bound", self.limit)

    def __call__(self, t: RealScalarLike) -> RealScalarLike:
        unbounded = jnp.sum(self.amplitudes * jnp.cos(self.frequencies * t + self.phases))
        return self.limit * jnp.tanh(unbounded / self.limit)

    @property
    def bound(self) -> RealScalarLike:
        return jnp.asarray(self.limit)

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        return no_breaks()


def _require_sines(amplitudes: Any, frequencies: Any, phases: Any) -> None:
    require_finite("amplitudes", amplitudes)
    for name, value in (("frequencies", frequencies), ("phases", phases)):
        require_shape(name, value, np.shape(amplitudes), "one per amplitude")
        require_finite(name, value)
