"""Switches at one distance of one another, and references that jump: what changes at once, wherever it stands."""

import dataclasses
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import eventful
import qsmc_jax as qj
from eventful import Case, at_ends, verdict_of
from qsmc_jax.base.module import float_field

PEAK = 1e-3  # of z = |sigma| / rho
METHODS = pytest.mark.parametrize("method", ["tsit5", pytest.param("rodas5p", marks=pytest.mark.slow)])


@pytest.mark.slow
@pytest.mark.parametrize(("count", "most"), [(64, 64), (50, 64), (100, 1000), (1000, 1000)])
def test_evenly_spaced_switches(count, most):
    """As many of at most so many: the others never come, and two counts share a program."""
    levels = 0.9 * np.random.default_rng(count).uniform(-1.0, 1.0, count)
    times = np.arange(1, count) * (20.0 / count)
    padded = np.pad(times, (0, most - count), constant_values=np.inf), np.pad(levels, (0, most - count))
    loop = dataclasses.replace(Case().loop(), disturbance=qj.disturbances.Telegraph(*padded))
    metrics = qj.simulate(loop, [0.5], 20.0, ts=at_ends(20.0), settings=qj.SolverSettings(method="tsit5")).metrics
    peak = eventful.scipys_peak(lambda t: levels[min(np.searchsorted(times, t, side="right"), count - 1)], times)
    assert verdict_of(metrics) == "HELD"
    assert float(metrics.peak_ratio) == pytest.approx(peak, abs=PEAK)


def spaced(seed):
    """Switch times at one distance of one another, but for rounding, and levels; the times that are not used: inf."""
    rng = np.random.default_rng([seed, 5])
    count, levels = rng.integers(2, 64), rng.uniform(-0.9, 0.9, 64)
    distance = 20.0 / count if seed % 2 else rng.uniform(0.35, 4.0)
    products = rng.choice([0.0, rng.uniform()]) * distance + distance * np.arange(1, 64)
    times = [products, np.cumsum(np.full(63, distance)), np.repeat(products, 2)[:63]][seed % 3]
    if seed % 3 == 2:  # each switch is one of two, some units in the last place of the time apart
        times[1::2] *= 1.0 + 2.0**-52 * rng.integers(1, 9)
    return np.where(times < 20.0, times, np.inf), levels


@METHODS
@pytest.mark.parametrize("seed", [0, 1, 2, *(pytest.param(k, marks=pytest.mark.slow) for k in range(3, 15))])
@pytest.mark.slow
def test_evenly_spaced_switches_of_any_distance_and_phase(seed, method):
    times, levels = spaced(seed)
    loop = dataclasses.replace(Case().loop(), disturbance=qj.disturbances.Telegraph(times, levels))
    metrics = qj.simulate(loop, [0.5], 20.0, ts=at_ends(20.0), settings=qj.SolverSettings(method=method)).metrics
    # Where SciPy is started anew, two times of one switch are one.
    marks = np.array([t for k, t in enumerate(times) if k == 0 or t > times[k - 1] * (1.0 + 1e-14)])
    peak = eventful.scipys_peak(lambda t: levels[np.searchsorted(times, t, side="right")], marks)
    assert verdict_of(metrics) == "HELD"
    assert float(metrics.peak_ratio) == pytest.approx(peak, abs=PEAK)


# A reference that jumps moves sigma as far: out of the funnel, or on inside it, where the plant would be teleported.


class SetPoint(qj.AbstractReference):
    """A set point that changes at once, or at once begins to move; each piece has the derivatives it should have."""

    at: Float[Array, ""] = float_field()
    height: Float[Array, ""] = float_field()
    is_slope: Float[Array, ""] = float_field(default=0.0)
    is_declared: bool = eqx.field(static=True, default=False)

    def derivatives(self, t, order):
        moves = jnp.where(t < self.at, 0.0, self.height * self.is_slope)
        value = jnp.where(t < self.at, 0.0, self.height * (1.0 - self.is_slope)) + moves * (t - self.at)
        return (value, moves, *(0.0 * t,) * order)[: order + 1]

    @property
    def break_times(self):
        return [self.at] if self.is_declared else []


def jumped(n, at, height, is_slope=0.0, method="auto", period=None, is_declared=False, funnel=(4.0, 3.0, 0.05)):
    """Verdict of a loop whose set point jumps, and when it left; a jump of the slope is one of sigma for n > 1."""
    implementation = None if period is None else qj.Implementation(period)
    reference = SetPoint(at, height, is_slope, is_declared)
    loop = dataclasses.replace(Case(n=n, funnel=funnel).loop(implementation), reference=reference)
    settings = qj.SolverSettings(method=method)
    bandwidth = 0.5 * (funnel[0] + funnel[2])
    metrics = qj.simulate(loop, [0.1] * n, 10.0, bandwidth=bandwidth, ts=at_ends(10.0), settings=settings).metrics
    return verdict_of(metrics), float(metrics.violation_time), float(metrics.end_time)


WAYS = pytest.mark.parametrize(
    ("n", "method", "is_declared"),
    [
        (1, "tsit5", False),
        *(
            pytest.param(n, method, is_declared, marks=pytest.mark.slow)
            for n, method, is_declared in ((1, "tsit5", True), (2, "rodas5p", False))
        ),
    ],
)
TIMES = [0.0133, 5.0, 5.0132, 9.999999]


@pytest.mark.slow
@WAYS
def test_a_set_point_that_jumps_out_of_the_funnel_is_a_violation(n, method, is_declared):
    for at in TIMES[1:]:
        for height in (1.0, -0.5, 0.2):
            for is_slope in (0.0, 1.0)[:n]:
                verdict, left, _ = jumped(n, at, height, is_slope, method, None, is_declared)
                assert (verdict, left) == ("VIOLATED", pytest.approx(at, abs=1e-6)), (at, height, is_slope)


@WAYS
@pytest.mark.slow
def test_a_set_point_that_jumps_inside_the_funnel_is_never_held(n, method, is_declared):
    for at in TIMES:
        for height in (0.01, -0.5, 1.0):
            for is_slope in (0.0, 1.0)[:n]:
                width = 0.05 if abs(height) < 0.05 else 1.5 if n == 1 else 3.0
                found = jumped(n, at, height, is_slope, method, None, is_declared, (4.0, 3.0, width))
                assert found == ("UNDECIDED", pytest.approx(math.nan, nan_ok=True), pytest.approx(at, abs=1e-6))


@pytest.mark.parametrize("n", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_a_set_point_that_jumps_is_never_held_by_a_sampled_loop(n):
    for at in TIMES:
        for height in (1.0, -0.5, 0.01):
            for is_slope in (0.0, 1.0)[:n]:
                for width in (0.2, 1.5):
                    verdict, left, _ = jumped(n, at, height, is_slope, period=0.01, funnel=(4.0, 3.0, width))
                    assert verdict != "HELD", (at, height, is_slope, width)
                    assert left >= at * (1.0 - 1e-12)
