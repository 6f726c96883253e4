"""The dense output that the methods share: a quartic in each coordinate."""

import diffrax as dfx
import jax.numpy as jnp

from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.numerics.hermite import Quartic, cubics


class QuarticInterpolation(dfx.AbstractLocalInterpolation):
    """Through the values and derivatives at both ends of the step, and the value at its middle; for states of scalars.

    Attributes:
        t0: Start of the step [s].
        t1: Its end [s].
        y0: Values at the start.
        y1: Values at the end.
        dy0: Derivatives at the start.
        dy1: Derivatives at the end.
        middle: Values at the middle.
    """

    t0: RealScalarLike
    t1: RealScalarLike
    y0: Scalars
    y1: Scalars
    dy0: Scalars
    dy1: Scalars
    middle: Scalars

    def evaluate(self, t0: RealScalarLike, t1: RealScalarLike | None = None, left: bool = True) -> Scalars:
        """The values at `t0`, or what they change from `t0` to `t1` [s]."""
        if t1 is not None:
            return tuple(b - a for a, b in zip(self.evaluate(t0), self.evaluate(t1), strict=True))
        h = self.t1 - self.t0
        return self.at(jnp.where(h > 0.0, (t0 - self.t0) / jnp.where(h > 0.0, h, 1.0), 0.0))

    def at(self, theta: RealScalarLike) -> Scalars:
        """The values at a place in the step, 0 at its start and 1 at its end."""
        ends = cubics(self.t1 - self.t0, self.y0, self.y1, self.dy0, self.dy1)
        return tuple(Quartic(cubic, middle)(theta) for cubic, middle in zip(ends, self.middle, strict=True))
