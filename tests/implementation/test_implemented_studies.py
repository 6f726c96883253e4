"""What the studies of implemented loops claim: where each effect breaks the funnel, and who chatters."""

import functools as ft
import runpy

import numpy as np
import pytest

import places
import qsmc_jax as qj
from qsmc_jax.robustness.limits import limits

STUDIES = places.STUDIES

# For each effect: a value that all of 64 runs bear, one that most do not, and by what factor either may lie off the
# limit of the loop linearised along its nominal run. Noise comes to bear where sigma is near the edge; a lag at the
# start, where swings are large, the funnel is wide and the loop slow.
EXPECTED = {
    "example1_implemented": {
        "sample_period": (0.031, 0.09, 2.0),
        "saturation": (3.75, 0.6, 3.0),
        "noise": (0.028, 0.06, 2.0),
        "delay": (0.017, 0.06, 3.0),
        "lag": (0.13, 0.3, 4.0),
    },
    "example2_implemented": {
        "sample_period": (0.0037, 0.02, 3.0),
        "saturation": (32.0, 8.0, 3.0),
        "noise": (0.0046, 0.035, 11.0),
        "delay": (0.0024, 0.008, 3.0),
        "lag": (0.0053, 0.02, 23.0),
    },
}
CASES = [
    pytest.param(
        study, effect, id=f"{study}-{effect}", marks=[pytest.mark.slow] if study.startswith("example2") else []
    )
    for study, effects in EXPECTED.items()
    for effect in effects
]


@ft.cache
def loaded(name):
    return runpy.run_path(str(STUDIES / f"{name}.py"))


@pytest.mark.parametrize(("name", "effect"), CASES)
@pytest.mark.slow
def test_an_effect_breaks_the_funnel_where_the_study_says(name, effect):
    study = loaded(name)["study"]
    borne, broken, _ = EXPECTED[name][effect]
    for value, is_borne in ((borne, True), (broken, False)):
        runs = qj.monte_carlo(study.substitute(**{effect: value}), 64, block=64)
        violated = np.mean(runs["verdict"] == qj.Verdict.VIOLATED)
        assert not np.any(runs["verdict"] == qj.Verdict.UNDECIDED)
        assert violated == 0.0 if is_borne else violated > 0.5


@pytest.mark.parametrize(("name", "effect"), CASES)
@pytest.mark.slow
def test_it_does_so_about_where_theory_says(name, effect):
    borne, broken, factor = EXPECTED[name][effect]
    found = limits(loaded(name)["study"], {effect: np.sort([borne, broken])})
    limit = next(line.value for line in found.thresholds if line.kind == "local")
    assert limit / factor < borne < limit * factor
    assert limit / factor < broken < limit * factor


@pytest.fixture(scope="module")
def compared():
    studies = loaded("controllers_compared")["studies"]
    return qj.compare(studies, 64, block=64, metrics=("peak_ratio", "peak_u", "excess_variation_u"))


@pytest.mark.slow
def test_the_compared_controllers_are_judged_by_the_same_funnel_and_keep_it(compared):
    assert [study.violated + study.undecided for study in compared.studies] == [0] * 8


@pytest.mark.slow
def test_the_sign_law_chatters_a_million_times_as_much(compared):
    """It flips by 2 K at nearly every sample of 8.5 s: K = 14.1, every millisecond. The law's own is below 0.1."""
    ratio = compared["sign law"].ratios["excess_variation_u"]
    assert 1e6 < ratio.low < ratio.high < 1e8
    flips = 2.0 * 14.1 * 8.5 / 1e-3
    assert compared["sign law"].medians["excess_variation_u"].median == pytest.approx(flips, rel=0.1)
    assert abs(compared["quasi-sliding mode"].medians["excess_variation_u"].median) < 0.1


@pytest.mark.slow
def test_super_twisting_is_between_and_more_accurate(compared):
    sliding, twisting = compared["quasi-sliding mode"], compared["super-twisting"]
    assert 10.0 < twisting.medians["excess_variation_u"].median < 1e3
    assert twisting.medians["peak_ratio"].high < sliding.medians["peak_ratio"].low


@pytest.mark.slow
def test_the_laws_with_a_pole_ask_for_the_same_input(compared):
    for name in ("prescribed performance", "funnel control"):
        ratio = compared[name].ratios["peak_u"]
        assert 0.9 < ratio.low < ratio.high < 1.1
