"""The sliding surface: its formula, its roots, and what it refuses."""

import jax
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from qsmc_jax.control.surface import SlidingSurface
from qsmc_jax.numerics.hurwitz import is_hurwitz


def coefficients(roots):
    """c_1, ..., c_{n-1} of the polynomial with the given roots."""
    return np.atleast_1d(np.poly(roots)).real[:0:-1].copy()


def test_the_sliding_variable_is_equation_2():
    assert SlidingSurface([6.0, 12.0, 8.0])((1.0, 2.0, 3.0, 4.0)) == 6.0 + 24.0 + 24.0 + 4.0


def test_a_plant_of_order_one_has_its_error_as_sliding_variable():
    surface = SlidingSurface([])
    assert surface.order == 1
    assert surface((0.3,)) == 0.3


def test_a_state_of_another_order_is_refused():
    with pytest.raises(
        ValueError, match="Argument `e` must hold 2 errors, one more than `c` has coefficients, but has 3"
    ):
        SlidingSurface([2.0])((1.0, 2.0, 3.0))


@pytest.mark.parametrize("order", range(1, 8))
def test_binomial_coefficients_put_every_root_at_minus_a(order):
    np.testing.assert_allclose(SlidingSurface.binomial(1.5, order).c, coefficients([-1.5] * (order - 1)), rtol=1e-12)


def test_binomial_takes_a_traced_rate():
    slope = jax.jacfwd(lambda a: SlidingSurface.binomial(a, 4).c)(2.0)
    np.testing.assert_allclose(slope, [12.0, 12.0, 3.0])


@pytest.mark.parametrize("a", [0.0, -1.0])
def test_binomial_needs_a_positive_rate(a):
    with pytest.raises(ValueError, match="Argument `a` must be positive"):
        SlidingSurface.binomial(a, 3)


def test_binomial_needs_an_order():
    with pytest.raises(ValueError, match="Argument `order` must be at least 1, but is 0"):
        SlidingSurface.binomial(1.0, 0)


def test_roots_of_the_surface_of_example_2():
    roots = SlidingSurface([6.0, 12.0, 8.0]).roots()
    np.testing.assert_allclose(roots**3 + 8 * roots**2 + 12 * roots + 6, 0.0, atol=1e-11)


@settings(deadline=None, max_examples=300)
@given(st.integers(0, 8).flatmap(lambda m: arrays(float, m, elements=st.floats(-2.0, 8.0))))
def test_hurwitz_agrees_with_the_roots(c):
    roots = np.roots([1.0, *c[::-1]])
    assume(np.all(np.abs(roots.real) > 1e-3))
    assert bool(is_hurwitz(c)) == bool(np.all(roots.real < 0))


@settings(deadline=None, max_examples=100)
@given(arrays(float, (2, 4), elements=st.floats(0.1, 3.0)), st.integers(0, 8))
def test_roots_in_the_left_half_plane_are_hurwitz(parts, degree):
    pairs = [complex(-re, im) for re, im in parts.T]
    roots = [r for z in pairs for r in (z, z.conjugate())][: degree - degree % 2] + [-1.0] * (degree % 2)
    assert is_hurwitz(coefficients(roots))


@pytest.mark.parametrize(
    "c",
    [[0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0, 1.0], [4.0, 4.0, 5.0, 1.0], [0.0, 0.0], [4.0, 0.0, 5.0, 0.0]],
    ids=["s", "s^2+1", "s(s+1)", "(s+1)(s^2+1)", "(s^2+4)(s^2+s+1)", "s^2", "(s^2+1)(s^2+4)"],
)
def test_roots_on_the_imaginary_axis_are_not_hurwitz(c):
    assert not is_hurwitz(np.array(c))
    assert not jax.jit(is_hurwitz)(np.array(c))


def test_hurwitz_can_be_traced_for_a_drawn_surface():
    drawn = jax.vmap(lambda c: SlidingSurface(c).is_hurwitz())(np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0]]))
    assert drawn.tolist() == [True, False, False]


def test_the_constructor_names_the_root_that_offends():
    with pytest.raises(
        ValueError,
        match=r"Argument `c` must make s\^2 - 1 s \+ 1.25 Hurwitz, but has the root 0.5\+1j with real part 0.5 >= 0",
    ):
        SlidingSurface([1.25, -1.0])


def test_the_constructor_refuses_a_root_on_the_imaginary_axis():
    with pytest.raises(
        ValueError, match=r"must make s\^2 \+ 0 s \+ 1 Hurwitz, but has the root 0\+1j with real part 0 >= 0"
    ):
        SlidingSurface([1.0, 0.0])


@pytest.mark.parametrize("c", [2.0, [[1.0, 2.0]]])
def test_another_rank_is_refused(c):
    with pytest.raises(ValueError, match="Argument `c` of `SlidingSurface` must be a one-dimensional list of numbers"):
        SlidingSurface(c)


@pytest.mark.parametrize("c", [[np.nan], [1.0, np.inf]])
def test_coefficients_must_be_finite(c):
    with pytest.raises(ValueError, match="Argument `c` must be finite"):
        SlidingSurface(c)
