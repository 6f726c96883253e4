"""A distribution whose arguments depend on other draws is checked in each run: out of range is INADMISSIBLE."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import qsmc_jax as qj
from qsmc_jax.study.draw import Draw
from studies_for_tests import Integrator

BLOCK = 64

# Each is drawn with the number `a`, uniform in (0, 2); where that is in range, by the definition of the distribution.
CASES = {
    "uniform, low": (lambda d, a: d.uniform("x", a, 1.2), lambda a: a < 1.2),
    "uniform, high": (lambda d, a: d.uniform("x", 0.7, a), lambda a: a > 0.7),
    "log_uniform, low": (lambda d, a: d.log_uniform("x", a - 0.5, 3.0), lambda a: a > 0.5),
    "log_uniform, high": (lambda d, a: d.log_uniform("x", 0.7, a), lambda a: a > 0.7),
    "normal": (lambda d, a: d.normal("x", 0.0, a - 0.5), lambda a: a > 0.5),
    "truncated_normal, std": (lambda d, a: d.truncated_normal("x", 0.0, a - 0.5, -1.0, 1.0), lambda a: a > 0.5),
    "truncated_normal, low": (lambda d, a: d.truncated_normal("x", 0.0, 1.0, a, 1.2), lambda a: a < 1.2),
    "truncated_normal, far below": (
        lambda d, a: d.truncated_normal("x", -60.0 * a, 1.0, -50.0, -40.0),
        lambda a: (60.0 * a > 3.0) & (60.0 * a < 87.0),
    ),
    "triangular, mode": (lambda d, a: d.triangular("x", 0.0, a, 1.2), lambda a: a <= 1.2),
    "triangular, low": (lambda d, a: d.triangular("x", a - 0.5, 1.0, 2.0), lambda a: a - 0.5 <= 1.0),
    "exponential": (lambda d, a: d.exponential("x", 1.2 - a), lambda a: a < 1.2),
    "choice": (lambda d, a: d.choice("x", [1.0, 1.0 / jnp.maximum(a - 0.5, 0.0)]), lambda a: a > 0.5),
    "parameter": (lambda d, a: d.parameter("x", 0.9, bounds=(0.0, a)), lambda a: a >= 0.9),
    "parameter, bounds": (lambda d, a: d.parameter("x", 0.9, bounds=(a - 0.5, 0.9)), lambda a: a < 1.4),
    "several": (
        lambda d, a: d.uniform("x", a, 1.7) + d.uniform("y", 0.3, a, shape=(2,))[0],
        lambda a: (a > 0.3) & (a < 1.7),
    ),
}
ENGINES = {"ideal": None, "sampled": qj.Implementation(0.01)}


def study_of(drawn, implementation):
    """A study whose disturbance depends a little on what is drawn."""

    def scenario(draw):
        value = drawn(draw, draw.uniform("a", 0.0, 2.0))
        control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(2.0, 1.0, 0.1))
        disturbance = qj.disturbances.Constant(0.1 * jnp.tanh(value))
        loop = qj.ClosedLoop(Integrator(1.0), qj.references.Constant(0.0), disturbance, control, implementation)
        return qj.Scenario(loop, x0=[0.5], t1=0.5)

    return qj.Study(scenario, bandwidth=0.2)


def noted(drawn, point):
    """What is drawn first, and whether the run was found to be in range."""
    draw = Draw(point)
    drawn(draw, draw.uniform("a", 0.0, 2.0))
    return draw.recorded["a"], draw.is_valid


@pytest.mark.parametrize("is_traced", [False, True], ids=["replay", "batch"])
@pytest.mark.parametrize(("drawn", "is_right"), CASES.values(), ids=CASES)
def test_arguments_out_of_range_are_noted_in_the_run(drawn, is_right, is_traced):
    points = np.random.default_rng(0).uniform(size=(40, 4))
    each = jax.jit(jax.vmap(lambda point: noted(drawn, point))) if is_traced else None
    found = zip(*each(points), strict=True) if each else [noted(drawn, point) for point in points]
    for a, is_valid in found:
        assert bool(is_valid) == is_right(a), a


@pytest.mark.slow
@pytest.mark.parametrize("case", ["truncated_normal, std", "choice", "parameter, bounds", "several"])
def test_such_runs_are_inadmissible_and_only_they(case):
    """What is noted is tested above, for every case; here, that it reaches the verdicts."""
    drawn, is_right = CASES[case]
    compare(study_of(drawn, ENGINES["ideal"]), is_right)


@pytest.mark.parametrize(("width", "is_valid"), [(0.0, False), (-1e-9, False), (1e-9, True)])
def test_an_interval_must_have_a_width_in_every_run(width, is_valid):
    _, noted_valid = noted(lambda draw, a: draw.uniform("x", a, a + width), np.full(2, 0.5))
    assert bool(noted_valid) == is_valid


def test_runs_of_both_kinds_stand_side_by_side():
    compare(study_of(CASES["uniform, low"][0], ENGINES["sampled"]), CASES["uniform, low"][1])


def compare(study, is_right):
    runs = qj.monte_carlo(study, BLOCK, block=BLOCK)
    right = is_right(runs["a"])
    assert 0 < right.sum() < BLOCK
    np.testing.assert_array_equal(runs["verdict"] == qj.Verdict.INADMISSIBLE, ~right)
    for claim in ("verdict_reaching", "verdict_tracking"):
        assert np.all(runs[claim][~right] == qj.Verdict.INADMISSIBLE)
    assert np.all(runs["outcome"][~right] == qj.Outcome.BAD_PARAMETERS)
    assert np.all(runs["steps"][~right] == 0)
    assert np.all(runs["verdict"][right] == qj.Verdict.HELD)
    for index in (np.flatnonzero(right)[0], np.flatnonzero(~right)[0]):
        run = study.replay(int(index))
        assert (run.verdict, run.outcome) == (runs["verdict"][index], runs["outcome"][index])


def test_a_run_that_makes_no_loop_is_replayed_as_inadmissible_too():
    """A log-uniform number from below 0 is NaN, which no disturbance takes."""
    study = study_of(CASES["log_uniform, low"][0], ENGINES["sampled"])
    starts = 2.0 * qj.Random().points(0, range(BLOCK), study.dimension)[:, 0]
    run = study.replay(int(np.argmin(starts)))
    assert starts.min() < 0.5
    assert (run.verdict, run.outcome) == (qj.Verdict.INADMISSIBLE, qj.Outcome.BAD_PARAMETERS)


def test_other_mistakes_in_a_run_are_told():
    study = study_of(lambda d, a: qj.Funnel(a - 0.5, 1.0, 0.1)(0.0), ENGINES["ideal"])
    starts = 2.0 * qj.Random().points(0, range(BLOCK), study.dimension)[:, 0]
    with pytest.raises(ValueError, match="Argument `rho0` must be positive"):
        study.replay(int(np.argmin(starts)))


def test_the_advice_names_the_distribution():
    assert "a distribution has arguments out of range in this run" in qj.Outcome.BAD_PARAMETERS.advice


def test_fixed_arguments_cost_nothing():
    """They are compared once, before any run: a batch has nothing to compare."""
    draw = Draw(np.full(2, 0.5))
    draw.uniform("a", 0.0, 1.0)
    draw.normal("b", 0.0, 1.0)
    assert draw.is_valid is np.True_


def test_a_default_that_depends_on_draws_is_refused():
    """A batch would take the nominal one in every run, and a replay the run's own."""

    def scenario(draw):
        mu = draw.parameter("mu", draw.uniform("a", 1.0, 2.0), bounds=(0.5, 3.0))
        control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(2.0, mu, 0.1))
        loop = qj.ClosedLoop(Integrator(1.0), qj.references.Constant(0.0), qj.disturbances.Zero(), control)
        return qj.Scenario(loop, x0=[0.5], t1=0.5)

    with pytest.raises(ValueError, match="`default` of `mu` must be fixed, but depends on other names"):
        qj.Study(scenario, bandwidth=0.2)
