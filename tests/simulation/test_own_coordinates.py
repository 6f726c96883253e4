"""Loops of plants in their own coordinates against SciPy on right-hand sides written by hand, and closed forms."""

import math
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import qsmc_jax as qj
from own_plants import BANDWIDTH, FUNNEL, PLANTS, T1, Pendulum, Scaled, Tank, loop_of, solved
from problems import STILL, STILL_BANDWIDTH, WIDTH, escape_time, example1
from qsmc_jax.numerics.gudermann import ratio
from qsmc_jax.simulation.ideal import read
from qsmc_jax.simulation.ideal.lifted import LiftedCoordinates

SLOWLY = [pytest.param(*each, marks=pytest.mark.slow) for each in (("joint", "tsit5"), ("scaled", "rodas5p"))]


@pytest.mark.parametrize(("name", "method"), [("tank", "tsit5"), *SLOWLY])
def test_a_loop_is_scipys(name, method):
    truth, settings = solved(name), qj.SolverSettings(method=method)
    run = qj.simulate(loop_of(name), PLANTS[name][4], T1, bandwidth=BANDWIDTH, settings=settings)
    assert run.verdict is qj.Verdict.HELD
    assert run.x.shape == (2001, len(PLANTS[name][4]))
    np.testing.assert_allclose(run.x[-1], truth["x1"], atol=2e-5)
    assert float(run.metrics.peak_ratio) == pytest.approx(truth["peak_ratio"], rel=1e-5)
    assert float(run.metrics.peak_u) == pytest.approx(math.tan(math.pi * truth["peak_ratio"] / 2), rel=1e-4)
    assert 0.0 < float(run.metrics.coordinate_drift) < 1e-5
    for i in range(run.x.shape[1]):
        np.testing.assert_allclose(run.x[:, i], np.interp(run.ts, truth["ts"], truth["states"][i]), atol=5e-5)


@pytest.mark.slow
def test_a_chain_in_its_own_coordinates_is_the_chain():
    chain = example1()
    own = qj.ClosedLoop(Pendulum(), chain.reference, chain.disturbance, chain.control)
    ours, theirs = (qj.simulate(loop, [0.9, -0.2], 20.0, bandwidth=0.1).metrics.columns() for loop in (own, chain))
    for name in ("peak_ratio", "peak_u", "reach_time", "energy_u", "total_variation_u", "rms_error", "peak_error[1]"):
        assert float(ours[name]) == pytest.approx(float(theirs[name]), rel=2e-5), name
    assert set(ours) - set(theirs) == {"coordinate_drift"}


class Integrator(qj.AbstractStateSpace):
    """x1' = g u with a state x2 that grows by itself, at a rate that may be its square."""

    gain: float
    blows_up: bool

    states: ClassVar[int] = 2
    relative_degrees: ClassVar[tuple[int, ...]] = (1,)

    def vector_field(self, t, x, d):
        """x2 is seen by nobody."""
        return d, (x[1] ** 2 if self.blows_up else -x[1]) + 0.0 * x[0]

    def input_matrix(self, t, x):
        """The gain."""
        return self.gain, 0.0

    def output(self, t, x):
        """The first state."""
        return x[0]


def scalar(sign=1.0, blows_up=False, disturbance=None, gain=1.0):
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), STILL, sign)
    d = disturbance or qj.disturbances.Zero()
    return qj.ClosedLoop(Integrator(gain, blows_up), qj.references.Constant(0.0), d, control)


@pytest.mark.slow
@pytest.mark.parametrize("z0", [0.5, -0.9])
def test_a_wrong_sign_leaves_the_funnel_when_the_closed_form_does(z0):
    run = qj.simulate(scalar(-1.0), [z0 * WIDTH, 1.0], 20.0, bandwidth=STILL_BANDWIDTH)
    assert run.verdict is qj.Verdict.VIOLATED
    assert float(run.metrics.violation_time) == pytest.approx(escape_time(z0), rel=1e-5)


@pytest.mark.slow
def test_an_internal_state_that_escapes_leaves_the_run_undecided_and_says_when():
    """x2 = 1 / (1/2 - t): no verdict, since nobody knows what comes after."""
    run = qj.simulate(scalar(blows_up=True), [0.3, 2.0], 1.0, bandwidth=STILL_BANDWIDTH)
    assert run.verdict is qj.Verdict.UNDECIDED
    assert float(run.metrics.end_time) == pytest.approx(0.5, rel=1e-6)


class Strict(Integrator):
    """Another class, so that no program of another test serves."""


class Twisted(qj.AbstractStateSpace):
    """The output is a curved function of the state: what is solved of it and of the state differs by local errors."""

    states, relative_degrees = 1, (1,)

    def vector_field(self, t, x, d):
        """Nothing else."""
        return (d,)

    def input_matrix(self, t, x):
        """A unit."""
        return (1.0,)

    def output(self, t, x):
        """Rises everywhere."""
        return x[0] + 0.5 * jnp.sin(3.0 * x[0]) / 3.0


def twisted(size):
    """Under a disturbance that is balanced at tan(pi z / 2) = size at its peaks."""
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), STILL)
    loop = qj.ClosedLoop(Twisted(), qj.references.Constant(0.0), qj.disturbances.Sine(size, 3.0), control)
    return qj.simulate(loop, [0.5], 5.0, bandwidth=STILL_BANDWIDTH)


def test_a_run_whose_coordinates_disagree_by_more_than_its_margin_is_undecided():
    """The margin is 2 / (pi size): 6e-4, which is known, and 6e-7, which is not."""
    calm, close = twisted(1e3), twisted(1e6)
    assert calm.verdict is qj.Verdict.HELD
    assert float(calm.metrics.margin) == pytest.approx(2 / math.pi * 1e-3, rel=1e-3)
    assert close.verdict is qj.Verdict.UNDECIDED
    assert close.outcome is qj.Outcome.DRIFTED


def test_the_funnel_coordinate_comes_back_to_what_the_state_says():
    """rho z - sigma(x) decays at the rate mu of the funnel, whatever the disturbance, the gain and the input."""
    loop, x = loop_of("tank"), (0.4, 0.2, 0.3)

    def gap(t, y):
        return loop.control.funnel(t) * ratio(y[-1]) - loop.sliding_variable(t, y[:-1])

    with jax.enable_x64(True):
        t = jnp.asarray(0.7)
        for s in (-2.0, 0.1, 3.0):
            y = tuple(map(jnp.asarray, (*x, s)))
            value, rate = jax.jvp(gap, (t, y), (jnp.ones(()), LiftedCoordinates().vector_field(t, y, loop)))
            assert float(rate) == pytest.approx(-FUNNEL[1] * float(value), rel=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_run_whose_coordinates_disagree_by_more_than_is_allowed_is_undecided(monkeypatch, sign):
    """Also one that leaves, as by the wrong sign: from what has drifted nobody knows that it did."""
    monkeypatch.setattr(read, "_DRIFT", 1e-16)
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), STILL, sign)
    loop = qj.ClosedLoop(Strict(1.0, False), qj.references.Constant(0.0), qj.disturbances.Sine(0.4, 3.0), control)
    run = qj.simulate(loop, [0.3, 1.0], 5.0, bandwidth=STILL_BANDWIDTH)
    assert run.outcome is qj.Outcome.DRIFTED
    assert run.verdict is qj.Verdict.UNDECIDED


class Kick(qj.AbstractDisturbance):
    """A push for a thousandth of a second, which says nothing of itself."""

    start: float
    size: float

    @property
    def bound(self):
        """Its size."""
        return self.size

    @property
    def break_times(self):
        """None."""
        return jnp.zeros((0,))

    def __call__(self, t):
        """At one time only."""
        return jnp.where((t > self.start) & (t < self.start + 1e-3), self.size, 0.0)


class Reservoir(qj.AbstractStateSpace):
    """The disturbance enters a state that the output sees much later."""

    states, relative_degrees = 2, (1,)

    def vector_field(self, t, x, d):
        """x2 decays in a second."""
        return x[1] * jnp.cos(t), -x[1] + d

    def input_matrix(self, t, x):
        """The gain."""
        return 1.0, 0.0

    def output(self, t, x):
        """The first state."""
        return x[0]


class Leaking(qj.AbstractStateSpace):
    """The input fills a second state too, through a valve that opens for a moment."""

    states, relative_degrees = 2, (1,)

    def vector_field(self, t, x, d):
        """The first state grows by 2 a second unless the input holds it, so that u is all but -2."""
        return 2.0, 0.0 * x[0]

    def input_matrix(self, t, x):
        """Open for a thousandth of a second."""
        return 1.0, jnp.where((t > 1.7) & (t < 1.701), 100.0, 0.0)

    def output(self, t, x):
        """The first state."""
        return x[0]


def test_an_input_that_reaches_an_internal_state_for_a_moment_is_not_stepped_over():
    """At rest u = -2: the second state is -0.2 afterwards."""
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), STILL)
    loop = qj.ClosedLoop(Leaking(), qj.references.Constant(0.0), qj.disturbances.Zero(), control)
    at_rest = 2.0 / math.pi * math.atan(2.0) * WIDTH
    run = qj.simulate(loop, [at_rest, 0.0], 4.0, bandwidth=STILL_BANDWIDTH)
    assert run.x[-1, 1] == pytest.approx(-0.2, rel=1e-3)


SMALL = pytest.param(2.7, 50e-6, marks=pytest.mark.slow)  # with tolerances to match


@pytest.mark.parametrize(("start", "size"), [(1.2345, 50.0), SMALL])
def test_a_short_push_on_an_internal_state_is_not_stepped_over(start, size):
    """x2 = size (1 - exp(-0.001)) exp(-(t - end)) afterwards."""
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(2.0, 1.0, 0.1))
    loop = qj.ClosedLoop(Reservoir(), qj.references.Constant(0.0), Kick(start, size), control)
    settings = qj.SolverSettings(rtol=1e-6, atol=1e-8 * size)
    run = qj.simulate(loop, [0.0, 0.0], 4.0, bandwidth=BANDWIDTH, settings=settings)
    pushed = size * (1.0 - math.exp(-1e-3)) * math.exp(-(4.0 - start - 1e-3))
    assert run.x[-1, 1] == pytest.approx(pushed, rel=1e-3)


@pytest.mark.slow
def test_gradients_through_internal_states_are_differences():
    def energy(level):
        settings = qj.SolverSettings(rtol=1e-9, method="tsit5", adjoint="forward")
        x0 = jnp.stack([0.4, 0.2, level])
        return qj.simulate(loop_of("tank"), x0, 2.0, bandwidth=BANDWIDTH, settings=settings).metrics.energy_u

    with jax.enable_x64(True):
        slope = jax.jvp(energy, (jnp.asarray(0.3),), (jnp.asarray(1.0),))[1]
        difference = (float(energy(jnp.asarray(0.3 + 1e-4))) - float(energy(jnp.asarray(0.3 - 1e-4)))) / 2e-4
    assert float(slope) == pytest.approx(difference, rel=1e-3)


def scenario(draw):
    """The tank from a drawn start, under a drawn disturbance."""
    loop = loop_of("tank", disturbance=qj.disturbances.Sine(draw.uniform("a", 0.2, 0.9), 1.3))
    return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.4, shape=(3,)), t1=3.0)


REQUIRED = {"level": qj.always(lambda s: 0.35 - s.x[2], unit="m")}
STUDY = qj.Study(
    scenario, BANDWIDTH, metrics=[qj.metrics.Peak("top", lambda s: s.x[2], unit="m")], requirements=REQUIRED
)


@pytest.mark.slow
def test_a_study_judges_and_replays_requirements_on_internal_states():
    rows = qj.monte_carlo(STUDY, 64, block=64)
    assert (rows["verdict"] == qj.Verdict.HELD).all()
    assert 0 < rows.counts("level")[qj.Verdict.VIOLATED] < 64
    assert ((rows["verdict_level"] == qj.Verdict.VIOLATED) == (rows["top"] > 0.35)).all()
    np.testing.assert_allclose(rows["margin_level"], 0.35 - rows["top"], atol=1e-9)
    assert (rows["coordinate_drift"] < 1e-5).all()
    worst = int(np.argmin(rows["margin_level"]))
    again = STUDY.replay(rows.row(worst)["index"])
    assert float(again.x[:, 2].max()) == pytest.approx(rows["top"][worst], abs=1e-5)
    assert again.to_xarray()["x"].dims == ("t", "state")


class Late(Tank):
    relative_degrees: ClassVar[tuple[int, ...]] = (3,)


class Early(Tank):
    relative_degrees: ClassVar[tuple[int, ...]] = (1,)


class Short(Tank):
    def input_matrix(self, t, x):
        """One number is missing."""
        return 0.0, 1.0


class Rough(Tank):
    def vector_field(self, t, x, d):
        """Coulomb's friction on the level."""
        return x[1], d, -jnp.sign(x[2])


class Driven(Tank):
    def vector_field(self, t, x, d):
        """The disturbance pushes one way or the other, by the level."""
        return x[1], d * jnp.sign(x[2]), -x[2]


class Root(Tank):
    def output(self, t, x):
        """No number where the level is negative."""
        return x[0] + jnp.sqrt(x[2])


class Two(Tank):
    relative_degrees: ClassVar[tuple[int, ...]] = (1, 1)


def started(plant, c, x0=(0.4, 0.2, 0.3)):
    control = qj.QuasiSlidingControl(qj.SlidingSurface(c), qj.Funnel(9.0, 1.0, 0.1))
    loop = qj.ClosedLoop(plant(), qj.references.SumOfSines([0.5], [1.0]), qj.disturbances.Zero(), control)
    return qj.simulate(loop, list(x0), 1.0)


BAD = {
    "too late": (lambda: started(Late, [1.0, 2.0]), "is 3, and it shows in derivative 2: say 2"),
    "too early": (lambda: started(Early, []), "in the first 1 it does not: say 2, or more"),
    "two": (
        lambda: Two(),
        "`vector_field` of `Two` must take a time and a state of 3 numbers x[0] ... x[2] and 2 disturb",
    ),
    "short": (lambda: Short(), "`input_matrix` of `Short` must return 3 numbers, one a state, but returns 2 of them"),
    "rough": (lambda: started(Rough, [1.0]), "`vector_field[2]` of `Rough` must be continuous in the state"),
    "driven": (lambda: started(Driven, [1.0]), "`vector_field[1]` of `Driven` must be continuous in the state"),
    "root": (
        lambda: started(Root, [1.0], (0.4, 0.2, -0.3)),
        "`output` of `Root` must be finite, but is nan at t = 0 s",
    ),
    "start": (lambda: started(Tank, [1.0], (0.4, 0.2)), "the plant has 3 states"),
    "surface": (lambda: started(Scaled, [1.0]), "must have 0 coefficients"),
}


@pytest.mark.parametrize(("attempt", "message"), BAD.values(), ids=BAD)
def test_what_does_not_fit_is_named(attempt, message):
    with pytest.raises(qj.InputError) as error:
        attempt()
    assert message in str(error.value)
