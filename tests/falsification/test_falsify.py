"""The worst scenario of loops of order 1, s' = d + g u, whose worst is known in closed form."""

import dataclasses
import math
import runpy

import numpy as np
import pytest
import scipy.stats

import places
import qsmc_jax as qj
from drawing import draws_in_given_axes
from problems import STILL, STILL_BANDWIDTH, WIDTH, escape_time
from qsmc_jax.falsification.evaluation import Evaluator
from qsmc_jax.falsification.objective import metrics_of
from qsmc_jax.study.batches import BatchSolver
from studies_for_tests import Integrator

D, LONG = 2.0, 30.0
# What a metric is good to at default settings.
GOOD = 1e-4


def scenario_under(disturbance):
    """The integrator in a funnel that stands still, sigma is x; parameters say what is uncertain about it."""

    def scenario(draw):
        wrong = draw.parameter("wrong", 0.0, bounds=(0.0, 1.0)) * draw.choice("coin", [0.0, 1.0], [1.0 - 1e-6, 1e-6])
        bend, reach = (draw.parameter(*each, bounds=(0.0, 1.0)) for each in (("bend", 0.0), ("reach", 0.2)))
        gain = 1.0 + bend * (draw.uniform("p", 0.0, 1.0) - 0.3) ** 2
        control = qj.QuasiSlidingControl(qj.SlidingSurface([]), STILL, 1.0 - 2.0 * wrong)
        loop = qj.ClosedLoop(Integrator(gain), qj.references.Constant(0.0), disturbance(draw), control)
        start = draw.record("start", reach * WIDTH * draw.uniform("part", 0.5, 1.0))
        return qj.Scenario(loop, x0=[start], t1=LONG)

    return scenario


def constant(draw):
    size, spread = (draw.parameter(*each, bounds=(0.0, 9.0)) for each in (("size", D), ("spread", 0.0)))
    return qj.disturbances.Constant(size * draw.uniform("d", -1.0, 1.0) + spread * draw.normal("n", 0.0, 1.0))


def sine(draw):
    return qj.disturbances.random_sine(draw, "d", bound=D)


PLAIN = qj.Study(scenario_under(constant), bandwidth=STILL_BANDWIDTH)
SINE = qj.Study(scenario_under(sine), bandwidth=STILL_BANDWIDTH)
CALM = PLAIN.substitute(size=0.0)


@pytest.fixture(scope="module")
def found():
    return qj.falsify(PLAIN, "peak_u", budget=100)


def test_a_constant_disturbance_asks_for_as_much_input(found):
    """The input goes to -d/g, which it reaches as t grows: sup |u| = max(|u(0)|, D)."""
    assert found.value == pytest.approx(D, rel=GOOD)
    assert abs(found.values["d"]) == pytest.approx(1.0)
    assert found.value > found.random_value


def test_the_start_may_be_the_worst():
    """From sigma(0) = 0.95 rho the first input is the largest: tan(0.95 pi/2)."""
    worst = qj.falsify(PLAIN.substitute(reach=0.95), "peak_u", budget=100)
    assert worst.value == pytest.approx(math.tan(0.95 * math.pi / 2), rel=GOOD)
    assert worst.values["part"] == pytest.approx(1.0)


def test_an_adversary_replaces_the_disturbance_within_its_bound():
    """A sine of amplitude D never asks for D: the loop is a low-pass filter. A constant does."""
    worst = qj.falsify(SINE, "peak_u", budget=100, adversary=0)
    assert worst.value == pytest.approx(D, rel=GOOD)
    assert worst.values["adversary.bound"] == pytest.approx(D)
    assert abs(worst.values["adversary.level"]) == pytest.approx(1.0)
    assert {"d.amplitude", "d.frequency", "d.phase"} <= set(worst.replaced)
    assert not {"part", "adversary.level"} & set(worst.replaced)
    assert "d.phase" not in str(worst)


def test_an_adversary_that_may_switch_is_worse():
    """The input follows -d: from rest its variation is D, and 2 D more with each switch of the sign."""
    worst = qj.falsify(SINE.substitute(reach=0.0), "total_variation_u", budget=600, adversary=2)
    assert worst.value == pytest.approx(5 * D, rel=1e-3)
    assert sorted(worst.values["adversary.time"]) == worst.values["adversary.time"].tolist()


def test_a_worst_case_inside_the_box_is_found():
    """u = -d/g with g = 1 + (p - 0.3)^2 is largest at p = 0.3."""
    worst = qj.falsify(PLAIN.substitute(bend=1.0), "peak_u", budget=400)
    assert worst.value == pytest.approx(D, rel=GOOD)
    assert worst.values["p"] == pytest.approx(0.3, abs=5e-3)


def test_a_rare_wrong_sign_is_found_and_violates():
    """One run in a million leaves the funnel, at a time known in closed form."""
    worst = qj.falsify(CALM.substitute(wrong=1.0), budget=64)
    assert worst.verdict == qj.Verdict.VIOLATED
    assert worst.values["coin"] == 1.0
    assert worst.first_violation_at <= worst.simulations <= 64
    assert math.isfinite(worst.random_value)
    time = worst.replay().metrics.violation_time
    assert float(time) == pytest.approx(escape_time(0.2 * float(worst.values["part"])), rel=GOOD)
    assert str(worst).startswith("VIOLATED: a scenario within the study's uncertainty left the funnel")


@pytest.fixture(scope="module")
def limited():
    gentle = {"gentle": qj.always(lambda s: D - abs(s.u))}
    return qj.Study(PLAIN.scenario, bandwidth=STILL_BANDWIDTH, metrics="claims", requirements=gentle)


@pytest.mark.parametrize(("size", "verdict"), [(0.99 * D, "HELD"), (1.01 * D, "VIOLATED")])
def test_a_requirement_is_violated_just_where_it_is(limited, size, verdict):
    """|u| goes to |d|: a limit a little above is never reached, one a little below is."""
    worst = qj.falsify(limited.substitute(size=size), "gentle", budget=100)
    assert worst.verdict.name == verdict
    assert worst.column == "margin_gentle"
    if verdict == "HELD":
        assert worst.value == pytest.approx(D - size, abs=GOOD * D)


def test_an_adversary_leaves_a_rare_choice_alone():
    """It looks as if nothing depended on it, wherever random runs look."""
    worst = qj.falsify(SINE.substitute(wrong=1.0), budget=100, adversary=0)
    assert worst.verdict == qj.Verdict.VIOLATED
    assert "coin" not in worst.replaced


def test_what_has_no_end_is_cut_off_at_its_quantiles_and_named():
    worst = qj.falsify(CALM.substitute(spread=1.0, reach=0.0), "peak_u", budget=100, tail=0.01)
    assert worst.value == pytest.approx(scipy.stats.norm.ppf(0.99), rel=GOOD)
    assert worst.cut == ("n",)
    assert worst.outside == pytest.approx(1 - 0.99**2)
    assert "`n`" in str(worst)


def test_a_metric_without_a_derivative_is_searched_without_one():
    worst = qj.falsify(PLAIN, "largest_disturbance", budget=100)
    assert worst.value == pytest.approx(D)
    assert "no derivative" in str(worst)


def test_no_more_is_simulated_than_the_budget_and_all_of_it_is_counted(monkeypatch):
    lanes, keep = [], Evaluator._keep

    def counted(self, points, rows, counts):
        lanes.append(len(points))
        keep(self, points, rows, counts)

    monkeypatch.setattr(Evaluator, "_keep", counted)
    for budget in (1, 7, 30):
        lanes.clear()
        worst = qj.falsify(PLAIN, "peak_u", budget=budget)
        assert sum(lanes) <= worst.simulations <= budget
        assert worst.simulations == budget


def test_a_gradient_costs_a_simulation_for_each_number_and_one():
    from qsmc_jax.falsification.evaluation import Ask

    assert Ask(np.zeros((1, 5)), np.array([0, 3])).cost == 3
    assert Ask(np.zeros((4, 5))).cost == 4


def test_the_same_seed_finds_the_same(found):
    again = qj.falsify(PLAIN, "peak_u", budget=100)
    assert again.summary() == found.summary()


def test_one_program_makes_all_simulations(found, monkeypatch):
    programs, compile_block = set(), BatchSolver.compile_block

    def compiled(self, block, *more):
        programs.add(block)
        return compile_block(self, block, *more)

    monkeypatch.setattr(BatchSolver, "compile_block", compiled)
    qj.falsify(PLAIN, "peak_u", budget=100, seed=1)
    assert len([block for block in programs if type(block).__name__ == "Along"]) == 1


def test_the_replay_is_the_worst_run(found):
    run = found.replay()
    assert float(run.metrics.peak_u) == pytest.approx(found.value, rel=GOOD)
    again = PLAIN.substitute(**found.values).simulate()
    assert float(again.metrics.peak_u) == pytest.approx(found.value, rel=GOOD)


def test_the_picture_and_the_table_tell_the_search(found):
    ax = draws_in_given_axes(found.plot)
    assert "simulations" in ax.get_xlabel()
    table = found.table()
    assert np.all(np.diff(table["peak_u"]) > 0.0)
    assert table["simulations"][-1] <= found.simulations
    assert found.summary()["value"] == found.value


def test_the_finding_comes_first_and_promises_nothing(found):
    first = str(found).splitlines()[0]
    assert first == "NO VIOLATION FOUND in 100 simulations, which proves none absent; worst: peak_u = 2."


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"objective": "peek_u"}, "`objective` must name a claim, or a metric.*is `peek_u`. Did you mean `peak_u`"),
        ({"objective": "steps"}, "of which a direction is worse, but is `steps`"),
        ({"objective": "part"}, "but is `part`"),
        ({"budget": 0}, "`budget` must be at least 1, but is 0"),
        ({"seed": -1}, "`seed` must be in"),
        ({"adversary": -1}, "`adversary` must be at least 0, but is -1"),
        ({"adversary": 65}, "`adversary` must be at most 64, but is 65"),
        ({"tail": 0.5}, "`tail` must lie strictly between 0 and 1/2, but is 0.5"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        qj.falsify(PLAIN, **arguments)


def test_nothing_can_replace_no_disturbance():
    with pytest.raises(ValueError, match="`adversary` must take the place of a disturbance"):
        qj.falsify(CALM.substitute(spread=0.0, n=0.0), adversary=0)


EXAMPLES = {
    # From the steady and the first peaks under a constant disturbance at its bound; sup |u| of a simulation by hand.
    "example1_uncertain": ({}, 400, 8.02, range(10)),
    "example2_uncertain": ({"rho0": 5.0, "mu": 3.0, "rho_inf": 0.05}, 400, 35.3, range(2)),
    "example2_uncertain, box of gains": ({}, 400, 37.9, range(2)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_the_known_worst_of_the_examples_is_found_from_every_seed(name):
    fixed, budget, least, seeds = EXAMPLES[name]
    file = places.ROOT / "studies" / f"{name.partition(',')[0]}.py"
    study = runpy.run_path(str(file))["study"].substitute(**fixed)
    found = [qj.falsify(study, "peak_u", budget=budget, seed=seed, adversary=0) for seed in seeds]
    assert min(each.value for each in found) >= least
    assert all(each.verdict == qj.Verdict.HELD for each in found)
    assert float(found[0].replay().metrics.peak_u) == pytest.approx(found[0].value, rel=GOOD)


def test_only_metrics_that_a_loop_has_can_be_made_worse():
    """A sampled arm has no barrier, nor does it drift; an ideal one has both, and no reversals of a command."""
    arm = runpy.run_path(str(places.STUDIES / "two_link_arm.py"))["study"]

    def sampled(draw):
        made = arm.scenario(draw)
        return dataclasses.replace(made, loop=dataclasses.replace(made.loop, implementation=qj.Implementation(1e-3)))

    of = {"ideal": set(metrics_of(arm)), "sampled": set(metrics_of(qj.Study(sampled, bandwidth=arm.bandwidth)))}
    assert {"peak_barrier", "coordinate_drift"} == of["ideal"] - of["sampled"]
    assert {"reversal_rate", "peak_excess"} <= of["sampled"] - of["ideal"]
    assert not {"peak_barrier", "coordinate_drift", "reversal_rate"} & set(metrics_of(PLAIN))
