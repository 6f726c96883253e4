"""Numbers that a scenario reads from outside: a program compiled with old ones decides nothing about new ones."""

import math

import jax.numpy as jnp
import pytest
from jaxtyping import Array, Float

import qsmc_jax as qj
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.module import float_field
from qsmc_jax.control.control import AbstractControl
from studies_for_tests import Integrator

OUTSIDE = {"gain": 2.0, "push": 0.0, "law": 2.0, "lag": 1e-3, "noise": 0.0}


class Drifting(qj.AbstractPlant):
    """x' = push + u + d, with a push that is nobody's field."""

    order = 1

    def drift(self, t, x):
        """From outside."""
        return OUTSIDE["push"] + 0.0 * x[0]

    def gain(self, t, x):
        """One."""
        return 1.0


class Proportional(AbstractControl):
    """u = -K sigma, with a K that is nobody's field."""

    surface: qj.SlidingSurface
    funnel: qj.Funnel
    gain_sign: Float[Array, ""] = float_field(default=1.0)

    positive = ()

    def first_memory(self):
        """None."""
        return ()

    def command(self, sample, memory):
        """From outside."""
        return -OUTSIDE["law"] * sample.sigma, memory


class Lag(qj.actuators.AbstractActuator):
    """A first-order lag whose time constant is nobody's field."""

    def _inner(self):
        return qj.actuators.FirstOrderLag(OUTSIDE["lag"])

    def rest(self):
        """That of the lag."""
        return self._inner().rest()

    def move(self, state, command, dt):
        """That of the lag."""
        return self._inner().move(state, command, dt)

    def swing(self, state, command, dt):
        """That of the lag."""
        return self._inner().swing(state, command, dt)

    def kinks(self, state, command):
        """None."""
        return ()

    def is_valid(self):
        """Always."""
        return True


class Offset(qj.noises.AbstractNoise):
    """An offset of what is measured that is nobody's field."""

    def __call__(self, t, k):
        """From outside."""
        return (OUTSIDE["noise"] + 0.0 * t,)

    def bounds(self):
        """Some."""
        return jnp.ones(1)

    def is_valid(self):
        """Always."""
        return True


def loop_of(plant):
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(rho0=1.0, mu=1.0, rho_inf=0.1))
    return qj.ClosedLoop(plant, qj.references.Constant(0.0), qj.disturbances.Constant(0.5), control)


def by_number(draw):
    """Its gain is read when a run is made."""
    return qj.Scenario(loop_of(Integrator(OUTSIDE["gain"])), x0=draw.uniform("x0", -0.5, 0.5, shape=(1,)), t1=4.0)


def by_function(draw):
    """Its push is read when the drift is traced."""
    return qj.Scenario(loop_of(Drifting()), x0=draw.uniform("x0", -0.5, 0.5, shape=(1,)), t1=4.0)


FUNNEL, SURFACE = qj.Funnel(rho0=1.0, mu=1.0, rho_inf=0.2), qj.SlidingSurface([])


def sampled(control, **implementation):
    """x' = u, sampled each 10 ms, from 0.5."""
    made = qj.Implementation(sample_period=0.01, **implementation)
    parts = Integrator(1.0), qj.references.Constant(0.0), qj.disturbances.Zero()
    return qj.ClosedLoop(*parts, control, made)


SAMPLED = {
    "law": (lambda: sampled(Proportional(SURFACE, FUNNEL)), -2.0),
    "lag": (lambda: sampled(Proportional(SURFACE, FUNNEL), actuator=Lag()), 50.0),
    "noise": (lambda: sampled(Proportional(SURFACE, FUNNEL), noise=Offset()), 5.0),
}

CASES = [(by_number, "gain", -2.0), (by_function, "push", 50.0)]
KINDS = pytest.mark.parametrize(("scenario", "name", "value"), CASES, ids=["a number", "in a function"])


@pytest.fixture(autouse=True)
def _put_back():
    before = dict(OUTSIDE)
    yield
    OUTSIDE.update(before)


@KINDS
def test_a_study_made_anew_is_of_the_new_numbers(scenario, name, value):
    """At -2 the gain pushes outwards, and all runs leave; a push of 50 is held at tan(pi z / 2) = 50.5 to 51.6.

    For x = z rho with rho' in (-1, 0) needs an input between those.
    """
    old = qj.monte_carlo(qj.Study(scenario, bandwidth=0.2), 64)
    assert (old["verdict"] == qj.Verdict.HELD).all()
    OUTSIDE[name] = value
    study = qj.Study(scenario, bandwidth=0.2)
    new, run = qj.monte_carlo(study, 64), study.replay(0)
    if name == "gain":
        assert (new["verdict"] == qj.Verdict.VIOLATED).all()
        assert run.verdict == qj.Verdict.VIOLATED
    else:
        low, high = (2.0 / math.pi * math.atan(u) for u in (50.5, 51.6))
        assert ((low < new["peak_ratio"]) & (new["peak_ratio"] < high)).all()
        assert low < run.metrics.peak_ratio < high
    OUTSIDE.update(gain=2.0, push=0.0)
    again = qj.monte_carlo(qj.Study(scenario, bandwidth=0.2), 64)
    assert again["peak_ratio"].tolist() == old["peak_ratio"].tolist()


@KINDS
@pytest.mark.parametrize("is_compiled", [True, False])
def test_a_study_whose_numbers_changed_gives_no_verdict(scenario, name, value, is_compiled):
    study = qj.Study(scenario, bandwidth=0.2)
    if is_compiled:
        qj.monte_carlo(study, 64)
    OUTSIDE[name] = value
    said = "Argument `scenario` must compute the same in every call, but its"
    with pytest.raises(InputError, match=said):
        qj.verify(study, 64)
    with pytest.raises(InputError, match=said):
        qj.monte_carlo(study, 64)
    with pytest.raises(InputError, match=said):
        qj.robustness_map(study.substitute(x0=[0.1]), over={"x0": [0.1, 0.2]}, runs=64)


@pytest.mark.slow
def test_nor_is_a_program_compiled_for_it():
    """One that is there is of the old numbers; another one would be of the new."""
    study = qj.Study(by_number, bandwidth=0.2)
    before = list(qj.stream(study, range(64), block=64))[0]
    OUTSIDE["gain"] = -2.0
    assert list(qj.stream(study, range(64), block=64))[0]["peak_ratio"].tolist() == before["peak_ratio"].tolist()
    with pytest.raises(InputError, match="has changed since the study was made"):
        list(qj.stream(study, range(64), block=128))
    with pytest.raises(InputError, match="has changed since the study was made"):
        study.replay(0)


def test_a_loop_is_solved_with_the_numbers_of_the_moment():
    loop = loop_of(Drifting())
    assert qj.simulate(loop, [0.1], 4.0, bandwidth=0.2).metrics.peak_u < 2.0
    OUTSIDE["push"] = 50.0
    assert 50.5 < qj.simulate(loop, [0.1], 4.0, bandwidth=0.2).metrics.peak_u < 51.6
    OUTSIDE["push"] = 0.0
    assert qj.simulate(loop, [0.1], 4.0, bandwidth=0.2).metrics.peak_u < 2.0


@pytest.mark.parametrize("name", SAMPLED)
def test_nor_is_a_part_of_an_implementation_what_it_was(name):
    """x' = u = -2 x stays below 0.55 e^-2t, inside rho = e^-t + 0.2; what is changed leaves it by t = 4 s.

    There rho = 0.218, and x is 0.45 e^8 or more with u = 2 x; 0.45 cos(0.8) e^-0.04 = 0.3 or more with a lag of 50 s,
    by x'' + x' / 50 + x / 25 = 0; and -5 with 5 added to what is measured.
    """
    make, value = SAMPLED[name]

    def scenario(draw):
        return qj.Scenario(make(), x0=draw.uniform("x0", 0.45, 0.55, shape=(1,)), t1=4.5)

    study = qj.Study(scenario, bandwidth=0.4)
    assert (qj.monte_carlo(study, 64)["verdict"] == qj.Verdict.HELD).all()
    assert qj.simulate(make(), [0.5], 4.5, bandwidth=0.4).verdict == qj.Verdict.HELD
    OUTSIDE[name] = value
    with pytest.raises(InputError, match="has changed since the study was made"):
        qj.monte_carlo(study, 64)
    assert (qj.monte_carlo(qj.Study(scenario, bandwidth=0.4), 64)["verdict"] == qj.Verdict.VIOLATED).all()
    assert qj.simulate(make(), [0.5], 4.5, bandwidth=0.4).verdict == qj.Verdict.VIOLATED
