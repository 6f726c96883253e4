"""Loops in funnels of other shapes: against SciPy, and against the same loop with everything shifted."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

import qsmc_jax as qj
from own_plants import Scalar
from qsmc_jax.control.funnels.rates import require_own_rates
from qsmc_jax.control.settling import settling_time as qj_settling
from studies_for_tests import Integrator

F = qj.funnels
BANDWIDTH = 0.2
G = 2.0

# By name: the funnel; its half-width in plain Python; where its rate jumps.
FUNNELS = {
    "finite time": (
        F.FiniteTime(1.0, 1.5, 1.0, 0.1),
        lambda t: max(1.0 - t, 0.0) ** 1.5 + 0.1,
        1.0,
    ),
    "late": (
        F.PrescribedTime(1.0, 0.01, 1.0, 0.1),
        lambda t: (math.exp(-0.01 * t / (1.0 - t)) if t < 1.0 else 0.0) + 0.1,
        1.0,
    ),
    "a power law": (F.Smooth(lambda t: (1.0 + 2.0 * t) ** -2 + 0.1), lambda t: (1.0 + 2.0 * t) ** -2 + 0.1, 3.0),
    # A method that looks at a few instants of a long step sees neither that it narrows nor that it widens again.
    "a dip": (
        F.Smooth(lambda t: 1.0 + jnp.exp(-t) - 0.9 * jnp.exp(-(((t - 1.7) / 1e-3) ** 2))),
        lambda t: 1.0 + math.exp(-t) - 0.9 * math.exp(-(((t - 1.7) / 1e-3) ** 2)),
        1.7,
    ),
}


def loop_in(funnel, desired=0.0, gain_sign=1.0, implementation=None, disturbance=None):
    """x' = 2 u + d about a constant."""
    d = disturbance or qj.disturbances.Sine(1.5, 2.0)
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), funnel, gain_sign)
    return qj.ClosedLoop(Integrator(G), qj.references.Constant(desired), d, control, implementation)


def peak_by_scipy(width, middle, x0=0.5, t1=3.0):
    """sup |x| / rho, stepwise around where the funnel is sharp."""

    def rate(t, x):
        return [-G * math.tan(math.pi * x[0] / (2.0 * width(t))) + 1.5 * math.sin(2.0 * t)]

    x, peak = [x0], 0.0
    ends = sorted({0.0, *(min(max(middle + k, 0.0), t1) for k in (-0.01, 0.0, 0.01)), t1})
    for a, b in zip(ends, ends[1:], strict=False):
        longest = 2e-5 if b - a <= 0.011 else 1e-2
        grid = np.linspace(a, b, 20_001)
        tight = {"method": "Radau", "rtol": 1e-10, "atol": 1e-12}
        solved = scipy.integrate.solve_ivp(rate, (a, b), x, t_eval=grid, max_step=longest, **tight)
        x = solved.y[:, -1]
        peak = max(peak, *(abs(value) / width(t) for t, value in zip(grid, solved.y[0], strict=True)))
    return peak


SLOWLY = [pytest.param(name, marks=pytest.mark.slow) for name in ("late", "a power law")]


@pytest.mark.parametrize("name", ["finite time", "a dip", *SLOWLY])
def test_the_peak_is_scipys(name):
    funnel, width, middle = FUNNELS[name]
    run = qj.simulate(loop_in(funnel), [0.5], 3.0, bandwidth=BANDWIDTH if name != "a dip" else 1.5)
    assert run.verdict is qj.Verdict.HELD
    assert float(run.metrics.peak_ratio) == pytest.approx(peak_by_scipy(width, middle), rel=3e-5)


def shifted(**changes):
    """A run in a funnel with constant centre 0.3, and the same about 0.3 in the symmetric one."""
    wide = qj.Funnel(1.0, 1.0, 0.5)
    both = F.Asymmetric(F.Smooth(lambda t: jnp.exp(-t) + 0.8), F.Smooth(lambda t: jnp.exp(-t) + 0.2))
    one = qj.simulate(loop_in(both, **changes), [0.5], 3.0, bandwidth=1.0)
    other = qj.simulate(loop_in(wide, desired=0.3, **changes), [0.5], 3.0, bandwidth=0.6)
    return one, other


def check_shifted(one, other, tolerance):
    assert one.verdict is other.verdict
    assert one.outcome is other.outcome
    assert float(one.metrics.peak_ratio) == pytest.approx(float(other.metrics.peak_ratio), rel=tolerance)
    assert float(one.metrics.peak_u) == pytest.approx(float(other.metrics.peak_u), rel=tolerance)
    assert float(one.metrics.violation_time) == pytest.approx(float(other.metrics.violation_time), rel=tolerance)
    np.testing.assert_allclose(one.x, other.x, atol=tolerance)
    np.testing.assert_allclose(one.sigma, other.sigma + 0.3, atol=tolerance)
    low, high = one.edges
    np.testing.assert_allclose(low, 0.3 - other.rho, rtol=1e-12)
    np.testing.assert_allclose(high, 0.3 + other.rho, rtol=1e-12)


def test_about_another_centre_all_is_shifted():
    one, other = shifted()
    assert one.verdict is qj.Verdict.HELD
    check_shifted(one, other, 1e-6)
    # Its rate is right too: the integral of its square is read off cubics in long steps.
    mean_square = scipy.integrate.simpson(one.sigma**2, x=one.ts) / one.ts[-1]
    assert float(one.metrics.rms_error) == pytest.approx(math.sqrt(mean_square), rel=1e-5)


@pytest.mark.slow
def test_a_loop_that_leaves_leaves_at_the_shifted_edge():
    one, other = shifted(gain_sign=-1.0)
    assert one.verdict is qj.Verdict.VIOLATED
    check_shifted(one, other, 1e-6)


@pytest.mark.slow
def test_a_sampled_loop_is_shifted_too():
    check_shifted(*shifted(implementation=qj.Implementation(sample_period=0.02)), 1e-5)


@pytest.mark.slow
def test_a_sampled_loop_that_leaves_leaves_at_the_shifted_edge():
    made = qj.Implementation(sample_period=0.02, saturation=0.2)
    one, other = shifted(implementation=made, disturbance=qj.disturbances.Constant(1.2))
    assert one.verdict is qj.Verdict.VIOLATED
    check_shifted(one, other, 1e-5)


@pytest.mark.parametrize(("x0", "inside"), [(-0.09, True), (-0.11, False), (1.09, True), (1.11, False)])
def test_a_start_counts_as_inside_between_its_own_edges(x0, inside):
    funnel = F.Asymmetric(qj.Funnel(1.0, 1.0, 0.1), qj.Funnel(0.05, 1.0, 0.05))
    run = qj.simulate(loop_in(funnel), [x0], 0.1, bandwidth=BANDWIDTH)
    assert (run.verdict is qj.Verdict.HELD) == inside
    assert (run.verdict is qj.Verdict.INADMISSIBLE) == (not inside)


@pytest.mark.slow
def test_other_coordinates_say_the_same():
    funnel = F.Asymmetric(qj.Funnel(1.0, 1.0, 0.1), qj.Funnel(0.8, 2.0, 0.05))
    rest, wave = qj.references.Constant(0.0), qj.disturbances.Sine(1.5, 2.0)
    own = qj.ClosedLoop(Scalar(G), rest, wave, qj.QuasiSlidingControl(qj.SlidingSurface([]), funnel))
    physical = qj.SolverSettings(coordinates="physical")
    truth, *others = (
        qj.simulate(loop, [0.5], 3.0, bandwidth=BANDWIDTH, settings=settings)
        for loop, settings in ((loop_in(funnel), None), (own, None), (own, physical))
    )
    for other in others:
        assert float(other.metrics.peak_ratio) == pytest.approx(float(truth.metrics.peak_ratio), rel=1e-5)
        np.testing.assert_allclose(other.x[-1], truth.x[-1], atol=1e-5)


def test_errors_keep_their_bounds_from_the_settling_time_on():
    """Truth: the envelope by quadrature of the impulse response, for an error of order 2."""
    c, eps, e0 = 2.0, 0.1, (0.9, 0.0)
    for funnel, width in ((F.FiniteTime(4.0, 2.0, 1.0, 0.05), lambda t: 4.0 * np.maximum(1.0 - t, 0.0) ** 2 + 0.05),):
        from_theory = settling(c, width, eps, e0[0])
        found = float(qj_settling(np.asarray([c]), funnel, eps, (eps / c, 2.0 * eps), e0))
        assert from_theory <= found <= from_theory + 1.0


def settling(c, width, eps, e0):
    """The last time at which |e0| e^(-ct) + int e^(-c(t-s)) rho(s) ds is eps / c or more."""
    ts = np.linspace(0.0, 20.0, 200_001)
    envelope = scipy.integrate.solve_ivp(
        lambda t, y: -c * y + width(t), (0.0, 20.0), [abs(e0)], t_eval=ts, rtol=1e-9, atol=1e-12, max_step=0.01
    ).y[0]
    return ts[np.flatnonzero(envelope >= eps / c)[-1]]


class Narrowing(qj.AbstractFunnel):
    """1 / (1 + t) + 0.1, with a rate that may be wrong and a step up to `until`, as a user may write it."""

    rate_is: float = -1.0
    step: float = 0.0
    until: float = 1.2345
    break_times: tuple[float, ...] = ()

    def width_and_rate(self, t):
        """By hand."""
        return 1.0 / (1.0 + t) + 0.1 + jnp.where(t < self.until, self.step, 0.0), self.rate_is / (1.0 + t) ** 2

    def centre_and_rate(self, t):
        """Around 0."""
        return 0.0, 0.0

    bandwidths, narrowest, steepest, rate = (0.1, 1.1), 0.1, 1.0, 1.0

    def reaching_time(self, bandwidth):
        """By hand."""
        return 1.0 / (bandwidth - 0.1) - 1.0

    def enclosing(self, bandwidth):
        """Wide enough."""
        return qj.Funnel(1.0, 1e-3, 0.1)

    def is_valid(self):
        """Always."""
        return jnp.array(True)


def test_a_rate_that_is_not_the_derivative_is_named():
    with pytest.raises(qj.InputError, match=r"Derivative 1 of `Narrowing`, its half-width, must be .* instead of -"):
        qj.simulate(loop_in(F.Asymmetric(FUNNELS["finite time"][0], Narrowing(-2.0))), [0.5], 3.0, bandwidth=BANDWIDTH)


@pytest.mark.parametrize("breaks", [(), (1.2345,), (1.2345, 1.2346)])
def test_an_edge_that_jumps_is_named(breaks):
    """A loop well inside before would be outside after, on which the law has no say."""
    funnel = Narrowing(-1.0, 0.5, 1.2345, breaks)
    with pytest.raises(qj.InputError, match=r"`Narrowing` must not jump, but an edge does at t = 1\.2345 s"):
        qj.simulate(loop_in(funnel), [0.5], 3.0, bandwidth=BANDWIDTH)
    require_own_rates(funnel, 1.2)


@pytest.mark.slow
def test_a_funnel_of_ones_own_is_the_same_given_as_a_function():
    own, function = (
        qj.simulate(loop_in(each), [0.5], 3.0, bandwidth=BANDWIDTH)
        for each in (Narrowing(), F.Smooth(lambda t: 1.0 / (1.0 + t) + 0.1))
    )
    assert own.verdict is function.verdict
    assert float(own.metrics.peak_ratio) == pytest.approx(float(function.metrics.peak_ratio), rel=1e-9)
