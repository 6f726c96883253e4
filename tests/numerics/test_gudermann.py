"""The funnel coordinate against mpmath, at the centre, at the edge and beyond."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from qsmc_jax.numerics.gudermann import funnel_coordinate, gd, margin, ratio, sinh_cosh, tan_half_pi

RTOL = 4e-15
COORDINATES = st.floats(-300.0, 300.0) | st.floats(-1.0, 1.0) | st.floats(1e-280, 1e-3)
RATIOS = st.floats(-1.0, 1.0, exclude_min=True, exclude_max=True)
ON_TWO_EXAMPLES = [0.0, 1e-9, -0.3, 5.0, -40.0, 300.0]


def relative_error(value, truth):
    """Relative to the truth, or to 1e-290: near the smallest float64, XLA rounds to zero."""
    return float(abs(mp.mpf(float(value)) - truth) / max(abs(truth), mp.mpf("1e-290")))


@settings(deadline=None, max_examples=200)
@given(COORDINATES)
def test_gd_is_the_arctangent_of_sinh(s):
    with mp.workdps(60):
        assert relative_error(gd(s), mp.atan(mp.sinh(s))) < RTOL


@settings(deadline=None, max_examples=200)
@given(COORDINATES)
def test_margin_keeps_its_relative_digits(s):
    with mp.workdps(400):
        assert relative_error(margin(s), 1 - abs(2 / mp.pi * mp.atan(mp.sinh(s)))) < RTOL * max(1.0, abs(s))


@settings(deadline=None, max_examples=200)
@given(COORDINATES)
def test_sinh_and_cosh_from_one_exponential(s):
    with mp.workdps(60):
        sinh, cosh = sinh_cosh(s)
        assert relative_error(sinh, mp.sinh(s)) < RTOL
        assert relative_error(cosh, mp.cosh(s)) < RTOL


@settings(deadline=None, max_examples=200)
@given(RATIOS)
def test_funnel_coordinate_is_accurate_up_to_the_edge(z):
    with mp.workdps(60):
        truth = mp.asinh(mp.tan(mp.pi * mp.mpf(z) / 2))
        assert relative_error(funnel_coordinate(z), truth) < RTOL


@pytest.mark.parametrize("z", [-0.999999, -0.3, 0.0, 1e-12, 0.77, 1 - 1e-9])
def test_ratio_inverts_the_coordinate(z):
    np.testing.assert_allclose(ratio(funnel_coordinate(z)), z, rtol=1e-14)


@pytest.mark.parametrize("z", [1.0, -1.0, 1.5, 3.2, -2.0, np.inf, np.nan])
def test_outside_the_funnel_there_is_no_coordinate(z):
    assert np.isnan(funnel_coordinate(z))


def test_the_tangent_stays_on_its_branch_at_the_last_float_below_the_edge():
    rho = 0.05
    sigma = np.nextafter(rho, 0.0)
    with mp.workdps(60):
        truth = mp.tan(mp.pi * mp.mpf(sigma) / (2 * mp.mpf(rho)))
        assert relative_error(tan_half_pi(sigma, rho), truth) < RTOL
    assert np.isnan(tan_half_pi(rho, rho))


@pytest.mark.parametrize("s", ON_TWO_EXAMPLES)
def test_derivatives_are_those_of_the_closed_forms(s):
    np.testing.assert_allclose(jax.grad(gd)(s), 1 / np.cosh(s), rtol=1e-12)
    np.testing.assert_allclose(jax.grad(lambda s: sinh_cosh(s)[0])(s), np.cosh(s), rtol=1e-12)
    np.testing.assert_allclose(jax.grad(lambda s: sinh_cosh(s)[1])(s), np.sinh(s), rtol=1e-12)


@pytest.mark.parametrize("z", [0.0, 0.2, -0.5, 0.9999, 1.0, -1.0, 1.5, 0.5])
def test_gradients_of_the_tangent_are_finite_even_where_it_is_not_defined(z):
    slope = jax.grad(tan_half_pi, argnums=(0, 1))(z, 1.0)
    assert np.all(np.isfinite(slope))
    if abs(z) < 1:
        np.testing.assert_allclose(slope[0], np.pi / 2 / np.cos(np.pi * z / 2) ** 2, rtol=1e-11)


@pytest.mark.parametrize("s", [700.0, -1e4, 1e300])
def test_far_coordinates_give_finite_numbers_and_gradients(s):
    values = (gd(s), margin(s), *sinh_cosh(s), jax.grad(gd)(s), jax.grad(margin)(s))
    assert np.all(np.isfinite(jnp.stack(values)))
