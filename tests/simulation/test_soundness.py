"""Loops on which verdicts once were wrong, and their kin: whatever is short against a step, wherever it stands."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import eventful
import qsmc_jax as qj
import reference_sampled_loop as exact
from eventful import FX, GAUSSIAN, HALF_SINE, REF, SECH, STEP, Case, D, F, G, Push, at_ends, verdict_of
from qsmc_jax.base.module import float_field

PEAK = 1e-3  # of z = |sigma| / rho
TIGHT = (4.0, 3.0, 0.005)
METHODS = pytest.mark.parametrize("method", ["tsit5", pytest.param("rodas5p", marks=pytest.mark.slow)])


def solved(case, method="tsit5", ts=None, **settings):
    settings = qj.SolverSettings(method=method, **settings)
    return qj.simulate(
        case.loop(), list(case.x0), case.horizon, ts=at_ends(case.horizon) if ts is None else ts, settings=settings
    ).metrics


def agrees(case, method="tsit5", **settings):
    """Verdict, peak and time of leaving are SciPy's."""
    metrics, (left, peak, _) = solved(case, method, **settings), eventful.scipys(case)
    if math.isfinite(left):
        assert verdict_of(metrics) == "VIOLATED"
        assert float(metrics.violation_time) == pytest.approx(left, abs=1e-3)
    else:
        assert verdict_of(metrics) == "HELD"
        assert float(metrics.peak_ratio) == pytest.approx(peak, abs=PEAK)


def known(case, method, verdict, **metrics):
    """The answers once found for a loop, to the digits they are known to."""
    found = solved(case, method)
    assert verdict_of(found) == verdict
    for name, value in metrics.items():
        assert float(getattr(found, name)) == pytest.approx(value, rel=1e-3)


# The loops that were wrong: of order 1, all in one program.


@METHODS
def test_a_gain_that_reverses_for_ten_milliseconds(method):
    known(Case(funnel=TIGHT, horizon=100.0, where=G, height=3.0), method, "VIOLATED", violation_time=7.02267)


@METHODS
def test_a_gain_that_reverses_for_two(method):
    known(Case(funnel=TIGHT, where=G, height=10.0, width=0.002), method, "VIOLATED", violation_time=7.0284)


@METHODS
def test_a_shock_of_eleven_milliseconds(method):
    shock = Case(where=D, shape=HALF_SINE, at=7.03 + 0.0055, width=0.011, height=30.0)
    known(shock, method, "HELD", peak_ratio=0.97900, peak_u=30.3, total_variation_u=61.6)


@METHODS
def test_a_push_of_two_milliseconds(method):
    known(Case(where=D, at=7.08, width=0.002, height=60.0), method, "HELD", peak_ratio=0.989443, peak_u=60.2989)


@pytest.mark.slow
@pytest.mark.parametrize(("level", "peak", "variation"), [(20.0, 0.97707, 35.298), (25.0, 0.98089, 41.413)])
def test_a_large_constant_push(level, peak, variation):
    known(Case(level=level), "rodas5p", "HELD", peak_ratio=peak, total_variation_u=variation)


# Held within its region of stability the explicit method would take a million steps, ten times what it is given.
@pytest.mark.parametrize("method", ["rodas5p", "auto"])
@pytest.mark.parametrize(("level", "sign"), [(50.0, 1.0), (-50.0, -1.0)])
@pytest.mark.slow
def test_a_push_that_is_larger_still(level, sign, method):
    """The input rises to its peak once, and comes back to d, whatever the sign of the gain."""
    case = Case(level=level, x0=(math.copysign(0.5, level),), sign=sign)
    agrees(case, method)
    peak, first = 2.0 * float(solved(case, method).peak_u), math.tan(0.5 * math.pi * 0.5 / 4.05)
    assert float(solved(case, method).total_variation_u) == pytest.approx(peak - first - 50.0, rel=1e-4)


def test_an_unstable_drift():
    known(Case(level=1e-9, push_out=50.0, x0=(0.0,)), "tsit5", "HELD", peak_u=48.787)


@pytest.mark.slow
def test_a_wide_funnel():
    known(Case(funnel=(1e9, 3.0, 1e6), x0=(5e8,)), "auto", "HELD")


@pytest.mark.parametrize("margin", [1e-3, 1e-5, 1e-8, 1e-10, 1e-12])
@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["g > 0", "g < 0"])
def test_a_start_at_the_edge_of_the_funnel(margin, sign):
    case = Case(x0=(sign * 4.05 * (1.0 - margin),), sign=sign)
    found = solved(case)
    assert verdict_of(found) == "HELD"
    assert float(found.margin) == pytest.approx(margin, rel=1e-3 + 1e-15 / margin)


# Their kin.

WIDTHS = [1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 3e-2]
PLACES = {"near 0": 0.004, "near the end": 19.997, "at a round number": 10.0, "at a step's": 0.1, "at none": 7.0321}


QUICK = [(1e-6, 7.0321), (1e-5, 19.997), (1e-4, 0.004), (1e-3, 10.0), (1e-2, 0.1), (3e-2, 7.0321)]
SOME = pytest.mark.parametrize(
    ("width", "at"),
    [pytest.param(w, at, marks=[] if (w, at) in QUICK else pytest.mark.slow) for w in WIDTHS for at in PLACES.values()],
)


@METHODS
@SOME
def test_pushes_of_any_width_and_place(width, at, method):
    """Of an area that moves sigma by a good part of the funnel, or of what an input of 1e3 can push."""
    height = min(0.05 / width, 1e3)
    for where, shape, sign in ((D, GAUSSIAN, 1.0), (F, HALF_SINE, -1.0), (D, SECH, -1.0), (FX, GAUSSIAN, 1.0)):
        agrees(Case(where=where, shape=shape, at=at, width=width, height=height, sign=sign, size=0.5), method)


@METHODS
@SOME
def test_gains_that_dip_anywhere(width, at, method):
    for height, sign in ((0.9, 1.0), (1.5, -1.0), (0.05 / width + 1.0, 1.0)):
        agrees(Case(funnel=(4.0, 3.0, 0.02), where=G, at=at, width=width, height=height, sign=sign), method)


@pytest.mark.slow
@pytest.mark.parametrize(("n", "method"), [(2, "tsit5"), (3, "rodas5p")])
def test_higher_orders(n, method):
    for width in WIDTHS:
        for at in PLACES.values():
            for where, height in ((D, 0.05 / width), (G, 0.05 / width), (FX, 0.1 / width)):
                case = Case(n=n, x0=(0.1,) * n, where=where, at=at, width=width, height=min(height, 1e3), size=0.5)
                agrees(case, method)


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 3])
def test_references_with_a_bump(n):
    for width in WIDTHS[1:]:
        for shape in (GAUSSIAN, STEP):
            height = min(20.0 * width**n, 0.5)
            agrees(Case(n=n, x0=(0.1,) * n, where=REF, shape=shape, width=width, height=height, size=0.5))


@pytest.mark.slow
def test_in_physical_coordinates():
    for where, height in ((D, 30.0), (G, 3.0), (FX, 60.0)):
        agrees(Case(where=where, height=height, width=0.004, size=0.5), coordinates="physical")


@pytest.mark.slow
def test_a_short_push_in_a_long_run():
    for width in (1e-4, 1e-2):
        agrees(Case(horizon=1e4, at=6543.21, width=width, height=60.0), "rodas5p")


@pytest.mark.slow
def test_the_answer_does_not_depend_on_what_is_saved():
    dip = Case(funnel=TIGHT, where=G, height=3.0)
    push = Case(at=7.08, width=0.002, height=60.0)
    grids = [np.linspace(0.0, 20.0, count) for count in (2, 137, 2001)]
    left = [float(solved(dip, ts=ts).violation_time) for ts in grids]
    peaks = [float(solved(push, ts=ts).peak_ratio) for ts in grids]
    assert np.ptp(left) < 1e-6
    assert np.ptp(peaks) < 1e-6


def dipping(draw):
    at = draw.uniform("at", 3.0, 90.0)
    one = Case(funnel=TIGHT, horizon=100.0, where=G, at=at, height=3.0)
    return qj.Scenario(one.loop(), x0=[0.5], t1=100.0)


@pytest.mark.slow
@pytest.mark.parametrize("runs", [64, 512])
def test_a_study_of_a_dip_at_a_drawn_time_leaves_in_every_run(runs):
    found = qj.verify(qj.Study(dipping, bandwidth=0.01), runs, block=64)
    assert found.verdict == qj.Verdict.VIOLATED
    assert found.claims[0].violated == runs


# Functions that bend or jump undeclared, whatever they are written with; of order 1 with d their sum with nothing.

TABLE = np.random.default_rng(0).uniform(-1.0, 1.0, 40)
KNOTS = np.linspace(0.0, 20.0, 21)
BENDS = {
    "interp": (lambda t: jnp.interp(t, KNOTS, np.sin(KNOTS)), lambda t: np.interp(t, KNOTS, np.sin(KNOTS)), KNOTS),
    "elu": (
        lambda t: 0.05 * jax.nn.elu(t - 3.0),
        lambda t: 0.05 * (t - 3.0 if t > 3.0 else math.expm1(t - 3.0)),
        [3.0],
    ),
    "leaky": (lambda t: 0.05 * jax.nn.leaky_relu(t - 3.0), lambda t: 0.05 * max(t - 3.0, 0.01 * (t - 3.0)), [3.0]),
    "selu": (
        lambda t: 0.05 * jax.nn.selu(t - 3.0),
        lambda t: 0.05 * 1.0507009873554805 * (t - 3.0 if t > 3.0 else 1.6732632423543772 * math.expm1(t - 3.0)),
        [3.0],
    ),
    "logsumexp": (
        lambda t: 0.05 * jax.nn.logsumexp(jnp.stack([t, 6.0 - t])),
        lambda t: 0.05 * np.logaddexp(t, 6.0 - t),
        [],
    ),
    "joined": (
        lambda t: 0.02 * jnp.where(t < 3.0, t**2, 6.0 * t - 9.0),
        lambda t: 0.02 * (t**2 if t < 3.0 else 6.0 * t - 9.0),
        [3.0],
    ),
}
TURNS = np.pi * np.arange(8)
JUMPS = {
    "arctan of tan": (lambda t: jnp.arctan(jnp.tan(t)), lambda t: math.atan(math.tan(t)), TURNS + 0.5 * np.pi),
    "arctan2": (
        lambda t: 0.3 * jnp.arctan2(jnp.sin(t), jnp.cos(t)),
        lambda t: 0.3 * math.atan2(math.sin(t), math.cos(t)),
        TURNS,
    ),
    "sine by its size": (
        lambda t: 0.5 * jnp.sin(t + 0.5) / jnp.abs(jnp.sin(t + 0.5)),
        lambda t: 0.5 * np.sign(math.sin(t + 0.5)),
        TURNS - 0.5,
    ),
    "remainder": (lambda t: jnp.mod(t, 1.3), lambda t: t % 1.3, 1.3 * np.arange(16)),
    "floor": (lambda t: 0.1 * jnp.floor(t), lambda t: 0.1 * math.floor(t), np.arange(20.0)),
    "table": (
        lambda t: jnp.asarray(TABLE)[jnp.asarray(t / 0.5, int)],
        lambda t: TABLE[min(int(t / 0.5), 39)],
        0.5 * np.arange(40),
    ),
}


class OneOf(qj.AbstractDisturbance):
    """One of some functions of time, by its number, so that all share a program."""

    functions: tuple = eqx.field(static=True)
    number: Float[Array, ""] = float_field()

    def __call__(self, t):
        return jax.lax.switch(
            jnp.asarray(self.number, int), [lambda t, f=f: jnp.asarray(f(t), float) for f in self.functions], t
        )

    @property
    def bound(self):
        return 2.0

    @property
    def break_times(self):
        return []


ALL = {name: tuple(f for f, _, _ in group.values()) for name, group in (("bends", BENDS), ("jumps", JUMPS))}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("group", "number"), [(n, k) for n, fs in ALL.items() for k in range(len(fs))], ids=[*BENDS, *JUMPS]
)
def test_functions_that_bend_or_jump_need_no_declaration(group, number):
    """Each group by a method of its own: what a function may hide is worked out alike for both."""
    method = {"bends": "tsit5", "jumps": "rodas5p"}[group]
    loop = dataclasses.replace(Case().loop(), disturbance=OneOf(ALL[group], number))
    metrics = qj.simulate(loop, [0.5], 20.0, ts=at_ends(20.0), settings=qj.SolverSettings(method=method)).metrics
    _, d, marks = list((BENDS if group == "bends" else JUMPS).values())[number]
    assert verdict_of(metrics) == "HELD"
    assert float(metrics.peak_ratio) == pytest.approx(eventful.scipys_peak(d, marks), abs=PEAK)


# The sampled loop: what happens between two samples.

PERIOD = 0.05


def sampled(case, horizon=3.0, unmatched=()):
    """Metrics of a sampled loop, and those of the integration event by event."""
    implementation = qj.Implementation(sample_period=PERIOD, unmatched=unmatched)
    run = qj.simulate(case.loop(implementation), list(case.x0), horizon, bandwidth=1.0, ts=at_ends(horizon)).metrics
    twin = eventful.sampled_twin(case, PERIOD)
    return run, exact.simulate(twin, case.x0, horizon, 1.0).metrics


SAMPLED = {
    "push": dict(where=D, height=1.0),
    "short push": dict(where=F, height=300.0, width=1e-4),
    "shock": dict(where=FX, height=100.0, shape=HALF_SINE, size=1.0),
    "dip": dict(where=G, height=40.0, level=1.0),
    "short dip": dict(where=G, height=2000.0, width=2e-4, level=1.0),
    "turn": dict(where=REF, height=0.15),
    "short turn": dict(where=REF, height=-0.3, width=1e-4),
}


# A reference that turns is another program.
@pytest.mark.parametrize(
    "numbers",
    [pytest.param(one, marks=pytest.mark.slow if one["where"] == REF else []) for one in SAMPLED.values()],
    ids=SAMPLED,
)
def test_what_happens_inside_a_hold_is_met(numbers):
    case = Case(**{"funnel": (4.0, 3.0, 0.4), "at": 2.013, "width": 2e-3, **numbers})
    run, truth = sampled(case)
    assert verdict_of(run) == ("HELD" if truth.peak_ratio < 1.0 else "VIOLATED")
    if truth.peak_ratio < 1e3:  # else the run is lost, and given up
        assert float(run.peak_ratio) == pytest.approx(truth.peak_ratio, rel=PEAK)
    assert float(run.violation_time) == pytest.approx(truth.violation_time, abs=1e-5)


@pytest.mark.parametrize(("level", "sign"), [(50.0, 1.0), (-50.0, -1.0), (25.0, -1.0)])
def test_a_large_constant_push_throws_a_sampled_loop_out(level, sign):
    run, truth = sampled(Case(funnel=(4.0, 3.0, 0.4), level=level, sign=sign))
    assert truth.peak_ratio > 1.0
    assert verdict_of(run) == "VIOLATED"
    assert float(run.violation_time) == pytest.approx(truth.violation_time, abs=1e-5)


@pytest.mark.slow
def test_an_unmatched_push_inside_a_hold_is_met():
    """Nothing answers before the next sample: x_1 is moved by the push's area, and sigma by c as much."""
    push = Push(0.0, eventful.Feature(GAUSSIAN, 2.013, 1e-3, 200.0))
    case = Case(n=2, x0=(0.0, 0.0), level=0.0, funnel=(4.0, 3.0, 0.4))
    implementation = qj.Implementation(sample_period=PERIOD, unmatched=(push,))
    run = qj.simulate(case.loop(implementation), [0.0, 0.0], 2.04, bandwidth=1.0, ts=at_ends(2.04)).metrics
    height = 2.0 * 200.0 * 1e-3 * math.sqrt(math.pi)
    assert verdict_of(run) == "VIOLATED"
    assert float(run.peak_ratio) == pytest.approx(height / (4.0 * math.exp(-3.0 * 2.017) + 0.4), rel=0.01)


def pushed(draw):
    """Pushes by 3.5 inside a hold, of which a funnel of 2 holds none."""
    width = draw.uniform("width", 5e-4, 2e-3)
    at = PERIOD * (draw.choice("hold", [40.0, 41.0, 57.0]) + draw.uniform("place", 0.2, 0.8))
    one = Case(funnel=(4.0, 3.0, 2.0), at=at, width=width, height=3.5 / (width * math.sqrt(math.pi)))
    return qj.Scenario(one.loop(qj.Implementation(sample_period=PERIOD)), x0=[0.5], t1=5.0)


@pytest.mark.parametrize("runs", [64, pytest.param(512, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_a_study_of_a_push_inside_a_hold_leaves_in_every_run(runs):
    found = qj.verify(qj.Study(pushed, bandwidth=2.5), runs, block=64)
    assert found.verdict == qj.Verdict.VIOLATED
    assert found.claims[0].violated == runs


@pytest.mark.slow
def test_a_function_in_a_field_is_solved():
    """What is part of a loop and no number, such as the function of a reference, stands in no one's way."""
    loop = dataclasses.replace(Case().loop(), reference=qj.references.Smooth(lambda t: 0.5 * jnp.tanh(t - 5.0)))
    metrics = qj.simulate(loop, [0.5], 20.0, ts=at_ends(20.0)).metrics
    assert verdict_of(metrics) == "HELD"
