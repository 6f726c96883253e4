r"""Controllers to compare the quasi-sliding-mode law with, on its sliding variable and judged by its funnel.

They read what that law reads, $\sigma$ with $\dot\sigma = w + g u$. `Sign`, `BoundaryLayer`, `SuperTwisting` and
`ProportionalDerivative` are defined everywhere, so that `Sample.beyond` makes no difference; the other two are made
for the funnel, as that law is.

A comparison is worth something on equal terms only. So each class makes its controller from the quasi-sliding-mode one
that it is to be compared with, by a stated rule: the same slope at $\sigma = 0$, the same error at rest, or gains from
a bound on what they have to overcome. Traced numbers will do.
"""

import math
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import (
    is_traced,
    require,
    require_finite,
    require_nonnegative,
    require_positive,
    show,
)
from qsmc_jax.base.module import float_field
from qsmc_jax.base.precision import entry_point
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.control.control import AbstractControl, Sample
from qsmc_jax.control.funnel import Funnel
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.control.surface import SlidingSurface


class Sign(AbstractControl):
    r"""Classical sliding mode, $u = -\operatorname{sgn}(g) K \operatorname{sgn}\sigma$ with $\operatorname{sgn} 0 = 0$.

    Sampled with period $\tau$ it leaves $|\sigma| = O(\tau)$.

    Attributes:
        surface: Sliding surface.
        funnel: Funnel that the loop is judged by.
        amplitude: K, in units of the input, positive.
        gain_sign: The sign of the control gain g, 1 or -1.

    Examples:
        >>> import qsmc_jax as qj
        >>> control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> float(qj.controllers.Sign.for_bound(control, residual_bound=3.0, gain_min=2.0, reaching_rate=1.0).amplitude)
        2.0

    Source: Utkin, Sliding Modes in Control and Optimization (1992).
    """

    surface: SlidingSurface
    funnel: Funnel
    amplitude: Float[Array, ""] = float_field()
    gain_sign: Float[Array, ""] = float_field(default=1.0)

    positive: ClassVar[tuple[str, ...]] = ("amplitude",)

    @classmethod
    def for_bound(
        cls,
        control: QuasiSlidingControl,
        residual_bound: RealScalarLike,
        gain_min: RealScalarLike,
        reaching_rate: RealScalarLike,
    ) -> "Sign":
        r"""The least amplitude with $\sigma\dot\sigma \le -\eta|\sigma|$, $K = (W + \eta) / g_{min}$.

        Args:
            control: What it is to be compared with.
            residual_bound: Bound W on $|w|$, in units of the sliding variable per second, not negative.
            gain_min: Least value $g_{min}$ of $|g|$, positive.
            reaching_rate: Rate $\eta$, in units of the sliding variable per second, positive.
        """
        require_nonnegative("residual_bound", residual_bound)
        require_positive("gain_min", gain_min)
        require_positive("reaching_rate", reaching_rate)
        amplitude = (residual_bound + reaching_rate) / gain_min
        return cls(control.surface, control.funnel, amplitude, control.gain_sign)

    def first_memory(self) -> Scalars:
        return ()

    def command(self, sample: Sample, memory: Scalars) -> tuple[RealScalarLike, Scalars]:
        return -self.gain_sign * self.amplitude * jnp.sign(sample.sigma), ()


class BoundaryLayer(AbstractControl):
    r"""Sliding mode with a boundary layer, $u = -\operatorname{sgn}(g) K \operatorname{sat}(\sigma / \phi)$.

    Attributes:
        surface: Sliding surface.
        funnel: Funnel that the loop is judged by.
        amplitude: K, in units of the input, positive.
        width: Half-width $\phi$ of the layer, in units of the sliding variable, positive.
        gain_sign: The sign of the control gain g, 1 or -1.

    Examples:
        >>> import qsmc_jax as qj
        >>> control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> round(float(qj.controllers.BoundaryLayer.with_equal_slope(control, amplitude=1.0).width), 4)
        0.0318

    Source: Slotine and Li, Applied Nonlinear Control (1991), section 7.2.
    """

    surface: SlidingSurface
    funnel: Funnel
    amplitude: Float[Array, ""] = float_field()
    width: Float[Array, ""] = float_field()
    gain_sign: Float[Array, ""] = float_field(default=1.0)

    positive: ClassVar[tuple[str, ...]] = ("amplitude", "width")

    @classmethod
    def with_equal_slope(cls, control: QuasiSlidingControl, amplitude: RealScalarLike) -> "BoundaryLayer":
        r"""The layer with the slope $\pi / 2\rho_\infty$ of `control` at $\sigma = 0$ and $\rho = \rho_\infty$.

        Args:
            control: What it is to be compared with.
            amplitude: K, in units of the input, positive.
        """
        return cls(control.surface, control.funnel, amplitude, amplitude / _slope(control), control.gain_sign)

    @classmethod
    def with_equal_accuracy(
        cls,
        control: QuasiSlidingControl,
        amplitude: RealScalarLike,
        residual_bound: RealScalarLike,
        gain_min: RealScalarLike,
    ) -> "BoundaryLayer":
        r"""The layer that leaves at rest, under the worst w and g, the $|\sigma|$ that `control` leaves.

        With $r = W / g_{min}$ these are $\phi r / K$ and $\frac{2}{\pi}\rho_\infty\arctan r$.

        Args:
            control: What it is to be compared with.
            amplitude: K, above r: with less, there is no rest in the layer.
            residual_bound: Bound W on $|w|$, in units of the sliding variable per second, positive.
            gain_min: Least value $g_{min}$ of $|g|$, positive.
        """
        require_positive("residual_bound", residual_bound)
        require_positive("gain_min", gain_min)
        needed = residual_bound / gain_min
        if not is_traced(amplitude, needed):
            require(
                bool(amplitude > needed),
                f"Argument `amplitude` must be above `residual_bound / gain_min` = {show(needed)}, but is "
                f"{show(amplitude)}. With less, w pushes it out of the layer.",
            )
        width = amplitude * _error_at_rest(control, needed) / needed
        return cls(control.surface, control.funnel, amplitude, width, control.gain_sign)

    def first_memory(self) -> Scalars:
        return ()

    def command(self, sample: Sample, memory: Scalars) -> tuple[RealScalarLike, Scalars]:
        return -self.gain_sign * self.amplitude * jnp.clip(sample.sigma / self.width, -1.0, 1.0), ()


class SuperTwisting(AbstractControl):
    r"""The super-twisting law $u = -\operatorname{sgn}(g) k_1 |\sigma|^{1/2} \operatorname{sgn}\sigma + v$.

    Its memory is the integral $\dot v = -\operatorname{sgn}(g) k_2 \operatorname{sgn}\sigma$, 0 at first, taken as it
    is implemented: by explicit Euler steps of the nominal period, $v_{k+1} = v_k - \operatorname{sgn}(g) k_2 \tau
    \operatorname{sgn}\sigma_k$. So it leaves $|\sigma| = O(\tau^2)$. Nothing stops the integral when the command
    saturates. At $\sigma = 0$ the slope is infinite; its derivative there is given as 0.

    Attributes:
        surface: Sliding surface.
        funnel: Funnel that the loop is judged by.
        k1: Gain on the root, in units of the input per root of the sliding variable's, positive.
        k2: Gain on the integral, in units of the input per second, positive.
        gain_sign: The sign of the control gain g, 1 or -1.

    Examples:
        >>> import qsmc_jax as qj
        >>> control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> law = qj.controllers.SuperTwisting.for_rate(control, residual_rate=4.0, gain_min=1.0)
        >>> float(law.k1), float(law.k2)
        (3.0, 4.4)

    Source: Levant, Sliding order and sliding accuracy in sliding mode control, Int. J. Control 58 (1993).
    """

    surface: SlidingSurface
    funnel: Funnel
    k1: Float[Array, ""] = float_field()
    k2: Float[Array, ""] = float_field()
    gain_sign: Float[Array, ""] = float_field(default=1.0)

    positive: ClassVar[tuple[str, ...]] = ("k1", "k2")

    @classmethod
    def for_rate(
        cls, control: QuasiSlidingControl, residual_rate: RealScalarLike, gain_min: RealScalarLike
    ) -> "SuperTwisting":
        r"""The usual gains for $|\dot w| \le L$, $k_1 = 1.5 \sqrt L / g_{min}$ and $k_2 = 1.1 L / g_{min}$.

        With $\xi = w + g v$ and constant g > 0 the loop is $\dot\sigma = -g k_1 |\sigma|^{1/2}
        \operatorname{sgn}\sigma + \xi$, $\dot\xi = \dot w - g k_2 \operatorname{sgn}\sigma$: both gains stand with g.
        It is stable if $g k_2 > L$ and $(g k_1)^2 > g k_2 + L$, which then hold for every constant $g \ge g_{min}$. If
        g varies, $\dot g v$ adds to $\dot w$, and L has to bound the sum.

        Args:
            control: What it is to be compared with.
            residual_rate: Bound L on $|\dot w|$, in units of the sliding variable per second squared, positive.
            gain_min: Least value $g_{min}$ of $|g|$, positive.

        Source: Levant, Robust exact differentiation via sliding mode technique, Automatica 34 (1998), for g = 1; Seeber
        and Horn, Automatica 84 (2017), for the conditions.
        """
        require_positive("residual_rate", residual_rate)
        require_positive("gain_min", gain_min)
        k1, k2 = 1.5 * residual_rate**0.5 / gain_min, 1.1 * residual_rate / gain_min
        return cls(control.surface, control.funnel, k1, k2, control.gain_sign)

    def first_memory(self) -> Scalars:
        return (jnp.zeros(()),)

    def command(self, sample: Sample, memory: Scalars) -> tuple[RealScalarLike, Scalars]:
        (v,), sign = memory, jnp.sign(sample.sigma)
        u = v - self.gain_sign * self.k1 * sign * _root(jnp.abs(sample.sigma))
        return u, (v - self.gain_sign * self.k2 * sample.period * sign,)


class PrescribedPerformance(AbstractControl):
    r"""Prescribed performance control, $u = -\operatorname{sgn}(g) k \ln\frac{1 + z}{1 - z}$ with $z = \sigma / \rho$.

    Outside the funnel it holds 21.4 k, its value just inside: the logarithm grows so slowly that a larger k may be
    needed where the tangent has enough. `beyond="wrap"` evaluates the formula as it stands, which has no value there:
    u is NaN.

    Attributes:
        surface: Sliding surface.
        funnel: Funnel $\rho(t)$.
        gain: k, in units of the input, positive.
        gain_sign: The sign of the control gain g, 1 or -1.

    Examples:
        >>> import qsmc_jax as qj
        >>> control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> round(float(qj.controllers.PrescribedPerformance.with_equal_slope(control).gain), 4)
        0.7854

    Source: Bechlioulis and Rovithakis, IEEE Trans. Automatic Control 53 (2008), for the transformation, and Automatica
    50 (2014), for the law without adaptation; both have it on the errors one by one, here it acts on $\sigma$.
    """

    surface: SlidingSurface
    funnel: Funnel
    gain: Float[Array, ""] = float_field()
    gain_sign: Float[Array, ""] = float_field(default=1.0)

    positive: ClassVar[tuple[str, ...]] = ("gain",)

    @classmethod
    def with_equal_slope(cls, control: QuasiSlidingControl) -> "PrescribedPerformance":
        r"""The law with the slope of `control` at $\sigma = 0$, for every $\rho$: $k = \pi / 4$.

        Args:
            control: What it is to be compared with.
        """
        return cls(control.surface, control.funnel, 0.25 * math.pi, control.gain_sign)

    def first_memory(self) -> Scalars:
        return ()

    def command(self, sample: Sample, memory: Scalars) -> tuple[RealScalarLike, Scalars]:
        # ln((1 + z) / (1 - z)) = 2 artanh z, which keeps its digits at 0
        return -2.0 * self.gain_sign * self.gain * jnp.arctanh(sample.inside() / sample.rho), ()


class FunnelControl(AbstractControl):
    r"""Funnel control, $u = -\operatorname{sgn}(g) k \frac{z}{1 - z^2}$ with $z = \sigma / \rho$.

    Outside the funnel it holds its value just inside, 5e8 k. `beyond="wrap"` evaluates the formula as it stands, which
    has the wrong sign there.

    Attributes:
        surface: Sliding surface.
        funnel: Funnel $\rho(t)$.
        gain: k, in units of the input, positive.
        gain_sign: The sign of the control gain g, 1 or -1.

    Examples:
        >>> import qsmc_jax as qj
        >>> control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> round(float(qj.controllers.FunnelControl.with_equal_slope(control).gain), 4)
        1.5708

    Source: Ilchmann, Ryan and Sangwin, ESAIM: COCV 7 (2002), with the gain $1 / (1 - |z|)$ on the error; this smooth
    gain is that of Berger, Le and Reis, Automatica 87 (2018). Here it acts on $\sigma$, in units of $\rho$.
    """

    surface: SlidingSurface
    funnel: Funnel
    gain: Float[Array, ""] = float_field()
    gain_sign: Float[Array, ""] = float_field(default=1.0)

    positive: ClassVar[tuple[str, ...]] = ("gain",)

    @classmethod
    def with_equal_slope(cls, control: QuasiSlidingControl) -> "FunnelControl":
        r"""The law with the slope of `control` at $\sigma = 0$, for every $\rho$: $k = \pi / 2$.

        Args:
            control: What it is to be compared with.
        """
        return cls(control.surface, control.funnel, 0.5 * math.pi, control.gain_sign)

    def first_memory(self) -> Scalars:
        return ()

    def command(self, sample: Sample, memory: Scalars) -> tuple[RealScalarLike, Scalars]:
        # z / (1 - z^2) from the distances to the edges, which floating point knows exactly
        sigma, rho = sample.inside(), sample.rho
        return -self.gain_sign * self.gain * sigma * rho / ((rho - sigma) * (rho + sigma)), ()


class ProportionalDerivative(AbstractControl):
    r"""The naive reference, $u = \operatorname{sgn}(g) (k_f x_{des}^{(n)} - k \sigma)$.

    For n = 2 this is a PD controller with gains $k c_1$ and k and a feedforward of the desired acceleration; nothing
    compensates gravity or any other part of f.

    Attributes:
        surface: Sliding surface.
        funnel: Funnel that the loop is judged by.
        gain: k, in units of the input per unit of the sliding variable, positive.
        feedforward: $k_f$, in units of the input per unit of $x_{des}^{(n)}$: an estimate of $1 / |g|$; 0 for none.
        gain_sign: The sign of the control gain g, 1 or -1.

    Examples:
        >>> import qsmc_jax as qj
        >>> control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> round(float(qj.controllers.ProportionalDerivative.with_equal_slope(control).gain), 3)
        31.416
    """

    surface: SlidingSurface
    funnel: Funnel
    gain: Float[Array, ""] = float_field()
    feedforward: Float[Array, ""] = float_field(default=0.0)
    gain_sign: Float[Array, ""] = float_field(default=1.0)

    positive: ClassVar[tuple[str, ...]] = ("gain",)

    def __check_init__(self):
        require_finite("feedforward", self.feedforward)

    @classmethod
    def with_equal_slope(
        cls, control: QuasiSlidingControl, feedforward: RealScalarLike = 0.0
    ) -> "ProportionalDerivative":
        r"""The law with the slope of `control` at $\sigma = 0$ and $\rho = \rho_\infty$, $k = \pi / 2\rho_\infty$.

        Args:
            control: What it is to be compared with.
            feedforward: $k_f$; 0 for none.
        """
        return cls(control.surface, control.funnel, _slope(control), feedforward, control.gain_sign)

    def first_memory(self) -> Scalars:
        return ()

    def command(self, sample: Sample, memory: Scalars) -> tuple[RealScalarLike, Scalars]:
        return self.gain_sign * (self.feedforward * sample.desired[-1] - self.gain * sample.sigma), ()


def _slope(control: QuasiSlidingControl) -> RealScalarLike:
    r"""How steep the tangent is at $\sigma = 0$ when the funnel has shrunk, $\pi / 2\rho_\infty$."""
    return 0.5 * math.pi / control.funnel.rho_inf


@entry_point
def _error_at_rest(control: QuasiSlidingControl, needed: RealScalarLike) -> RealScalarLike:
    r"""The $|\sigma|$ at which the tangent gives the input `needed`, when the funnel has shrunk."""
    return (2.0 / math.pi) * control.funnel.rho_inf * jnp.arctan(needed)


def _root(size: Float[Array, ""]) -> Float[Array, ""]:
    """The root of a size, with derivative 0 at 0."""
    is_zero = size == 0.0
    return jnp.where(is_zero, 0.0, jnp.sqrt(jnp.where(is_zero, 1.0, size)))
