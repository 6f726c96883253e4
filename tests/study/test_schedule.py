"""Runs solved in the order of their expected cost: what is learned, what it saves, and that no row depends on it."""

import numpy as np
import pytest
from scipy.integrate import quad

import problems
import qsmc_jax as qj
from qsmc_jax.simulation.stiffness import EXPLICIT_UP_TO, method_for, stiffness, with_method
from qsmc_jax.study.schedule import Schedule, Workload
from qsmc_jax.study.windows import FIRST_WINDOW, reassembled
from studies_for_tests import Integrator

RHO_INF = (0.003, 0.2)


def funnels(draw):
    """An integrator whose funnels end anywhere between wide and 67 times narrower: some of the runs are stiff."""
    rho_inf = draw.log_uniform("rho_inf", *RHO_INF)
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, 1.0, rho_inf))
    loop = qj.ClosedLoop(Integrator(1.0), qj.references.Constant(0.0), qj.disturbances.Sine(0.5, 1.0), control)
    return qj.Scenario(loop, x0=[draw.uniform("x0", -0.5, 0.5)], t1=20.0)


STUDY = qj.Study(funnels, bandwidth=0.25)


def solve(runs=512, **options):
    workload = Workload()
    tables = list(qj.stream(STUDY, range(runs), seed=5, block=64, workload=workload, **options))
    columns = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    return columns, workload


def test_order_is_that_of_the_steps_learned():
    random = np.random.default_rng(0)
    points = random.uniform(size=(300, 3))
    steps = np.round(1000 * np.exp(2 * points[:, 1] - points[:, 2] ** 2)).astype(int)
    schedule = Schedule(3)
    schedule.learn(points[:200], steps[:200])
    ranks = np.argsort(np.argsort(steps[200:][schedule.order(points[200:], np.zeros(100))]))
    assert np.max(np.abs(ranks - np.arange(100))) <= 2  # exactly linear in the features, up to rounding of the steps


def test_order_is_that_of_the_hint_while_nothing_is_known():
    np.testing.assert_array_equal(Schedule(2).order(np.zeros((4, 2)), np.array([2.0, 1.0, 1.0, 0.0])), [3, 1, 2, 0])


def test_runs_that_took_no_step_teach_nothing():
    schedule = Schedule(1)
    schedule.learn(np.array([[0.1], [0.2]]), np.array([0, 0]))
    np.testing.assert_array_equal(schedule.order(np.array([[0.9], [0.1]]), np.zeros(2)), [0, 1])


def test_occupancy_is_the_part_of_the_work_that_was_needed():
    workload = Workload()
    assert workload.occupancy == 1.0
    workload.add(np.array([10, 30]), lanes=4)
    assert workload.occupancy == pytest.approx(40 / 120)


@pytest.mark.slow
def test_rows_do_not_depend_on_the_order_in_which_they_are_solved(monkeypatch):
    sorted_rows, _ = solve()
    monkeypatch.setattr(Schedule, "order", lambda self, points, hint: np.arange(len(points)))
    for name, column in solve()[0].items():
        np.testing.assert_array_equal(column, sorted_rows[name], err_msg=name)


@pytest.mark.slow
def test_sorting_lets_lanes_wait_less(monkeypatch):
    _, by_cost = solve(runs=2048, settings=qj.SolverSettings(method="tsit5"))
    monkeypatch.setattr(Schedule, "order", lambda self, points, hint: np.arange(len(points)))
    _, as_drawn = solve(runs=2048, settings=qj.SolverSettings(method="tsit5"))
    assert by_cost.steps == as_drawn.steps
    assert by_cost.occupancy > 1.3 * as_drawn.occupancy


def test_rows_solved_in_any_order_come_back_in_their_own():
    order = np.random.default_rng(1).permutation(100)
    solved = [(rows, qj.Runs({"index": 7 + rows, "cost": rows / 3.0}, ())) for rows in np.split(order, [30, 31, 80])]
    runs = reassembled(solved)
    np.testing.assert_array_equal(runs["index"], np.arange(7, 107))
    np.testing.assert_array_equal(runs["cost"], np.arange(100) / 3.0)


@pytest.mark.slow
def test_windows_come_in_order_and_whole():
    tables = list(qj.stream(STUDY, range(64 * FIRST_WINDOW + 70), seed=5, block=64))
    assert [len(table) for table in tables] == [64 * FIRST_WINDOW, 70]
    np.testing.assert_array_equal(
        np.concatenate([table["index"] for table in tables]), np.arange(sum(map(len, tables)))
    )


def test_stiffness_is_the_integral_of_the_decay_rate_along_the_reference():
    mass, length, gravity, friction = 0.01, 9.8, 9.8, 0.01
    gain = 1.0 / (mass * length**2)

    def decay_rate(t):
        x1, x2, d = np.sin(t), np.cos(t), 0.5 * np.sin(t)
        w = -gravity / length * np.sin(x1) - friction / mass * x2 + np.sin(x2) + np.sin(t) + d
        rho = 4.0 * np.exp(-3.0 * t) + 0.05
        u = (abs(w) + 12.0 * np.exp(-3.0 * t)) / gain
        return gain * np.pi / (2.0 * rho) * (1.0 + u**2)

    exact = quad(decay_rate, 0.0, 20.0, limit=500)[0]
    assert float(stiffness(qj.paper.example1(), [0.1, 0.1], 20.0)) == pytest.approx(exact, rel=0.05)


def expected_decays(rho_inf):
    """The same of a run of the study: an integrator under d = 0.5 sin t."""
    ts = np.linspace(0.0, 20.0, 20_001)
    rho = np.exp(-ts) + rho_inf
    u = 0.5 * np.abs(np.sin(ts)) + np.exp(-ts)
    return np.trapezoid(np.pi / (2.0 * rho) * (1.0 + u**2), ts)


@pytest.mark.slow
def test_auto_takes_the_implicit_method_for_the_stiffest_runs_only():
    steps = {method: solve(settings=qj.SolverSettings(method=method))[0] for method in ("auto", "tsit5", "rodas5p")}
    assert STUDY.stiffness < EXPLICIT_UP_TO  # so that a run must be thrice as stiff to be worth a second program
    decays = np.array([expected_decays(rho_inf) for rho_inf in steps["auto"]["rho_inf"]])
    is_stiff, is_clear = decays > 3 * EXPLICIT_UP_TO, np.abs(decays / (3 * EXPLICIT_UP_TO) - 1.0) > 0.05
    assert 0 < is_stiff.sum() < len(is_stiff)
    for method, rows in (("rodas5p", is_stiff), ("tsit5", ~is_stiff)):
        for name, column in steps["auto"].items():
            np.testing.assert_array_equal(column[rows & is_clear], steps[method][name][rows & is_clear], err_msg=name)


@pytest.mark.slow
def test_both_methods_agree_on_the_peak():
    tsit5, rodas5p = (solve(settings=qj.SolverSettings(method=method))[0] for method in ("tsit5", "rodas5p"))
    np.testing.assert_allclose(rodas5p["peak_ratio"], tsit5["peak_ratio"], atol=10e-6)
    np.testing.assert_array_equal(rodas5p["verdict"], tsit5["verdict"])


@pytest.mark.slow
def test_a_replayed_run_is_solved_by_the_method_of_its_row():
    rows, _ = solve(runs=64)
    for index in (np.argmin(rows["rho_inf"]), np.argmax(rows["rho_inf"])):
        run = STUDY.replay(int(index), seed=5)
        # Another program: it rounds differently, and may take a step more or less.
        assert abs(int(run.metrics.steps) - int(rows["steps"][index])) <= 0.02 * rows["steps"][index]


def test_stiff_studies_need_one_method():
    stiff = STUDY.substitute(rho_inf=0.01)
    assert stiff.stiffness > EXPLICIT_UP_TO
    assert {method_for(each, stiff.stiffness) for each in (1.0, 1e9)} == {"rodas5p"}


def test_a_method_that_was_asked_for_is_kept():
    settings = qj.SolverSettings(method="rodas4")
    assert with_method(settings, problems.example1(), [0.1, 0.1], 20.0) == settings
