"""Peak gains against closed forms and an independent quadrature; the envelope against simulated errors."""

import jax
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

from qsmc_jax.base.precision import enable_x64
from qsmc_jax.control.error_bounds import peak_gains
from qsmc_jax.control.funnel import Funnel
from qsmc_jax.control.surface import SlidingSurface

# Peak gains for (s + 1)^(n-1), known to four decimals: 2 / e and so on.
BINOMIAL = {
    1: [1, 2],
    2: [1, 0.7358, 2.2707],
    3: [1, 0.5413, 0.6200, 2.4601],
    4: [1, 0.4481, 0.3751, 0.5597, 2.6096],
    5: [1, 0.3907, 0.2697, 0.2935, 0.5210, 2.7341],
}
ROOTS = {
    "real": [-1.0, -2.0],
    "close": [-1.0, -1.1, -3.0],
    "stiff": [-0.1, -50.0],
    "complex": [-0.2 + 0.9797958971132712j, -0.2 - 0.9797958971132712j],
    "oscillating": [-1.0 + 20.0j, -1.0 - 20.0j],
    "mixed": [-0.05, -3.0 + 4.0j, -3.0 - 4.0j, -100.0],
}
FUNNEL = Funnel(2.0, 1.5, 0.1)


def coefficients(roots):
    return np.poly(roots).real[:0:-1].copy()


def impulse_response(roots, i):
    """h_i by partial fractions, for distinct roots; the direct part of the last is left out."""
    roots = np.asarray(roots, complex)
    residues = [roots[k] ** i / np.prod(roots[k] - np.delete(roots, k)) for k in range(len(roots))]
    return lambda t: np.sum(residues * np.exp(roots * t)).real


def l1_norm(roots, i):
    """The integral of |h_i| by adaptive quadrature between the zeros found by Brent's method."""
    h, roots = impulse_response(roots, i), np.asarray(roots)
    end = 40.0 / np.min(-roots.real)
    step = np.pi / (30.0 * max(np.max(np.abs(roots.imag)), 1e-9))
    grid = np.unique(np.concatenate([np.geomspace(1e-5, end, 1000), np.arange(0.0, end, max(step, end / 5000))]))
    values = np.array([h(t) for t in grid])
    zeros = [brentq(h, *grid[k : k + 2], xtol=1e-14) for k in np.flatnonzero(values[:-1] * values[1:] < 0)]
    cuts = np.unique([0.0, *zeros, *(np.geomspace(1e-3, 1.0, 12) * end)])
    return sum(abs(quad(h, *cuts[k : k + 2], epsabs=1e-14, epsrel=1e-10)[0]) for k in range(len(cuts) - 1))


@pytest.mark.parametrize("degree", BINOMIAL)
def test_binomial_surfaces_match_the_table(degree):
    np.testing.assert_allclose(peak_gains(SlidingSurface.binomial(1.0, degree + 1).c), BINOMIAL[degree], atol=5.1e-5)


def test_second_order_binomial_is_two_over_e():
    np.testing.assert_allclose(peak_gains(np.array([1.0, 2.0]))[:2], [1.0, 2 / np.e], rtol=1e-9)


@pytest.mark.parametrize("a", [0.01, 3.0, 200.0])
def test_gains_scale_with_the_units_of_time(a):
    scaled = peak_gains(SlidingSurface.binomial(a, 4).c) / a ** (np.arange(4.0) - 3.0)
    np.testing.assert_allclose(scaled, peak_gains(SlidingSurface.binomial(1.0, 4).c), rtol=1e-9)


def test_orders_one_and_two_are_exact():
    assert peak_gains(np.zeros(0)).tolist() == [1.0]
    assert peak_gains(np.array([4.0])).tolist() == [0.25, 2.0]


@pytest.mark.parametrize("roots", ROOTS.values(), ids=ROOTS.keys())
def test_gains_are_the_l1_norms_of_the_impulse_responses(roots):
    degree = len(roots)
    truth = [l1_norm(roots, i) + (i == degree) for i in range(degree + 1)]
    np.testing.assert_allclose(peak_gains(coefficients(roots)), truth, rtol=1e-7)


@pytest.mark.parametrize("roots", [[-1, -1, -1, -1], [-0.1, -50], [-1e-3, -1, -1e3], [-1, -2, -3, -4, -5, -6, -7]])
def test_with_real_poles_the_first_gain_is_the_static_one(roots):
    c = coefficients(roots)
    np.testing.assert_allclose(peak_gains(c)[0], 1 / c[0], rtol=1e-10)


def test_an_oscillating_surface_against_its_closed_form():
    # |exp(-a t) sin(b t)| / b integrates to coth(pi a / 2 b) / (a^2 + b^2)
    a, b = 1.0, 100.0
    truth = 1 / np.tanh(np.pi * a / (2 * b)) / (a**2 + b**2)
    np.testing.assert_allclose(peak_gains(coefficients([-a + b * 1j, -a - b * 1j]))[0], truth, rtol=1e-6)


@pytest.mark.parametrize(("ratio", "rtol"), [(1.0, 1e-6), (5.0, 1e-6), (20.0, 1e-5)])
def test_traced_gains_are_as_good_as_documented(ratio, rtol):
    c = coefficients([-1 + ratio * 1j, -1 - ratio * 1j])
    truth = 1 / np.tanh(np.pi / (2 * ratio)) / (1 + ratio**2)
    np.testing.assert_allclose(jax.jit(peak_gains)(c)[0], truth, rtol=rtol)


def test_gains_of_a_drawn_surface_are_those_of_each():
    cs = np.array([[1.0, 0.4], [5.0, 50.1], [2.0, 3.0]])
    np.testing.assert_allclose(jax.jit(jax.vmap(peak_gains))(cs), [peak_gains(c) for c in cs], rtol=1e-7)


def test_gradients_agree_with_finite_differences():
    c, step = np.array([1.0, 0.4]), 1e-4
    sides = [[peak_gains(c + sign * step * unit) for sign in (1, -1)] for unit in np.eye(2)]
    differences = np.array([(up - down) / (2 * step) for up, down in sides]).T
    np.testing.assert_allclose(jax.jacrev(peak_gains)(c), differences, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("c", [[-1.0], [1.0, 0.0], [1.0, 1.0, 1.0]])
def test_without_decay_no_bound_exists(c):
    assert np.all(peak_gains(np.array(c)) == np.inf)
    assert np.all(jax.jit(peak_gains)(np.array(c)) == np.inf)
    assert np.all(np.isfinite(jax.jacfwd(peak_gains)(np.array(c))))


def test_error_bounds_are_float64_numpy_without_the_caller_asking():
    with enable_x64(False):
        bounds = SlidingSurface([2.0]).error_bounds(0.1)
    assert isinstance(bounds, np.ndarray)
    np.testing.assert_allclose(bounds, [0.05, 0.2], rtol=1e-15)


@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_the_papers_bounds_are_never_below_the_sharp_ones(order):
    surface = SlidingSurface.binomial(2.0, order)
    paper = surface.paper_bounds(0.1)
    np.testing.assert_allclose(paper, 4.0 ** np.arange(order) * 0.1 / 2.0 ** (order - 1), rtol=1e-14)
    assert np.all(surface.error_bounds(0.1) <= paper * (1 + 1e-9))


@pytest.mark.parametrize(
    ("c", "applies"), [([6.0, 12.0, 8.0], False), ([8.0, 12.0, 6.0], True), ([8.0, 12.0, 6.0 + 1e-7], False)]
)
def test_the_papers_bounds_need_binomial_coefficients(c, applies):
    assert (SlidingSurface(c).paper_bounds(0.1) is not None) is applies


def simulate_errors(c, e0, sigma, t1, breaks=()):
    """Errors and their derivatives at t1 for a given sliding variable, by an integrator that stops at its jumps."""
    x, cuts = np.array(e0[:-1], float), np.unique([0.0, *breaks, t1])
    for left, right in zip(cuts[:-1], cuts[1:], strict=True):
        value = sigma if not breaks else lambda t, middle=0.5 * (left + right): sigma(t, middle)
        x = solve_ivp(lambda t, x, v=value: [*x[1:], v(t) - c @ x], (left, right), x, rtol=1e-10, atol=1e-12).y[:, -1]
    return x


@pytest.mark.parametrize("name", ["real", "close", "complex"])
@pytest.mark.parametrize("i", [0, 1])
def test_the_worst_sliding_variable_attains_the_envelope(name, i):
    roots, t1 = ROOTS[name], 3.0
    c = coefficients(roots)
    e0 = np.linspace(0.05, 0.1, len(roots) + 1)
    free = simulate_errors(c, e0, lambda t: 0.0, t1)[i]
    h = impulse_response(roots, i)
    grid = np.linspace(1e-9, t1, 400)
    values = [h(t) for t in grid]
    switches = [t1 - brentq(h, *grid[k : k + 2]) for k in range(399) if values[k] * values[k + 1] < 0]
    breaks = (*switches, 0.5 * t1)

    def worst(t, middle):
        return np.sign(free) * np.sign(h(t1 - middle)) * (2.0 * np.exp(-1.5 * t) + 0.1)

    reached = abs(simulate_errors(c, e0, worst, t1, breaks)[i])
    np.testing.assert_allclose(SlidingSurface(c).error_envelope([t1], e0, FUNNEL)[0, i], reached, rtol=1e-7)


@pytest.mark.parametrize("roots", [[-1.0], [-1.0, -1.0, -1.0], *ROOTS.values()], ids=["first", "binomial", *ROOTS])
def test_no_sliding_variable_in_the_funnel_exceeds_the_envelope(roots):
    c, ts = coefficients(roots), np.linspace(0.0, 4.0, 41)
    rng = np.random.default_rng(3)
    frequencies, phases = rng.uniform(0.5, 20.0, 4), rng.uniform(0.0, 6.0, 4)

    def sigma(t):
        wave = np.clip(2.0 * np.sum(np.sin(frequencies * t + phases)), -1.0 + 1e-9, 1.0 - 1e-9)
        return wave * (2.0 * np.exp(-1.5 * t) + 0.1)

    start = 0.02 * rng.standard_normal(len(c)) * np.max(np.abs(roots)) ** np.arange(len(c))
    e0 = np.append(start, sigma(0.0) - c @ start)
    solution = solve_ivp(lambda t, x: [*x[1:], sigma(t) - c @ x], (0.0, 4.0), start, "LSODA", ts, rtol=1e-9, atol=1e-12)
    last = np.array([sigma(t) for t in ts]) - c @ solution.y
    errors = np.abs(np.vstack([solution.y, last])).T
    envelope = SlidingSurface(c).error_envelope(ts, e0, FUNNEL)
    assert np.all(errors <= envelope * (1 + 1e-6))


@pytest.mark.parametrize("roots", [[-1.0], [-1.0, -2.0, -3.0], ROOTS["complex"], ROOTS["mixed"]])
def test_in_the_end_the_envelope_is_the_error_bound_at_the_final_width(roots):
    surface = SlidingSurface(coefficients(roots))
    last = surface.error_envelope([600.0], np.zeros(len(roots) + 1), FUNNEL)[0]
    np.testing.assert_allclose(last, surface.error_bounds(0.1), rtol=1e-8)


def test_with_order_one_the_envelope_is_the_funnel():
    ts = np.array([0.0, 2.0, 1.0])
    envelope = SlidingSurface([]).error_envelope(ts, [0.3], FUNNEL)
    np.testing.assert_allclose(envelope[:, 0], 2.0 * np.exp(-1.5 * ts) + 0.1, rtol=1e-15)


def test_with_order_two_the_envelope_has_a_closed_form():
    ts, a, mu = np.array([2.0, 0.0, 0.7]), 3.0, 1.5
    first = (
        0.2 * np.exp(-a * ts) + 0.1 * (1 - np.exp(-a * ts)) / a + 2.0 * (np.exp(-mu * ts) - np.exp(-a * ts)) / (a - mu)
    )
    second = a * first + 2.0 * np.exp(-mu * ts) + 0.1
    envelope = SlidingSurface([a]).error_envelope(ts, [0.2, 0.0], FUNNEL)
    np.testing.assert_allclose(envelope, np.stack([first, second], axis=1), rtol=1e-10)


def test_the_envelope_needs_a_start_inside_the_funnel():
    with pytest.raises(
        ValueError, match=r"Argument `e0` must start inside the funnel, \|sigma\| < 2.1, but has \|sigma\| = 2.1"
    ):
        SlidingSurface([]).error_envelope([1.0], [2.1], FUNNEL)


def test_the_envelope_needs_times_that_are_not_negative():
    with pytest.raises(ValueError, match="Argument `ts` must not be negative, but has -1"):
        SlidingSurface([1.0]).error_envelope([0.0, -1.0], [0.0, 0.0], FUNNEL)
