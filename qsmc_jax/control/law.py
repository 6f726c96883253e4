"""The quasi-sliding-mode control law."""

import math
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require_finite
from qsmc_jax.base.module import float_field
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.control.control import EDGE, AbstractControl, Sample
from qsmc_jax.control.funnel import AbstractFunnel
from qsmc_jax.control.surface import SlidingSurface
from qsmc_jax.numerics.gudermann import sinh_cosh, tan_half_pi


class QuasiSlidingControl(AbstractControl):
    r"""The law $u = u_0 - \operatorname{sgn}(g) K \tan\frac{\pi\sigma}{2\rho}$; the paper's has $K = 1$, $u_0 = 0$.

    Of the plant it knows the order and the sign of the gain. Theorem 1 holds with any K and $u_0$: the loop is the
    paper's with the gain $K g$ and the disturbance $d + g u_0$. K brings the input's unit and size, $u_0$ what it is at
    rest. The scaled law, $u_0 - \operatorname{sgn}(g) K \tan(\frac{\pi\sigma}{2\rho}) / \rho$, grows as the funnel
    narrows; it is the one with a proof for several coupled inputs, see `MultivariableLoop`.

    Attributes:
        surface: Sliding surface, $\sigma$ as a function of the errors.
        funnel: Funnel $\rho(t)$; about a centre m the law acts on $\sigma - m$.
        gain_sign: The sign of the control gain g, 1 or -1.
        gain: K, positive, in units of the input; of the scaled law, times those of the sliding variable.
        offset: $u_0$, in units of the input.
        is_scaled: Whether the tangent is divided by the funnel's half-width.

    Examples:
        Half-way to the edge the input is 1:

        >>> import qsmc_jax as qj
        >>> control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> round(float(control(sigma=0.5, rho=1.0)), 3), float(control(sigma=1.5, rho=1.0))
        (-1.0, nan)

    Source: paper, eq. (4). The paper's law is given inside the funnel only; the next branches of the tangent, which
    point the wrong way, are never used: outside, u is NaN.
    """

    instead: ClassVar[str] = "A law of your own is an `AbstractControl`: give it `command(sample, memory)`."

    surface: SlidingSurface
    funnel: AbstractFunnel
    gain_sign: Float[Array, ""] = float_field(default=1.0)
    gain: Float[Array, ""] = float_field(default=1.0)
    offset: Float[Array, ""] = float_field(default=0.0)
    is_scaled: bool = eqx.field(static=True, default=False)

    positive: ClassVar[tuple[str, ...]] = ("gain",)

    def __check_init__(self):
        require_finite("offset", self.offset)

    def __call__(self, sigma: RealScalarLike, rho: RealScalarLike) -> Float[Array, ""]:
        r"""The control at `sigma`, from the funnel's centre, and half-width `rho`; NaN unless $|\sigma| < \rho$."""
        return self._input(tan_half_pi(sigma, rho), rho)

    def at(self, s: RealScalarLike, t: RealScalarLike) -> RealScalarLike:
        r"""The control at the funnel coordinate `s`, where the tangent is $\sinh s$.

        Args:
            s: Funnel coordinate [-].
            t: Time [s].
        """
        return self._input(sinh_cosh(s)[0], self.funnel(t) if self.is_scaled else 1.0)

    def gain_at(self, t: RealScalarLike) -> RealScalarLike:
        """What the tangent is multiplied by at a time: K, or K over the funnel's half-width then.

        Args:
            t: Time [s].
        """
        return self.gain / self.funnel(t) if self.is_scaled else self.gain

    def first_memory(self) -> Scalars:
        return ()

    def command(self, sample: Sample, memory: Scalars) -> tuple[RealScalarLike, Scalars]:
        if sample.beyond == "wrap":
            return self._input(jnp.tan(0.5 * math.pi * sample.inside() / sample.rho), sample.rho), ()
        if not sample.is_exact:
            return self(sample.inside(), sample.rho), ()
        # By one number, which is inside for certain: of sigma and rho an enclosure does not know that they go together.
        place = jnp.clip((sample.sigma - sample.centre) / sample.rho, EDGE - 1.0, 1.0 - EDGE)
        return self._input(tan_half_pi(place, 1.0), sample.rho), ()

    def _input(self, tangent: RealScalarLike, rho: RealScalarLike) -> Float[Array, ""]:
        gain = self.gain / rho if self.is_scaled else self.gain
        return self.offset - self.gain_sign * gain * tangent
