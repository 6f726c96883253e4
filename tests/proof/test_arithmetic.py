"""Interval arithmetic against mpmath with 100 digits: no enclosure is too small, and none much too wide."""

import math

import mpmath
import numpy as np
import pytest

from qsmc_jax.proof.arithmetic import Arithmetic, Interval, point

AR = Arithmetic()
ELEMENTARY = {
    "exp": (mpmath.exp, -60.0, 60.0),
    "log": (mpmath.log, 1e-6, 1e6),
    "sin": (mpmath.sin, -100.0, 100.0),
    "cos": (mpmath.cos, -100.0, 100.0),
    "tan": (mpmath.tan, -1.57, 1.57),
    "atan": (mpmath.atan, -1e4, 1e4),
    "sqrt": (mpmath.sqrt, 1e-9, 1e9),
}
BINARY = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
}
# Widths of results at points, in parts of their size or of 1: some units in the last place for each term of a series.
SHARP = 1e-13


def drawn(low, high, count, seed):
    """Numbers of many sizes, some of them next to multiples of pi/2, to powers of two, and to the ends."""
    rng = np.random.default_rng(seed)
    sizes = rng.uniform(low, high, count)
    special = np.concatenate([np.arange(-60, 61) * (math.pi / 2), 2.0 ** np.arange(-20, 20), [low, high]])
    special = special[(special >= low) & (special <= high)]
    near = np.concatenate([special, np.nextafter(special, math.inf), np.nextafter(special, -math.inf)])
    return np.concatenate([sizes, near[(near >= low) & (near <= high)]])


def exact(fn, x):
    with mpmath.workdps(100):
        return fn(mpmath.mpf(float(x)))


def holds(interval, truth):
    """Whether the ends, which are doubles, lie on either side of the exact numbers."""
    ends = zip(np.ravel(interval.lo), np.ravel(interval.hi), truth, strict=True)
    return [mpmath.mpf(float(lo)) <= value <= mpmath.mpf(float(hi)) for lo, hi, value in ends]


@pytest.mark.parametrize("name", ELEMENTARY)
def test_at_points_a_function_is_enclosed_closely(name):
    fn, low, high = ELEMENTARY[name]
    x = drawn(low, high, 1000, 1)
    with mpmath.workdps(100):
        found = getattr(AR, name)(point(x))
        truth = [exact(fn, each) for each in x]
        assert all(holds(found, truth))
    size = np.maximum(1.0, np.abs([float(each) for each in truth]))
    loose = {"tan": 1e3, "sin": 10.0, "cos": 10.0}.get(name, 1.0)  # next to a pole; and angles of many turns
    assert np.all(found.hi - found.lo <= loose * SHARP * size * np.maximum(1.0, np.abs(x) / 10.0))


@pytest.mark.parametrize("name", ELEMENTARY)
def test_over_an_interval_every_value_is_inside(name):
    fn, low, high = ELEMENTARY[name]
    rng = np.random.default_rng(2)
    ends = np.sort(rng.uniform(low, high, (300, 2)) * rng.choice([1.0, 0.05], (300, 1)), axis=1)
    ends = np.clip(ends, low, high)
    found = getattr(AR, name)(Interval(ends[:, 0], ends[:, 1]))
    with mpmath.workdps(100):
        for part in (0.0, 0.1, 0.37, 0.5, 0.93, 1.0):
            inner = np.clip(ends[:, 0] + part * (ends[:, 1] - ends[:, 0]), ends[:, 0], ends[:, 1])
            assert all(holds(found, [exact(fn, each) for each in inner]))


@pytest.mark.parametrize("name", ["sin", "cos"])
@pytest.mark.parametrize("turns", [0, 1, -3, 12, 1000])
def test_crests_inside_an_interval_are_taken_in(name, turns):
    """Between ends close to a crest, and far from one, whatever the sign."""
    for crest, value in ((0.5, 1.0), (1.5, -1.0)):
        at = math.pi * (crest + 2 * turns) if name == "sin" else math.pi * (crest - 0.5 + 2 * turns)
        for width in (1e-7, 0.3, 1.0):
            found = getattr(AR, name)(Interval(np.array([at - width]), np.array([at + 0.5 * width])))
            assert found.lo[0] <= value <= found.hi[0]


@pytest.mark.parametrize("name", ["sin", "cos"])
def test_huge_angles_are_enclosed_or_not_known(name):
    x = 10.0 ** np.random.default_rng(5).uniform(8.0, 22.0, 500)
    with np.errstate(all="ignore"), mpmath.workdps(100):
        found = getattr(AR, name)(point(x))
        inside = holds(found, [exact(ELEMENTARY[name][0], each) for each in x])
    assert np.all(np.isnan(found.lo) | inside)


@pytest.mark.parametrize("name", BINARY)
def test_sums_and_products_are_enclosed(name):
    rng = np.random.default_rng(3)
    sizes = 10.0 ** rng.uniform(-12.0, 12.0, (2, 1000)) * rng.choice([-1.0, 1.0], (2, 1000))
    a, b = (Interval(np.minimum(x, 0.9 * x), np.maximum(x, 0.9 * x)) for x in sizes)
    found = getattr(AR, name)(a, b)
    with mpmath.workdps(100):
        for p in (a.lo, a.hi):
            for q in (b.lo, b.hi):
                pairs = zip(p, q, strict=True)
                assert all(holds(found, [BINARY[name](mpmath.mpf(x), mpmath.mpf(y)) for x, y in pairs]))


@pytest.mark.parametrize("exponent", [1, 2, 3, 7, 10])
def test_powers_are_enclosed(exponent):
    rng = np.random.default_rng(4)
    ends = np.sort(rng.uniform(-3.0, 3.0, (500, 2)), axis=1)
    found = AR.power(Interval(ends[:, 0], ends[:, 1]), exponent)
    with mpmath.workdps(100):
        for part in (0.0, 0.3, 0.5, 0.8, 1.0):
            inner = np.clip(ends[:, 0] + part * (ends[:, 1] - ends[:, 0]), ends[:, 0], ends[:, 1])
            assert all(holds(found, [mpmath.mpf(float(each)) ** exponent for each in inner]))


@pytest.mark.parametrize(
    ("name", "x"),
    [
        *(("tan", each) for each in (1.5708, -1.58, 3.0, math.inf)),
        *(("log", each) for each in (0.0, -1.0, math.inf)),
        *(("sqrt", each) for each in (-1.0, math.inf)),
        *((name, math.nan) for name in ELEMENTARY),
        ("cos", 1e300),
        ("atan", 1e300),
    ],
)
def test_what_is_not_known_holds_no_comparison(name, x):
    """Or all that a function can be: nobody is told a number that is not so."""
    with np.errstate(all="ignore"):
        found = getattr(AR, name)(point(np.array([x])))
    least, most = {"cos": (-1.0, 1.0), "atan": (-1.570796, 1.570797)}.get(name, (math.inf, -math.inf))
    assert np.isnan(found.lo[0]) or np.isnan(found.hi[0]) or (found.lo[0] <= least and found.hi[0] >= most)


def test_the_sums_of_what_overflows_are_not_known():
    with np.errstate(all="ignore"):
        found = AR.mul(point(np.array([1e200])), point(np.array([1e200])))
        assert not np.all(found.lo <= 0.0)
        assert not np.all(AR.sub(found, found).lo >= 0.0)


@pytest.mark.parametrize("ends", [((0.0, 0.0), (0.0, 0.0)), ((1.0, 1.0), (1.0, 1.0)), ((-1.0, 2.0), (0.0, 1.0))])
def test_kinks_have_all_slopes_between_their_sides(ends):
    """Where a = b the derivative of max(a, b) by a is anything from 0 to 1, also where neither has any width."""
    from qsmc_jax.proof import field

    a, b = (Interval(np.array([low]), np.array([high])) for low, high in ends)
    part = field._part(AR, a, b)
    assert part.lo[0] == 0.0
    assert part.hi[0] == 1.0
    sign = field._sign(AR, Interval(np.array([0.0]), np.array([0.0])))
    assert (sign.lo[0], sign.hi[0]) == (-1.0, 1.0)
