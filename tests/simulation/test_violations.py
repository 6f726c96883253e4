"""No violation missed: loops whose escape from the funnel is known in closed form (`problems.VIOLATED`)."""

import functools as ft
import math
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import problems
import qsmc_jax as qj
from qsmc_jax.base.module import float_field
from qsmc_jax.study.sampling import Random
from qsmc_jax.study.tangents import differentiate

# One compiled program each.
ROUTES = {
    "funnel": ft.partial(qj.SolverSettings),
    "physical": ft.partial(qj.SolverSettings, coordinates="physical"),
    "rodas5p": ft.partial(qj.SolverSettings, method="rodas5p"),
}
# Where the gain has the wrong sign nothing damps the errors of the steps: they add up to thirty times the tolerance.
DEFAULT_ATOL, TIGHT_ATOL = 5e-5, 1e-6
TIGHT = {"rtol": qj.tight().rtol, "atol": qj.tight().atol}
# The energy is not under error control: its error is that of the rule on steps made for the coordinates, and those of
# the physical route are long where the input, but not the state, falls steeply.
ENERGY_RTOL = {"funnel": 1e-4, "physical": 1e-2, "rodas5p": 5e-6}


@pytest.fixture(params=ROUTES, scope="module")
def route(request):
    return request.param


@pytest.mark.parametrize("problem", problems.VIOLATED, ids=str)
@pytest.mark.parametrize(("preset", "atol"), [({}, DEFAULT_ATOL), (TIGHT, TIGHT_ATOL)], ids=["default", "tight"])
def test_escape_is_found_when_it_happens(route, problem, preset, atol):
    run = problem.simulate(ROUTES[route](**preset))
    assert run.verdict == qj.Verdict.VIOLATED
    assert run.outcome == qj.Outcome.LEFT_FUNNEL
    assert float(run.metrics.violation_time) == pytest.approx(problem.answers["violation_time"], abs=atol, rel=0)


@pytest.mark.parametrize("problem", problems.HELD, ids=str)
def test_loop_that_stays_inside_is_held_with_the_metrics_of_its_closed_form(route, problem):
    run = problem.simulate(ROUTES[route]())
    assert run.verdict == qj.Verdict.HELD
    for name, answer in problem.answers.items():
        found = run.x[-1, 0] if name == "x1" else float(getattr(run.metrics, name))
        rtol = {"energy_u": ENERGY_RTOL[route], "reach_time": 1e-4}.get(name, 1e-5)
        assert found == pytest.approx(answer, rel=rtol), name


@pytest.fixture(scope="module")
def escaped():
    return problems.VIOLATED[0].simulate()


@pytest.mark.parametrize(
    ("metric", "value"),
    {
        "verdict": qj.Verdict.VIOLATED,
        "verdict_reaching": qj.Verdict.VIOLATED,
        "verdict_tracking": qj.Verdict.VIOLATED,
        "peak_ratio": 1.0,
        "margin": 0.0,
        "peak_u": math.inf,
        "max_u": math.inf,
        "reach_time": math.inf,
        "settle_time": math.inf,
        "least_gain": -1.0,
    }.items(),
)
def test_metrics_of_an_escape(escaped, metric, value):
    assert float(getattr(escaped.metrics, metric)) == value


def test_an_input_that_grew_upwards_has_no_known_least_value(escaped):
    assert math.isnan(escaped.metrics.min_u)


def test_signals_end_with_the_escape(escaped):
    ended = escaped.ts > float(escaped.metrics.violation_time)
    assert np.all(np.isnan(escaped.sigma[ended]))
    assert np.all(np.isfinite(escaped.sigma[~ended]))


def test_advice_names_the_reason(escaped):
    assert "gain_sign" in str(escaped)
    assert "least_gain" in escaped.outcome.advice


def test_gain_of_the_wrong_sign_for_a_while_shows_in_the_least_gain():
    problem = problems.HELD[2]
    run = problem.simulate()
    assert run.verdict == qj.Verdict.HELD
    # Met at the ends of steps only, so not quite the least there is.
    assert float(run.metrics.least_gain) == pytest.approx(-float(problem.loop.plant.gain_scale), rel=0.05)


def wrong_sign(draw):
    """Loops of order 1 in a constant funnel whose gain has the wrong sign, from anywhere in the funnel."""
    gain, z0 = draw.uniform("gain", 0.5, 2.0), draw.uniform("z0", 0.01, 0.999)
    loop = problems.scalar_loop(problems.STILL, draw.parameter("sign", -1.0, bounds=(-1.0, 1.0)), gain_scale=gain)
    return qj.Scenario(loop, x0=[z0 * problems.WIDTH], t1=20.0)


@pytest.fixture(scope="module")
def wrong_sign_runs():
    return solve_lanes({})


def solve_lanes(preset, **values):
    study = qj.Study(wrong_sign, bandwidth=problems.STILL_BANDWIDTH).substitute(**values)
    return qj.monte_carlo(study, 256, settings=qj.SolverSettings(**preset), block=64)


@pytest.mark.parametrize(("preset", "atol"), [({}, DEFAULT_ATOL), (TIGHT, TIGHT_ATOL)], ids=["default", "tight"])
@pytest.mark.slow
def test_every_lane_escapes_when_it_must(preset, atol):
    runs = solve_lanes(preset)
    times = [problems.escape_time(z0, gain) for z0, gain in zip(runs["z0"], runs["gain"], strict=True)]
    assert runs.counts()[qj.Verdict.VIOLATED] == len(runs)
    np.testing.assert_allclose(runs["violation_time"], times, rtol=0, atol=atol)


def test_every_lane_names_the_broken_premise(wrong_sign_runs):
    np.testing.assert_allclose(wrong_sign_runs["least_gain"], -wrong_sign_runs["gain"])


def test_right_sign_leaves_every_lane_held():
    runs = solve_lanes({}, sign=1.0)
    assert runs.counts()[qj.Verdict.HELD] == len(runs)
    np.testing.assert_allclose(runs["peak_ratio"], runs["z0"], rtol=1e-9)


def wrong_sign_from(draw):
    """The same, but that gain and start are parameters, and what is drawn scales the start."""
    gain, start = draw.parameter("gain", 1.0, bounds=(0.5, 2.0)), draw.parameter("start", 1.0, bounds=(0.5, 1.0))
    loop = problems.scalar_loop(problems.STILL, draw.parameter("sign", -1.0, bounds=(-1.0, 1.0)), gain_scale=gain)
    return qj.Scenario(loop, x0=[draw.uniform("z0", 0.05, 0.98) * start * problems.WIDTH], t1=20.0)


@pytest.mark.slow
# Near the end s grows without bound and what it is off with it: the derivative has some digits less than the time.
@pytest.mark.parametrize(
    ("mode", "preset", "rtol"),
    [
        ("forward", {}, 1e-2),
        pytest.param("forward", TIGHT, 1e-4, marks=pytest.mark.slow),
        pytest.param("reverse", {}, 1e-2, marks=pytest.mark.slow),
        pytest.param("forward", {"method": "rodas5p"}, 1e-2, marks=pytest.mark.slow),
    ],
)
def test_time_of_escape_has_the_derivative_of_its_closed_form(mode, preset, rtol):
    """With t = -ln(sin(pi z / 2)) / k, k = pi g / (2 rho): dt/dg = -t / g, dt/dz = -(pi / 2) cot(pi z / 2) / k."""
    study = qj.Study(wrong_sign_from, bandwidth=problems.STILL_BANDWIDTH)
    settings = qj.SolverSettings(**preset, adjoint=mode)
    asked = {"names": ("gain", "start"), "metrics": ("violation_time",), "settings": settings, "block": 64}
    found = differentiate(study, np.arange(64), 0, **asked)
    z = 0.05 + 0.93 * Random().points(0, np.arange(64), study.dimension)[:, 0]
    by_gain = [-problems.escape_time(each) for each in z]
    by_start = -z * math.pi / 2 / np.tan(math.pi * z / 2) / (math.pi / (2 * problems.WIDTH))
    assert found.is_known.all()
    np.testing.assert_allclose(found.jacobian[:, 0, 0], by_gain, rtol=rtol)
    np.testing.assert_allclose(found.jacobian[:, 0, 1], by_start, rtol=rtol, atol=1e-4)
    held = differentiate(study.substitute(sign=1.0), np.arange(64), 0, **asked)
    assert np.isinf(held.values).all()
    assert not held.jacobian.any()


@pytest.mark.parametrize("method", ["tsit5", pytest.param("rodas4", marks=pytest.mark.slow), "rodas5p"])
@pytest.mark.parametrize("gain", [200.0, 2e4])
def test_growth_from_rest_is_not_damped_away(method, gain):
    """g = b cos t, tiny d, stiff: at rest until g turns at pi / 2, and out of the funnel soon after, d growing like
    exp(k (t - pi/2)^2 / 2), k = pi b / (2 rho): within sqrt(2 ln(rho k / d) / k) and half as much again."""
    level = 1e-3
    loop = problems.scalar_loop(problems.STILL, gain_scale=gain, gain_frequency=1.0, level=level)
    settings = qj.SolverSettings(method=method)
    run = qj.simulate(loop, (0.5,), 5.0, bandwidth=problems.STILL_BANDWIDTH, settings=settings)
    k = math.pi * gain / (2 * problems.WIDTH)
    assert run.verdict == qj.Verdict.VIOLATED
    late = math.sqrt(2 * math.log(problems.WIDTH * k / level) / k)
    assert math.pi / 2 < float(run.metrics.violation_time) < math.pi / 2 + 1.5 * late


class Dipping(qj.AbstractPlant):
    """x' = g u + d with g = b (1 - 3 exp(-((t - 3) / width)^2)): negative within 1.05 widths of t = 3."""

    width: Float[Array, ""] = float_field()
    strength: Float[Array, ""] = float_field()
    order: ClassVar[int] = 1

    def drift(self, t, x):
        return 0.0 * x[0]

    def gain(self, t, x):
        return self.strength * (1.0 - 3.0 * jnp.exp(-(((t - 3.0) / self.width) ** 2)))


@pytest.mark.parametrize("rtol", [1e-3, 1e-4, 1e-6])
@pytest.mark.parametrize("width", [0.3, 0.1, 0.03])
def test_no_short_loss_of_the_gains_sign_is_stepped_over(width, rtol):
    """At rest in a stiff loop an implicit method would take steps longer than the dip, and damp what grows in it.

    In the dip sigma grows at some 2e5 a second: it can only leave, and does so soon after the gain turns.
    """
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, 1.0, 0.1))
    loop = qj.ClosedLoop(Dipping(width, 2e4), qj.references.Constant(0.0), qj.disturbances.Sine(0.1, 0.3), control)
    run = qj.simulate(loop, [0.05], 20.0, bandwidth=0.2, settings=qj.SolverSettings(rtol=rtol, method="rodas5p"))
    turn = 3.0 - width * math.sqrt(math.log(3.0))
    assert run.verdict == qj.Verdict.VIOLATED
    assert turn < float(run.metrics.violation_time) < turn + 0.1 * width


def test_the_comparison_bound_has_the_motion_of_the_funnel():
    """Without a push w = 0; where z is highest z' = 0, so g u = z rho': the bound is |rho'| / g, |u| is z times it."""
    gain, funnel = 0.5, qj.Funnel(1.0, 3.0, 0.5)
    run = qj.simulate(problems.scalar_loop(funnel, gain_scale=gain), [0.3], 3.0, bandwidth=0.75)
    time, ratio = float(run.metrics.peak_time), float(run.metrics.peak_ratio)
    speed = 3.0 * math.exp(-3.0 * time)
    assert time > 0.01
    assert float(run.metrics.peak_u_bound) == pytest.approx(speed / gain, rel=1e-4)
    assert float(run.metrics.peak_u) == pytest.approx(ratio * speed / gain, rel=1e-3)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_start_outside_is_inadmissible_and_takes_no_step(side):
    loop = problems.scalar_loop(problems.STILL)
    run = qj.simulate(loop, [1.5 * side * problems.WIDTH], 20.0, bandwidth=problems.STILL_BANDWIDTH)
    assert run.verdict == qj.Verdict.INADMISSIBLE
    assert run.outcome == qj.Outcome.STARTED_OUTSIDE
    assert int(run.metrics.steps) == 0
    assert np.isnan(float(run.metrics.peak_ratio))
    assert np.all(np.isnan(run.x))


def test_premise_is_strict_at_the_edge():
    loop = problems.scalar_loop(problems.STILL)
    starts = ((1 - 1e-6) * problems.WIDTH, problems.WIDTH)
    runs = [qj.simulate(loop, [x0], 20.0, bandwidth=problems.STILL_BANDWIDTH) for x0 in starts]
    assert [run.verdict for run in runs] == [qj.Verdict.HELD, qj.Verdict.INADMISSIBLE]


class Fading(qj.AbstractPlant):
    """An integrator whose gain falls slowly through zero at a given time."""

    gone: Float[Array, ""] = float_field()
    fall: Float[Array, ""] = float_field()
    order: ClassVar[int] = 1

    def drift(self, t, x):
        return 0.0 * x[0]

    def gain(self, t, x):
        return self.fall * (self.gone - t)


@pytest.mark.parametrize(
    ("fall", "push", "method"),
    [(fall, 1.5, method) for fall in (0.2, 1.0) for method in ("tsit5", "rodas5p")]
    + [(0.01, push, "rodas5p") for push in (-1.5, 15.0)],  # stiff loops
)
def test_a_gain_that_fades_slowly_is_a_violation_where_it_is_gone(fall, push, method):
    # While there is any gain the law holds the push; what is left of the funnel then, some u e^-u, is gone at once.
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(4.0, 3.0, 0.05))
    loop = qj.ClosedLoop(Fading(3.0, fall), qj.references.Constant(0.0), qj.disturbances.Constant(push), control)
    run = qj.simulate(loop, [0.1], 10.0, settings=qj.SolverSettings(method=method))
    assert run.verdict == qj.Verdict.VIOLATED
    assert float(run.metrics.violation_time) == pytest.approx(3.0, abs=1e-6)
