"""The cubic Hermite interpolant of one step, on the unit interval, and where it turns.

A step of an adaptive solver knows the value and the slope at both ends. Metrics such as a supremum are read off this
cubic, never off a save grid. Slopes are per step: `m = h * dy/dt`.
"""

import functools as ft
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient

from qsmc_jax.base.types import RealScalarLike, Scalars

_BISECTIONS = 50


class Cubic(NamedTuple):
    r"""$p(\theta)$, $\theta \in [0, 1]$, with $p(0) = y_0$, $p(1) = y_1$, $p'(0) = m_0$, $p'(1) = m_1$."""

    y0: RealScalarLike
    y1: RealScalarLike
    m0: RealScalarLike
    m1: RealScalarLike

    def coefficients(self) -> tuple[RealScalarLike, RealScalarLike, RealScalarLike]:
        r"""$(a, b, m_0)$ of $p = y_0 + m_0 \theta + b \theta^2 + a \theta^3$."""
        rise = self.y1 - self.y0
        return self.m0 + self.m1 - 2.0 * rise, 3.0 * rise - 2.0 * self.m0 - self.m1, self.m0

    def __call__(self, theta: RealScalarLike) -> RealScalarLike:
        """The value at `theta`."""
        a, b, m0 = self.coefficients()
        return self.y0 + theta * (m0 + theta * (b + theta * a))

    def slope(self, theta: RealScalarLike) -> RealScalarLike:
        """The derivative at `theta`, per step."""
        a, b, m0 = self.coefficients()
        return m0 + theta * (2.0 * b + theta * 3.0 * a)

    def turning_points(self) -> tuple[RealScalarLike, RealScalarLike]:
        """Where the cubic turns, in order, clipped to [0, 1]; an end of the interval stands for a missing turn.

        Gradients do not pass through: at an extremum the value does not depend on the place to first order.
        """
        a, b, m0 = (stop_gradient(c) for c in self.coefficients())
        discriminant = b * b - 3.0 * a * m0
        q = -(b + jnp.where(b < 0.0, -1.0, 1.0) * jnp.sqrt(jnp.maximum(discriminant, 0.0)))
        first, second = _quotient(q, 3.0 * a), _quotient(m0, q)
        turns = discriminant > 0.0
        low = jnp.where(turns, jnp.minimum(first, second), 0.0)
        high = jnp.where(turns, jnp.maximum(first, second), 1.0)
        return jnp.clip(low, 0.0, 1.0), jnp.clip(high, 0.0, 1.0)

    def stations(self, start: RealScalarLike = 0.0) -> tuple[RealScalarLike, ...]:
        r"""$p$ at `start` in [0, 1], at the turning points after it, and at 1; between these $p$ is monotone."""
        return (self(start), *(self(jnp.maximum(turn, start)) for turn in self.turning_points()), self.y1)

    def largest(self, start: RealScalarLike = 0.0) -> RealScalarLike:
        r"""$\max |p(\theta)|$ over $\theta$ from `start` in [0, 1] on."""
        return ft.reduce(jnp.maximum, map(jnp.abs, self.stations(start)))

    def parabolas_turn(self) -> RealScalarLike:
        """Where the parabola with the slopes of both ends turns; 1 if it does not."""
        m0, m1 = stop_gradient(self.m0), stop_gradient(self.m1)
        turns = m0 * m1 < 0.0
        return jnp.where(turns, m0 / jnp.where(turns, m0 - m1, 1.0), 1.0)

    def crest(self) -> tuple[RealScalarLike, RealScalarLike]:
        r"""Where $|p|$ is highest after the start, and how high, if the cubic hardly bends more than a parabola does.

        It looks at the end, and where the parabola with the slopes of both ends turns. What it misses is of the size of
        the third-order terms of the step, which a solver of order 3 holds below its tolerance; in return it takes one
        division.
        """
        place = self.parabolas_turn()
        inner, end = jnp.abs(self(place)), jnp.abs(self.y1)
        is_inner = inner > end
        return jnp.where(is_inner, place, 1.0), jnp.where(is_inner, inner, end)

    def last_descent(self, level: RealScalarLike) -> RealScalarLike:
        r"""The last place at which $|p|$ falls through `level`, given that it is at least `level` somewhere.

        On the last monotone piece that begins outside, a bisection finds the place, and one Newton step from there
        carries the derivative.
        """
        low, high = self.turning_points()
        left, right = jnp.zeros(()), low
        for start, end in ((low, high), (high, jnp.ones(()))):
            begins_outside = jnp.abs(self(start)) >= level
            left, right = jnp.where(begins_outside, start, left), jnp.where(begins_outside, end, right)
        left, _ = stop_gradient(jax.lax.fori_loop(0, _BISECTIONS, ft.partial(_halve, self, level), (left, right)))
        slope = jnp.sign(self(left)) * self.slope(left)
        is_falling = slope < 0.0
        step = (level - jnp.abs(self(left))) / jnp.where(is_falling, slope, -1.0)
        return left + jnp.where(is_falling & (jnp.abs(step) < 1e-3), step, 0.0)

    def first_ascent(self, level: RealScalarLike) -> RealScalarLike:
        r"""The first place at which $|p|$ rises through `level`, given that it is at least `level` somewhere."""
        return 1.0 - Cubic(self.y1, self.y0, -self.m1, -self.m0).last_descent(level)


class Quartic(NamedTuple):
    r"""$p(\theta)$, $\theta \in [0, 1]$, with the ends of a cubic, and $p(1/2)$ given."""

    ends: Cubic
    middle: RealScalarLike

    def coefficients(self) -> tuple[RealScalarLike, ...]:
        r"""The coefficients of $p$, the constant first."""
        a, b, m0 = self.ends.coefficients()
        # What the cubic lacks at 1/2, times 16 theta^2 (1 - theta)^2.
        lack = 16.0 * self.middle - (8.0 * (self.ends.y0 + self.ends.y1) + 2.0 * (self.ends.m0 - self.ends.m1))
        return self.ends.y0, m0, b + lack, a - 2.0 * lack, lack

    def __call__(self, theta: RealScalarLike) -> RealScalarLike:
        """The value at `theta`."""
        return _horner(self.coefficients(), theta)

    def turn_near(self, theta: RealScalarLike) -> RealScalarLike:
        """The turning point next to `theta`, where the cubic turns: two Newton steps, kept inside [0, 1]."""
        slope = tuple(k * c for k, c in enumerate(self.coefficients()) if k > 0)
        curvature = tuple(k * c for k, c in enumerate(slope) if k > 0)
        for _ in range(2):
            bend = _horner(curvature, theta)
            step = _horner(slope, theta) / jnp.where(bend == 0.0, jnp.inf, bend)
            theta = jnp.clip(theta - step, 0.0, 1.0)
        return stop_gradient(theta)

    def extremes(self) -> tuple[RealScalarLike, RealScalarLike]:
        r"""The least and the largest $p$ after the start, looked for at the end and where the cubic turns.

        Where the quartic turns beside these places, that is off by the square of the distance only.
        """
        values = (self.ends.y1, *map(self, self.ends.turning_points()))
        return ft.reduce(jnp.minimum, values), ft.reduce(jnp.maximum, values)

    def highest(self) -> tuple[RealScalarLike, RealScalarLike]:
        r"""Where $|p|$ is highest, and how high: the highest place of the cubic, improved if it lies inside."""
        place, height = jnp.ones_like(self.ends.y1), jnp.abs(self.ends.y1)
        for candidate in (jnp.zeros_like(self.ends.y0), *self.ends.turning_points()):
            value = jnp.abs(self.ends(candidate))
            is_higher = value > height
            place, height = jnp.where(is_higher, candidate, place), jnp.where(is_higher, value, height)
        is_inside = (place > 0.0) & (place < 1.0)
        place = jnp.where(is_inside, self.turn_near(place), place)
        return place, jnp.where(is_inside, jnp.abs(self(place)), height)


def _halve(
    cubic: Cubic, level: RealScalarLike, _: Any, bracket: tuple[RealScalarLike, RealScalarLike]
) -> tuple[RealScalarLike, RealScalarLike]:
    """Half of the bracket: what lies left of it is outside the level, what lies right of it inside."""
    middle = 0.5 * (bracket[0] + bracket[1])
    is_outside = stop_gradient(jnp.abs(cubic(middle)) >= level)
    return jnp.where(is_outside, middle, bracket[0]), jnp.where(is_outside, bracket[1], middle)


def cubics(h: RealScalarLike, left: Scalars, right: Scalars, rates0: Scalars, rates1: Scalars) -> list[Cubic]:
    """One for each coordinate over a step of length h, given values and derivatives (per time) at both ends."""
    ends = zip(left, right, rates0, rates1, strict=True)
    return [Cubic(y0, y1, h * m0, h * m1) for y0, y1, m0, m1 in ends]


def integral_of_square(
    h: RealScalarLike,
    left: tuple[RealScalarLike, RealScalarLike],
    right: tuple[RealScalarLike, RealScalarLike],
) -> RealScalarLike:
    """The integral of p^2 over a step of length h, given p and its derivative (per time) at both ends.

    The trapezium rule with end corrections: exact for the cubic through these data, as p^2 has them.
    """
    (p0, m0), (p1, m1) = left, right
    return h * (0.5 * (p0 * p0 + p1 * p1) + h / 6.0 * (p0 * m0 - p1 * m1))


def _horner(coefficients: tuple[RealScalarLike, ...], theta: RealScalarLike) -> RealScalarLike:
    """The polynomial with the given coefficients, the constant first."""
    value = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        value = coefficient + theta * value
    return value


def _quotient(numerator: RealScalarLike, denominator: RealScalarLike) -> RealScalarLike:
    """The quotient, or -1 (outside the unit interval) where the denominator is zero."""
    is_zero = denominator == 0.0
    return jnp.where(is_zero, -1.0, numerator / jnp.where(is_zero, 1.0, denominator))
