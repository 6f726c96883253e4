"""Loops with several inputs: against scalar loops, closed forms, SciPy, and Lyapunov's inequality."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

import qsmc_jax as qj
from own_plants import UNTOUCHED, Pair, Scalar, beside_scalar_runs
from qsmc_jax.base.errors import InputError
from qsmc_jax.simulation.trajectory_plots import plot_trajectory
from qsmc_jax.verification.tiers import Tiers

T1, WAVES = 4.0, ((0.5, 2.0), (0.8, 1.1))
FUNNELS = (4.0, 1.5, 0.2), (3.0, 1.0, 0.3)
ROTATED = lambda degrees: [  # noqa: E731
    [math.cos(math.radians(degrees)), -math.sin(math.radians(degrees))],
    [math.sin(math.radians(degrees)), math.cos(math.radians(degrees))],
]


def laws(funnels=FUNNELS, **options):
    """A law for each funnel."""
    return tuple(qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(*each), **options) for each in funnels)


def pair(matrix, coupling=0.0, pushes=(0.5, 0.4), controls=None):
    """A loop of both, and references and disturbances that it has."""
    (b11, b12), (b21, b22) = matrix
    references = tuple(qj.references.SumOfSines([a], [w]) for a, w in WAVES)
    disturbances = tuple(qj.disturbances.Sine(size, 3.0 + i) for i, size in enumerate(pushes))
    controls = laws(is_scaled=True) if controls is None else controls
    return qj.MultivariableLoop(Pair(coupling, b11, b12, b21, b22), references, disturbances, controls)


def by_scipy(loop, x0, is_scaled=True):
    """Times, sigma/rho and inputs of both channels."""
    plant = loop.plant
    b = np.array([[plant.b11, plant.b12], [plant.b21, plant.b22]])
    sizes = [float(each.amplitude) for each in loop.disturbances]

    def read(t, x):
        rho = np.array([r0 * np.exp(-mu * t) + r for r0, mu, r in FUNNELS])
        z = (x - np.array([a * np.sin(w * t) for a, w in WAVES])) / rho
        return z, -np.tan(0.5 * np.pi * z) / (rho if is_scaled else 1.0)

    def rate(t, x):
        push = np.array([size * np.sin((3.0 + i) * t) for i, size in enumerate(sizes)])
        own = float(plant.coupling) * np.array([np.sin(x[1]), -x[0]])
        return own + push + b @ read(t, x)[1]

    found = scipy.integrate.solve_ivp(rate, (0.0, T1), x0, "Radau", dense_output=True, rtol=1e-10, atol=1e-12)
    ts = np.linspace(0.0, T1, 40_001)
    return ts, *read(ts, found.sol(ts))


@pytest.mark.parametrize(
    ("matrix", "coupling", "is_scaled"),
    [(ROTATED(60.0), 0.7, True), ([[2.0, 0.9], [-0.4, 1.0]], 1.5, True), ([[1.0, 0.3], [0.2, 1.5]], 0.4, False)],
    ids=["rotated", "unlike", "unscaled"],
)
def test_both_channels_are_what_scipy_makes_of_them(matrix, coupling, is_scaled):
    loop, x0 = pair(matrix, coupling, controls=laws(is_scaled=is_scaled)), [1.5, -0.8]
    run = qj.simulate(loop, x0, T1)
    ts, z, u = by_scipy(loop, x0, is_scaled)
    assert {verdict.name for verdict in run.verdicts.values()} == {"HELD"}
    f = run.metrics.channels
    for i in range(2):
        assert float(f[f"peak_ratio[{i}]"]) == pytest.approx(np.abs(z[i]).max(), rel=1e-6)
        assert float(f[f"max_u[{i}]"]) == pytest.approx(u[i].max(), abs=1e-5 * np.abs(u).max())
        assert float(f[f"min_u[{i}]"]) == pytest.approx(u[i].min(), abs=1e-5 * np.abs(u).max())
    assert float(run.metrics.peak_ratio) == pytest.approx(np.abs(z).max(), rel=1e-6)
    assert float(run.metrics.energy_u) == pytest.approx(np.trapezoid((u**2).sum(axis=0), ts), rel=1e-5)
    value = np.log1p(np.tan(0.5 * np.pi * z) ** 2).sum(axis=0) / np.pi
    assert float(run.metrics.peak_barrier) == pytest.approx(value.max(), rel=1e-5)
    assert float(run.metrics.peak_barrier) <= float(run.metrics.barrier_bound) * (1.0 + 1e-6)
    np.testing.assert_allclose(run.sigma[-1] / run.rho[-1], z[:, -1], rtol=1e-5)


@pytest.mark.slow
def test_channels_that_do_not_touch_are_scalar_runs():
    loop, x0, tight = pair(np.diag(UNTOUCHED)), [1.5, -0.8], qj.SolverSettings(rtol=1e-11, method="rodas5p")
    run, scalar_runs = beside_scalar_runs(loop, UNTOUCHED, x0, T1, tight)
    for i, alone in enumerate(scalar_runs):
        assert float(run.metrics.peak_errors[i]) == pytest.approx(float(alone.metrics.peak_errors[0]), rel=1e-8)


@pytest.mark.parametrize(("first", "ratios"), [(0, (0.6, 0.2)), (1, (-0.1, -0.7))])
def test_turned_around_they_leave_at_the_closed_form(first, ratios):
    widths = 2.0, 1.5
    controls = laws([(width - 1e-6, 1e-9, 1e-6) for width in widths], is_scaled=True)
    calm, rest = (qj.disturbances.Zero(),) * 2, (qj.references.Constant(0.0),) * 2
    (b11, b12), (b21, b22) = ROTATED(180.0)
    loop = qj.MultivariableLoop(Pair(0.0, b11, b12, b21, b22), rest, calm, controls)
    x0 = [ratio * width for ratio, width in zip(ratios, widths, strict=True)]
    run = qj.simulate(loop, x0, 10.0, bandwidth=1.0)
    width, ratio = widths[first], ratios[first]
    # sigma' = tan(pi sigma / 2 rho) / rho: the sine grows by exp(pi t / 2 rho^2).
    leaves = width**2 * 2.0 / math.pi * math.log(1.0 / math.sin(0.5 * math.pi * abs(ratio)))
    assert float(run.metrics.violation_time) == pytest.approx(leaves, rel=1e-5)
    assert run.verdicts["funnel"].name == run.verdicts[f"funnel[{first}]"].name == "VIOLATED"
    assert run.verdicts[f"funnel[{1 - first}]"].name == "UNDECIDED"
    assert math.isinf(run.metrics.channels[f"peak_u[{first}]"])
    assert math.isinf(run.metrics.barrier_bound)


def scenario(draw):
    """Any matrix with a definite symmetric part, any start, gains and pushes."""
    least, skew = draw.uniform("least", 0.2, 1.0, shape=(2,)), draw.uniform("skew", -3.0, 3.0)
    turn, gain = draw.uniform("turn", 0.0, math.pi), draw.uniform("gain", 0.5, 3.0, shape=(2,))
    c, s = jnp.cos(turn), jnp.sin(turn)
    off = c * s * (least[0] - least[1])
    b11, b22 = c**2 * least[0] + s**2 * least[1], s**2 * least[0] + c**2 * least[1]
    start, pushes = draw.uniform("start", -0.9, 0.9, shape=(2,)), draw.uniform("push", 0.0, 5.0, shape=(2,))
    # B diag(K) is the matrix with this symmetric part.
    matrix = (b11 / gain[0], (off - skew) / gain[1]), ((off + skew) / gain[0], b22 / gain[1])
    controls = tuple(
        dataclasses.replace(law, gain=each) for law, each in zip(laws(is_scaled=True), (gain[0], gain[1]), strict=True)
    )
    loop = pair(matrix, draw.uniform("coupling", 0.0, 3.0), pushes=(pushes[0], pushes[1]), controls=controls)
    return qj.Scenario(loop, x0=[start[0] * 4.2, start[1] * 3.3], t1=T1)


CALM = 30.0
STUDY = qj.Study(
    scenario,
    bandwidth=(0.5, 0.7),
    metrics=[qj.metrics.Peak("both", lambda s: jnp.abs(s.u[0]) + jnp.abs(s.u[1]))],
    requirements={"calm": qj.always(lambda s: CALM - jnp.abs(s.u[0]))},
)


def test_no_run_passes_the_bound_of_lyapunov():
    runs = qj.monte_carlo(STUDY, 2048, block=1024)
    assert (runs["verdict"] == qj.Verdict.HELD).all()
    part = runs["peak_barrier"] / runs["barrier_bound"]
    assert part.max() <= 1.0 + 1e-6
    assert np.quantile(part, 0.5) > 0.5  # a bound that says something
    assert (runs["peak_ratio"] == np.maximum(runs["peak_ratio[0]"], runs["peak_ratio[1]"])).all()
    assert (runs["margin"] == np.minimum(runs["margin[0]"], runs["margin[1]"])).all()
    assert runs.claims[:3] == ("funnel", "reaching", "tracking")
    assert {"funnel[0]", "reaching[1]", "tracking[1]", "calm"} <= set(runs.claims)
    alone = runs["peak_u[0]"], runs["peak_u[1]"]
    assert (runs["both"] <= (alone[0] + alone[1]) * (1.0 + 1e-4)).all()
    assert (runs["both"] >= np.maximum(*alone) * (1.0 - 1e-4)).all()
    np.testing.assert_allclose(runs["margin_calm"], CALM - alone[0], rtol=1e-3, atol=1e-3 * CALM)
    sure = np.abs(alone[0] - CALM) > 1e-3 * CALM
    assert (runs["verdict_calm"][sure] == np.where(alone[0] > CALM, qj.Verdict.VIOLATED, qj.Verdict.HELD)[sure]).all()
    assert 0 < (alone[0] > CALM).sum() < len(runs)


@pytest.mark.parametrize("method", ["auto", "tsit5", "rodas4", "rodas5p"])
def test_no_method_decides_twice(method):
    first, firmer, second, third = (each.method for each in Tiers.of(STUDY, qj.SolverSettings(method=method)).settings)
    assert first == firmer == method
    assert second not in (method, *(("tsit5", "rodas5p") if method == "auto" else ()))
    assert third != second


WITH_A_SURFACE = qj.QuasiSlidingControl(qj.SlidingSurface([1.0]), qj.Funnel(*FUNNELS[1]))
WRONG = {
    "definite": (lambda: qj.simulate(pair([[1.0, 3.0], [3.0, 1.0]]), [0.0, 0.0], T1), "definite symmetric part"),
    "controls": (lambda: pair([[1.0, 0.0], [0.0, 1.0]], controls=laws()[:1]), "`controls` must be a tuple with one"),
    "plant": (
        lambda: qj.MultivariableLoop(Scalar(), (qj.references.Constant(0.0),), (qj.disturbances.Zero(),), laws()[:1]),
        "must have several inputs",
    ),
    "surface": (
        lambda: pair([[1.0, 0.0], [0.0, 1.0]], controls=(laws()[0], WITH_A_SURFACE)),
        "must have 0 coefficients",
    ),
    "bandwidth": (
        lambda: qj.simulate(pair([[1.0, 0.0], [0.0, 1.0]]), [0.0, 0.0], T1, bandwidth=(0.5, 0.7, 0.9)),
        "one for each of the 2 channels",
    ),
    "C2": (
        lambda: qj.simulate(pair([[1.0, 0.0], [0.0, 1.0]]), [0.0, 0.0], T1, bandwidth=(0.5, 0.1)),
        "`bandwidth` must lie strictly between",
    ),
    "coordinates": (
        lambda: qj.simulate(
            pair([[1.0, 0.0], [0.0, 1.0]]), [0.0, 0.0], T1, settings=qj.SolverSettings(coordinates="physical")
        ),
        'must be "funnel"',
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_named(name):
    make, says = WRONG[name]
    with pytest.raises(InputError, match=says):
        make()


def test_the_wrong_shape_of_a_method_is_named():
    class Short(Pair.__bases__[0]):
        states, relative_degrees = 2, (1, 1)
        vector_field = lambda self, t, x, d: (d[0], d[1])  # noqa: E731
        input_matrix = lambda self, t, x: ((1.0, 0.0), (0.0, 1.0))  # noqa: E731
        output = lambda self, t, x: (x[0],)  # noqa: E731

    with pytest.raises(InputError, match="must return 2 numbers, one a channel"):
        Short()


def test_the_relative_degree_of_each_output_is_looked_at():
    class Late(qj.AbstractStateSpace):
        states, relative_degrees = 3, (1, 1)

        def vector_field(self, t, x, d):
            return d[0], x[2], d[1]

        def input_matrix(self, t, x):
            return (1.0, 0.0), (0.0, 0.0), (0.0, 1.0)

        def output(self, t, x):
            return x[0], x[1]

    rest, calm = (qj.references.Constant(0.0),) * 2, (qj.disturbances.Zero(),) * 2
    loop = qj.MultivariableLoop(Late(), rest, calm, laws())
    with pytest.raises(InputError, match="for output 1"):
        qj.simulate(loop, [0.0, 0.0, 0.0], T1)


@pytest.mark.parametrize("x0", [[4.5, 0.0], [0.0, -3.4]])
def test_a_run_that_starts_outside_in_one_channel_is_not_begun(x0):
    run = qj.simulate(pair(ROTATED(60.0)), x0, T1)
    assert run.outcome == qj.Outcome.STARTED_OUTSIDE
    assert {verdict.name for verdict in run.verdicts.values()} == {"INADMISSIBLE"}


def test_a_dataset_has_each_channel():
    pytest.importorskip("xarray")
    run = qj.simulate(pair(ROTATED(60.0), 0.7), [1.5, -0.8], T1)
    dimensions = {name: each.dims for name, each in run.to_xarray().items()}
    assert dimensions["u"] == ("t", "channel")
    assert dimensions["e"] == ("t", "error")


def test_what_is_told_of_several_channels_has_each(tmp_path):
    loop = pair(ROTATED(60.0), 0.7)
    run = qj.simulate(loop, [1.5, -0.8], T1)
    assert "channel 1: HELD" in str(run)
    assert "together: sup V" in str(run)
    assert {"x[1]", "e[1]", "sigma[1]", "rho[0]", "u[1]", "d[0]"} <= set(run.columns())
    qj.save(run, tmp_path / "run.npz")
    again = qj.load(tmp_path / "run.npz", of=loop)
    np.testing.assert_array_equal(again.sigma, run.sigma)
    assert again.verdicts == run.verdicts
    lines = [line.get_ydata() for line in run.plot_funnel().lines]
    low, high = run.edges
    for i in range(2):
        np.testing.assert_allclose(lines[i], (2.0 * run.sigma[:, i] - low[:, i] - high[:, i]) / (high - low)[:, i])
    assert len(run.plot()) == 4
    axes = plot_trajectory(run, again, labels=("before", "after"))
    named = [text.get_text() for text in axes[0].get_legend().get_texts()]
    assert named == ["channel 0, before", "channel 1, before", "channel 0, after", "channel 1, after", "$x_{des}$"]
    with pytest.raises(InputError, match="order 2"):
        run.plot_phase_plane()
