"""References from a differential equation: against known references, SciPy, and what is refused."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

import qsmc_jax as qj
from own_plants import Joint, joint, joint_outputs
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.module import float_field
from qsmc_jax.base.precision import in_64_bits
from studies_for_tests import Integrator

T1, FUNNEL = 6.0, qj.Funnel(4.0, 3.0, 0.05)
CONTROL = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), FUNNEL)


class Oscillator(qj.AbstractReferenceModel):
    """Two sines at once, x_des = a sin(omega t) + 1, as the output of a system."""

    start: object = float_field(default=(0.0, 1.3))
    frequency: float = float_field(default=1.3)

    states = 2

    def vector_field(self, t, x):
        """A spring."""
        return x[1], -(self.frequency**2) * x[0]

    def output(self, t, x):
        """About 1."""
        return x[0] + 1.0


class Master(qj.AbstractReferenceModel):
    """An oscillator of van der Pol, pushed from outside."""

    start: object = float_field(default=(0.4, 0.0))

    states = 2

    def vector_field(self, t, x):
        """As it stands in textbooks."""
        return x[1], (1.0 - x[0] ** 2) * x[1] - x[0] + 0.3 * jnp.cos(2.0 * t)

    def output(self, t, x):
        """Not a state, so that derivatives are some."""
        return x[0] + 0.1 * jnp.sin(x[1])


def loop_of(reference, implementation=None):
    wave = qj.disturbances.Sine(0.5, 1.0)
    return qj.ClosedLoop(qj.plants.InvertedPendulum(), reference, wave, CONTROL, implementation)


def implemented():
    noise = qj.noises.Signals((qj.disturbances.Sine(1e-3, 3.0), qj.disturbances.Sine(2e-3, 5.0)))
    return qj.Implementation(2e-3, noise=noise, delay=1e-3)


@pytest.mark.parametrize("sampled", [False, True])
def test_a_model_of_a_known_reference_is_that_reference(sampled):
    """The model's states are not measured: noise is for the plant's, two numbers."""
    made = implemented() if sampled else None
    wave = qj.references.SumOfSines([1.0], [1.3], offset=1.0)
    # At none of these times a command arrives: there the input is either of two numbers, as time is rounded.
    ts, tight = np.linspace(0.0, T1, 2001)[:-1] + 7e-4, qj.tight()
    runs = (qj.simulate(loop_of(each, made), [0.9, 0.9], T1, ts=ts, settings=tight) for each in (wave, Oscillator()))
    known, found = runs
    assert found.x.shape[1] == 4
    assert known.x.shape[1] == 2
    np.testing.assert_allclose(found.x[:, 2], np.sin(1.3 * ts), atol=1e-6)
    near = {"rtol": 1e-6, "atol": 2e-6}
    for name in ("desired", "e", "sigma", "u"):
        np.testing.assert_allclose(getattr(found, name), getattr(known, name), **near)
    assert float(found.metrics.peak_ratio) == pytest.approx(float(known.metrics.peak_ratio), rel=near["rtol"])
    assert found.verdict is known.verdict is qj.Verdict.HELD


@pytest.mark.slow
def test_a_slave_follows_its_master_as_scipy_has_it():
    loop = loop_of(Master())
    run = qj.simulate(loop, [0.9, 0.2], T1, settings=qj.tight())
    rho = lambda t: 4.0 * math.exp(-3.0 * t) + 0.05  # noqa: E731

    def of_master(t, z):
        return z[1], (1.0 - z[0] ** 2) * z[1] - z[0] + 0.3 * math.cos(2.0 * t)

    def ratio(t, y):
        a, b = y[2:]
        b_rate = of_master(t, y[2:])[1]
        wanted = a + 0.1 * math.sin(b), b + 0.1 * math.cos(b) * b_rate
        return (2.0 * (y[0] - wanted[0]) + y[1] - wanted[1]) / rho(t)

    def rates(t, y):
        u = -math.tan(0.5 * math.pi * ratio(t, y))
        u /= 0.01 * 9.8**2
        return [y[1], -math.sin(y[0]) - y[1] + math.sin(y[1]) + u + 0.5 * math.sin(t), *of_master(t, y[2:])]

    solved = scipy.integrate.solve_ivp(
        rates, (0.0, T1), [0.9, 0.2, 0.4, 0.0], "Radau", rtol=1e-10, atol=1e-12, dense_output=True
    )
    np.testing.assert_allclose(run.x[-1], solved.y[:, -1], atol=1e-6)
    peak = max(abs(ratio(t, solved.sol(t))) for t in np.linspace(0.0, T1, 20001))
    assert float(run.metrics.peak_ratio) == pytest.approx(peak, abs=1e-6)


@pytest.mark.slow
def test_a_plant_of_order_4_in_its_own_coordinates_follows_one_too():
    """Against SciPy, the derivatives of the output by hand."""
    surface, funnel = qj.SlidingSurface.binomial(2.0, 4), qj.Funnel(30.0, 1.0, 0.5)
    control = qj.QuasiSlidingControl(surface, funnel)
    loop = qj.ClosedLoop(Joint(), Oscillator(frequency=0.8), qj.disturbances.Zero(), control)
    x0, c = [0.2, 0.0, 0.2, 0.0], [8.0, 12.0, 6.0, 1.0]
    run = qj.simulate(loop, x0, 3.0, settings=qj.tight())
    start = [0.0, 1.3]

    def ratio(t, y):
        a, b = y[4:]
        wanted = a + 1.0, b, -0.64 * a, -0.64 * b
        sigma = sum(ci * (yi - di) for ci, yi, di in zip(c, joint_outputs(t, y[:4]), wanted, strict=True))
        return sigma / (30.0 * math.exp(-t) + 0.5)

    def rates(t, y):
        u = -math.tan(0.5 * math.pi * ratio(t, y))
        return [*joint(t, y[:4], u, 0.0), y[5], -0.64 * y[4]]

    grid = np.linspace(0.0, 3.0, 20001)
    options = {"method": "Radau", "rtol": 1e-10, "atol": 1e-12, "dense_output": True}
    solved = scipy.integrate.solve_ivp(rates, (0.0, 3.0), [*x0, *start], **options)
    np.testing.assert_allclose(run.x[-1], solved.y[:, -1], atol=2e-6)
    peak = max(abs(ratio(t, solved.sol(t))) for t in grid)
    assert float(run.metrics.peak_ratio) == pytest.approx(peak, abs=1e-6)


class Pulsed(qj.AbstractReferenceModel):
    """A lag at rest that is pushed for a moment."""

    start: object = float_field(default=(0.0,))
    height: float = float_field(default=400.0)

    states = 1

    def vector_field(self, t, x):
        """The push lasts for some 5 ms."""
        return (-x[0] + self.height * jnp.exp(-(((t - 3.3337) / 2e-3) ** 2)),)

    def output(self, t, x):
        """The lag's state."""
        return x[0]


def test_a_push_on_the_model_between_two_steps_is_seen():
    """Unseen it would be HELD: at rest steps grow to a second. The model jumps by 1.4, the funnel is 0.2 wide."""
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, 1.0, 0.2))
    made = [
        qj.ClosedLoop(Integrator(1.0), Pulsed(height=each), qj.disturbances.Zero(), control) for each in (400.0, 0.0)
    ]
    pushed, calm = (qj.simulate(each, [0.0], T1, bandwidth=0.4) for each in made)
    assert calm.metrics.steps < 100
    # At the peak the input holds against the model's rate: tan(pi z / 2) = 400, less what the lag has gained by then.
    assert float(pushed.metrics.peak_ratio) == pytest.approx(1.0 - 2.0 / (math.pi * 400.0), abs=1e-5)
    peak = 400.0 * 2e-3 * math.sqrt(math.pi)
    assert float(pushed.x[:, 1].max()) == pytest.approx(peak, rel=0.01)


class Nodding(qj.AbstractReferenceModel):
    """A lag at rest, whose output nods for half a millisecond: no state shows that, and nothing is left of it."""

    start: object = float_field(default=(0.0,))
    states = 1

    def vector_field(self, t, x):
        """At rest."""
        return (-x[0],)

    def output(self, t, x):
        """A bump in time."""
        return x[0] + 0.7 * jnp.exp(-(((t - 3.3337) / 2e-4) ** 2))


def test_what_a_model_asks_for_between_two_steps_is_seen():
    """The input holds against the steepest of the bump, tan(pi z / 2) = 0.7 sqrt(2 / e) / 2e-4."""
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, 1.0, 0.2))
    loop = qj.ClosedLoop(Integrator(1.0), Nodding(), qj.disturbances.Zero(), control)
    run = qj.simulate(loop, [0.0], T1, bandwidth=0.4)
    steepest = 0.7 * math.sqrt(2.0 / math.e) / 2e-4
    assert float(run.metrics.peak_ratio) == pytest.approx(1.0 - 2.0 / (math.pi * steepest), abs=1e-5)


def scenario(draw):
    start = draw.uniform("master", -0.5, 0.5, shape=(2,))
    gain = draw.parameter("mu", 3.0, bounds=(1.0, 5.0))
    model = Oscillator(start, draw.parameter("omega", 1.0, bounds=(0.5, 2.0)))
    control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(6.0, gain, 0.05))
    loop = dataclasses.replace(loop_of(model), control=control)
    return qj.Scenario(loop, x0=[0.9, 0.2], t1=2.0)


MEETS = {"near": qj.always(lambda s: 1.9 - jnp.abs(s.x[2]), unit="rad")}
STUDY = qj.Study(scenario, bandwidth=0.1, requirements=MEETS)


@pytest.mark.slow
def test_a_study_draws_where_it_starts_and_replays_it():
    rows = qj.monte_carlo(STUDY, 64, block=64)
    assert (rows["verdict"] == qj.Verdict.HELD).all()
    largest = np.hypot(rows["master[0]"], rows["master[1]"])  # in [0, 2.1]: the amplitude of x[2] at omega = 1
    assert ((1.9 - rows["margin_near"]) <= largest + 1e-6).all()
    again = STUDY.replay(int(np.argmax(largest)))
    worst = int(np.argmax(largest))
    np.testing.assert_allclose(again.x[0, 2:], [rows["master[0]"][worst], rows["master[1]"][worst]])
    assert float(again.metrics.peak_ratio) == pytest.approx(rows["peak_ratio"][worst], rel=1e-9)


@pytest.mark.slow
def test_gradients_reach_the_model():
    def peak(omega):
        loop = loop_of(Oscillator(frequency=omega))
        return qj.simulate(loop, [0.9, 0.2], 1.0, settings=qj.tight().replace(adjoint="forward")).metrics.rms_error

    with jax.enable_x64(True):
        slope = float(jax.jvp(peak, (jnp.asarray(1.0),), (jnp.ones(()),))[1])
    h = 1e-4
    differences = (float(peak(np.asarray(1.0 + h))) - float(peak(np.asarray(1.0 - h)))) / (2.0 * h)
    assert slope == pytest.approx(differences, rel=1e-4)


class Wrong(qj.AbstractReferenceModel):
    """One state too few."""

    start: object = float_field(default=(0.0, 0.0))
    states = 2

    def vector_field(self, t, x):
        """One rate."""
        return (x[1],)

    def output(self, t, x):
        """The first."""
        return x[0]


class Jumping(qj.AbstractReferenceModel):
    """A relay."""

    start: object = float_field(default=(0.3,))
    states = 1

    def vector_field(self, t, x):
        """It jumps at 0."""
        return (-jnp.sign(x[0]),)

    def output(self, t, x):
        """The state."""
        return x[0]


class TwoIntegrators(qj.AbstractStateSpace):
    """Two integrators."""

    states, relative_degrees = 2, (1, 1)

    def vector_field(self, t, x, d):
        """Disturbances alone."""
        return d

    def input_matrix(self, t, x):
        """Apart from each other."""
        return (1.0, 0.0), (0.0, 1.0)

    def output(self, t, x):
        """Both."""
        return x


class Infinite(Jumping):
    """Not a number where it starts."""

    def vector_field(self, t, x):
        """A root of what is negative."""
        return (jnp.sqrt(x[0] - 1.0),)


def test_what_is_no_model_is_named():
    with pytest.raises(InputError, match="`vector_field` of `Wrong` must return 2 numbers"):
        Wrong()
    with pytest.raises(InputError, match="`start` of `Oscillator` must have shape"):
        Oscillator(start=[1.0])
    with pytest.raises(InputError, match="`start` of `Oscillator` must be finite"):
        Oscillator(start=[1.0, np.nan])
    with pytest.raises(InputError, match=r"`vector_field\[0\]` of `Jumping` must be continuous"):
        qj.simulate(qj.ClosedLoop(Integrator(1.0), Jumping(), qj.disturbances.Zero(), scalar()), [0.0], 1.0)
    with pytest.raises(InputError, match=r"Derivative 1 of `Infinite`, a reference, must be finite"):
        qj.simulate(qj.ClosedLoop(Integrator(1.0), Infinite(), qj.disturbances.Zero(), scalar()), [0.0], 1.0)
    with pytest.raises(InputError, match="Argument `x0` must have shape"):
        qj.simulate(loop_of(Oscillator()), [0.9, 0.9, 0.0, 1.3], T1)
    with pytest.raises(InputError, match="ask `loop.whole`"):
        loop_of(Oscillator()).sliding_variable(0.0, (0.9, 0.9))
    unmatched = {"unmatched": (qj.disturbances.Zero(),)}
    for given in unmatched, {"measurement_delay": 1e-4}:
        with pytest.raises(InputError, match=f"`{next(iter(given))}` .* with a reference model"):
            loop_of(Oscillator(), qj.Implementation(1e-3, **given))


class Ramp(Jumping):
    """Its rate is a plain number, and needs no array."""

    def vector_field(self, t, x):
        """Constant."""
        return (0.5,)


def test_rates_may_be_plain_numbers():
    with in_64_bits():
        found = Ramp().derivatives(0.0, (0.3,), 2)
    assert [float(each) for each in found] == [0.3, 0.5, 0.0]
    loop = qj.ClosedLoop(Integrator(1.0), Ramp(), qj.disturbances.Zero(), scalar())
    assert [float(each) for each in loop.whole.vector_field(0.0, loop.start([0.3]))] == [0.0, 0.5]


@pytest.mark.slow  # by default beartype refuses it first
def test_several_inputs_take_no_model():
    calm = (qj.disturbances.Zero(),) * 2
    with pytest.raises(InputError, match="`references` must have no reference model"):
        qj.MultivariableLoop(TwoIntegrators(), (Ramp(), Ramp()), calm, (scalar(), scalar()))


def scalar():
    return qj.QuasiSlidingControl(qj.SlidingSurface([]), FUNNEL)


@pytest.mark.slow
def test_studies_of_two_models_are_two():
    """Programs and campaigns are kept by what functions compute: a model's is part of it."""

    def study(power):
        class Own(qj.AbstractReferenceModel):
            start: object = float_field(default=(0.5,))
            states = 1

            def vector_field(self, t, x):
                return (-(x[0] ** power),)

            def output(self, t, x):
                return x[0]

        def made(draw):
            loop = qj.ClosedLoop(Integrator(1.0), Own(), qj.disturbances.Zero(), scalar())
            return qj.Scenario(loop, x0=[0.9], t1=1.0)

        return qj.Study(made, bandwidth=0.1)

    one, other = study(1), study(3)
    assert one.contents != other.contents
    ends = [float(each.replay(0).x[-1, 1]) for each in (one, other)]
    assert ends == pytest.approx([0.5 * math.exp(-1.0), (4.0 + 2.0) ** -0.5], rel=1e-5)
