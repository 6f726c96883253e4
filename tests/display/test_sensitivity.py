"""Rank correlations of a report against SciPy's."""

import numpy as np
import pytest
import scipy.stats

from qsmc_jax.report.sensitivity import Sensitivity
from qsmc_jax.study.runs import Runs


@pytest.mark.parametrize("digits", [8, 1], ids=["all different", "many equal"])
def test_correlations_are_those_of_scipy_strongest_first(digits):
    random = np.random.default_rng(4)
    a, b, c = np.round(random.normal(size=(3, 500)), digits)
    margin = np.round(2.0 * a - b**3 + 0.1 * c, digits)
    margin[7] = np.nan  # a run that has none
    columns = {"index": np.arange(500), "a": a, "b": b, "c": c, "one": np.ones(500), "margin": margin}
    found = Sensitivity.of([Runs(columns, ("a", "b", "c", "one"))])
    known = np.isfinite(margin)
    for name, value in zip(found.names, found.correlation, strict=True):
        assert value == pytest.approx(scipy.stats.spearmanr(columns[name][known], margin[known]).statistic, abs=1e-12)
    assert found.names == ("a", "b", "c")
