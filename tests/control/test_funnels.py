"""Funnels of other shapes against their formulas in NumPy, central differences, and grids much finer than theirs."""

import functools as ft
import math

import jax.numpy as jnp
import numpy as np
import pytest

import qsmc_jax as qj
from qsmc_jax.base.precision import in_64_bits

F = qj.funnels
TS = np.concatenate([[0.0], np.geomspace(1e-4, 60.0, 4000)])
POWER_LAW = F.Smooth(lambda t: 4.0 / (1.0 + 2.0 * t) ** 2 + 0.05)


def finite(t, p, end):
    return np.where(t < end, 4.0 * np.maximum(1.0 - t / end, 0.0) ** p, 0.0) + 0.05


def prescribed(t, k, end):
    left = np.where(t < end, end - t, 1.0)
    return np.where(t < end, 4.0 * np.exp(-k * t / left), 0.0) + 0.05


def exponential(t, rho0):
    return rho0 * np.exp(-3.0 * t) + 0.05


def around_zero(width):
    return lambda t: (-width(t), width(t))


# By name: the funnel, its edges in NumPy, where it jumps or kinks.
FUNNELS = {
    "the paper's": (qj.Funnel(4.0, 3.0, 0.05), around_zero(lambda t: exponential(t, 4.0)), math.inf),
    "finite time": (F.FiniteTime(4.0, 2.0, 1.5, 0.05), around_zero(lambda t: finite(t, 2.0, 1.5)), 1.5),
    "a corner": (F.FiniteTime(4.0, 1.0, 1.5, 0.05), around_zero(lambda t: finite(t, 1.0, 1.5)), 1.5),
    "prescribed time": (F.PrescribedTime(4.0, 1.0, 2.0, 0.05), around_zero(lambda t: prescribed(t, 1.0, 2.0)), 2.0),
    "late": (F.PrescribedTime(4.0, 0.01, 2.0, 0.05), around_zero(lambda t: prescribed(t, 0.01, 2.0)), 2.0),
    "early": (F.PrescribedTime(4.0, 5.0, 2.0, 0.05), around_zero(lambda t: prescribed(t, 5.0, 2.0)), 2.0),
    "a power law": (POWER_LAW, around_zero(lambda t: 4.0 / (1.0 + 2.0 * t) ** 2 + 0.05), math.inf),
    "asymmetric": (
        F.Asymmetric(qj.Funnel(4.0, 3.0, 0.05), F.FiniteTime(4.0, 2.0, 1.5, 0.05)),
        lambda t: (-finite(t, 2.0, 1.5), exponential(t, 4.0)),
        1.5,
    ),
}
EACH = pytest.mark.parametrize("name", FUNNELS)


@ft.cache
def values(name):
    """Centre and half-width with their rates at the times."""
    funnel = FUNNELS[name][0]
    with in_64_bits():
        rows = [(*funnel.centre_and_rate(t), *funnel.width_and_rate(t)) for t in TS[::40]]
    return np.asarray(rows, float).T


@EACH
def test_edges_are_those_of_the_formula(name):
    centre, _, width, _ = values(name)
    low, high = FUNNELS[name][1](TS[::40])
    np.testing.assert_allclose(centre - width, low, rtol=1e-12)
    np.testing.assert_allclose(centre + width, high, rtol=1e-12)


@EACH
def test_rates_are_derivatives(name):
    _, edges, corner = FUNNELS[name]
    ts = TS[::40]
    is_smooth = (np.abs(ts - corner) > 1e-4) & (ts > 1e-4)
    step = 1e-6 * np.minimum(ts, np.abs(corner - ts))[is_smooth]
    _, centre_rate, _, width_rate = values(name)[:, is_smooth]
    found = centre_rate - width_rate, centre_rate + width_rate
    for rate, before, after in zip(found, edges(ts[is_smooth] - step), edges(ts[is_smooth] + step), strict=True):
        np.testing.assert_allclose(rate, (after - before) / (2.0 * step), rtol=1e-5, atol=1e-5)


@EACH
@pytest.mark.parametrize("bandwidth", [0.06, 0.3, 3.0, 9.0])
def test_from_the_reaching_time_on_it_lies_inside_and_not_before(name, bandwidth):
    funnel, edges, _ = FUNNELS[name]
    t = float(funnel.reaching_time(bandwidth))
    farthest = lambda t: max(map(abs, (float(edge) for edge in edges(np.asarray(t)))))  # noqa: E731
    assert farthest(t * (1.0 + 1e-9)) <= bandwidth * (1.0 + 1e-9)
    assert t == 0.0 or farthest(t * (1.0 - 1e-4)) > bandwidth


@EACH
def test_bandwidths_lie_between_its_ends(name):
    funnel, edges, _ = FUNNELS[name]
    end, start = funnel.bandwidths
    assert float(end) == pytest.approx(0.05, rel=1e-8)
    assert float(start) == pytest.approx(4.0 if name == "the paper's" else 4.05)
    assert funnel.reaching_time(0.049) == np.inf
    assert [bool(funnel.admits(eps)) for eps in (0.049, 0.06, 4.1)] == [False, True, False]


@EACH
def test_the_steepest_edge_and_the_narrowest_width_bound_those_on_a_grid(name):
    funnel, edges, _ = FUNNELS[name]
    _, centre_rate, width, width_rate = values(name)
    on_grid = np.max(np.abs([centre_rate - width_rate, centre_rate + width_rate]))
    fine = np.linspace(0.0, 3.0, 400_001)
    steepest = max(np.max(np.abs(np.diff(edge))) / (fine[1] - fine[0]) for edge in edges(fine))
    assert float(funnel.steepest) >= max(on_grid, steepest) * (1.0 - 1e-9)
    assert float(funnel.steepest) == pytest.approx(steepest, rel=1e-3)
    assert 0.05 * (1.0 - 1e-9) <= float(funnel.narrowest) <= np.min(width)


@EACH
def test_an_exponential_funnel_encloses_it(name):
    funnel, edges, _ = FUNNELS[name]
    around = funnel.enclosing(0.1)
    wide = exponential_of(around, TS)
    assert np.all(np.max(np.abs(edges(TS)), axis=0) <= wide * (1.0 + 1e-9))
    assert float(around.rho_inf) < 0.1


def exponential_of(funnel, ts):
    rho0, mu, rho_inf = (float(value) for value in (funnel.rho0, funnel.mu, funnel.rho_inf))
    return rho0 * np.exp(-mu * ts) + rho_inf


def test_a_short_late_bump_is_not_missed():
    funnel = F.Smooth(lambda t: 4.0 * jnp.exp(-3.0 * t) + 0.05 + 0.2 * jnp.exp(-(((t - 50.0) / 1e-6) ** 2)))
    t = float(funnel.reaching_time(0.1))
    assert 50.0 < t < 50.01


def test_a_funnel_that_widens_again_is_reached_when_it_is_narrow_for_good():
    funnel = F.Smooth(lambda t: 0.05 + 4.0 * t**2 * jnp.exp(-2.0 * t) + 0.5 * jnp.exp(-t))
    t = float(funnel.reaching_time(0.1))
    width = lambda t: 0.05 + 4.0 * t**2 * np.exp(-2.0 * t) + 0.5 * np.exp(-t)  # noqa: E731
    assert np.all(width(np.linspace(t, 60.0, 100_001)) <= 0.1)
    assert width(t * (1 - 2e-3)) > 0.1


REFUSED = {
    "not positive": (lambda: F.Smooth(lambda t: 1.0 - t), r"`fn` of `funnels.Smooth` must be positive .* 0 at t = 1 s"),
    "a kink": (lambda: F.Smooth(lambda t: abs(t - 1.0) + 0.1), "`fn` of `Smooth` must be smooth"),
    "power": (lambda: F.FiniteTime(1.0, 0.5, 1.0, 0.1), "`power` must be 1 or more, but is 0.5"),
    "end time": (lambda: F.FiniteTime(1.0, 2.0, -1.0, 0.1), "`end_time` must be positive"),
    "shape": (lambda: F.PrescribedTime(1.0, 0.0, 1.0, 0.1), "`shape` must be positive"),
    "not around 0": (lambda: F.Asymmetric(FUNNELS["asymmetric"][0], qj.Funnel(1.0, 1.0, 0.1)), "a funnel around 0"),
    "time scale": (lambda: F.Smooth(lambda t: 1.0 + 0.0 * t, time_scale=0.0), "`time_scale` must be positive"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_makes_no_funnel_is_named(case):
    make, message = REFUSED[case]
    with pytest.raises(qj.InputError, match=message):
        make()


def test_a_bandwidth_outside_is_named():
    with pytest.raises(qj.InputError, match=r"between 0\.05, where the funnel ends, and 4\.05, .* but is 0\.04"):
        F.FiniteTime(4.0, 2.0, 1.5, 0.05).check_bandwidth(0.04)
