"""The search for a critical value: what it claims is true as often as it says, and it says no more than that.

Truth: the coin study, P(violated) = p exactly; for the coverage, coins thrown by NumPy.
"""

from collections import Counter

import numpy as np
import pytest
import scipy.stats

import qsmc_jax as qj
from coin_study import study
from drawing import draws_in_given_axes
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.robustness.critical import plan_tests, search
from studies_for_tests import Integrator

BLOCK = 128


@pytest.fixture(scope="module")
def found():
    """The largest p for which P(violated) = p is below 0.2."""
    return qj.critical_value(study, "p", 0.2, steps=4, block=BLOCK)


def test_the_bracket_is_on_the_safe_side_of_the_truth(found):
    assert found.is_found
    assert found.side == "largest"
    assert 0.0 <= found.shown < 0.2
    assert found.shown < found.not_shown


def test_the_ends_are_tested_first_and_then_the_middle(found):
    assert [test.value for test in found.tests[:3]] == [0.0, 1.0, 0.5]
    assert len(found.tests) == 6


def test_the_runs_of_a_test_are_its_own(found):
    """Test k has the runs from k times the budget on."""
    most = found.looks[-1]
    for number, test in enumerate(found.tests):
        (table,) = qj.stream(study, range(number * most, number * most + test.runs), block=BLOCK)
        assert test.violated == np.sum(table["coin"] < test.value)


def test_each_finding_is_what_its_interval_says(found):
    risk = 0.05 / (3 * 6)
    assert found.confidence_each == pytest.approx(1 - risk)
    for test in found.tests:
        expected = scipy.stats.binomtest(test.violated, test.runs).proportion_ci(1 - risk, method="exact")
        assert (test.low, test.high) == pytest.approx((expected.low, expected.high), rel=1e-7)
        assert test.finding == ("below" if test.high < 0.2 else "above" if test.low > 0.2 else "open")
        assert test.finding != "open" or test.runs == found.looks[-1]


def test_the_first_look_is_the_smallest_that_can_show_it(found):
    fewest = found.looks[0]
    risk = 0.05 / (3 * 6)
    assert 1 - (risk / 2) ** (1 / fewest) <= 0.2 < 1 - (risk / 2) ** (1 / (fewest - 1))
    assert found.looks == (fewest, 2 * fewest, 4 * fewest)


def test_the_other_side_is_found_from_the_ends():
    """With flip 1, P(violated) = 1 - p."""
    found = qj.critical_value(study.substitute(flip=1.0), "p", 0.2, steps=3, block=BLOCK)
    assert found.side == "smallest"
    assert found.not_shown < found.shown
    assert 0.8 < found.shown <= 1.0
    assert "the probability falls with `p`" in found.conclusion()


def test_what_is_claimed_and_what_is_not(found):
    words = found.conclusion()
    assert words.startswith(f"FOUND: at p = {found.shown:.6g} the probability of leaving the funnel is below 0.2")
    assert "Nothing is claimed of any value that was not tested." in words
    assert "assumes that the probability rises with `p`" in words
    assert words in str(found)


def coins(probability, seed=0):
    """A stand-in for solving: the violation probability at each value is known."""
    rng = np.random.default_rng(seed)

    def count(value, indices):
        violated = int(rng.binomial(len(indices), probability(value)))
        return Counter({Verdict.VIOLATED: violated, Verdict.HELD: len(indices) - violated})

    return count


def test_all_findings_are_right_together_as_often_as_promised():
    """1000 searches at 80 %, less three sigma; probabilities near the one asked for, where errors are made."""
    plan, searches = plan_tests(0.05, 0.8, 6, None), 1000

    def is_wrong(test):
        return (test.finding == "below") != (test.value < 0.05) and test.finding != "open"

    count = coins(lambda value: value, seed=1)
    made = [search(count, (0.03, 0.08), plan, "largest")[1] for _ in range(searches)]
    right = np.mean([not any(map(is_wrong, tests)) for tests in made])
    assert right >= 0.8 - 3 * np.sqrt(0.8 * 0.2 / searches)


def test_positive_ends_far_apart_are_bisected_in_the_logarithm():
    side, tests = search(coins(lambda value: float(value > 1e-3)), (1e-6, 1.0), plan_tests(0.1, 0.95, 12, None), None)
    shown = max(test.value for test in tests if test.finding == "below")
    assert side == "largest"
    assert tests[2].value == pytest.approx(1e-3)
    assert shown <= 1e-3 < shown * 10 ** (6 / 2**11)


def test_a_probability_at_the_border_stays_open_and_bounded_in_cost():
    plan = plan_tests(0.1, 0.95, 3, None)
    _, tests = search(coins(lambda value: 0.1 * (value > 0.0)), (0.0, 1.0), plan, "largest")
    assert [test.finding for test in tests] == ["below", "open", "open", "open", "open"]
    assert all(test.runs == plan.looks[-1] for test in tests[1:])


def test_the_tests_of_a_search_share_the_risk_over_their_looks():
    plan = plan_tests(0.05, 0.8, 6, None)
    assert plan.each == pytest.approx(1.0 - 0.2 / (8 * 3))
    assert plan.tests == 8


@pytest.mark.parametrize(("violated", "finding"), [(0, "below"), (20, "open"), (95, "above")])
def test_a_value_is_safe_by_the_upper_end_and_unsafe_by_the_lower(violated, finding):
    """Of every hundred runs so many are violated, where 20 is the border."""
    plan = plan_tests(0.2, 0.9, 0, None)

    def count(value, indices):
        bad = round(len(indices) * violated / 100)
        return Counter({Verdict.VIOLATED: bad, Verdict.HELD: len(indices) - bad})

    _, tests = search(count, (0.0, 1.0), plan, None)
    for test in tests:
        exact = scipy.stats.binomtest(test.violated, test.runs).proportion_ci(plan.each, method="exact")
        assert (test.low, test.high) == pytest.approx((exact.low, exact.high), rel=1e-7)
        assert test.finding == finding


def test_inadmissible_runs_are_left_out_of_the_interval():
    """Of the first look, which would just do, a tenth is not admissible: it does no longer."""
    plan = plan_tests(0.2, 0.9, 0, None)

    def count(value, indices):
        none = len(indices) // 10
        return Counter({Verdict.INADMISSIBLE: none, Verdict.HELD: len(indices) - none})

    _, tests = search(count, (0.0, 1.0), plan, None)
    assert [test.runs for test in tests] == [plan.looks[1]] * 2
    for test in tests:
        exact = scipy.stats.binomtest(0, test.runs - test.inadmissible).proportion_ci(plan.each, method="exact")
        assert test.high == pytest.approx(exact.high, rel=1e-7)


def test_inadmissible_runs_show_nothing():
    plan = plan_tests(0.1, 0.95, 3, None)
    _, tests = search(lambda _, indices: Counter({Verdict.INADMISSIBLE: len(indices)}), (0.0, 1.0), plan, None)
    assert [(test.finding, test.low, test.high) for test in tests] == [("open", 0.0, 1.0)] * 2


ENDINGS = {
    "neither": ({"between": (0.8, 0.9)}, False, "NOT FOUND: neither at p = 0.8 nor at p = 0.9 was it shown"),
    "both": ({"between": (0.01, 0.02)}, True, "SAFE AT BOTH ENDS: at p = 0.01 and at p = 0.02"),
    "wrong side": ({"side": "smallest"}, False, "NOT FOUND: the smallest value was asked for, but at p = 1 it was not"),
}


@pytest.mark.parametrize(("arguments", "is_found", "words"), ENDINGS.values(), ids=ENDINGS)
def test_nothing_is_bisected_unless_the_safe_end_is_safe(arguments, is_found, words):
    found = qj.critical_value(study, "p", 0.2, steps=4, block=BLOCK, **arguments)
    assert len(found.tests) == 2
    assert found.is_found == is_found
    assert found.shown is None
    assert found.not_shown is None
    assert found.conclusion().startswith(words)
    found.plot()


def test_both_ends_safe_with_a_side_gives_the_far_end():
    found = qj.critical_value(study, "p", 0.2, between=(0.01, 0.02), side="largest", steps=4, block=BLOCK)
    assert (found.shown, found.not_shown) == (0.02, None)


def test_the_picture_has_every_test(found):
    ax = draws_in_given_axes(found.plot)
    assert sum(len(container.lines[0].get_xdata()) for container in ax.containers) == len(found.tests)


def test_the_summary_holds_every_test(found):
    summary = found.summary()
    assert len(summary["tests"]) == len(found.table()["value"]) == len(found.tests)
    assert summary["runs"] == sum(test["runs"] for test in summary["tests"])


def test_progress_counts_every_run_that_may_be_needed():
    told = []
    found = qj.critical_value(study, "p", 0.2, steps=1, block=BLOCK, progress=lambda *at: told.append(at))
    assert {total for _, total in told} == {3 * found.looks[-1]}
    assert sorted(told) == told


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "pp"}, "There is no name `pp`.*Did you mean `p`"),
        ({"below": 0.0}, "`below` must lie strictly between 0 and 1, but is 0.0"),
        ({"below": 1.0}, "`below` must lie strictly between 0 and 1, but is 1.0"),
        ({"confidence": 0.0}, "`confidence` must lie strictly between 0 and 1"),
        ({"steps": -1}, "`steps` must be at least 0, but is -1"),
        ({"between": (0.5, 0.5)}, "`between` must be two numbers in increasing order"),
        ({"between": (-1.0, 0.5)}, "`p` must lie in .0, 1., but is -1"),
        ({"between": (0.5, 2.0)}, "`p` must lie in .0, 1., but is 2"),
        ({"between": (0.0, np.inf)}, "`between` must be given for `p`.*two finite numbers"),
        ({"budget_per_test": 10}, "`budget_per_test` must be at least 34, the fewest runs"),
        ({"block": 100}, "`block` must be a positive multiple of 64"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        qj.critical_value(study, **{"name": "p", "below": 0.2, **arguments})


def other(draw):
    """An integrator with names that cannot be bisected, or only between given ends."""
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, 1.0, 0.1))
    plant = Integrator(draw.choice("gain", [1.0, 2.0]) + draw.exponential("more", 1.0))
    loop = qj.ClosedLoop(plant, qj.references.Constant(0.0), qj.disturbances.Zero(), control)
    return qj.Scenario(loop, x0=draw.uniform("x0", 0.0, 0.5, shape=(1,)), t1=1.0)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("gain", "`gain` has only a few: map them instead"),
        ("more", "`between` must be given for `more`, whose bounds in the study are .0, inf."),
        ("x0", "`x0` must have shape"),
    ],
)
def test_names_that_cannot_be_bisected_are_refused(name, message):
    with pytest.raises(ValueError, match=message):
        qj.critical_value(qj.Study(other, bandwidth=0.2), name, 0.2)
