"""The paper's seven runs against metrics solved apart from this project, and against dense sampling of the signals."""

import numpy as np
import pytest
import scipy.integrate
import scipy.signal

import problems
import qsmc_jax as qj

# The names that `Metrics` has for the oracle's.
METRICS = {"sup_ratio": "peak_ratio", "sup_u": "peak_u", "reach_time": "reach_time", "t_peak": "peak_time"}
# Absolute, with the default rtol of 1e-6. A peak is flat: its time has about half as many digits as its height.
DEFAULT_ATOL = {"sup_ratio": 2e-5, "sup_u": 1e-4, "reach_time": 1e-4, "t_peak": 1e-4}
# The oracle's integrals are sums over a fine grid, good to about six digits.
INTEGRALS_RTOL = 1e-4
TIMES = 20001


@pytest.fixture(scope="module", params=problems.PAPER, ids=str)
def problem(request):
    return request.param


@pytest.fixture(scope="module")
def run(problem):
    return problem.simulate(ts=np.linspace(0.0, problem.t1, TIMES))


@pytest.fixture(scope="module")
def tight_run(problem):
    preset = qj.tight()
    # With the default step limit, which is never met, both runs share one compiled program.
    return problem.simulate(qj.SolverSettings(preset.rtol, preset.atol), ts=np.linspace(0.0, problem.t1, TIMES))


@pytest.mark.parametrize(("answer", "atol"), DEFAULT_ATOL.items(), ids=DEFAULT_ATOL)
def test_metric_at_default_settings(problem, run, answer, atol):
    assert float(getattr(run.metrics, METRICS[answer])) == pytest.approx(problem.answers[answer], abs=atol, rel=0)


def test_last_state_at_default_settings(problem, run):
    np.testing.assert_allclose(run.x[-1], problem.answers["xT"], rtol=0, atol=1e-7)


@pytest.mark.parametrize("answer", ["energy_u", "total_variation_u"])
def test_integral_of_the_input(problem, run, answer):
    assert float(getattr(run.metrics, answer)) == pytest.approx(problem.answers[answer], rel=INTEGRALS_RTOL)


def test_the_largest_and_the_least_input_are_those_of_the_signal(run):
    """On a grid of 1 ms extremes are too small by less than 0.1 %: what is between its points is left out."""
    for found, seen in ((run.metrics.max_u, run.u.max()), (-run.metrics.min_u, -run.u.min())):
        assert -1e-6 < float(found) / seen - 1.0 < 1e-3


def test_late_errors(problem, run):
    late = np.abs(run.e[run.ts >= 5.0]).max(axis=0)
    np.testing.assert_allclose(late, problem.answers["sup_e_after5"], rtol=0, atol=1e-5)


def test_all_three_claims_hold(run):
    f = run.metrics
    assert run.outcome == qj.Outcome.COMPLETED
    assert [f.verdict, f.verdict_reaching, f.verdict_tracking] == [qj.Verdict.HELD] * 3


def test_peak_obeys_the_comparison_bound(run):
    assert float(run.metrics.peak_u) <= float(run.metrics.peak_u_bound) * (1 + 1e-6)


@pytest.mark.parametrize("answer", ["sup_ratio", "sup_u", "reach_time"])
def test_metric_with_the_tight_preset(problem, tight_run, answer):
    assert float(getattr(tight_run.metrics, METRICS[answer])) == pytest.approx(problem.answers[answer], abs=1e-6, rel=0)


def test_last_state_with_the_tight_preset(problem, tight_run):
    np.testing.assert_allclose(tight_run.x[-1], problem.answers["xT"], rtol=0, atol=1e-6)


def test_the_tight_preset_solves_the_paper_within_its_step_limit(tight_run):
    assert qj.tight().max_steps > 10 * int(tight_run.metrics.steps)


@pytest.fixture(scope="module", params=[problems.PAPER[0], problems.PAPER[4]], ids=str)
def sampled(request):
    """A run of 2 s, past its reaching time, with sampled every 0.1 ms."""
    problem = request.param
    return qj.simulate(problem.loop, problem.x0, 2.0, bandwidth=0.1, ts=np.linspace(0.0, 2.0, TIMES))


def test_peak_errors_agree_with_dense_sampling(sampled):
    steady = np.abs(sampled.e[sampled.ts >= sampled.reaching_time]).max(axis=0)
    # A peak between two samples, or at the reaching time itself, is missed by what e moves in 0.1 ms.
    np.testing.assert_allclose([float(peak) for peak in sampled.metrics.peak_errors], steady, rtol=1e-4)


def test_rms_error_agrees_with_dense_sampling(sampled):
    rms = np.sqrt(scipy.integrate.simpson(sampled.e[:, 0] ** 2, x=sampled.ts) / 2.0)
    assert float(sampled.metrics.rms_error) == pytest.approx(rms, rel=1e-6)


def test_peak_ratio_agrees_with_dense_sampling(sampled):
    highest = np.max(np.abs(sampled.sigma) / sampled.rho)
    assert highest <= float(sampled.metrics.peak_ratio) * (1 + 1e-9)
    assert highest == pytest.approx(float(sampled.metrics.peak_ratio), rel=1e-6)


def test_settle_time_is_the_end_of_the_last_step_outside_the_error_bounds(problem, run):
    # The largest error that |sigma| < epsilon permits is epsilon times the L1 norm of the impulse response.
    residues, poles, _ = scipy.signal.residue([1.0], [1.0, *np.asarray(problem.loop.control.surface.c)[::-1]])
    times = np.linspace(0.0, 60.0, 600_001)
    norm = np.trapezoid(np.abs((np.exp(np.outer(times, poles)) @ residues).real), times)
    assert run.error_bounds[0] == pytest.approx(problem.bandwidth * norm, rel=1e-6)
    outside = run.ts[np.any(np.abs(run.e) >= run.error_bounds, axis=1)]
    assert outside[-1] <= float(run.metrics.settle_time) <= outside[-1] + 0.05


def test_settle_time_is_infinite_when_the_horizon_ends_before(sampled):
    is_outside = bool(np.any(np.abs(sampled.e[-1]) >= sampled.error_bounds))
    assert np.isinf(float(sampled.metrics.settle_time)) == is_outside
