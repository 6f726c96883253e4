"""Numbers that a scenario reads from outside: a program compiled with old ones decides nothing about new ones."""

import math

import pytest

import qsmc_jax as qj
from qsmc_jax.base.errors import InputError
from studies_for_tests import Integrator

OUTSIDE = {"gain": 2.0, "push": 0.0}


class Drifting(qj.AbstractPlant):
    """x' = push + u + d, with a push that is nobody's field."""

    order = 1

    def drift(self, t, x):
        """From outside."""
        return OUTSIDE["push"] + 0.0 * x[0]

    def gain(self, t, x):
        """One."""
        return 1.0


def loop_of(plant):
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(rho0=1.0, mu=1.0, rho_inf=0.1))
    return qj.ClosedLoop(plant, qj.references.Constant(0.0), qj.disturbances.Constant(0.5), control)


def by_number(draw):
    """Its gain is read when a run is made."""
    return qj.Scenario(loop_of(Integrator(OUTSIDE["gain"])), x0=draw.uniform("x0", -0.5, 0.5, shape=(1,)), t1=4.0)


def by_function(draw):
    """Its push is read when the drift is traced."""
    return qj.Scenario(loop_of(Drifting()), x0=draw.uniform("x0", -0.5, 0.5, shape=(1,)), t1=4.0)


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
        assert low < run.figures.peak_ratio < high
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
    assert qj.simulate(loop, [0.1], 4.0, bandwidth=0.2).figures.peak_u < 2.0
    OUTSIDE["push"] = 50.0
    assert 50.5 < qj.simulate(loop, [0.1], 4.0, bandwidth=0.2).figures.peak_u < 51.6
    OUTSIDE["push"] = 0.0
    assert qj.simulate(loop, [0.1], 4.0, bandwidth=0.2).figures.peak_u < 2.0
