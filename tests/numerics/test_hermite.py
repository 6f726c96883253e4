"""The interpolants of a step: exact on polynomials of their degree, with the true maximum."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from qsmc_jax.numerics.hermite import Cubic, Quartic

THETAS = np.linspace(0.0, 1.0, 2001)
NUMBER = st.floats(-1e3, 1e3, allow_subnormal=False)
CUBICS = st.tuples(NUMBER, NUMBER, NUMBER, NUMBER)

largest = jax.jit(Cubic.largest)
turning_points = jax.jit(Cubic.turning_points)
gradient_of_largest = jax.jit(jax.grad(Cubic.largest))
cubic_values = jax.jit(jax.vmap(Cubic.__call__, (None, 0)))
cubic_slopes = jax.jit(jax.vmap(Cubic.slope, (None, 0)))
quartic_values = jax.jit(jax.vmap(Quartic.__call__, (None, 0)))
highest = jax.jit(Quartic.highest)


def cubic_of(p):
    slope = p.deriv()
    return Cubic(p(0.0), p(1.0), slope(0.0), slope(1.0))


def quartic_of(p):
    return Quartic(cubic_of(p), p(0.5))


def scale(ends):
    return 1.0 + max(map(abs, ends))


@given(CUBICS)
def test_cubic_is_exact_on_cubics(coefficients):
    p = Polynomial(coefficients)
    np.testing.assert_allclose(cubic_values(cubic_of(p), THETAS), p(THETAS), rtol=0, atol=1e-13 * scale(coefficients))


@given(CUBICS)
def test_slope_is_exact_on_cubics(coefficients):
    p = Polynomial(coefficients)
    slopes = cubic_slopes(cubic_of(p), THETAS)
    np.testing.assert_allclose(slopes, p.deriv()(THETAS), rtol=0, atol=1e-12 * scale(coefficients))


@given(st.tuples(*[NUMBER] * 5))
def test_quartic_is_exact_on_quartics(coefficients):
    p = Polynomial(coefficients)
    values = quartic_values(quartic_of(p), THETAS)
    np.testing.assert_allclose(values, p(THETAS), rtol=0, atol=1e-12 * scale(coefficients))


@given(CUBICS)
def test_largest_is_the_maximum_of_dense_samples(ends):
    cubic = Cubic(*ends)
    highest, sampled = float(largest(cubic)), np.max(np.abs(cubic_values(cubic, THETAS)))
    # Between samples, 1/2000 apart, a cubic rises above them by at most max|p''| / 8 times that squared.
    curvature = 12.0 * (abs(ends[0]) + abs(ends[1])) + 6.0 * (abs(ends[2]) + abs(ends[3]))
    rounding = 1e-12 * scale(ends)
    assert sampled - rounding <= highest <= sampled + curvature / 8 / 2000**2 + rounding


@given(CUBICS, st.floats(0.0, 1.0))
def test_largest_from_a_start_on_ignores_what_comes_before(ends, start):
    cubic = Cubic(*ends)
    sampled = np.max(np.abs(cubic_values(cubic, start + (1.0 - start) * THETAS)))
    curvature = 12.0 * (abs(ends[0]) + abs(ends[1])) + 6.0 * (abs(ends[2]) + abs(ends[3]))
    rounding = 1e-12 * scale(ends)
    assert sampled - rounding <= float(largest(cubic, start)) <= sampled + curvature / 8 / 2000**2 + rounding


def test_turning_points_are_the_roots_of_the_slope():
    p = Polynomial.fromroots([0.2, 0.7]).integ()
    np.testing.assert_allclose(turning_points(cubic_of(p)), [0.2, 0.7], atol=1e-14)


@pytest.mark.parametrize(
    "p",
    {
        "constant": Polynomial([2.0]),
        "line": Polynomial([1.0, -3.0]),
        "monotone cubic": Polynomial([0.0, 1.0, 0.0, 1.0]),
        "turns outside": Polynomial.fromroots([-0.5, 1.5]).integ(),
    }.values(),
)
def test_ends_stand_for_missing_turns(p):
    low, high = turning_points(cubic_of(p))
    assert {float(low), float(high)} <= {0.0, 1.0}


def test_parabola_turns_once():
    assert 0.3 in [pytest.approx(float(turn)) for turn in turning_points(cubic_of(Polynomial.fromroots([0.3]).integ()))]


@given(CUBICS)
def test_gradient_of_the_maximum_is_finite(ends):
    assert np.all(np.isfinite(gradient_of_largest(Cubic(*ends))))


def test_gradient_of_the_maximum_is_that_at_its_place():
    # d max p / d p(0) = (1 + 2 theta) (1 - theta)^2 at the turn, here 0.5 by symmetry.
    gradient = gradient_of_largest(Cubic(0.0, 0.0, 1.0, -1.0))
    np.testing.assert_allclose(gradient, [0.5, 0.5, 0.125, -0.125], atol=1e-15)


def test_quartic_finds_the_turn_next_to_the_cubics():
    p = Polynomial.fromroots([0.45, -1.0, 2.0]).integ()
    quartic = quartic_of(p)
    guess = min(turning_points(quartic.ends), key=lambda turn: abs(float(turn) - 0.45))
    assert abs(float(guess) - 0.45) > 1e-5
    assert float(jax.jit(Quartic.turn_near)(quartic, guess)) == pytest.approx(0.45, abs=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_highest_place_of_a_quartic_and_its_height(sign):
    p = sign * (1.0 - Polynomial.fromroots([0.3]) ** 2 + 0.1 * Polynomial.fromroots([0.3]) ** 4)
    place, height = highest(quartic_of(p))
    assert float(place) == pytest.approx(0.3, abs=1e-9)
    assert float(height) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize(("slope", "place"), [(-1.0, 0.0), (1.0, 1.0)])
def test_highest_place_of_a_line_is_an_end(slope, place):
    found, height = highest(quartic_of(Polynomial([2.0, slope])))
    assert (float(found), float(height)) == (place, max(2.0, 2.0 + slope))
