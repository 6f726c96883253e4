"""Limits of imperfect implementation against polynomial roots, matrix exponentials, and simulations in NumPy."""

import math

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from qsmc_jax.control import thresholds as th
from qsmc_jax.control.funnel import Funnel
from qsmc_jax.control.surface import SlidingSurface

JUST_BELOW, JUST_ABOVE = 0.999, 1.001  # nothing but the limit itself lies in between
FRACTIONS = [0.03, 0.2, 0.5, 0.8, 0.95, JUST_BELOW]


@st.composite
def loops(draw, least=1, most=5):
    """The gain, residual, half-width and surface of a loop that is stable when ideal."""
    degree = draw(st.integers(least, most)) - 1
    pairs = draw(st.integers(0, degree // 2))
    roots = [-draw(st.floats(0.2, 3.0)) for _ in range(degree - 2 * pairs)]
    for _ in range(pairs):
        size, angle = draw(st.floats(0.2, 3.0)), draw(st.floats(0.3, 1.4))
        roots += [-size * np.exp(1j * angle), -size * np.exp(-1j * angle)]
    c = tuple(float(v) for v in np.atleast_1d(np.real(np.poly(roots)))[:0:-1])
    gain, residual, rho = draw(st.floats(0.2, 5.0)), draw(st.floats(-5.0, 5.0)), draw(st.floats(0.02, 5.0))
    assume(is_loop_stable(loop_gain(gain, residual, rho), c, margin=1e-3))
    return gain, residual, rho, c


def loop_gain(gain, residual, rho):
    """The slope of -g tan(pi sigma / (2 rho)) at rest, by a difference quotient in complex steps."""
    at_rest = 2.0 * rho / math.pi * math.atan(residual / gain)
    return np.imag(gain * np.tan(math.pi * (at_rest + 1e-20j) / (2.0 * rho))) / 1e-20


def is_loop_stable(k, c, actuator=(1.0,), margin=0.0):
    """Whether actuator(s) s^n + k p(s) is Hurwitz; polynomials highest first."""
    open_loop = np.concatenate([actuator, np.zeros(len(c) + 1)])
    return bool(np.all(np.roots(np.polyadd(open_loop, k * np.array([1.0, *c[::-1]]))).real < -margin))


def chain(c):
    """The matrices of n integrators in a row and of the sliding variable."""
    n = len(c) + 1
    return np.eye(n, k=1), np.eye(n)[:, -1:], np.array([[*c, 1.0]])


def is_sampled_loop_stable(k, c, period):
    """By the exponential of the chain with a held input, its eigenvalues z taken as (z - 1) / period: no clustering."""
    a, b, surface = chain(c)
    n = len(a)
    held = scipy.linalg.expm(np.block([[a, b], [np.zeros((1, n + 1))]]) * period) - np.eye(n + 1)
    rates = np.linalg.eigvals((held[:n, :n] - k * held[:n, n:] @ surface) / period)
    return bool(np.all(2.0 * rates.real + period * np.abs(rates) ** 2 < 0))


@settings(max_examples=25)
@given(loops())
def test_sampled_loop_is_stable_up_to_the_critical_period_and_not_beyond(loop):
    k, c, limit = loop_gain(*loop[:3]), loop[3], th.critical_period(*loop)
    assert all(is_sampled_loop_stable(k, c, fraction * limit) for fraction in FRACTIONS)
    assert not is_sampled_loop_stable(k, c, JUST_ABOVE * limit)


@given(loops(1, 1), st.floats(0.1, 3.0))
def test_closed_forms_of_order_one(loop, damping):
    (gain, residual, rho, _), k = loop, loop_gain(*loop[:3])
    assert th.small_signal_gain(gain, residual, rho) == pytest.approx(k, rel=1e-9)
    period = 4.0 * rho * gain / (math.pi * (gain**2 + residual**2))
    assert th.critical_period(gain, residual, rho) == pytest.approx(period, rel=1e-12)
    assert th.critical_delay(gain, residual, rho) == pytest.approx(rho * gain / (gain**2 + residual**2), rel=1e-12)
    assert th.critical_lag(gain, residual, rho) == math.inf
    assert th.critical_actuator_frequency(gain, residual, rho, damping) == pytest.approx(0.5 * k / damping, rel=1e-9)


@given(loops(2, 2))
def test_closed_forms_of_order_two(loop):
    assert th.critical_period(*loop) == pytest.approx(2.0 / max(loop_gain(*loop[:3]), *loop[3]), rel=1e-9)
    assert th.critical_lag(*loop) == pytest.approx(1.0 / loop[3][0], rel=1e-12)


@given(loops(3, 3))
def test_critical_lag_has_the_closed_form_of_order_three(loop):
    k, (c1, c2) = loop_gain(*loop[:3]), loop[3]
    assert th.critical_lag(*loop) == pytest.approx(1.0 / c2 - c1 / (k * c2**2), rel=1e-9)  # by Routh's array


@pytest.mark.parametrize(("order", "steps"), [(1, 2.0), (2, 2.0), (3, 2.0027), (4, 2.0082)])
def test_slow_surfaces_hardly_lengthen_the_critical_period(order, steps):
    c = SlidingSurface.binomial(1.0, order).c
    assert th.critical_period(1.0, 0.0, 0.1, c) * math.pi / 0.2 == pytest.approx(steps, abs=5e-5)


@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_a_very_slow_surface_counts_for_nothing(order):
    c = SlidingSurface.binomial(1e-7, order).c
    k = th.small_signal_gain(1.0, 0.5, 0.1)
    assert th.critical_period(1.0, 0.5, 0.1, c) * k == pytest.approx(2.0, rel=1e-6)
    assert th.critical_delay(1.0, 0.5, 0.1, c) * k == pytest.approx(math.pi / 2.0, rel=1e-6)
    assert th.critical_lag(1.0, 0.5, 0.1, c) * c[-1] == pytest.approx(1.0, rel=1e-6)
    assert th.critical_actuator_frequency(1.0, 0.5, 0.1, 0.7, c) / k == pytest.approx(1.0 / 1.4, rel=1e-6)


def sampled_run(residual, period, samples=6000):
    """The nonlinear loop with g = 1, rho = 1 from next to its rest: its distances, until it leaves the funnel."""
    rest = 2.0 / math.pi * math.atan(residual)
    sigma, distances = rest + 1e-4, []
    while abs(sigma) < 1.0 and len(distances) < samples:
        distances.append(abs(sigma - rest))
        sigma += period * (residual - math.tan(0.5 * math.pi * sigma))
    return distances


@pytest.mark.parametrize("residual", [0.0, 0.3, -0.5, 0.8, 2.0])
def test_nonlinear_sampled_loop_settles_below_the_critical_period(residual):
    distances = sampled_run(residual, 0.99 * th.critical_period(1.0, residual, 1.0))
    assert len(distances) == 6000
    assert distances[-1] < 1e-12


@pytest.mark.parametrize(("residual", "leaves"), [(0.0, True), (0.3, True), (-0.5, True), (0.8, False), (-2.0, False)])
def test_nonlinear_sampled_loop_leaves_or_chatters_above_the_critical_period(residual, leaves):
    distances = sampled_run(residual, 1.01 * th.critical_period(1.0, residual, 1.0))
    assert (len(distances) < 6000) == leaves
    assert min(distances[-10:]) > 1e-3


def is_delayed_loop_stable(k, c, delay, points=16):
    """By the eigenvalues of the infinitesimal generator on Chebyshev points of one delay (pseudospectral)."""
    a, b, surface = chain(c)
    n = len(a)
    i = np.arange(points + 1)
    theta, weights = np.cos(np.pi * i / points), np.where(i % points, 1.0, 2.0) * (-1.0) ** i
    derivative = np.outer(weights, 1.0 / weights) / (theta[:, None] - theta + np.eye(points + 1))
    derivative -= np.diag(derivative.sum(axis=1))
    generator = np.kron(2.0 / delay * derivative, np.eye(n))
    generator[:n] = 0.0
    generator[:n, :n], generator[:n, -n:] = a, -k * b @ surface
    return bool(np.all(np.linalg.eigvals(generator).real < 0))


@settings(max_examples=20)
@given(loops(1, 4))
def test_delayed_loop_is_stable_up_to_the_critical_delay_and_not_beyond(loop):
    k, c, limit = loop_gain(*loop[:3]), loop[3], th.critical_delay(*loop)
    assert all(is_delayed_loop_stable(k, c, fraction * limit) for fraction in (0.4, 0.8, JUST_BELOW))
    assert not is_delayed_loop_stable(k, c, JUST_ABOVE * limit)


@pytest.mark.parametrize("order", [2, 3, 4])
def test_critical_delay_tends_to_its_asymptote(order):
    c = SlidingSurface.binomial(1.0, order).c
    k = th.small_signal_gain(1.0, 0.0, 1e-3)  # the next term is of order (c / k)^2
    assert th.critical_delay(1.0, 0.0, 1e-3, c) * k == pytest.approx(math.pi / 2.0 - c[-1] / k, abs=20.0 / k**2)


@pytest.mark.parametrize(("fraction", "is_kept"), [(0.97, True), (1.03, False)])
@pytest.mark.parametrize("residual", [0.0, 0.5, 2.0])
def test_nonlinear_delayed_loop_settles_just_below_the_critical_delay(residual, fraction, is_kept):
    """By the method of steps with the trapezoidal rule, 400 steps per delay."""
    step = fraction * th.critical_delay(1.0, residual, 1.0) / 400
    rest = 2.0 / math.pi * math.atan(residual)
    sigma, swings = np.full(401, rest + 1e-3 * (1.0 - rest)), []
    for _ in range(150):
        slopes = residual - np.tan(0.5 * math.pi * sigma)
        sigma = sigma[-1] + scipy.integrate.cumulative_trapezoid(slopes, dx=step, initial=0.0)
        swings.append(np.max(np.abs(sigma - rest)))
        if swings[-1] >= 1.0 - rest:  # may have left the funnel
            break
    assert (max(swings[-6:]) < 0.3 * max(swings[:6])) == is_kept


@given(loops())
def test_lagged_loop_is_stable_up_to_the_critical_lag_and_not_beyond(loop):
    k, c, limit = loop_gain(*loop[:3]), loop[3], th.critical_lag(*loop)
    lags = [1e3 / k] if math.isinf(limit) else [fraction * limit for fraction in FRACTIONS]
    assert all(is_loop_stable(k, c, [lag, 1.0]) for lag in lags)
    assert math.isinf(limit) or not is_loop_stable(k, c, [JUST_ABOVE * limit, 1.0])


@given(loops(), st.floats(0.1, 3.0))
def test_loop_with_second_order_actuator_is_stable_down_to_the_critical_frequency_and_not_beyond(loop, damping):
    k, c, limit = loop_gain(*loop[:3]), loop[3], th.critical_actuator_frequency(*loop[:3], damping, loop[3])
    actuators = [(q**2, 2.0 * damping * q, 1.0) for q in np.array([*FRACTIONS, JUST_ABOVE]) / limit]
    assert all(is_loop_stable(k, c, actuator) for actuator in actuators[:-1])
    assert not is_loop_stable(k, c, actuators[-1])


def test_an_ideal_loop_that_is_unstable_leaves_nothing():
    c = (8.0, 2.0)  # Hurwitz, but s^3 + k (s^2 + 2 s + 8) is only for k > 4
    rho_limit = math.pi / 8.0
    for limit in (th.critical_period, th.critical_delay, th.critical_lag):
        assert limit(1.0, 0.0, 1.001 * rho_limit, c) == 0.0
        assert 0.0 < limit(1.0, 0.0, 0.999 * rho_limit, c) < 0.01
    assert th.critical_actuator_frequency(1.0, 0.0, 1.001 * rho_limit, 0.7, c) == math.inf
    assert 100.0 < th.critical_actuator_frequency(1.0, 0.0, 0.999 * rho_limit, 0.7, c) < math.inf


@pytest.mark.parametrize("ratio0", [0.0, 0.6, 0.9999])
@pytest.mark.parametrize(("residual", "gain"), [(0.0, 1.0), (1.0, 2.0), (3.0, 0.7)])
@pytest.mark.parametrize("funnel", [(1.0, 1.0, 0.1), (3.0, 4.0, 0.5)], ids=["slow", "fast"])
def test_sufficient_saturation_keeps_the_funnel_against_the_strongest_push(funnel, residual, gain, ratio0):
    rho0, mu, rho_inf = funnel
    limit = th.sufficient_saturation(residual, gain, Funnel(*funnel))

    def rate(t, z):
        excess = rho0 * math.exp(-mu * t)
        u = min(limit, math.tan(0.5 * math.pi * z[0])) if z[0] < 1.0 else limit
        return [(residual - gain * u + z[0] * mu * excess) / (excess + rho_inf)]

    run = scipy.integrate.solve_ivp(rate, (0.0, 14.0), [ratio0], method="LSODA", rtol=1e-8, atol=1e-10, max_step=0.1)
    assert np.max(run.y) <= max(ratio0, 2.0 / math.pi * math.atan(limit)) + 1e-7


@given(st.floats(0.0, 5.0), st.floats(0.1, 5.0), st.tuples(*3 * [st.floats(0.05, 5.0)]), st.floats(-0.999, 0.999))
def test_full_input_keeps_the_funnel_just_above_the_necessary_saturation_only(residual, gain, funnel, ratio0):
    rho0, mu, rho_inf = funnel
    sigma0 = ratio0 * (rho0 + rho_inf)
    t = np.geomspace(1e-6, 1e8, 200_001) / mu
    rho = rho0 * np.exp(-mu * t) + rho_inf

    def is_kept(limit):
        return bool(np.all(abs(sigma0) + (residual - gain * limit) * t <= rho))

    limit = th.necessary_saturation(residual, gain, Funnel(*funnel), sigma0)
    assert limit >= residual / gain
    assert is_kept(limit * (1.0 + 1e-6) + 1e-6)
    assert limit < 1e-3 or not is_kept(limit * (1.0 - 1e-4))


def configurations(seed, runs):
    """Random residual bounds, gains, funnels and starts, one row each."""
    rng = np.random.default_rng(seed)
    gain_min = 10.0 ** rng.uniform(-1, 1, runs)
    gain_max = gain_min * 10.0 ** rng.uniform(0, 0.5, runs)
    residual = gain_min * np.where(rng.random(runs) < 0.05, 0.0, 10.0 ** rng.uniform(-2, 1, runs))
    rho_inf = 10.0 ** rng.uniform(-2, 0, runs)
    rho0 = rho_inf * 10.0 ** rng.uniform(-1, 1.5, runs)
    mu = gain_min / rho0 * 10.0 ** rng.uniform(-2, 0.7, runs)
    ratio0 = np.where(rng.random(runs) < 0.1, 0.0, rng.uniform(0.0, 0.97, runs))
    return np.stack([residual, gain_min, gain_max, rho0, mu, rho_inf, ratio0], axis=1)


def period_of(row):
    return th.sufficient_period(row[0], (row[1], row[2]), Funnel(*row[3:6]), row[6])


def excursions(table, periods, seed, samples=40, pieces=3, points=4):
    """The largest |sigma| / rho of each sampled run against its adversary, between samples too.

    The adversary of a run: random switching between samples; always outward; always across; whichever of the four
    extremes goes farthest; outward, across or random from sample to sample.
    """
    residual, gain_min, gain_max, rho0, mu, rho_inf, ratio0 = table.T
    rng, runs = np.random.default_rng(seed), len(table)
    gains, kind = np.stack([gain_min, gain_max]), rng.integers(5, size=runs)
    sigma, worst = rng.choice([-1.0, 1.0], runs) * ratio0 * (rho0 + rho_inf), np.zeros(runs)
    for i in range(samples):
        rho = rho0 * np.exp(-mu * i * periods) + rho_inf
        side = np.where(sigma >= 0.0, 1.0, -1.0)
        u = -np.tan(0.5 * math.pi * sigma / rho)
        ends = [sigma + periods * (side * residual + gain_min * u), sigma + periods * (gain_max * u - side * residual)]
        move = np.choose(kind, [2, 0, 1, np.argmax(np.abs(ends), axis=0), rng.integers(3, size=runs)])
        for j in range(pieces):
            w = residual * np.choose(move, [side, -side, rng.choice([-1.0, 1.0], runs)])
            g = np.choose(move, [gain_min, gain_max, gains[rng.integers(2, size=runs), np.arange(runs)]])
            for point in range(points):
                sigma = sigma + (w + g * u) * periods / (pieces * points)
                t = (i + (j + (point + 1) / points) / pieces) * periods
                worst = np.maximum(worst, np.abs(sigma) / (rho0 * np.exp(-mu * t) + rho_inf))
    return worst


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.slow
def test_no_adversary_leaves_the_ratio_at_the_sufficient_period(seed):
    """1000 configurations each, 10 000 in all."""
    table = configurations(seed, 1000)
    periods, ratios = np.array([period_of(row) for row in table]).T
    assert np.all(ratios >= table[:, -1])
    assert np.all(ratios < 1.0)
    worst = excursions(table, JUST_BELOW * periods, seed)
    assert np.all(worst <= ratios)
    has_room = ratios > table[:, -1] + 0.05
    assert np.quantile((worst / ratios)[has_room], 0.9) > 0.95  # the adversaries are no weaklings
    critical = [min(th.critical_period(gain, row[0], row[5]) for gain in row[1:3]) for row in table[:200]]
    assert np.median(periods[:200] / critical) > 0.2  # no vacuous bound


def one_sample_period(row, ratio, points=400):
    """The longest period for which no extreme leaves `ratio` within one sample, on a grid of states and widths."""
    residual, gain_min, gain_max, rho0, mu, rho_inf, _ = row
    z, excess = np.linspace(0.0, ratio, points), np.linspace(0.0, rho0, 9)[:, None]
    rho, push = excess + rho_inf, residual + ratio * mu * excess
    outward, across = push - gain_min * np.tan(0.5 * math.pi * z), push + gain_max * np.tan(0.5 * math.pi * z)
    with np.errstate(divide="ignore", invalid="ignore"):
        periods = np.where(outward > 0.0, (ratio - z) * rho / outward, np.inf), (ratio + z) * rho / across
    return float(np.min(periods))


def test_sufficient_period_is_the_longest_that_one_sample_allows():
    for row in configurations(99, 12):
        period, ratio = period_of(row)
        assert period <= one_sample_period(row, ratio, points=20_000) * (1.0 + 1e-9)
        control = np.geomspace(max(math.tan(0.5 * math.pi * row[-1]), 1e-5), 1e4, 1500)
        best = max(one_sample_period(row, ratio) for ratio in 2.0 / math.pi * np.arctan(control))
        assert period == pytest.approx(best, rel=0.02)  # the grid is 1.4 % wide
        assert period >= best * (1.0 - 1e-4)  # 400 states miss the tightest by little


def test_sufficient_period_is_the_critical_one_for_a_nearly_undisturbed_constant_funnel():
    period, _ = th.sufficient_period(0.0, (2.0, 2.0), Funnel(1e-9, 1e-9, 0.5))
    assert period == pytest.approx(th.critical_period(2.0, 0.0, 0.5), rel=1e-6)


def test_sufficient_period_can_exceed_the_critical_one_where_the_loop_chatters_inside():
    period = th.sufficient_period(5.0, (1.0, 1.0), Funnel(1e-6, 1e-6, 1.0)).period
    assert period > 1.05 * th.critical_period(1.0, 5.0, 1.0)
    assert len(sampled_run(5.0, period)) == 6000


@pytest.mark.parametrize("residual", [0.0, 1e-8, 1e3, 1e6])
@pytest.mark.parametrize("mu", [1e-8, 1.0, 1e8])
def test_sufficient_period_survives_extreme_numbers(residual, mu):
    period, ratio = th.sufficient_period(residual, (1.0, 1.0), Funnel(1.0, mu, 1.0), 0.5)
    assert 0.0 < period < math.inf
    assert 0.5 <= ratio < 1.0


@pytest.mark.parametrize(("residual", "fraction"), [(0.0, 0.2), (0.0, 0.8), (1.5, 0.5)])
def test_noise_gain_is_the_variance_of_simulated_loops(residual, fraction):
    chains, size = 40_000, 1e-4
    rng = np.random.default_rng(7)
    period = fraction * th.critical_period(1.0, residual, 1.0)
    sigma = np.full(chains, 2.0 / math.pi * math.atan(residual))
    for _ in range(60):
        sigma = sigma + period * (residual - np.tan(0.5 * math.pi * (sigma + size * rng.standard_normal(chains))))
    # a sample variance of 40 000 has a relative deviation of sqrt(2 / 40 000) = 0.7 %; 4 of them
    assert np.var(sigma) / size**2 == pytest.approx(th.noise_gain(1.0, residual, 1.0, period), rel=0.028)
    assert th.noise_gain(1.0, residual, 1.0, period / fraction * (1.0 + 1e-12)) == math.inf


@pytest.mark.parametrize("ratio0", [1e-6, 0.1, -0.5, 0.9, 0.9999999])
def test_escape_time_is_the_integral_of_the_inverse_speed(ratio0):
    def inverse_speed(log_ratio):
        return 0.15 * math.exp(log_ratio) / math.tan(0.5 * math.pi * math.exp(log_ratio))

    expected, _ = scipy.integrate.quad(inverse_speed, math.log(abs(ratio0)), 0.0, epsabs=0.0, epsrel=1e-8)
    assert th.escape_time(2.0, 0.3, ratio0) == pytest.approx(expected, rel=1e-6)
    assert th.escape_time(2.0, 0.3, 0.0) == math.inf


def test_results_are_plain_floats_whatever_kind_of_number_comes_in():
    funnel = Funnel(1.0, 2.0, 0.1)
    results = [
        th.critical_period(1, np.float64(0.5), funnel.rho_inf, [1.0]),
        th.critical_delay(1, np.float64(0.5), funnel.rho_inf, np.array([2.0, 3.0])),
        th.critical_lag(np.array(1.0), 0, funnel.rho_inf, (2.0,)),
        th.critical_actuator_frequency(1, 0, 0.1, 1, (2.0,)),
        th.necessary_saturation(1, np.array(2.0), funnel, np.float64(1.0)),
        *th.sufficient_period(1, (1, np.array(2.0)), funnel, np.array(0.5)),
        th.noise_gain(1, 0, funnel.rho_inf, np.array(0.01)),
        th.escape_time(1, funnel.rho_inf, np.array(0.5)),
    ]
    assert {type(result) for result in results} == {float}


FUNNEL = Funnel(1.0, 1.0, 0.25)
CALLS = [
    (th.small_signal_gain, (0.0, 0.0, 1.0), r"`gain` must be positive and finite, but is 0\."),
    (th.critical_period, (1.0, math.inf, 1.0), "`residual` must be finite, but is inf"),
    (th.critical_delay, (1.0, 0.0, -1.0), r"`rho` must be positive and finite, but is -1\."),
    (th.critical_lag, (1.0, 0.0, 1.0, (-1.0,)), "`c` must make .* Hurwitz, but has the root 1 "),
    (th.critical_actuator_frequency, (1.0, 0.0, 1.0, 0.0), "`damping` must be positive and finite"),
    (th.sufficient_saturation, (-1.0, 1.0, FUNNEL), "`residual_bound` must be finite and not negative"),
    (th.sufficient_saturation, (1.0, 0.0, FUNNEL), "`gain_min` must be positive"),
    (th.necessary_saturation, (-1.0, 1.0, FUNNEL), "`residual` must be finite and not negative"),
    (th.necessary_saturation, (1.0, 0.0, FUNNEL), "`gain_max` must be positive"),
    (th.necessary_saturation, (1.0, 1.0, FUNNEL, -1.25), r"inside the funnel, \|sigma0\| < 1\.25, but is -1\.25"),
    (th.necessary_saturation, (1.0, 1.0, FUNNEL, math.nan), "`sigma0` must be finite"),
    (th.sufficient_period, (-1.0, (1.0, 1.0), FUNNEL), "`residual_bound` must be finite and not negative"),
    (th.sufficient_period, (1.0, (0.0, 1.0), FUNNEL), "`gain_bounds` must be positive"),
    (th.sufficient_period, (1.0, (2.0, 1.0), FUNNEL), r"must be in increasing order, but is \(2, 1\)"),
    (th.sufficient_period, (1.0, (1.0, 1.0), FUNNEL, 1.0), r"`ratio0` must be in \[0, 1\), but is 1\."),
    (th.sufficient_period, (1.0, (1.0, 1.0), FUNNEL, -0.1), r"`ratio0` must be in \[0, 1\)"),
    (th.noise_gain, (1.0, 0.0, 1.0, 0.0), "`period` must be positive and finite"),
    (th.escape_time, (1.0, 1.0, -1.0), r"`ratio0` must lie strictly between -1 and 1, but is -1\."),
]


@pytest.mark.parametrize(("function", "arguments", "message"), CALLS)
def test_bad_arguments_are_refused_by_name(function, arguments, message):
    with pytest.raises(ValueError, match=message):
        function(*arguments)
