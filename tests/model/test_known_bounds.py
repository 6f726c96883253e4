"""Bounds of sums of sines that are known beforehand, whatever the amplitudes."""

import numpy as np
import pytest

import qsmc_jax as qj


def test_a_bound_that_is_known_beforehand_is_that_of_the_sum():
    sines = qj.disturbances.SumOfSines
    assert sines([1.0, -2.0], [0.5, 4.0], bound=3.5).bound == 3.5
    assert sines([1.0, -2.0], [0.5, 4.0]).bound == 3.0
    drawn = qj.disturbances.random_sines(qj.Draw(np.full(9, 0.3)), "sines", bound=0.7, terms=3)
    assert drawn.bound == 0.7
    assert np.sum(np.abs(drawn.amplitudes)) == pytest.approx(0.7, rel=1e-12)


def test_a_bound_below_the_sum_is_refused():
    with pytest.raises(
        qj.InputError, match="Argument `bound` must be at least the sum of the amplitudes, 3, but is 2.9"
    ):
        qj.disturbances.SumOfSines([1.0, -2.0], [1.0, 2.0], bound=2.9)
