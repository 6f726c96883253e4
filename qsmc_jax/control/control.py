"""What a controller is, whatever its law: from what it measures at an instant to an input, with a memory of its own."""

import abc
import functools as ft
from typing import ClassVar, Literal, NamedTuple, TypeAlias

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require_positive, require_sign
from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike, Scalars
from qsmc_jax.control.funnel import AbstractFunnel
from qsmc_jax.control.surface import SlidingSurface

Beyond: TypeAlias = Literal["saturate", "wrap"]

# How near to its edge a law with a pole there is evaluated at most: the quasi-sliding-mode law then gives 6.4e8.
EDGE = 1e-9


class Sample(NamedTuple):
    """What a controller is given at a sampling instant.

    Attributes:
        t: Time [s].
        period: Nominal time between samples [s]; 0 in the ideal loop, where errors are exact.
        sigma: The sliding variable as measured.
        rho: Half-width of the funnel.
        desired: Desired output and its first n derivatives, n + 1 scalars.
        beyond: What a law that is made for the funnel does outside: `"saturate"` holds the value it has just inside
            the edge; `"wrap"` evaluates the formula as it stands, which for the tangent has the wrong sign.
        centre: Centre of the funnel.
        errors: The errors e^(0) ... e^(n-1) as measured, n scalars.

    Examples:
        >>> import qsmc_jax as qj
        >>> sample = qj.Sample(t=0.0, period=1e-2, sigma=0.4, rho=1.0, desired=(0.0, 0.0, 0.0))
        >>> control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> round(float(control.command(sample, control.first_memory())[0]), 6)
        -0.726543
    """

    t: RealScalarLike
    period: RealScalarLike
    sigma: RealScalarLike
    rho: RealScalarLike
    desired: Scalars
    beyond: Beyond = "saturate"
    centre: RealScalarLike = 0.0
    errors: Scalars = ()

    @property
    def output(self) -> Scalars:
        """The output y and its first n - 1 derivatives as measured, n scalars."""
        return tuple(ei + di for ei, di in zip(self.errors, self.desired, strict=False))

    def inside(self) -> RealScalarLike:
        """The sliding variable, from the funnel's centre, at which a law that is made for the funnel is evaluated."""
        deviation = self.sigma - self.centre
        if self.beyond == "wrap":
            return deviation
        edge = (1.0 - EDGE) * self.rho
        return jnp.clip(deviation, -edge, edge)

    @property
    def is_exact(self) -> bool:
        """Whether it is one of the ideal loop."""
        return isinstance(self.period, float) and self.period == 0.0


class AbstractControl(AbstractModule):
    """A controller: it knows the errors, the reference, and of the plant the order and the sign of the gain.

    A law of your own is a class with the fields below, `first_memory` and `command`. One that is smooth and has no
    memory is solved in continuous time too, where a `Sample` has exact errors and period 0; so is one whose memory has
    rates, an `AbstractDynamicControl`. Any other needs an `Implementation`. What it may do within a step is enclosed
    like any function that you bring.

    Attributes:
        surface: Sliding surface.
        funnel: Funnel: what the loop is judged by, whether or not the law makes use of it.
        gain_sign: The sign of the control gain g, 1 or -1.
        positive: Names of the law's own numbers that must be positive.
        is_smooth: Whether the law has a derivative; one that switches by a sign has none that tuning could use, and
            no ideal loop.

    Examples:
        A linear law in the output, with the reference fed forward:

        >>> from typing import ClassVar
        >>> import qsmc_jax as qj
        >>> class Linear(qj.AbstractControl):
        ...     surface: qj.SlidingSurface
        ...     funnel: qj.AbstractFunnel
        ...     gain_sign: float = 1.0
        ...     positive: ClassVar[tuple[str, ...]] = ()
        ...     def first_memory(self):
        ...         return ()
        ...     def command(self, sample, memory):
        ...         return sample.desired[1] - 4.0 * sample.errors[0], ()
        >>> law = Linear(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.5))
        >>> rest, calm = qj.references.Constant(0.0), qj.disturbances.Zero()
        >>> loop = qj.ClosedLoop(qj.plants.InvertedPendulum(), rest, calm, law)
        >>> round(float(loop.input(0.0, (0.5, 0.0))), 6)
        -2.0
    """

    hint: ClassVar[str] = (
        "Use `qj.QuasiSlidingControl(surface, funnel)`, one of `qj.controllers`, or an `AbstractControl` of your own."
    )

    surface: eqx.AbstractVar[SlidingSurface]
    funnel: eqx.AbstractVar[AbstractFunnel]
    gain_sign: eqx.AbstractVar[Float[Array, ""]]
    positive: eqx.AbstractClassVar[tuple[str, ...]]
    is_smooth: ClassVar[bool] = True

    def __check_init__(self):
        for name in self.positive:
            require_positive(name, getattr(self, name))
        require_sign("gain_sign", self.gain_sign)

    def is_valid(self) -> BoolScalarLike:
        """Whether funnel, surface and the law's own numbers are what the constructors ask for, for traced ones."""
        own = [getattr(self, name) > 0.0 for name in self.positive] + [law.is_valid() for law in self.inner_laws]
        return ft.reduce(jnp.logical_and, own, self.funnel.is_valid() & self.surface.is_hurwitz())

    @property
    def has_derivative(self) -> bool:
        """Whether the law is smooth, and those that it is made of."""
        return self.is_smooth and all(law.has_derivative for law in self.inner_laws)

    @property
    def inner_laws(self) -> list["AbstractControl"]:
        """The laws that this one is made of."""
        return [value for value in vars(self).values() if isinstance(value, AbstractControl)]

    def exact_sample(self, t: RealScalarLike, errors: Scalars, desired: Scalars, sigma: RealScalarLike) -> Sample:
        """What it is given in the ideal loop.

        Args:
            t: Time [s].
            errors: Errors, n scalars.
            desired: Desired output and its first n derivatives.
            sigma: The sliding variable.
        """
        # A law with a memory may be given what lies outside the funnel, though the loop is inside.
        beyond = "saturate" if len(self.first_memory()) else "wrap"
        return Sample(t, 0.0, sigma, self.funnel(t), desired, beyond, self.funnel.centre(t), errors)

    @abc.abstractmethod
    def first_memory(self) -> Scalars:
        """The controller's memory before the first sample; empty if its law has none."""

    @abc.abstractmethod
    def command(self, sample: Sample, memory: Scalars) -> tuple[RealScalarLike, Scalars]:
        """The input to be held until the next sample, and the memory to be kept.

        Args:
            sample: What it is given.
            memory: What it kept at the sample before.
        """
