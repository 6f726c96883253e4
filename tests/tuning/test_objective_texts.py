"""Objectives and constraints as texts: what is read, what it means, and what is refused."""

import pytest

from qsmc_jax.tuning.objectives import (
    Constraint,
    cvar,
    least,
    mean,
    parse_constraint,
    parse_objective,
    violation,
    worst,
)

OBJECTIVES = {
    "mean(energy_u)": mean("energy_u"),
    "cvar(peak_error[0], 0.9)": cvar("peak_error[0]", 0.9),
    "cvar(peak_error[12], 0)": cvar("peak_error[12]", 0.0),
    "worst(peak_u) + least(margin)": worst("peak_u") + least("margin"),
    "cvar(peak_error[0], 0.9) + 0.01 * mean(energy_u)": cvar("peak_error[0]", 0.9) + 0.01 * mean("energy_u"),
    "mean(peak_u) - 2 * least(margin)": mean("peak_u") - 2.0 * least("margin"),
    "-0.5 * worst(peak_rate_u) + 1e-06 * mean(rms_error)": -0.5 * worst("peak_rate_u") + 1e-6 * mean("rms_error"),
}


@pytest.mark.parametrize("text", OBJECTIVES)
def test_an_objective_reads_as_it_prints(text):
    assert str(OBJECTIVES[text]) == text
    assert parse_objective(text) == OBJECTIVES[text]


@pytest.mark.parametrize("bound", ["<= 20", ">= -0.25", "<= 0", ">= 1e-06"])
@pytest.mark.parametrize("text", OBJECTIVES)
def test_a_constraint_reads_as_it_prints(text, bound):
    made = parse_constraint(f"{text} {bound}")
    number = float(bound.split()[1])
    assert made == Constraint(OBJECTIVES[text], number, 1 if bound.startswith("<=") else -1)
    assert str(made) == f"{text} {bound}"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("  mean(peak_u)\n", mean("peak_u")),
        ("mean('peak_u')", mean("peak_u")),
        ('cvar("peak_error[0]")', cvar("peak_error[0]", 0.9)),
        ("mean(peak_u) * 2 * 3", 6.0 * mean("peak_u")),
        ("2 * (mean(peak_u) - 3 * worst(margin))", 2.0 * mean("peak_u") + (-6.0) * worst("margin")),
        ("-mean(peak_u)", -1.0 * mean("peak_u")),
    ],
)
def test_an_objective_may_be_written_in_other_ways(text, expected):
    assert parse_objective(text) == expected


def test_violation_reads_as_a_probability():
    assert parse_constraint("violation <= 0.01") == (cvar("peak_ratio", 0.99) <= 1.0)
    assert parse_constraint(str(violation(0.01))) == violation(0.01)


def test_a_bound_may_stand_on_the_left():
    assert parse_constraint("20 >= worst(peak_u)") == (worst("peak_u") <= 20.0)
    assert parse_constraint("0.1 <= least(margin)") == (least("margin") >= 0.1)


def test_what_is_made_already_passes_through():
    objective = mean("peak_u")
    assert parse_objective(objective) is objective
    constraint = objective <= 1.0
    assert parse_constraint(constraint) is constraint


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os')",
        "__import__('os').system('true')",
        "mean.__class__",
        "mean(m) if 1 else 2",
        "[mean(peak_u)]",
        "mean",
        "peak_u",
        "median(peak_u)",
        "mean()",
        "mean(peak_u, 0.5)",
        "mean(metric=peak_u)",
        "cvar(peak_u, level)",
        "cvar(peak_u, level=0.5)",
        "mean(peak_u) + 1",
        "1 + mean(peak_u)",
        "mean(peak_u) / 2",
        "mean(peak_u) * mean(energy_u)",
        "mean(peak_u) < 2",
        "mean(peak_u) == 2",
        "mean(peak_u) <= mean(energy_u)",
        "1 <= mean(peak_u) <= 2",
        "(mean(peak_u) <= 2) + mean(peak_u)",
        "violation",
        "violation >= 0.01",
        "mean(peak_u",
        "mean(peak_u); mean(peak_u)",
        "'mean(peak_u)'",
        "",
    ],
)
def test_malformed_texts_are_refused(text):
    with pytest.raises(ValueError, match=r"Argument `objective` must be made of mean\(m\)"):
        parse_objective(text)
    with pytest.raises(ValueError, match=r"Argument `subject_to` must be made of mean\(m\)"):
        parse_constraint(text)


@pytest.mark.parametrize("text", ["3", "-3", "2 * 3", "mean(energy_u) <= 2", "violation <= 0.01", "1 <= 2"])
def test_an_objective_is_a_sum_of_statistics(text):
    with pytest.raises(ValueError, match="Argument `objective` must be a sum of statistics, but is"):
        parse_objective(text)


@pytest.mark.parametrize("text", ["3", "mean(energy_u)", "cvar(peak_u, 0.9) + worst(peak_u)", "1 <= 2"])
def test_a_constraint_is_a_comparison(text):
    with pytest.raises(ValueError, match="Argument `subject_to` must be a comparison with a number, not"):
        parse_constraint(text)


@pytest.mark.parametrize("text", ["mean(settle_time)", "worst(verdict)", "mean(peak_error)", "mean(mean(peak_u))"])
def test_columns_without_a_derivative_are_refused(text):
    with pytest.raises(ValueError, match=r"`metric` must be peak_error\[i\] or one of peak_ratio, .*, but is "):
        parse_objective(text)


@pytest.mark.parametrize("level", ["1.5", "1", "-0.1"])
def test_a_level_outside_the_unit_interval_is_refused(level):
    with pytest.raises(ValueError, match=rf"`level` must lie in \[0, 1\), but is {float(level)}"):
        parse_objective(f"cvar(peak_u, {level})")
