"""Names that can be columns, tables that are mappings, and what objects show of themselves."""

import dataclasses

import numpy as np
import pytest

import qsmc_jax as qj
from qsmc_jax.metrics.standard import Metrics


def study_with(name):
    def scenario(draw):
        value = draw.uniform(name, 0.1, 0.9)
        return qj.Scenario(qj.paper.example1(), x0=[value, value], t1=3.0)

    return qj.Study(scenario, bandwidth=0.5)


@pytest.mark.parametrize("name", ["index", "tier", *(field.name for field in dataclasses.fields(Metrics))])
def test_a_name_that_is_a_column_is_refused(name):
    with pytest.raises(qj.InputError, match=f"must not be that of a column which every table has, but is `{name}`"):
        study_with(name)


@pytest.mark.parametrize(
    "name", ["a=b", "a,b", "m[0]", "a\nb", "a\x1b[31m", 'a"b', "a'b", "(a)", "{a}", "@a", "-a", " a"]
)
def test_a_name_that_cannot_be_given_a_value_by_text_is_refused(name):
    with pytest.raises(qj.InputError, match="Argument `name` must"):
        study_with(name)


@pytest.mark.parametrize("name", ["mass", "m_1", "Masse in kg", "k2", "größe", "a.b", "a/b", "$\\mu$"])
def test_other_names_are_columns(name):
    assert study_with(name).specs[0].columns == (name,)


def table(rows=7):
    columns = {"index": np.arange(rows), "verdict": np.zeros(rows, int), "peak_ratio": np.linspace(0.1, 0.4, rows)}
    return qj.Runs({**columns, "mass": np.arange(rows) + 0.5}, ("mass",))


def test_runs_are_a_mapping_of_columns():
    runs = table()
    assert list(runs.keys()) == list(runs) == ["index", "verdict", "peak_ratio", "mass"]
    assert dict(runs.items())["mass"] is runs["mass"]
    assert [len(column) for column in runs.values()] == [7] * 4
    assert "mass" in runs
    assert "masses" not in runs
    assert runs.get("mass") is runs["mass"]
    assert runs.get("masses", 3) == 3
    assert {**runs}.keys() == runs.keys()
    with pytest.raises(KeyError, match="There is no column `masses`. Did you mean `mass`"):
        runs["masses"]
    with pytest.raises(qj.InputError):
        runs["masses"]


def test_slices_are_rows():
    part = table()[2:6:2]
    assert part["index"].tolist() == [2, 4]
    assert part.names == ("mass",)


def test_reprs_are_short_and_hold_the_numbers():
    assert repr(table()) == "<Runs: 7 runs, 4 columns: 7 HELD; worst sup |sigma|/rho 0.4>"
    assert repr(qj.Funnel(2.0, 1.5, 0.1)) == "Funnel(rho0=2, mu=1.5, rho_inf=0.1)"
    loop = qj.paper.example1()
    assert "amplitudes=[1.]" in repr(loop)
    assert "\n" not in repr(loop)
    assert repr(study_with("mass")) == "<Study: mass; bandwidth 0.5>"
    long = qj.references.SumOfSines(np.ones(50), np.ones(50))
    assert "amplitudes=float64[50]" in repr(long)
