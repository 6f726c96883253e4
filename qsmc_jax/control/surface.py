"""The sliding surface: the line in the space of errors on which they decay by themselves."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Array, ArrayLike, Complex, Float

from qsmc_jax.base.checks import is_traced, require, require_finite, require_positive
from qsmc_jax.base.module import AbstractModule, float_field
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike, State
from qsmc_jax.control.error_bounds import error_envelope, peak_gains, poles
from qsmc_jax.control.funnel import AbstractFunnel
from qsmc_jax.numerics.hurwitz import is_hurwitz

_BINOMIAL_RTOL = 1e-9


class SlidingSurface(AbstractModule):
    r"""Sliding surface $\sigma = c_1 e + \dots + c_{n-1} e^{(n-2)} + e^{(n-1)}$ of a plant of order n.

    On $\sigma = 0$ the tracking error e decays as the roots of $p(s) = s^{n-1} + c_{n-1} s^{n-2} + \dots + c_1$ say.

    Attributes:
        c: Coefficients $c_1, \dots, c_{n-1}$ [1/s^{n-1}, ..., 1/s], lowest derivative first; empty for a plant of order
            1.

    Raises:
        InputError: If p is not Hurwitz; the message names the root. A traced `c` is not checked: see `is_hurwitz`.

    Examples:
        Both roots at -2, $(s + 2)^2 = s^2 + 4 s + 4$:

        >>> import qsmc_jax as qj
        >>> surface = qj.SlidingSurface.binomial(2.0, order=3)
        >>> surface.c.tolist(), surface((1.0, 0.0, 0.5)).item()
        ([4.0, 4.0], 4.5)
        >>> [round(bound, 3) for bound in surface.paper_bounds(0.1).tolist()]
        [0.025, 0.1, 0.4]

    Source: paper, eq. (2).
    """

    c: Float[Array, " c"] = float_field()

    def __check_init__(self):
        if is_traced(self.c) or np.ndim(self.c) != 1:  # the base class refuses another rank
            return
        require_finite("c", self.c)
        require(bool(self.is_hurwitz()), _not_hurwitz(np.asarray(self.c)))

    def __call__(self, e: State) -> RealScalarLike:
        """The sliding variable, in units of the highest error derivative.

        Args:
            e: Errors `e[0] ... e[n - 1]`: the tracking error and its n - 1 derivatives.

        Returns:
            A scalar.
        """
        require(
            len(e) == self.order,
            f"Argument `e` must hold {self.order} errors, one more than `c` has coefficients, but has {len(e)}.",
        )
        return sum((self.c[j] * e[j] for j in range(self.order - 1)), start=e[self.order - 1])

    @classmethod
    def binomial(cls, a: RealScalarLike, order: int) -> "SlidingSurface":
        r"""The surface with all n - 1 roots at $-a$, $c_i = \binom{n-1}{n-i} a^{n-i}$.

        Args:
            a: Rate of decay [1/s], positive.
            order: Order n of the plant, at least 1.

        Source: paper, proof of Theorem 1.
        """
        require(order >= 1, f"Argument `order` must be at least 1, but is {order}. It is the order of the plant.")
        require_positive("a", a)
        c: Any = [math.comb(order - 1, order - i) * a ** (order - i) for i in range(1, order)]
        return cls(c)

    @property
    def order(self) -> int:
        """The order n of the plant the surface is for."""
        return self.c.shape[-1] + 1

    def roots(self) -> Complex[np.ndarray, " c"]:
        """The roots of p [1/s]; numbers only, not traced."""
        return poles(np.asarray(self.c))

    def is_hurwitz(self) -> BoolScalarLike:
        """Whether every root of p has a negative real part; a root on the imaginary axis fails. Works on traced `c`."""
        return is_hurwitz(self.c)

    def error_bounds(self, bandwidth: RealScalarLike) -> Float[Array | np.ndarray, " n"]:
        r"""The sharp bounds $\varepsilon \|G_i\|_1$ that $|\sigma| \le \varepsilon$ leaves in the end on $|e^{(i)}|$.

        They hold for any Hurwitz c, and no smaller number does. Traced `c`: see `peak_gains`.

        Args:
            bandwidth: Bandwidth $\varepsilon$ of the quasi-sliding mode, in units of the sliding variable.
        """
        return bandwidth * peak_gains(self.c)

    def paper_bounds(self, bandwidth: float) -> Float[np.ndarray, " n"] | None:
        r"""The paper's bounds $(2a)^i \varepsilon / a^{n-1}$ on $|e^{(i)}|$, or None if they do not apply.

        Numbers only. They need the binomial coefficients, here to a relative 1e-9; they are sharp for i = 0 and n = 2.

        Args:
            bandwidth: Bandwidth $\varepsilon$ of the quasi-sliding mode, in units of the sliding variable.

        Source: paper, proof of Theorem 1, after Slotine and Li, Applied Nonlinear Control (1991), section 7.1.
        """
        degree = self.order - 1
        a = self.c[-1] / degree if degree else 1.0
        if not np.allclose(self.c, type(self).binomial(a, self.order).c, rtol=_BINOMIAL_RTOL, atol=0.0):
            return None
        return np.asarray(bandwidth * (2.0 * a) ** np.arange(self.order) / a**degree)

    def error_envelope(
        self,
        ts: Sequence[float] | Float[ArrayLike, " times"],
        e0: State | Float[ArrayLike, " n"],
        funnel: AbstractFunnel,
    ) -> Float[np.ndarray, "times n"]:
        r"""The sharp bounds on $|e^{(i)}(t)|$ of a run that starts at `e0` and stays in the funnel; numbers only.

        Args:
            ts: Times [s], not negative, in any order.
            e0: Errors at time 0, `e0[0] ... e0[n - 1]`.
            funnel: The funnel; for one that is not exponential, bounds of one around it, which are not sharp.

        Returns:
            One row per time, one column per derivative i = 0 ... n - 1.

        Raises:
            InputError: If `e0` lies outside the funnel or a time is negative.
        """
        times, errors = np.asarray(ts, float), np.asarray(e0, float)
        earliest = float(times.min(initial=0.0))
        require(earliest == 0.0, f"Argument `ts` must not be negative, but has {earliest:.6g}. Runs start at time 0.")
        centre, width = float(funnel.centre(0.0)), float(funnel(0.0))
        away, name = abs(float(self(tuple(errors))) - centre), f"|sigma - {centre:.6g}|" if centre else "|sigma|"
        require(
            away < width,
            f"Argument `e0` must start inside the funnel, {name} < {width:.6g}, but has {name} = {away:.6g}. "
            "Choose a wider one.",
        )
        around = funnel.enclosing(2.0 * funnel.bandwidths[0])
        rho0, mu, rho_inf = (float(v) for v in (around.rho0, around.mu, around.rho_inf))
        return error_envelope(np.asarray(self.c), times, errors, rho0, mu, rho_inf)


def _not_hurwitz(c: Float[np.ndarray, " c"]) -> str:
    worst = max(poles(c), key=lambda root: (root.real, root.imag), default=0j)
    real = abs(max(worst.real, 0.0))  # a root on the axis may come out of the root finder just left of it
    root = f"{real:.6g}{worst.imag:+.6g}j" if worst.imag else f"{real:.6g}"
    return (
        f"Argument `c` must make {_polynomial(c)} Hurwitz, but has the root {root} with real part {real:.6g} >= 0. "
        "Choose coefficients whose roots have negative real parts, for instance `SlidingSurface.binomial(a, order)`."
    )


def _polynomial(c: Float[np.ndarray, " c"]) -> str:
    degree = len(c)
    powers = [*("" if j == 0 else " s" if j == 1 else f" s^{j}" for j in range(degree))]
    lower = [f" {'-' if c[j] < 0 else '+'} {abs(c[j]):.6g}{powers[j]}" for j in reversed(range(degree))]
    return ("s" if degree == 1 else f"s^{degree}") + "".join(lower)
