"""What Jupyter shows of results, and tables for pandas and xarray: the same numbers."""

import base64
import re
import sys

import numpy as np
import pytest

import qsmc_jax as qj
from qsmc_jax.display.notebook import as_html
from qsmc_jax.display.result import AbstractResult
from studies_for_tests import study


@pytest.fixture(scope="module")
def found():
    tables = []
    result = qj.verify(study, 64, block=64, threads=1, sink=tables.append)
    return result, tables[0]


@pytest.fixture(scope="module")
def run():
    return study.simulate(ts=np.linspace(0.0, 6.0, 301))


def picture_in(text):
    """The bytes of the one picture."""
    (content,) = re.findall(r'src="data:image/png;base64,([^"]+)"', text)
    return base64.b64decode(content)


@pytest.mark.slow
def test_a_result_shows_its_text_and_a_picture(found, run):
    for each in (found[0], run):
        shown = each._repr_html_()
        assert str(each).splitlines()[0].replace("<", "&lt;") in shown
        assert picture_in(shown).startswith(b"\x89PNG")


def test_a_table_shows_its_first_rows_with_verdicts_by_name(found):
    shown = found[1]._repr_html_()
    assert f"{found[1].row(0)['margin']:.5g}" in shown
    assert "HELD" in shown.splitlines()[2]
    assert shown.count("\n") < 10


def test_text_can_carry_no_markup():
    assert "<b>" not in as_html("<b>&")


def test_frames_have_the_same_numbers(found, run):
    pytest.importorskip("pandas")
    frame = found[1].to_pandas()
    np.testing.assert_array_equal(frame["margin"], found[1]["margin"])
    assert frame.index.name == "index"
    signals = run.to_pandas()
    np.testing.assert_array_equal(signals["e[0]"], run.e[:, 0])
    np.testing.assert_array_equal(signals.index, run.ts)


def test_datasets_have_the_same_numbers(found, run):
    pytest.importorskip("xarray")
    runs = found[1].to_xarray()
    np.testing.assert_array_equal(runs["peak_u"].sel(run=5), found[1]["peak_u"][found[1]["index"] == 5][0])
    signals = run.to_xarray()
    np.testing.assert_array_equal(signals["x"].isel(derivative=0), run.x[:, 0])
    assert signals["t"].attrs["units"] == "s"


def test_without_pandas_it_says_what_to_install(found, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"pip install 'qsmc_jax\[notebook\]'"):
        found[1].to_pandas()


RESULTS = [qj.Verification, qj.Tuning, qj.Landscape, qj.RobustnessMap, qj.CriticalValue, qj.Comparison]
RESULTS += [qj.Falsification, qj.Band, qj.Proof, qj.Card]


@pytest.mark.parametrize("kind", RESULTS)
def test_every_result_has_the_same_methods(kind):
    """Nothing abstract is left, and what dataclasses write themselves does not hide what results share."""
    assert not kind.__abstractmethods__
    assert kind.__repr__ is AbstractResult.__repr__
    assert kind.to_pandas is AbstractResult.to_pandas


def test_claims_and_cells_are_tables():
    pytest.importorskip("pandas")
    short = study.substitute(t1=1.0)
    claims = qj.verify(short, 64, block=64).to_pandas()
    assert claims.index.tolist() == ["funnel", "reaching", "tracking"]
    assert (claims["held"] + claims["violated"] + claims["undecided"] + claims["inadmissible"] == 64).all()
    cells = qj.landscape(short, ["mu", "t1"], "mean(peak_u)", points=2, runs=64, block=64)
    table = cells.to_pandas()
    assert table.index.name == "mu"
    assert table["mean(peak_u)"].tolist() == cells.values[0].ravel().tolist()
    assert cells.summary()["t1"] == table["t1"].tolist()
    data = cells.to_xarray()
    assert data["mean(peak_u)"].dims == ("row",)
    assert data["t1"].values.tolist() == table["t1"].tolist()


def test_medians_of_a_map_have_units_of_their_metrics():
    pytest.importorskip("xarray")
    way = qj.Study(
        study.scenario, bandwidth=0.2, metrics=["claims", qj.metrics.Final("way", lambda s: s.x[0], unit="m")]
    )
    found = qj.robustness_map(way, over={"t1": [0.5, 1.0]}, runs=64, block=64).to_xarray()
    assert found["median.way"].attrs["units"] == "m"
    assert found["median.way"].dims == ("t1",)
    assert "units" not in found["funnel.violated"].attrs
