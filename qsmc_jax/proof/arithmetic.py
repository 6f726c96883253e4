r"""Interval arithmetic whose every result contains what is exact: NumPy's IEEE operations, and a proof for the rest.

**Rounding.** IEEE 754 rounds +, -, *, / and the square root to nearest: a result r misses the exact number by at most
half a unit in the last place, u(r)/2, or by $2^{-1022}$ where it underflows (also where subnormal numbers are flushed).
`outward` moves r by $t = fl(|r| 2^{-52}) + 2^{-1022} \ge u(r)$: $u(r) \le |r| 2^{-52}$ for normal r. $r - u(r)$ is
a double, and rounding is monotone: so $fl(r - t) \le r - u(r)$ lies below the exact number, as $fl(r + t)$ lies above.
What overflows becomes infinite or NaN, and a NaN makes every comparison false: whoever asks is refused.

**Elementary functions.** No library's rounding is trusted. At a point each is a Taylor polynomial, evaluated in this
arithmetic, of a reduced argument that is an interval itself ($x - k \pi$ with an interval for $\pi$): whatever k is,
the result holds. Added is Lagrange's remainder, whose bound is said where it is used. Over an interval the ends decide
where a function is monotone; the extremes of sine and cosine are taken in where they may lie inside.

The same methods serve `jax.numpy`, to guess what is then proved: `Arithmetic(jnp, points)` rounds as XLA likes, and
nothing rests on it. This file and checker.py are all that a proof rests on; neither needs JAX.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

_EPS, _TINY = 2.0**-52, 2.0**-1022
# The largest argument of exp that is worked out, and bounds of exp beyond: exp(-700) < 1e-304, exp(700) > 1e304.
_EXP_END, _EXP_LOW, _EXP_HIGH = 700.0, 1e-300, 1e300
# Below pi / 2.
_TAN_END = 1.5707963


class Interval(NamedTuple):
    """All numbers from `lo` to `hi`; arrays hold many. A single number has the same object at both ends."""

    lo: Any
    hi: Any


def point(x: Any) -> Interval:
    """The interval of one number."""
    return Interval(x, x)


ZERO, ONE, MINUS = point(0.0), point(1.0), point(-1.0)


class Arithmetic:
    """Operations on intervals, in the arrays of one library.

    Args:
        xp: The library, `numpy` or `jax.numpy`.
        points: Elementary functions at points, where these need no proof; None for those of this file.
    """

    def __init__(self, xp: Any = np, points: Mapping[str, Callable[[Any], Any]] | None = None):
        self.xp, self._points = xp, points

    def outward(self, lo: Any, hi: Any) -> Interval:
        """The interval of two rounded ends, moved outward; see the head of this file."""
        if self._points is not None:
            return Interval(lo, hi)
        return Interval(lo - (abs(lo) * _EPS + _TINY), hi + (abs(hi) * _EPS + _TINY))

    def add(self, a: Interval, b: Interval) -> Interval:
        """The sum."""
        return self.outward(a.lo + b.lo, a.hi + b.hi)

    def sub(self, a: Interval, b: Interval) -> Interval:
        """The difference."""
        return self.outward(a.lo - b.hi, a.hi - b.lo)

    def neg(self, a: Interval) -> Interval:
        """The negative, which is exact."""
        return Interval(-a.hi, -a.lo)

    def mul(self, a: Interval, b: Interval) -> Interval:
        """The product."""
        ends = [p * q for p in self._ends(a) for q in self._ends(b)]
        return self.outward(*self._range(ends))

    def div(self, a: Interval, b: Interval) -> Interval:
        """The quotient; NaN where the divisor may be 0."""
        ends = [p / q for p in self._ends(a) for q in self._ends(b)]
        return self.where((b.lo > 0.0) | (b.hi < 0.0), self.outward(*self._range(ends)))

    def power(self, a: Interval, exponent: int) -> Interval:
        """A whole power, at least 1."""
        size = self.abs(a) if exponent % 2 == 0 else a  # an odd power grows, an even one with the absolute value
        low, high = point(size.lo), point(size.hi)
        for _ in range(exponent - 1):
            low, high = self.mul(low, point(size.lo)), self.mul(high, point(size.hi))
        return Interval(low.lo, high.hi)

    def abs(self, a: Interval) -> Interval:
        """The absolute value, which is exact."""
        least = self.xp.where((a.lo <= 0.0) & (a.hi >= 0.0), 0.0, self.xp.minimum(abs(a.lo), abs(a.hi)))
        return Interval(least, self.xp.maximum(abs(a.lo), abs(a.hi)))

    def max(self, a: Interval, b: Interval) -> Interval:
        """The larger, which is exact."""
        return Interval(self.xp.maximum(a.lo, b.lo), self.xp.maximum(a.hi, b.hi))

    def min(self, a: Interval, b: Interval) -> Interval:
        """The smaller, which is exact."""
        return Interval(self.xp.minimum(a.lo, b.lo), self.xp.minimum(a.hi, b.hi))

    def sqrt(self, a: Interval) -> Interval:
        """The square root; NaN unless positive. IEEE rounds it to nearest."""
        inside = self.where(a.lo > 0.0, a)
        return self.outward(self.xp.sqrt(inside.lo), self.xp.sqrt(inside.hi))

    def exp(self, a: Interval) -> Interval:
        """The exponential."""
        return self._growing("exp", a)

    def log(self, a: Interval) -> Interval:
        """The natural logarithm; NaN unless positive."""
        return self._growing("log", self.where(a.lo > 0.0, a))

    def atan(self, a: Interval) -> Interval:
        """The arctangent."""
        return self._growing("atan", a)

    def tan(self, a: Interval) -> Interval:
        """The tangent between -pi/2 and pi/2; NaN elsewhere."""
        return self._growing("tan", self.where((a.lo > -_TAN_END) & (a.hi < _TAN_END), a))

    def sin(self, a: Interval) -> Interval:
        """The sine."""
        return self._wave("sin", a, point(0.5))

    def cos(self, a: Interval) -> Interval:
        """The cosine."""
        return self._wave("cos", a, ZERO)

    def _wave(self, name: str, a: Interval, crest: Interval) -> Interval:
        """Sine or cosine, which are 1 where the angle in half turns, less `crest`, is an even integer."""
        xp, ends = self.xp, [self._at(name, end) for end in self._ends(a)]
        low, high = self._range([end for pair in ends for end in pair])
        half_turns = self.sub(self.div(a, PI), crest)
        crests, troughs = (self.mul(each, point(0.5)) for each in (half_turns, self.sub(half_turns, ONE)))
        has_crest, has_trough = (xp.ceil(each.lo) <= xp.floor(each.hi) for each in (crests, troughs))
        low, high = xp.where(has_trough, -1.0, low), xp.where(has_crest, 1.0, high)
        return Interval(xp.maximum(low, -1.0), xp.minimum(high, 1.0))

    def _growing(self, name: str, a: Interval) -> Interval:
        ends = [self._at(name, end) for end in self._ends(a)]
        return Interval(ends[0].lo, ends[-1].hi)

    def _at(self, name: str, x: Any) -> Interval:
        """An elementary function at points."""
        if self._points is not None:
            return point(self._points[name](x))
        return _POINTS[name](x)

    def _ends(self, a: Interval) -> tuple[Any, ...]:
        return (a.lo,) if a.lo is a.hi else (a.lo, a.hi)

    def _range(self, values: list[Any]) -> tuple[Any, Any]:
        low = high = values[0]
        for value in values[1:]:
            low, high = self.xp.minimum(low, value), self.xp.maximum(high, value)
        return low, high

    def where(self, holds: Any, a: Interval) -> Interval:
        """The interval where something holds, NaN elsewhere."""
        return Interval(self.xp.where(holds, a.lo, math.nan), self.xp.where(holds, a.hi, math.nan))


_NP = Arithmetic()
# The double nearest to pi is below it, 3.141592653589793116 < pi, and that of ln 2 too, 0.693147180559945286 < ln 2.
PI = Interval(math.pi, float(np.nextafter(math.pi, 4.0)))
_LN2 = Interval(0.6931471805599453, float(np.nextafter(0.6931471805599453, 1.0)))


def _series(x: Interval, divisors: list[int]) -> Interval:
    """The sum of x**j / divisors[j], by Horner's rule. Divisors are doubles: below 2**53 but for a power of two."""
    terms = [_NP.div(ONE, point(float(divisor))) for divisor in divisors]
    total = terms[-1]
    for term in reversed(terms[:-1]):
        total = _NP.add(term, _NP.mul(x, total))
    return total


def _size(x: Interval) -> Any:
    return np.maximum(abs(x.lo), abs(x.hi))


def _widened(value: Interval, remainder: Any) -> Interval:
    """A value that misses by at most so much; the caller's bound has a factor to spare for its own rounding."""
    return _NP.outward(value.lo - remainder, value.hi + remainder)


def _exp(x: Any) -> Interval:
    """It is 2**k exp r, r = x - k ln 2. Remainder after r**16: |r|**17 / 17! exp |r|, and exp |r| < 2 for r < 0.69."""
    inside = np.clip(x, -_EXP_END, _EXP_END)
    k = np.rint(inside / math.log(2.0))
    r = _NP.sub(point(inside), _NP.mul(point(k), _LN2))
    size = _size(r)
    value = _widened(_series(r, [math.factorial(j) for j in range(17)]), 4.0 * size**17 / math.factorial(17))
    # Times a power of two is exact: the result is between 1e-305 and 1e305.
    low, high = (np.ldexp(end, k.astype(int)) for end in value)
    low = np.where(size < 0.6, np.where(x < -_EXP_END, 0.0, low), math.nan)
    low, high = np.where(x > _EXP_END, _EXP_HIGH, low), np.where(x > _EXP_END, math.inf, high)
    return Interval(np.where(np.isnan(x), math.nan, low), np.where(x < -_EXP_END, _EXP_LOW, high))


def _log(x: Any) -> Interval:
    """It is k ln 2 + 2 artanh s, s = (m - 1)/(m + 1), m = x / 2**k. Remainder after s**25: |s|**27 / (27 (1 - s s))."""
    m, k = np.frexp(x)
    m, k = np.where(m < 0.7, 2.0 * m, m), np.where(m < 0.7, k - 1, k).astype(float)
    s = _NP.div(_NP.sub(point(m), ONE), _NP.add(point(m), ONE))
    size = _size(s)
    half = _NP.mul(s, _series(_NP.power(s, 2), [2 * j + 1 for j in range(13)]))
    half = _widened(half, np.where(size < 0.5, size**27 / 9.0, math.nan))
    return _NP.add(_NP.mul(point(k), _LN2), _NP.mul(point(2.0), half))


def _sine(x: Interval, half_turns: Any) -> Interval:
    """sin(x + k pi) = (-1)**k sin x, for a whole k. Remainder after x**21: |x|**23 / 23!, for any x."""
    size = _size(x)
    divisors = [(-1) ** j * math.factorial(2 * j + 1) for j in range(11)]
    value = _NP.mul(x, _series(_NP.power(x, 2), divisors))
    value = _widened(value, 2.0 * size**23 / math.factorial(23))
    is_odd, negative = half_turns % 2.0 == 1.0, _NP.neg(value)
    return Interval(np.where(is_odd, negative.lo, value.lo), np.where(is_odd, negative.hi, value.hi))


def _sin(x: Any) -> Interval:
    k = np.rint(x / math.pi)
    return _sine(_NP.sub(point(x), _NP.mul(point(k), PI)), k)


def _cos(x: Any) -> Interval:
    """It is sin(x + pi / 2) = sin(r + k pi), r = x - (k - 1/2) pi."""
    k = np.rint(x / math.pi + 0.5)
    return _sine(_NP.sub(point(x), _NP.mul(point(k - 0.5), PI)), k)


def _tan(x: Any) -> Interval:
    return _NP.div(_sin(x), _cos(x))


def _atan(x: Any) -> Interval:
    """It is 2 atan(x / (1 + sqrt(1 + x x))), three times; then remainder after y**25: |y|**27 / 27 (alternating)."""
    y = point(x)
    for _ in range(3):
        y = _NP.div(y, _NP.add(ONE, _NP.sqrt(_NP.add(ONE, _NP.power(y, 2)))))
    size = _size(y)
    value = _NP.mul(y, _series(_NP.power(y, 2), [(-1) ** j * (2 * j + 1) for j in range(13)]))
    return _NP.mul(point(8.0), _widened(value, np.where(size < 0.5, size**27 / 13.0, math.nan)))


_POINTS: dict[str, Callable[[Any], Interval]] = {
    "exp": _exp,
    "log": _log,
    "sin": _sin,
    "cos": _cos,
    "tan": _tan,
    "atan": _atan,
}
