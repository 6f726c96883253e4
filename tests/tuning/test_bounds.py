"""The bounds of parameters: the map between bounds and the unit cube, undone, differentiated and refused."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import qsmc_jax as qj
from qsmc_jax.study.study import Study
from qsmc_jax.tuning.bounds import Bounds, bounds_of


def central_differences(function, at, step):
    return np.array([(function(at + d) - function(at - d)) / (2.0 * step) for d in step * np.eye(len(at))])


def _scenario(draw):
    funnel = qj.Funnel(
        rho0=4.0,
        mu=draw.parameter("mu", 3.0, bounds=(0.5, 10.0)),
        rho_inf=draw.parameter("rho_inf", 0.05, bounds=(0.01, 0.1)),
    )
    slope = draw.parameter("slope", 2.0, bounds=(1.0, 4.0))
    control = qj.QuasiSlidingControl(qj.SlidingSurface([slope]), funnel)
    plant = qj.plants.InvertedPendulum(mass=draw.uniform("mass", 0.008, 0.012))
    amplitude = draw.parameter("amplitude", 0.0, bounds=(0.0, 1.0))
    frequency = draw.parameter("frequency", 1.0, bounds=(0.1, 1.0 + slope))
    loop = qj.ClosedLoop(plant, qj.references.SumOfSines([amplitude], [frequency]), qj.disturbances.Zero(), control)
    return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=20.0)


@pytest.fixture(scope="module")
def study():
    return Study(_scenario, bandwidth=0.2)


BOX = Bounds(
    ("linear", "logarithmic", "around zero", "decades"),
    np.array([0.5, 0.5, -2.0, 1e-6]),
    np.array([4.0, 50.0, 3.0, 1e3]),
    np.array([False, True, False, True]),
)
inside = st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4).map(np.array)


@given(inside)
def test_placing_undoes_the_gains_and_the_gains_undo_placing(u):
    gains = dict(zip(BOX.names, (BOX.low + u * (BOX.high - BOX.low)).tolist(), strict=True))
    placed = BOX.place(gains)
    assert np.all((placed >= -1e-12) & (placed <= 1.0 + 1e-12))
    assert BOX.gains(placed) == pytest.approx(gains, rel=1e-12, abs=1e-12)
    assert BOX.place(BOX.gains(u)) == pytest.approx(u, abs=1e-12)


def test_corners_of_the_cube_are_the_bounds():
    assert list(BOX.gains(np.zeros(4)).values()) == pytest.approx(BOX.low, rel=1e-12)
    assert list(BOX.gains(np.ones(4)).values()) == pytest.approx(BOX.high, rel=1e-12)


def test_the_middle_is_the_arithmetic_or_the_geometric_mean():
    assert list(BOX.gains(np.full(4, 0.5)).values()) == pytest.approx([2.25, 5.0, 0.5, 10**-1.5], rel=1e-12)


@given(inside)
def test_gains_never_leave_their_bounds(u):
    for v in (u, np.round(u), 3.0 * u - 1.0):
        gains = np.array(list(BOX.gains(v).values()))
        assert np.all((gains >= BOX.low) & (gains <= BOX.high))


@given(st.lists(st.floats(0.001, 0.999), min_size=4, max_size=4).map(np.array))
def test_slopes_are_central_differences_of_the_gains(v):
    step = 1e-5
    above, below = (np.array(list(BOX.gains(v + d).values())) for d in (step, -step))
    assert BOX.slopes(v) == pytest.approx((above - below) / (2.0 * step), rel=1e-6)


def test_bounds_more_than_a_decade_apart_are_searched_in_the_logarithm(study):
    names = ("mu", "slope", "rho_inf", "amplitude")
    bounds = bounds_of(study, names)
    assert bounds.names == names
    assert bounds.low.tolist() == [0.5, 1.0, 0.01, 0.0]
    assert bounds.high.tolist() == [10.0, 4.0, 0.1, 1.0]
    # 0.1 is just a decade above 0.01, and no logarithm reaches 0
    assert bounds.is_logarithmic.tolist() == [True, False, False, False]


def test_the_point_of_a_study_is_where_its_values_are(study):
    bounds = bounds_of(study, ("slope", "mu"))
    assert bounds.point(study) == pytest.approx([1 / 3, math.log(3.0 / 0.5) / math.log(10.0 / 0.5)], rel=1e-12)
    moved = study.substitute(slope=2.5)
    assert bounds.point(moved) == pytest.approx([0.5, bounds.point(study)[1]], rel=1e-12)


def test_bounds_are_those_of_the_study_whatever_is_substituted(study):
    assert bounds_of(study.substitute(mu=1.0), ("mu",)).high.tolist() == [10.0]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ((), "must name at least one parameter"),
        (("mu", "slope", "mu"), "must name each once"),
        (("mu", "slop"), "There is no name `slop` in this study. Did you mean `slope`"),
        (("mass",), "must name parameters, but `mass` is a uniform of shape ()"),
        (("mu", "x0"), "must name parameters, but `x0` is a uniform of shape (2,)"),
        (("frequency",), "Parameter `frequency` must have finite bounds that depend on no other name"),
    ],
)
def test_bounds_refuse_what_is_no_parameter_with_bounds(study, names, message):
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the message has brackets and is compared below
        bounds_of(study, names)
    assert message in str(caught.value)


def test_bounds_of_what_is_drawn_list_the_parameters(study):
    with pytest.raises(ValueError, match="Parameters: mu, rho_inf, slope, amplitude, frequency"):
        bounds_of(study, ("mass",))
