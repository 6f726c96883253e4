"""References: the wanted output and its time derivatives."""

import abc
from collections.abc import Callable
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require_finite, require_shape
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.module import AbstractModule, as_float64, float_field
from qsmc_jax.base.precision import in_64_bits
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.model.derivatives import time_derivatives
from qsmc_jax.model.kinks import as_times
from qsmc_jax.model.recording import Recording
from qsmc_jax.model.smooth import require_smooth


class AbstractReference(AbstractModule):
    r"""A reference $x_{des}(t)$ that the output should follow, with as many derivatives as the plant has states.

    Examples:
        A steady turn, as you may write it:

        >>> import qsmc_jax as qj
        >>> class Turn(qj.AbstractReference):
        ...     def derivatives(self, t, order):
        ...         return (2.0 * t, 2.0, *(0.0,) * order)[: order + 1]
        >>> Turn()(3.0), Turn().derivatives(3.0, 2)
        (6.0, (6.0, 2.0, 0.0))

    A loop compares them with each other before it is solved: each must be the derivative in time of the one before.

    Source: paper, below eq. (1), where $x_{des}$ is smooth; its bounds matter to the proof, not here.
    """

    hint: ClassVar[str] = "A smooth function f(t) becomes one by `qj.references.Smooth(f)`."

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        """Times [s] at which the highest derivative in use, the n-th, jumps or kinks; the solver steps to them.

        All lower ones must be continuous, for the errors are measured against them. A hint that saves steps: what is
        not declared is found by the solver. None here. Their number is fixed when traced.
        """
        return jnp.zeros((0,))

    @abc.abstractmethod
    def derivatives(self, t: RealScalarLike, order: int) -> tuple[RealScalarLike, ...]:
        r"""The reference and its first derivatives, $(x_{des}, \dot x_{des}, \dots, x_{des}^{(order)})$ at time t.

        Args:
            t: Time [s].
            order: Highest derivative wanted, not negative; fixed when traced.

        Returns:
            A tuple of `order + 1` scalars, in units of the output per second to the power k.
        """

    def __call__(self, t: RealScalarLike) -> RealScalarLike:
        """The reference at time `t` [s], in units of the output."""
        return self.derivatives(t, 0)[0]


class Constant(AbstractReference):
    r"""A constant, $x_{des}(t) = v$: regulation to a set point.

    Attributes:
        value: The constant v, in units of the output.

    Examples:
        >>> import qsmc_jax as qj
        >>> [float(value) for value in qj.references.Constant(0.5).derivatives(10.0, 2)]
        [0.5, 0.0, 0.0]
    """

    value: Float[Array, ""] = float_field()

    def __check_init__(self):
        require_finite("value", self.value)

    def derivatives(self, t: RealScalarLike, order: int) -> tuple[RealScalarLike, ...]:
        return (jnp.asarray(self.value), *(jnp.zeros(()) for _ in range(order)))


class SumOfSines(AbstractReference):
    r"""A sum of sines, $x_{des}(t) = v + \sum_j a_j \sin(\omega_j t + \varphi_j)$.

    $x_{des}^{(k)} = \sum_j a_j \omega_j^k \sin(\omega_j t + \varphi_j + k \pi / 2)$ for k >= 1, by cycling through one
    sine and one cosine.

    Attributes:
        amplitudes: Amplitudes $a_j$, in units of the output.
        frequencies: Angular frequencies $\omega_j$ [rad/s].
        phases: Phases $\varphi_j$ [rad]; None means zero.
        offset: The mean v, in units of the output.

    Examples:
        >>> import qsmc_jax as qj
        >>> reference = qj.references.SumOfSines(amplitudes=[1.0], frequencies=[2.0], offset=3.0)
        >>> [float(value) for value in reference.derivatives(0.0, order=1)]
        [3.0, 2.0]

    Source: paper, Example 1 is `SumOfSines([1.0], [1.0])`, Example 2 is
        `SumOfSines([1.0, 1.0], [1.0, 0.5], [0.0, pi / 2])`.
    """

    amplitudes: Float[Array, " terms"] = float_field()
    frequencies: Float[Array, " terms"] = float_field()
    phases: Float[Array, " terms"] = float_field()
    offset: Float[Array, ""] = float_field()

    def __init__(self, amplitudes: Any, frequencies: Any, phases: Any = None, offset: Any = 0.0):
        self.amplitudes = as_float64(amplitudes)
        self.frequencies = as_float64(frequencies)
        self.phases = as_float64(np.zeros(np.shape(self.amplitudes)) if phases is None else phases)
        self.offset = as_float64(offset)

    def __check_init__(self):
        require_finite("amplitudes", self.amplitudes)
        for name, value in (("frequencies", self.frequencies), ("phases", self.phases)):
            require_shape(name, value, np.shape(self.amplitudes), "one per amplitude")
            require_finite(name, value)
        require_finite("offset", self.offset)

    def derivatives(self, t: RealScalarLike, order: int) -> tuple[RealScalarLike, ...]:
        angles = self.frequencies * t + self.phases
        sine, cosine = jnp.sin(angles), jnp.cos(angles)
        cycle = (sine, cosine, -sine, -cosine)
        waves = [jnp.sum(self.amplitudes * self.frequencies**k * cycle[k % 4]) for k in range(order + 1)]
        return (self.offset + waves[0], *waves[1:])


class Smooth(AbstractReference):
    r"""Any smooth function of time; its derivatives come by Taylor mode, or by repeated forward mode where need be.

    `fn` is part of the pytree: a plain Python function is static to `eqx.filter_jit` and its kin, and the numbers in
    its closure are constants. To sweep, draw or tune numbers, hold them as arrays where they can be seen: in an
    `eqx.Module` with a `__call__(t)`, or in `eqx.Partial(fn, number, ...)`, whose `fn` takes them before t.

    A function with kinks or jumps is refused, for its derivatives would jump, and with them the errors. A comparison is
    no offence where nothing jumps: `jax.nn.logsumexp` and a `jnp.where` that only guards pass, for where they switch
    their values and three derivatives continue. `jnp.interp` and `jnp.clip` do not: subclass `AbstractReference`.

    Singular points of a smooth function (a square root at 0, an arcsine at 1) are not seen, except at t = 0, where
    every run starts.

    Attributes:
        fn: The function t -> x_des(t) of a scalar, written with `jax.numpy`, in units of the output.

    Raises:
        InputError: If `fn` can't be traced, is not smooth, has no forward derivative, does not return one number,
            closes over a traced number, or isn't finite with a finite derivative at t = 0.

    Examples:
        >>> import equinox as eqx
        >>> import jax.numpy as jnp
        >>> import numpy as np
        >>> import qsmc_jax as qj
        >>> reference = qj.references.Smooth(lambda t: t**3)
        >>> [float(value) for value in reference.derivatives(1.0, 3)]
        [1.0, 3.0, 6.0, 6.0]
        >>> bump = eqx.Partial(lambda width, t: jnp.exp(-((t / width) ** 2)), np.asarray(1.5))
        >>> float(qj.references.Smooth(bump)(0.0))
        1.0
    """

    fn: Callable[..., Any]

    def __check_init__(self):
        with in_64_bits():
            require_smooth(self.fn)

    def derivatives(self, t: RealScalarLike, order: int) -> tuple[RealScalarLike, ...]:
        return time_derivatives(self.fn, t, order)


class Recorded(AbstractReference):
    r"""A recorded reference, with as many derivatives as what is between its samples has.

    The errors of a plant of order n are measured against $x_{des}, \dots, x_{des}^{(n-1)}$, which must be continuous;
    $x_{des}^{(n)}$ may jump at samples, to which the solver steps. So lines do for n = 1, `"pchip"` for n = 2,
    `"cubic"` for n = 3; held samples, which jump, for none. One that holds beyond its record has a kink at its end, and
    does for n = 1. Sensor noise shows in derivatives: smooth a recording before it becomes a reference.

    Attributes:
        recording: The recording. A horizon beyond its end is refused, unless it holds its last sample.

    Examples:
        >>> import qsmc_jax as qj
        >>> path = qj.references.Recorded(qj.Recording([0.0, 1.0, 3.0], [0.0, 2.0, 4.0], kind="linear"))
        >>> [[float(value) for value in path.derivatives(t, 1)] for t in (0.5, 1.0)]
        [[1.0, 2.0], [2.0, 1.0]]
    """

    recording: Recording

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        return as_times(self.recording.times)

    def derivatives(self, t: RealScalarLike, order: int) -> tuple[RealScalarLike, ...]:
        return self.recording.derivatives(t, order)

    def check_order(self, order: int) -> None:
        """Raises `InputError` unless it does for a plant of order n.

        Args:
            order: The order n.
        """
        kind, has = self.recording.kind, self.recording.smoothness
        if has >= order - 1:
            return
        counted = "jumps" if has < 0 else f"has {has} continuous derivative{'' if has == 1 else 's'}"
        remedies = {1: 'Give `kind="linear"`', 2: 'Give `kind="pchip"`', 3: 'Give `kind="cubic"`'}
        remedy = remedies.get(order, "Fit a smooth function to it, `qj.references.Smooth(fn)`")
        if order in (2, 3) and self.recording.beyond == "hold":
            remedy += ' and `beyond="refuse"`, for where it begins to hold it kinks'
        raise InputError(
            f"Argument `reference` must have {order - 1} continuous derivatives for a plant of order {order}, but a "
            f"recording of kind {kind!r}, beyond={self.recording.beyond!r}, {counted}. {remedy}."
        )
