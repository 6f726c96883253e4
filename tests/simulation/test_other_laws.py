"""Ideal loops under other laws: closed forms of linear ones, and the paper's loop under another name."""

import math
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize

import qsmc_jax as qj
from qsmc_jax.base.module import float_field
from studies_for_tests import Integrator

G, T1, BANDWIDTH = 2.0, 3.0, 0.2
SURFACE, FUNNEL = qj.SlidingSurface([]), qj.Funnel(1.0, 1.0, 0.1)
WAVE = qj.disturbances.Sine(1.5, 2.0)
REST = qj.references.Constant(0.0)


def run_of(control, disturbance=WAVE, gain=G, x0=0.5, t1=T1, reference=REST, settings=None, implementation=None):
    """A run of x' = g u + d."""
    loop = qj.ClosedLoop(Integrator(gain), reference, disturbance, control, implementation)
    return qj.simulate(loop, [x0], t1, bandwidth=BANDWIDTH, settings=settings)


def check_input(run, u):
    """The metrics of the input against its values on the grid: cubic in its step for the integral."""
    f = run.metrics
    np.testing.assert_allclose(run.u, u, atol=2e-5 * np.max(np.abs(u)))
    assert float(f.max_u) == pytest.approx(np.max(u), abs=1e-4 * np.max(np.abs(u)))
    assert float(f.min_u) == pytest.approx(np.min(u), abs=1e-4 * np.max(np.abs(u)))
    assert float(f.peak_u) == pytest.approx(np.max(np.abs(u)), rel=1e-4)
    assert float(f.energy_u) == pytest.approx(scipy.integrate.simpson(u**2, x=run.ts), rel=1e-4)
    assert float(f.total_variation_u) == pytest.approx(np.sum(np.abs(np.diff(u))), rel=1e-3)


def test_gain_and_offset_are_those_of_another_plant():
    k, offset = 2.5, -0.7
    one = run_of(qj.QuasiSlidingControl(SURFACE, FUNNEL, 1.0, k, offset))
    moved = qj.disturbances.Sum((WAVE, qj.disturbances.Constant(G * offset)))
    other = run_of(qj.QuasiSlidingControl(SURFACE, FUNNEL), moved, gain=G * k)
    assert one.verdict is qj.Verdict.HELD
    np.testing.assert_allclose(one.x, other.x, atol=1e-6)
    assert float(one.metrics.peak_ratio) == pytest.approx(float(other.metrics.peak_ratio), rel=1e-6)
    check_input(one, offset + k * other.u)
    assert float(one.metrics.peak_u) <= float(one.metrics.peak_u_bound)


class Tangent(qj.AbstractControl):
    """The paper's law as a user would write it, from the errors."""

    surface: qj.SlidingSurface
    funnel: qj.AbstractFunnel
    gain: float = float_field(default=1.0)
    gain_sign: float = float_field(default=1.0)

    positive: ClassVar[tuple[str, ...]] = ("gain",)

    def first_memory(self):
        """None."""
        return ()

    def command(self, sample, memory):
        """Of the ratio."""
        ratio = self.surface(sample.errors) / sample.rho
        return -self.gain_sign * self.gain * jnp.tan(0.5 * math.pi * ratio), ()


@pytest.mark.parametrize("method", ["tsit5", pytest.param("rodas5p", marks=pytest.mark.slow)])
def test_the_papers_law_as_ones_own_is_the_papers(method):
    settings = qj.SolverSettings(method=method)
    own, papers = (
        run_of(law, settings=settings)
        for law in (Tangent(SURFACE, FUNNEL, 2.5), qj.QuasiSlidingControl(SURFACE, FUNNEL, 1.0, 2.5))
    )
    assert own.verdicts == papers.verdicts
    assert float(own.metrics.peak_ratio) == pytest.approx(float(papers.metrics.peak_ratio), rel=1e-6)
    np.testing.assert_allclose(own.x, papers.x, atol=1e-6)
    check_input(own, papers.u)
    assert np.isnan(own.metrics.peak_u_bound)


class Linear(qj.AbstractControl):
    """u = -k y, and a pulse; y is the output, about nothing."""

    surface: qj.SlidingSurface
    funnel: qj.AbstractFunnel
    k: float = float_field(default=1.0)
    pulse: float = float_field(default=0.0)
    gain_sign: float = float_field(default=1.0)

    positive: ClassVar[tuple[str, ...]] = ("k",)

    def first_memory(self):
        """None."""
        return ()

    def command(self, sample, memory):
        """Of the output; 1e-3 s wide about t = 1.7."""
        return -self.k * sample.output[0] + self.pulse * jnp.exp(-(((sample.t - 1.7) / 1e-3) ** 2)), ()


def linear(t, k, d, x0=0.5):
    """x of x' = -g k x + d."""
    return d / (G * k) + (x0 - d / (G * k)) * np.exp(-G * k * t)


@pytest.mark.slow
def test_a_linear_law_has_its_closed_form():
    k, d = 1.5, 0.25
    wide = qj.Funnel(1.0, 1.0, 0.15)
    run = run_of(Linear(SURFACE, wide, k), qj.disturbances.Constant(d))
    x = linear(run.ts, k, d)
    assert run.verdict is qj.Verdict.HELD
    np.testing.assert_allclose(run.x[:, 0], x, atol=2e-6)
    ratio = lambda t: linear(t, k, d) / (math.exp(-t) + 0.15)  # noqa: E731
    top = scipy.optimize.minimize_scalar(
        lambda t: -ratio(t), bounds=(0.0, T1), method="bounded", options={"xatol": 1e-9}
    )
    assert float(run.metrics.peak_ratio) == pytest.approx(max(ratio(0.0), -top.fun, ratio(T1)), rel=1e-5)
    check_input(run, -k * x)


def test_it_leaves_where_it_meets_the_edge():
    k, d = 1.5, 0.75
    run = run_of(Linear(SURFACE, FUNNEL, k), qj.disturbances.Constant(d))
    meets = scipy.optimize.brentq(lambda t: linear(t, k, d) - math.exp(-t) - 0.1, 0.5, T1)
    assert run.verdict is qj.Verdict.VIOLATED
    assert float(run.metrics.violation_time) == pytest.approx(meets, rel=1e-5)


def test_a_short_pulse_of_the_law_is_not_stepped_over():
    k, d, pulse = 1.5, 0.25, 150.0
    wide = qj.Funnel(1.0, 1.0, 0.15)
    held, left = (run_of(Linear(SURFACE, wide, k, p), qj.disturbances.Constant(d)) for p in (0.1 * pulse, pulse))
    jump = G * 0.1 * pulse * 1e-3 * math.sqrt(math.pi)
    assert held.verdict is qj.Verdict.HELD
    assert float(held.x[-1, 0]) == pytest.approx(linear(T1, k, d) + jump * math.exp(-G * k * (T1 - 1.7)), rel=1e-3)
    assert left.verdict is qj.Verdict.VIOLATED
    assert float(left.metrics.violation_time) == pytest.approx(1.7, abs=2e-3)


def test_a_law_with_a_weak_pole_is_not_said_to_leave():
    """Prescribed performance holds against any push; against a large one closer to the edge than can be resolved."""
    law = qj.controllers.PrescribedPerformance(SURFACE, FUNNEL, 0.01)
    close, closer = (run_of(law, qj.disturbances.Constant(G * 0.01 * factor), x0=0.0) for factor in (4.0, 400.0))
    assert close.verdict is qj.Verdict.HELD
    width = lambda t: np.exp(-t) + 0.1  # noqa: E731
    rate = lambda t, x: [-2.0 * G * 0.01 * math.atanh(x[0] / width(t)) + G * 0.01 * 4.0]  # noqa: E731
    truth = scipy.integrate.solve_ivp(rate, (0.0, T1), [0.0], method="Radau", rtol=1e-10, atol=1e-13)
    assert float(close.metrics.margin) == pytest.approx(1.0 - np.max(truth.y[0] / width(truth.t)), rel=1e-3)
    assert closer.outcome in (qj.Outcome.BEYOND_RESOLUTION, qj.Outcome.STEP_TOO_SMALL)
    assert closer.verdict is qj.Verdict.UNDECIDED


def test_in_the_wrong_direction_it_leaves():
    law = qj.controllers.FunnelControl(SURFACE, FUNNEL, 1.0, -1.0)
    run = run_of(law, qj.disturbances.Zero(), x0=0.5)
    width = lambda t: math.exp(-t) + 0.1  # noqa: E731
    edge = lambda t, x: 1.0 - 1e-5 - x[0] / width(t)  # noqa: E731
    edge.terminal = True
    rate = lambda t, x: [G * (x[0] / width(t)) / (1.0 - (x[0] / width(t)) ** 2)]  # noqa: E731
    truth = scipy.integrate.solve_ivp(rate, (0.0, T1), [0.5], events=edge, rtol=1e-10, atol=1e-12)
    assert run.verdict is qj.Verdict.VIOLATED
    assert float(run.metrics.violation_time) == pytest.approx(truth.t_events[0][0], rel=1e-5)


@pytest.mark.slow
def test_a_sampled_law_is_given_errors_and_output():
    """x_(k+1) = x_k - g k tau (x_k + 1) about 1: y is x, not e."""
    reference, tau, k = qj.references.Constant(1.0), 0.05, 0.3
    wide = qj.Funnel(3.0, 1.0, 2.0)
    loop = qj.ClosedLoop(
        Integrator(G), reference, qj.disturbances.Zero(), Linear(SURFACE, wide, k), qj.Implementation(tau)
    )
    run = qj.simulate(loop, [0.5], 1.0, bandwidth=2.5, ts=np.arange(21) * tau)
    np.testing.assert_allclose(run.x[:, 0], 0.5 * (1.0 - G * k * tau) ** np.arange(21), rtol=1e-9)


@pytest.mark.parametrize(
    "law", [qj.controllers.Sign(SURFACE, FUNNEL, 1.0), qj.controllers.SuperTwisting(SURFACE, FUNNEL, 1.0, 1.0)]
)
def test_a_law_that_switches_or_remembers_needs_an_implementation(law):
    with pytest.raises(
        qj.InputError, match=r"`implementation` must be given for a `\w+`: a law that switches or has a"
    ):
        run_of(law)


def test_the_gain_must_be_positive():
    with pytest.raises(qj.InputError, match="Argument `gain` must be positive"):
        qj.QuasiSlidingControl(SURFACE, FUNNEL, 1.0, -1.0)
    with pytest.raises(qj.InputError, match="Argument `offset` must be finite"):
        qj.QuasiSlidingControl(SURFACE, FUNNEL, 1.0, 1.0, math.inf)


@pytest.mark.slow
def test_a_saturated_law_holds_what_its_limit_can_hold():
    """At rest K tan(pi z / 2) = d / g as long as that is below the limit; started at it, x moves at d - g u_max."""
    law = qj.controllers.Saturated(qj.QuasiSlidingControl(SURFACE, FUNNEL), (-1.0, 1.0))
    held = run_of(law, qj.disturbances.Constant(1.5), x0=0.2, t1=20.0)
    assert held.verdict is qj.Verdict.HELD
    rho = math.exp(-20.0) + 0.1
    assert float(held.x[-1, 0]) == pytest.approx(2.0 / math.pi * math.atan(1.5 / G) * rho, rel=1e-5)
    left = run_of(law, qj.disturbances.Constant(2.5), x0=0.9)
    meets = scipy.optimize.brentq(lambda t: 0.9 + 0.5 * t - math.exp(-t) - 0.1, 0.0, T1)
    assert left.verdict is qj.Verdict.VIOLATED
    assert float(left.metrics.violation_time) == pytest.approx(meets, rel=1e-5)
    assert float(np.nanmax(np.abs(left.u))) == 1.0


@pytest.mark.slow
def test_an_input_goes_as_far_as_its_limits_and_no_farther():
    """The load passes for a while what the limit can hold, and each time the loop recovers: u has kinks there."""
    limited = qj.controllers.Saturated(qj.QuasiSlidingControl(SURFACE, FUNNEL), (-0.7, 0.72))
    held = run_of(qj.controllers.StateVariableFilter(limited, 500.0), qj.disturbances.Sine(1.5, 8.0))
    assert held.verdict is qj.Verdict.HELD
    assert (float(held.metrics.min_u), float(held.metrics.max_u)) == (-0.7, 0.72)
    assert float(held.metrics.peak_u) == 0.72


def test_what_a_law_is_made_of_must_be_fit_too():
    limited = qj.controllers.Saturated(qj.controllers.Sign(SURFACE, FUNNEL, 1.0), (-1.0, 1.0))
    with pytest.raises(qj.InputError, match="`implementation` must be given for a `Saturated`"):
        run_of(limited)
    with pytest.raises(qj.InputError, match=r"`input_range` must have low < high, but is \(1, -1\)"):
        qj.controllers.Saturated(qj.QuasiSlidingControl(SURFACE, FUNNEL), (1.0, -1.0))
    drawn = lambda gain, low: qj.controllers.Saturated(  # noqa: E731
        qj.QuasiSlidingControl(SURFACE, FUNNEL, 1.0, gain), jnp.stack([low, jnp.ones(())])
    ).is_valid()
    fit = [bool(jax.jit(drawn)(gain, low)) for gain, low in ((1.0, -1.0), (-1.0, -1.0), (1.0, 2.0))]
    assert fit == [True, False, False]
