"""What one solve says is not believed: another way of solving decides."""

import dataclasses

import numpy as np
import pytest

import qsmc_jax as qj
from qsmc_jax.falsification import falsify as module
from qsmc_jax.falsification.confirmation import confirm
from qsmc_jax.falsification.objective import Objective
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.verification.tiers import Tiers
from studies_for_tests import study as varied

STUDY = varied.substitute(d=0.5, g=1.0)
POINTS = np.full((2, STUDY.dimension), 0.5)
FUNNEL, PEAK = Objective.of(STUDY, "funnel"), Objective.of(STUDY, "peak_u")


@pytest.fixture(scope="module")
def rows():
    return qj.monte_carlo(STUDY, 2, sampling=qj.Table(POINTS), block=64)


def doctored(rows, **columns):
    """The rows as a careless solve would have them."""
    changed = {name: np.array(column, rows[name].dtype) for name, column in columns.items()}
    return dataclasses.replace(rows, columns={**rows.columns, **changed})


def confirmed(objective, rows):
    return confirm(STUDY, objective, rows, POINTS, Tiers.of(STUDY, SolverSettings()))


def test_what_both_ways_say_is_confirmed(rows):
    found = confirmed(PEAK, rows)
    assert found.value == pytest.approx(rows["peak_u"][0], rel=1e-4)
    assert found.verdict == qj.Verdict.HELD
    assert found.unconfirmed == 0


def test_a_violation_that_only_the_first_solve_saw_is_none(rows):
    found = confirmed(FUNNEL, doctored(rows, verdict=[1, 0]))
    assert found.verdict == qj.Verdict.HELD


def test_a_metric_that_another_way_does_not_give_is_passed_over(rows):
    """Half a per cent too high: within the bound of theory, but no solve is as wrong."""
    found = confirmed(PEAK, doctored(rows, peak_u=[1.005, 1.0] * rows["peak_u"]))
    assert found.value == pytest.approx(rows["peak_u"][1], rel=1e-4)
    assert found.unconfirmed == 1


def test_of_two_solves_the_less_bad_number_is_told(rows):
    high = 1.0005 * rows["peak_u"]
    assert confirmed(PEAK, doctored(rows, peak_u=high)).value < high[0]


def test_nothing_confirmed_is_nothing_found(rows):
    assert confirmed(PEAK, doctored(rows, peak_u=1.005 * rows["peak_u"])) is None


def test_a_violation_that_nothing_confirms_is_undecided(rows):
    class Searched:
        first_violation_at, undecided = 3, 0

    held = confirmed(FUNNEL, doctored(rows, verdict=[1, 0]))
    assert module._verdict(held, Searched()) == qj.Verdict.UNDECIDED
    assert module._verdict(None, Searched()) == qj.Verdict.UNDECIDED
