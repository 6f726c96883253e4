"""The control law: equation (4) inside the funnel, nothing outside."""

import jax
import mpmath as mp
import numpy as np
import pytest

from qsmc_jax.control.funnel import Funnel
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.control.surface import SlidingSurface

SURFACE, FUNNEL = SlidingSurface([2.0]), Funnel(4.0, 3.0, 0.05)
CONTROL = QuasiSlidingControl(SURFACE, FUNNEL)


@pytest.mark.parametrize("gain_sign", [1, -1])
@pytest.mark.parametrize("sigma", [-0.6, 0.0, 0.1, 0.399, 0.401, 0.7])
def test_the_law_is_equation_4(gain_sign, sigma):
    control = QuasiSlidingControl(SURFACE, FUNNEL, gain_sign)
    np.testing.assert_allclose(control(sigma, 0.8), -gain_sign * np.tan(np.pi * sigma / 1.6), rtol=1e-14)


@pytest.mark.parametrize("gap", [1e-3, 1e-9, 1e-16])
def test_digits_are_kept_near_the_edge(gap):
    rho = 0.05
    sigma = rho - gap
    with mp.workdps(50):
        truth = -mp.tan(mp.pi * mp.mpf(sigma) / (2 * mp.mpf(rho)))
    np.testing.assert_allclose(CONTROL(sigma, rho), float(truth), rtol=1e-14)


@pytest.mark.parametrize("sigma", [0.8, -0.8, 0.9, 1.7, -2.5, np.inf, np.nan])
def test_outside_the_funnel_the_control_is_nan(sigma):
    assert np.isnan(CONTROL(sigma, 0.8))


@pytest.mark.parametrize("sigma", [0.0, 0.3, 0.8, -2.5])
def test_gradients_are_finite_inside_and_outside(sigma):
    assert np.all(np.isfinite(jax.grad(CONTROL.__call__, argnums=(0, 1))(sigma, 0.8)))


def test_the_slope_at_the_surface_is_that_of_the_tangent():
    np.testing.assert_allclose(jax.grad(CONTROL.__call__)(0.0, 0.8), -np.pi / 1.6, rtol=1e-15)


@pytest.mark.parametrize("gain_sign", [0, 2, -0.5, np.nan])
def test_the_gain_sign_is_one_or_minus_one(gain_sign):
    with pytest.raises(ValueError, match="Argument `gain_sign` must be 1 or -1, but is"):
        QuasiSlidingControl(SURFACE, FUNNEL, gain_sign)


def test_the_gain_sign_can_be_drawn():
    controls = jax.vmap(lambda sign: QuasiSlidingControl(SURFACE, FUNNEL, sign)(0.4, 0.8))(np.array([1.0, -1.0]))
    np.testing.assert_allclose(controls, [-1.0, 1.0], rtol=1e-14)
