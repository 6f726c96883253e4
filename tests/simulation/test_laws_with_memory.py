"""Laws whose memory follows a differential equation, in the ideal loop: closed forms, SciPy, and what is refused."""

import math
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

import qsmc_jax as qj
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.module import float_field
from qsmc_jax.base.precision import in_64_bits
from qsmc_jax.control.controllers.saturated import is_of_coordinate, limits_of
from qsmc_jax.enclosures.unseen import Nodes, Step, unseen
from studies_for_tests import Integrator

G, T1, LOAD = 2.0, 6.0, 1.5
FUNNEL = qj.Funnel(2.0, 0.5, 0.4)
REST = qj.references.Constant(0.0)
# `tight()`, but for its limit of steps, so that loops share programs with those at default settings.
TIGHT = qj.SolverSettings(qj.tight().rtol, qj.tight().atol)


class Integral(qj.AbstractDynamicControl):
    """u = -p e - q int e."""

    surface: qj.SlidingSurface
    funnel: qj.AbstractFunnel
    p: float = float_field(default=1.5)
    q: float = float_field(default=2.0)
    gain_sign: float = float_field(default=1.0)

    positive: ClassVar[tuple[str, ...]] = ("p", "q")

    def first_memory(self):
        """The integral."""
        return (jnp.zeros(()),)

    def command(self, sample, memory):
        """The integral is a sum here."""
        e = sample.errors[0]
        return -self.p * e - self.q * memory[0], (memory[0] + sample.period * e,)

    def memory_at_start(self, sample):
        """At 0.1, to tell it from the sampled loop's."""
        return (0.1,)

    def memory_rates(self, sample, memory):
        """That of an integral."""
        return (sample.errors[0],)


def integral_loop(**numbers):
    law = Integral(qj.SlidingSurface([]), FUNNEL, **numbers)
    return qj.ClosedLoop(Integrator(G), REST, qj.disturbances.Constant(LOAD), law)


def test_an_integral_is_the_closed_form():
    """x' = g u + d, m' = x: linear, with constant d."""
    run = qj.simulate(integral_loop(), [0.5], T1, settings=qj.tight())
    matrix = np.array([[-G * 1.5, -G * 2.0], [1.0, 0.0]])
    rest = np.linalg.solve(matrix, [-LOAD, 0.0])
    exact = np.array([rest + scipy.linalg.expm(matrix * t) @ ([0.5, 0.1] - rest) for t in run.ts])
    np.testing.assert_allclose(run.x, exact, atol=1e-7)
    np.testing.assert_allclose(run.u, -1.5 * exact[:, 0] - 2.0 * exact[:, 1], atol=1e-6)
    peak = np.max(np.abs(exact[:, 0]) / (2.0 * np.exp(-0.5 * run.ts) + 0.4))
    assert float(run.metrics.peak_ratio) == pytest.approx(peak, abs=1e-5)
    assert run.verdict is qj.Verdict.HELD


@pytest.mark.slow
def test_in_a_sampled_loop_its_memory_is_not_a_state():
    loop = integral_loop()
    sampled = qj.ClosedLoop(loop.plant, REST, loop.disturbance, loop.control, qj.Implementation(1e-4))
    assert (loop.states, sampled.states) == (2, 1)
    ends = [qj.simulate(each, [0.5], T1).x[-1] for each in (loop, sampled)]
    assert ends[1].shape == (1,)
    assert abs(float(ends[0][0] - ends[1][0])) < 1e-3


def output_feedback(kind, omega, limit):
    example = qj.paper.example1()
    law = qj.controllers.Saturated(kind(example.control, omega), (-limit, limit))
    return qj.ClosedLoop(example.plant, example.reference, example.disturbance, law)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["HighGainObserver", "StateVariableFilter"])
def test_output_feedback_in_continuous_time_is_scipys(kind):
    """Estimates leave the funnel and come back, the law meets its limit and leaves it."""
    omega, limit, t1 = 120.0, 3.0, 2.0
    run = qj.simulate(output_feedback(getattr(qj.controllers, kind), omega, limit), [1.5, 0.9], t1, settings=TIGHT)
    funnel = qj.paper.example1().control.funnel
    rho = lambda t: float(funnel.rho0) * math.exp(-float(funnel.mu) * t) + float(funnel.rho_inf)  # noqa: E731
    c = float(qj.paper.example1().control.surface.c[0])

    def rates(t, y):
        e, a, b = y[0] - math.sin(t), y[2], y[3]
        z = (c * a + b) / rho(t)
        u = -math.tan(0.5 * math.pi * z) if abs(z) < 1.0 else -math.copysign(limit, z)
        u = min(max(u, -limit), limit) / (0.01 * 9.8**2)
        own = -math.sin(y[0]) - y[1] + math.sin(y[1]) + u + 0.5 * math.sin(t)
        if kind == "HighGainObserver":
            return [y[1], own, b + 2.0 * omega * (e - a), omega**2 * (e - a)]
        return [y[1], own, b, omega**2 * (e - a) - 2.0 * omega * b]

    start = [1.5, 0.9, 1.5, 0.0]
    options = {"rtol": 1e-10, "atol": 1e-12, "max_step": 1e-3, "dense_output": True}
    solved = scipy.integrate.solve_ivp(rates, (0.0, t1), start, "DOP853", **options)
    np.testing.assert_allclose(run.x[:, [0, 1, 3, 4]], solved.sol(run.ts).T, atol=2e-6)
    ts = np.linspace(0.0, t1, 20001)
    x = solved.sol(ts)
    sigma = c * (x[0] - np.sin(ts)) + x[1] - np.cos(ts)
    peak = np.max(np.abs(sigma) / [rho(t) for t in ts])
    assert float(run.metrics.peak_ratio) == pytest.approx(peak, abs=2e-6)
    assert float(run.metrics.peak_u) == pytest.approx(limit, rel=1e-9)
    assert 0.05 < np.mean(np.abs(run.u) == limit) < 0.95


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["HighGainObserver", "StateVariableFilter"])
def test_it_comes_to_state_feedback_in_proportion_to_its_gain(kind):
    """From half the horizon on, when the estimates have come in."""
    truth = qj.simulate(qj.paper.example1(), [0.1, 0.9], 1.5, bandwidth=0.1)
    late, apart = truth.ts >= 0.8, []
    for omega in (100.0, 200.0, 400.0, 800.0):
        loop = output_feedback(getattr(qj.controllers, kind), omega, 50.0)
        run = qj.simulate(loop, [0.1, 0.9], 1.5, bandwidth=0.1)
        apart.append(np.max(np.abs(run.x[late, :2] - truth.x[late])))
    np.testing.assert_allclose(np.log2(np.array(apart[:-1]) / apart[1:]), 1.0, atol=0.1)


def test_estimates_outside_the_funnel_do_not_wrap_around():
    """The tangent's next branch has the wrong sign. At the edge less 1e-9 it is 2e9 / pi, here times 1e-9."""
    law = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(1.0, 1.0, 0.2), gain=1e-9)
    observed = qj.controllers.HighGainObserver(law, 50.0)
    loop = qj.ClosedLoop(qj.plants.InvertedPendulum(), REST, qj.disturbances.Zero(), observed)
    start = loop.start((1.0, -1.5))
    assert [float(each) for each in start] == [1.0, -1.5, 1.0, 1.0, 0.0]
    assert abs(float(loop.whole.ratio(0.0, start))) < 0.5
    with in_64_bits():
        assert float(loop.whole.input(0.0, start)) == pytest.approx(-2.0 / math.pi, rel=1e-6)


class Kicked(Integral):
    """An integral that is kicked for 5 ms: by 1.4 in all."""

    def memory_rates(self, sample, memory):
        """The kick is far from any instant that a method would look at."""
        return (sample.errors[0] + 400.0 * jnp.exp(-(((sample.t - 3.3337) / 2e-3) ** 2)),)


def test_what_happens_to_the_memory_between_two_steps_is_seen():
    """Unseen the loop would stay at rest. SciPy is told to take steps that see it."""
    law = Kicked(qj.SlidingSurface([]), qj.Funnel(4.0, 0.5, 1.0))
    loop = qj.ClosedLoop(Integrator(G), REST, qj.disturbances.Zero(), law)
    run = qj.simulate(loop, [0.0], T1, settings=qj.tight())

    def rates(t, y):
        return [-G * (1.5 * y[0] + 2.0 * y[1]), y[0] + 400.0 * math.exp(-(((t - 3.3337) / 2e-3) ** 2))]

    solved = scipy.integrate.solve_ivp(rates, (0.0, T1), [0.0, 0.1], "DOP853", rtol=1e-10, atol=1e-12, max_step=1e-3)
    peak = np.max(np.abs(solved.y[0]) / (4.0 * np.exp(-0.5 * solved.t) + 1.0))
    assert peak > 0.5
    assert float(run.metrics.peak_ratio) == pytest.approx(peak, abs=1e-5)
    np.testing.assert_allclose(run.x[-1], solved.y[:, -1], atol=1e-6)


def scenario(draw):
    law = Integral(qj.SlidingSurface([]), FUNNEL, q=draw.uniform("q", 1.0, 3.0))
    load = qj.disturbances.Constant(draw.uniform("load", -LOAD, LOAD))
    return qj.Scenario(qj.ClosedLoop(Integrator(G), REST, load, law), x0=[0.5], t1=T1)


@pytest.mark.slow
def test_a_study_sees_the_memory():
    """At rest the integral holds the load: q m = d / g."""
    wanted = {"held": qj.eventually(lambda s: 0.02 - jnp.abs(2.0 * s.u + s.d), after=5.0)}
    study = qj.Study(
        scenario, bandwidth=0.5, metrics=[qj.metrics.Final("integral", lambda s: s.x[1])], requirements=wanted
    )
    rows = qj.monte_carlo(study, 64, block=64)
    np.testing.assert_allclose(rows["q"] * rows["integral"], rows["load"] / G, atol=0.02)
    assert (rows["verdict_held"] == qj.Verdict.HELD).all()
    again = study.replay(5)
    assert float(again.x[-1, 1]) == pytest.approx(rows["integral"][5], abs=1e-6)


class Forgetful(qj.AbstractControl):
    """A memory without rates."""

    surface: qj.SlidingSurface
    funnel: qj.AbstractFunnel
    gain_sign: float = float_field(default=1.0)

    positive: ClassVar[tuple[str, ...]] = ()

    def first_memory(self):
        """One number."""
        return (jnp.zeros(()),)

    def command(self, sample, memory):
        """No use of it."""
        return -sample.sigma, memory


def test_a_memory_without_rates_needs_an_implementation():
    law = Forgetful(qj.SlidingSurface([]), FUNNEL)
    wrapped = qj.controllers.Saturated(law, (-1.0, 1.0))
    for each in (law, wrapped, qj.controllers.HighGainObserver(law, 10.0)):
        with pytest.raises(InputError, match="has a memory without rates"):
            qj.ClosedLoop(Integrator(G), REST, qj.disturbances.Zero(), each)
    qj.ClosedLoop(Integrator(G), REST, qj.disturbances.Zero(), wrapped, qj.Implementation(1e-3))


class Double(Integral):
    """Two rates for one number."""

    def memory_rates(self, sample, memory):
        """One too many."""
        return (sample.errors[0], sample.sigma)


class Nowhere(Integral):
    """A memory that starts as two numbers."""

    def memory_at_start(self, sample):
        """One too many."""
        return (0.0, 0.0)


@pytest.mark.parametrize(("kind", "method"), [(Double, "memory_rates"), (Nowhere, "memory_at_start")])
def test_a_memory_has_as_many_rates_as_numbers(kind, method):
    law = kind(qj.SlidingSurface([]), FUNNEL)
    with pytest.raises(InputError, match=f"`{method}` of `{kind.__name__}` must return 1 numbers, as `first_memory`"):
        qj.ClosedLoop(Integrator(G), REST, qj.disturbances.Zero(), law)


def test_the_limits_of_a_law_are_known_through_what_is_around_it():
    inner = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), FUNNEL)
    limited = qj.controllers.Saturated(inner, (-1.0, 3.0))
    for law in limited, qj.controllers.HighGainObserver(limited, 5.0):
        assert [float(each) for each in limits_of(law)] == [-1.0, 3.0]
    for law in inner, qj.controllers.StateVariableFilter(inner, 5.0):
        assert limits_of(law) == (-math.inf, math.inf)
    narrower = qj.controllers.Saturated(qj.controllers.Saturated(inner, (-5.0, 5.0)), (-2.0, 2.0))
    assert [float(each) for each in limits_of(narrower)] == [-2.0, 2.0]


def test_only_the_quasi_sliding_law_and_its_limits_are_known_to_be_of_the_funnel_coordinate_alone():
    inner = qj.QuasiSlidingControl(qj.SlidingSurface([]), FUNNEL)
    limited, own = qj.controllers.Saturated(inner, (-1.0, 3.0)), Integral(qj.SlidingSurface([]), FUNNEL)
    known = inner, limited, qj.controllers.Saturated(limited, (-0.5, 0.5))
    estimated = qj.controllers.StateVariableFilter(limited, 5.0)
    other = own, qj.controllers.Saturated(own, (-1.0, 1.0)), estimated, qj.controllers.Saturated(estimated, (-1.0, 1.0))
    assert [is_of_coordinate(law) for law in (*known, *other)] == [True] * 3 + [False] * 4


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_what_a_limited_law_makes_of_the_edge_is_enclosed(side):
    """It is at its limit on both sides of the edge, and so in the whole step, though the funnel moves in it."""
    law = qj.controllers.Saturated(qj.QuasiSlidingControl(qj.SlidingSurface([]), FUNNEL), (-3.0, 3.0))

    def u(t):
        sigma = side * FUNNEL(t) * (0.9 + 0.2 * (t - 1.0) / 1e-3)
        sample = law.exact_sample(t, (sigma,), (0.0, 0.0), sigma)
        return law.command(sample, ())[0]

    with in_64_bits():
        step = Step(jnp.asarray(1.0), jnp.asarray(1.001), Nodes((0.0, 0.5, 1.0), few=(0.0, 0.5, 1.0)))
        found = unseen(u, step)
        assert float(u(jnp.asarray(1.0))) == float(u(jnp.asarray(1.001))) == -3.0 * side
    assert float(found.amount) == 0.0
