"""The funnel: its formula, the reaching time, and condition C2 at the boundary."""

import jax
import numpy as np
import pytest

from qsmc_jax.base.precision import enable_x64
from qsmc_jax.control.funnel import Funnel

EXAMPLE_2 = Funnel(5.0, 3.0, 0.05)


def test_width_follows_equation_3():
    np.testing.assert_allclose(Funnel(4.0, 3.0, 0.05)(0.7), 4.0 * np.exp(-2.1) + 0.05, rtol=1e-15)


def test_rate_is_the_derivative_of_the_width():
    width, rate = EXAMPLE_2.width_and_rate(0.7)
    assert width == EXAMPLE_2(0.7)
    np.testing.assert_allclose(rate, jax.grad(EXAMPLE_2)(0.7), rtol=1e-14)


def test_reaching_time_of_example_2():
    np.testing.assert_allclose(EXAMPLE_2.reaching_time(0.1), 1.5351, atol=5e-5)


def test_at_the_reaching_time_the_funnel_is_as_wide_as_the_bandwidth():
    np.testing.assert_allclose(EXAMPLE_2(EXAMPLE_2.reaching_time(0.3)), 0.3, rtol=1e-14)


@pytest.mark.parametrize("bandwidth", [0.05, 0.04, -1.0])
def test_a_bandwidth_not_above_the_final_width_is_never_reached(bandwidth):
    assert EXAMPLE_2.reaching_time(bandwidth) == np.inf


def test_a_funnel_that_starts_inside_the_bandwidth_reaches_it_at_once():
    assert EXAMPLE_2.reaching_time(7.0) == 0.0


@pytest.mark.parametrize("bandwidth", [0.05, 0.04, 0.1, 7.0])
def test_reaching_time_has_finite_gradients(bandwidth):
    def time(rho0, mu, rho_inf):
        return Funnel(rho0, mu, rho_inf).reaching_time(bandwidth)

    assert np.all(np.isfinite(jax.grad(time, argnums=(0, 1, 2))(5.0, 3.0, 0.05)))


def test_reaching_time_is_float64_without_the_caller_asking():
    with enable_x64(False):
        time = EXAMPLE_2.reaching_time(0.1)
    assert isinstance(time, np.ndarray)
    np.testing.assert_allclose(time, np.log(5.0 / (0.1 - 0.05)) / 3.0, rtol=1e-15)


@pytest.mark.parametrize(
    ("bandwidth", "admitted"), [(0.05, False), (np.nextafter(0.05, 1), True), (np.nextafter(5, 0), True), (5.0, False)]
)
def test_condition_c2_is_strict_at_both_ends(bandwidth, admitted):
    assert bool(EXAMPLE_2.admits(bandwidth)) is admitted
    assert bool(jax.jit(lambda eps: EXAMPLE_2.admits(eps))(bandwidth)) is admitted


def test_a_traced_funnel_with_a_negative_number_admits_nothing():
    assert not jax.jit(lambda mu: Funnel(5.0, mu, 0.05).admits(0.1))(-3.0)


@pytest.mark.parametrize("bandwidth", [0.05, 5.0])
def test_check_bandwidth_names_condition_c2(bandwidth):
    with pytest.raises(
        ValueError, match=rf"between 0.05, where .*, and 5, where .*\(condition C2, .*\), but is {bandwidth:g}\. "
    ):
        EXAMPLE_2.check_bandwidth(bandwidth)
    EXAMPLE_2.check_bandwidth(0.1)


@pytest.mark.parametrize("name", ["rho0", "mu", "rho_inf"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.inf, np.nan])
def test_numbers_must_be_positive_and_finite(name, value):
    numbers = {"rho0": 4.0, "mu": 3.0, "rho_inf": 0.05} | {name: value}
    with pytest.raises(ValueError, match=f"Argument `{name}` must be positive and finite"):
        Funnel(**numbers)
