"""Manufactured runs: sigma / rho = Z sin(w t) is chosen, and the disturbance that makes it so follows."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import problems
import qsmc_jax as qj
from qsmc_jax.base.module import float_field

RHO0, MU, RHO_INF = 1.0, 1.0, 0.5
C = 2.0
FREQUENCY = 2.0
T1 = 2.0  # past the first peak, at w t = pi / 2
TIGHT = qj.SolverSettings(qj.tight().rtol, qj.tight().atol)


class Manufactured(qj.AbstractDisturbance):
    r"""The d(t) under which a loop of order 1 or 2 has $\sigma^* = \rho Z \sin \omega t$, following $x_{des} = \sin t$.

    $d = \dot\sigma^* - f(x^*) - c \dot e^* + x_{des}^{(n)} + g \tan(\pi Z \sin(\omega t) / 2)$. For n = 2,
    $\dot e^* = \sigma^* - c e^*$
    is solved by $e^* = Z (\rho_0 R(c - \mu, \mu) + \rho_\infty R(c, 0))$ with
    $R(a, m) = e^{-m t} (a \sin \omega t - \omega \cos \omega t) / (a^2 + \omega^2)$.
    """

    plant: qj.AbstractPlant
    peak: Float[Array, ""] = float_field()

    def errors(self, t):
        sine, cosine = jnp.sin(FREQUENCY * t), jnp.cos(FREQUENCY * t)
        sigma = self.peak * sine * (RHO0 * jnp.exp(-MU * t) + RHO_INF)
        if self.plant.order == 1:
            return (sigma,)
        terms = ((RHO0, C - MU, MU), (RHO_INF, C, 0.0))
        responses = [r * jnp.exp(-m * t) * (a * sine - FREQUENCY * cosine) / (a**2 + FREQUENCY**2) for r, a, m in terms]
        e = self.peak * sum(responses)
        return e, sigma - C * e

    def state(self, t):
        desired = (jnp.sin(t), jnp.cos(t))
        return tuple(e + x for e, x in zip(self.errors(t), desired, strict=False))

    def __call__(self, t):
        sine, cosine = jnp.sin(FREQUENCY * t), jnp.cos(FREQUENCY * t)
        decaying = RHO0 * jnp.exp(-MU * t)
        sigma_rate = self.peak * (FREQUENCY * cosine * (decaying + RHO_INF) - MU * decaying * sine)
        x = self.state(t)
        known = self.plant.drift(t, x) + (C * self.errors(t)[1] if len(x) == 2 else 0.0)
        reference = jnp.cos(t) if len(x) == 1 else -jnp.sin(t)
        return sigma_rate - known + reference + self.plant.gain(t, x) * jnp.tan(math.pi / 2 * self.peak * sine)

    @property
    def bound(self):
        return jnp.asarray(jnp.inf)

    @property
    def break_times(self):
        return qj.disturbances.no_breaks()


@dataclasses.dataclass(frozen=True)
class Made:
    run: qj.Trajectory
    states: np.ndarray


def make(order, peak, gain=1.0, settings=None):
    plant = problems.chain(order)(drift_scale=1.0, gain_scale=gain, gain_ripple=0.5)
    control = qj.QuasiSlidingControl(qj.SlidingSurface([C] * (order - 1)), qj.Funnel(RHO0, MU, RHO_INF))
    disturbance = Manufactured(plant, peak)
    loop = qj.ClosedLoop(plant, qj.references.SumOfSines([1.0], [1.0]), disturbance, control)
    run = qj.simulate(loop, [float(x) for x in disturbance.state(0.0)], T1, bandwidth=0.75, settings=settings)
    return Made(run, np.stack([disturbance.state(t) for t in run.ts[::100]]))


ORDERS = pytest.mark.parametrize("order", [1, pytest.param(2, marks=pytest.mark.slow)], ids=["n=1", "n=2"])
PEAKS = pytest.mark.parametrize("peak", [0.1, 0.7, 0.99])


@pytest.mark.slow
@PEAKS
@ORDERS
def test_peak_ratio_with_the_tight_preset(order, peak):
    assert float(make(order, peak, settings=TIGHT).run.metrics.peak_ratio) == pytest.approx(peak, abs=1e-7)


@pytest.mark.parametrize("rtol", [1e-4, 1e-5, 1e-6])
@PEAKS
@ORDERS
def test_peak_ratio_is_good_to_twenty_times_the_tolerance(order, peak, rtol):
    run = make(order, peak, settings=qj.SolverSettings(rtol)).run
    assert float(run.metrics.peak_ratio) == pytest.approx(peak, abs=20 * rtol)


@PEAKS
def test_the_physical_route_finds_the_peak_too(peak):
    run = make(1, peak, settings=qj.SolverSettings(coordinates="physical")).run
    assert float(run.metrics.peak_ratio) == pytest.approx(peak, abs=2e-5)


@ORDERS
def test_peak_comes_at_its_time(order):
    assert float(make(order, 0.7).run.metrics.peak_time) == pytest.approx(math.pi / 2 / FREQUENCY, abs=1e-4)


@ORDERS
def test_states_are_the_chosen_ones(order):
    made = make(order, 0.7)
    np.testing.assert_allclose(made.run.x[::100], made.states, rtol=0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("rtol", [1e-4, 1e-6, 1e-8])
@ORDERS
def test_margin_of_a_millionth_keeps_its_digits(order, rtol):
    margin = 1e-6
    # A small gain makes this quick: explicit steps are as short as g (1 + u^2) is large, and u is near 1e6.
    run = make(order, 1.0 - margin, gain=1e-6, settings=qj.SolverSettings(rtol)).run
    assert run.verdict == qj.Verdict.HELD
    # What the tolerance controls is s, and the margin is (4 / pi) exp(-s).
    s = math.log(4 / math.pi / margin)
    assert float(run.metrics.margin) == pytest.approx(margin, rel=5 * rtol * s)
