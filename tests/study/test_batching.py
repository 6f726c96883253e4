"""The batch: any run alone, bit for bit, however the runs are cut; one trace a study; broken premises counted."""

import numpy as np
import pytest

import qsmc_jax as qj
from studies_for_tests import Integrator, scenario, study

BLOCK = 64


def same_to_the_last_bit(a, b):
    """Two tables with the same columns and bytes."""
    return all(np.array_equal(a[name], b[name], equal_nan=True) for name in a)


@pytest.fixture(scope="module")
def table():
    """200 runs in blocks of 64."""
    return qj.monte_carlo(study, 200, seed=2, block=BLOCK, threads=1)


@pytest.mark.parametrize(("block", "threads"), [(64, 3), (192, 2)])
def test_rows_do_not_depend_on_blocks_or_threads(table, block, threads):
    assert same_to_the_last_bit(qj.monte_carlo(study, 200, seed=2, block=block, threads=threads), table)


def test_any_run_can_be_solved_alone(table):
    (alone,) = qj.stream(study, [137], seed=2, block=BLOCK)
    assert same_to_the_last_bit(alone, table.take([137]))


def test_fewer_runs_are_a_prefix_of_more(table):
    assert same_to_the_last_bit(qj.monte_carlo(study, 70, seed=2, block=BLOCK), table.take(slice(70)))


def test_another_seed_gives_other_runs(table):
    other = qj.monte_carlo(study, BLOCK, seed=3, block=BLOCK)
    assert not np.intersect1d(other["d"], table["d"]).size


def test_a_replayed_run_agrees_with_its_row():
    """Another program rounds differently, and may refuse a step that the other just kept; so at a tight tolerance."""
    settings = qj.SolverSettings(rtol=1e-12)
    table = qj.monte_carlo(study, BLOCK, seed=2, settings=settings, block=BLOCK)
    row = table.row(int(np.flatnonzero(table["verdict"] == qj.Verdict.HELD)[5]))
    run = study.replay(row["index"], seed=2, settings=settings)
    for name in ("peak_ratio", "peak_u", "reach_time", "rms_error", "energy_u", "total_variation_u"):
        assert float(getattr(run.metrics, name)) == pytest.approx(row[name], rel=1e-9), name


def test_one_trace_serves_all_values_tolerances_and_seeds():
    calls = []

    def counted(draw):
        calls.append(draw)
        return scenario(draw)

    fresh = qj.Study(counted, bandwidth=0.2)
    qj.monte_carlo(fresh, BLOCK, block=BLOCK)
    studies = [fresh.substitute(mu=2.0), fresh.substitute(mu=3.0, t1=2.0), fresh.substitute(gain_sign=-1.0)]
    calls.clear()
    fresh.require_unchanged()
    asked = len(calls)
    calls.clear()
    for seed, other in enumerate(studies):
        qj.monte_carlo(other, BLOCK, seed=seed, settings=qj.SolverSettings(rtol=1e-5 / (1 + seed)), block=BLOCK)
    # Each asks once whether the scenario has changed, and traces nothing.
    assert len(calls) == asked * len(studies)


def of_funnel(make):
    """A study of the integrator whose funnel is drawn by `make(draw)`."""

    def drawn(draw):
        control = qj.QuasiSlidingControl(qj.SlidingSurface([]), make(draw))
        loop = qj.ClosedLoop(Integrator(1.0), qj.references.Constant(0.0), qj.disturbances.Zero(), control)
        return qj.Scenario(loop, x0=[0.1], t1=6.0)

    return qj.Study(drawn, bandwidth=0.2)


def test_a_drawn_width_that_is_not_positive_makes_its_runs_inadmissible():
    runs = qj.monte_carlo(of_funnel(lambda d: qj.Funnel(d.uniform("rho0", -0.5, 3.0), 1.0, 0.1)), 64, block=BLOCK)
    is_bad = runs["rho0"] <= 0
    assert 0 < is_bad.sum() < 64
    assert np.all((runs["verdict"] == qj.Verdict.INADMISSIBLE) == is_bad)
    assert np.all(runs["outcome"][is_bad] == qj.Outcome.BAD_PARAMETERS)
    assert np.all(runs["steps"][is_bad] == 0)


def test_c2_broken_by_a_drawn_width_leaves_only_the_funnel_claim():
    runs = qj.monte_carlo(of_funnel(lambda d: qj.Funnel(1.0, 1.0, d.uniform("rho_inf", 0.05, 0.3))), 64, block=BLOCK)
    breaks_c2 = runs["rho_inf"] >= 0.2
    assert 0 < breaks_c2.sum() < 64
    assert np.all(runs["verdict"] == qj.Verdict.HELD)
    for claim in ("verdict_reaching", "verdict_tracking"):
        assert np.all((runs[claim] == qj.Verdict.INADMISSIBLE) == breaks_c2), claim


def test_designs_for_exploration_run():
    for sampling in (qj.Sobol(), qj.LatinHypercube(64)):
        runs = qj.monte_carlo(study, 64, sampling=sampling, block=BLOCK)
        counts, _ = np.histogram(runs["d"], np.linspace(-1.0, 1.0, 65))
        assert np.all(counts == 1)  # one point a slice


def test_progress_is_told_after_each_block():
    told = []
    qj.monte_carlo(study, 130, block=BLOCK, progress=lambda done, total: told.append((done, total)))
    assert told == [(64, 130), (128, 130), (130, 130)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"runs": 0}, "`runs` must be at least 1, but is 0"),
        ({"runs": 1, "block": 100}, "`block` must be a positive multiple of 64, but is 100"),
        ({"runs": 1, "threads": -1}, "`threads` must be at least 1"),
        ({"runs": 1, "seed": -1}, "`seed` must be in"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        qj.monte_carlo(study, **arguments)


@pytest.mark.slow
def test_vectorised_functions_can_be_switched_off():
    """Sines come from another library then: the same runs up to what rounding does to the steps."""
    fast, plain = (
        qj.monte_carlo(with_sines, 64, block=BLOCK, settings=qj.SolverSettings(vectorise=vectorise))
        for vectorise in (True, False)
    )
    np.testing.assert_allclose(fast["peak_ratio"], plain["peak_ratio"], rtol=1e-6)
    assert not same_to_the_last_bit(fast, plain)


def driven(draw):
    """An integrator under a sine."""
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, 1.0, 0.1))
    disturbance = qj.disturbances.Sine(0.5, draw.uniform("frequency", 1.0, 3.0))
    loop = qj.ClosedLoop(Integrator(1.0), qj.references.Constant(0.0), disturbance, control)
    return qj.Scenario(loop, x0=[0.1], t1=6.0)


with_sines = qj.Study(driven, bandwidth=0.2)
