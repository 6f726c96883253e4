"""Estimators: their steps against matrix exponentials, and output feedback against state feedback."""

import math

import numpy as np
import pytest
import scipy.linalg

import qsmc_jax as qj
from qsmc_jax.base.precision import in_64_bits

SURFACES = {1: [], 2: [2.0], 4: [8.0, 12.0, 6.0]}


def observer(n, frequency):
    control = qj.QuasiSlidingControl(qj.SlidingSurface(SURFACES[n]), qj.Funnel(4.0, 3.0, 0.05))
    return qj.controllers.HighGainObserver(control, frequency)


def matrix_of(kind, n, omega):
    """The observer's, by its gains; the filter's, by the coefficients of (s + omega)^n."""
    matrix = np.eye(n, k=1)
    if kind is qj.controllers.HighGainObserver:
        matrix[:, 0] -= [math.comb(n, i + 1) * omega ** (i + 1) for i in range(n)]
    else:
        matrix[-1] -= np.poly([-omega] * n)[:0:-1]
    return matrix


@pytest.mark.parametrize("kind", [qj.controllers.HighGainObserver, qj.controllers.StateVariableFilter])
@pytest.mark.parametrize("n", SURFACES)
def test_steps_and_rates_are_those_of_the_matrix(n, kind):
    omega, e = 7.0, 0.4
    before = np.random.default_rng(n).normal(size=n)
    matrix, made = matrix_of(kind, n, omega), kind(observer(n, omega).law, omega)
    rest = np.eye(n)[0] * e  # where it stays for a constant output
    sample = qj.Sample(0.0, 0.0, math.nan, 4.0, (0.0,) * (n + 1), errors=(e, *(math.nan,) * (n - 1)))
    with in_64_bits():
        for period in (1e-3, 0.3):
            after = rest + scipy.linalg.expm(matrix * period) @ (before - rest)
            found = made.estimated(tuple(before), e, period)
            np.testing.assert_allclose(np.array(found, float), after, rtol=1e-11, atol=1e-12)
        rates = made.memory_rates(sample, (1.0, *before))
        np.testing.assert_allclose(np.array(rates, float), [0.0, *(matrix @ (before - rest))], rtol=1e-11, atol=1e-9)


def test_it_starts_from_the_first_sample_and_its_law_is_given_estimates():
    made = observer(2, 7.0)
    sample = qj.Sample(0.0, 0.1, math.nan, 4.05, (0.0, 0.0, 0.0), errors=(0.5, math.nan))
    with in_64_bits():
        u, memory = made.command(sample, made.first_memory())
    assert float(u) == pytest.approx(-math.tan(0.5 * math.pi * 2.0 * 0.5 / 4.05), rel=1e-12)
    assert [float(each) for each in memory] == [1.0, 0.5, 0.0]


@pytest.mark.slow
def test_output_feedback_comes_to_state_feedback_in_proportion_to_its_gain():
    example, made = qj.paper.example1(), qj.Implementation(1e-4)
    ts = np.linspace(0.0, 1.5, 16)

    def run(control):
        loop = qj.ClosedLoop(example.plant, example.reference, example.disturbance, control, made)
        return qj.simulate(loop, [0.1, 0.9], 1.5, bandwidth=0.1, ts=ts)

    truth = run(example.control).x[-8:]
    gains = (100.0, 200.0, 400.0, 800.0)
    apart = [np.max(np.abs(run(qj.controllers.HighGainObserver(example.control, w)).x[-8:] - truth)) for w in gains]
    orders = np.log2(np.array(apart[:-1]) / apart[1:])
    np.testing.assert_allclose(orders, 1.0, atol=0.25)
    assert apart[-1] < 2e-3
