"""The settling time against the envelope, which is computed by another program and, here, by SciPy's quadrature."""

import dataclasses
import itertools as it

import jax
import numpy as np
import pytest
from scipy.integrate import quad

import problems
from qsmc_jax.control.error_bounds import error_envelope, peak_gains, pole_bound
from qsmc_jax.control.funnel import Funnel
from qsmc_jax.control.settling import settling_time
from qsmc_jax.control.surface import SlidingSurface

TRACED = jax.jit(settling_time)


@dataclasses.dataclass(frozen=True)
class Case:
    c: np.ndarray
    e0: np.ndarray
    funnel: Funnel
    bandwidth: float

    @property
    def bounds(self):
        return self.bandwidth * np.asarray(peak_gains(self.c))

    def settling_time(self):
        return settling_time(self.c, self.funnel, self.bandwidth, tuple(self.bounds), tuple(self.e0))

    def is_outside(self, ts):
        funnel = (float(v) for v in (self.funnel.rho0, self.funnel.mu, self.funnel.rho_inf))
        envelope = error_envelope(self.c, ts, self.e0, *funnel)
        return np.any(envelope >= self.bounds * (1.0 + 1e-9), axis=1)

    def truth(self, guess):
        """The last time outside, or t_r, by looking more and more closely; up to 1.5 times a first guess."""
        start = float(self.funnel.reaching_time(self.bandwidth))
        left, right = start, 1.5 * max(guess, start)
        for _ in range(4):
            ts = np.linspace(left, right, 201)
            outside = np.flatnonzero(self.is_outside(ts))
            if len(outside) == 0:
                return start
            assert outside[-1] < len(ts) - 1
            left, right = ts[outside[-1]], ts[outside[-1] + 1]
        return right


def drawn(n, seed):
    """Surfaces with |Im| <= 3 |Re|, funnels that are up to thirty times as fast or slow, starts inside the funnel."""
    rng = np.random.default_rng([n, seed])
    pace, roots = 10 ** rng.uniform(-1, 1.5), []
    while len(roots) < n - 1:
        pole = -pace * 10 ** rng.uniform(-0.7, 0.7)
        is_pair = n - 1 - len(roots) > 1 and rng.random() < 0.6
        q = rng.uniform(0, 3)
        roots += [pole * (1 + 1j * q), pole * (1 - 1j * q)] if is_pair else [pole]
    c = np.poly(np.array(roots)).real[:0:-1].copy() if roots else np.zeros(0)
    rho0, rho_inf = 10 ** rng.uniform(-1, 1), 10 ** rng.uniform(-3, -1.5)
    funnel = Funnel(rho0, pace * 10 ** rng.uniform(-1.5, 1.5), rho_inf)
    e0 = rng.normal(size=n) * pace ** (np.arange(n) - n + 1.0) * 10 ** rng.uniform(-2, 2)
    e0[-1] = rng.uniform(-1, 1) * (rho0 + rho_inf) - c @ e0[:-1]
    return Case(c, e0, funnel, rho_inf + (rho0 - rho_inf) * 10 ** rng.uniform(-2.5, -0.2))


# In the last two cases the last error, on which the sliding variable acts at once, is the last to settle.
@pytest.mark.parametrize(("n", "seed"), [*it.product([1, 2, 3, 4, 5], range(4)), (4, 35), (5, 28)])
def test_it_is_the_last_time_at_which_the_envelope_is_outside(n, seed):
    case = drawn(n, seed)
    found = float(case.settling_time())
    truth = case.truth(found)
    late = 1e-6 * found if n < 3 else 0.2 * truth + 0.1 / pole_bound(case.c)
    assert truth * (1.0 - 1e-9) <= found <= truth + late


@pytest.mark.parametrize("n", [3, 5])
def test_traced_it_is_no_earlier_and_as_good(n):
    for seed in range(3):
        case = drawn(n, seed)
        found = float(TRACED(case.c, case.funnel, case.bandwidth, tuple(case.bounds), tuple(case.e0)))
        truth = case.truth(found)
        assert truth * (1.0 - 1e-9) <= found <= 1.2 * truth + 0.1 / pole_bound(case.c)


@pytest.mark.parametrize("problem", [problems.PAPER[0], problems.PAPER[4]], ids=str)
def test_the_papers_examples_settle_in_time(problem):
    control = problem.loop.control
    e0 = np.array([float(e) for e in problem.loop.errors(0.0, problem.x0)])
    case = Case(np.asarray(control.surface.c), e0, control.funnel, problem.bandwidth)
    found = float(case.settling_time())
    assert case.truth(found) * (1.0 - 1e-9) <= found < 0.5 * problem.t1


def test_it_solves_the_envelope_of_scipys_quadrature():
    # Both poles at -1: h_0 = t exp(-t), which is positive; the error itself is the last to settle from this start.
    case = Case(np.array([1.0, 2.0]), np.array([3.0, 0.0, -3.0]), Funnel(2.0, 1.5, 0.1), 0.2)

    def beyond(t):
        forced, _ = quad(lambda s: s * np.exp(-s) * (2.0 * np.exp(-1.5 * (t - s)) + 0.1), 0.0, t)
        return 3.0 * (1.0 + t) * np.exp(-t) + forced - 0.2

    found = float(case.settling_time())
    assert beyond(found) < 0.0 < beyond(0.97 * found)


@pytest.mark.parametrize(("c", "mu"), [(3.0, 3.0), (3.0, 3.0 * (1 + 1e-12)), (3.0, 3.0 * (1 - 1e-7))])
def test_rates_that_agree_are_no_special_case(c, mu):
    case = Case(np.array([c]), np.array([5.0, -15.0]), Funnel(4.0, mu, 0.05), 0.1)
    found = float(case.settling_time())
    ts = found * np.array([1.0 - 2e-6, 1.0])
    assert case.is_outside(ts).tolist() == [True, False]


@pytest.mark.parametrize("ratio", [20.0, 1000.0])
def test_a_surface_that_hardly_damps_is_given_longer_but_not_for_ever(ratio):
    c = np.poly([-1 + ratio * 1j, -1 - ratio * 1j]).real[:0:-1].copy()
    case = Case(c, np.array([1.0, 0.0, -c[0]]), Funnel(2.0 * c[0], 3.0, 0.1), 0.2)
    found = float(case.settling_time())
    decayed = np.log(10.0 * c[0])  # |e| decays as exp(-t) from 1, to some 0.1 / c_0
    assert decayed < found < 2.0 * decayed
    assert not np.any(case.is_outside(np.linspace(found, 1.2 * found, 2000)))


def test_without_a_settled_end_it_is_infinite():
    slow = Case(np.array([1.0, 2.0]), np.zeros(3), Funnel(2.0, 1e-8, 0.1), 0.2)
    assert np.isinf(slow.settling_time())
    too_narrow = dataclasses.replace(slow, bandwidth=0.1)
    assert np.isinf(too_narrow.settling_time())
    bounds, e0 = tuple(slow.bounds), tuple(slow.e0)
    unstable = TRACED(np.array([-1.0, 2.0]), slow.funnel, slow.bandwidth, bounds, e0)
    assert np.isinf(unstable)


def test_a_start_on_the_surface_settles_as_the_funnel_does():
    case = Case(np.array([2.0]), np.zeros(2), Funnel(4.0, 0.01, 0.05), 0.1)
    reached = float(case.funnel.reaching_time(0.1))
    # e' = -2 e + rho, the start forgotten: 2 e = 4 exp(-0.01 t) / (1 - 0.01 / 2) + 0.05.
    behind = -np.log(1.0 - 0.01 / 2.0) / 0.01
    assert float(case.settling_time()) - reached == pytest.approx(behind, rel=1e-5)


def test_it_scales_with_the_units_of_time():
    times = []
    for pace in (1e-3, 1.0, 1e4):
        c = SlidingSurface.binomial(pace, 4).c
        e0 = 5.0 * pace ** (np.arange(4.0) - 3.0)
        e0[-1] = -float(np.asarray(c) @ e0[:-1])
        times.append(pace * float(Case(np.asarray(c), e0, Funnel(2.0, 1.5 * pace, 0.1), 0.2).settling_time()))
    np.testing.assert_allclose(times, times[0], rtol=1e-9)
