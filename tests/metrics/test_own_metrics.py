"""Metrics of one's own against SciPy on an independent right-hand side, and everywhere they should show."""

import json
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pyarrow.parquet as pq
import pytest
import scipy.integrate
from typer.testing import CliRunner

import qsmc_jax as qj
from fake_step import UnitStep
from qsmc_jax.cli.main import app
from qsmc_jax.metrics.view import View
from qsmc_jax.study.tangents import differentiate
from studies_for_tests import Integrator

m = qj.metrics
T1, AFTER, BEFORE = 4.0, 0.75, 2.875
METRICS = (
    m.Peak("top", lambda s: s.x[0], unit="m"),
    m.Peak("late", lambda s: jnp.abs(s.e[0]), after=AFTER, before=BEFORE),
    m.Integral("work", lambda s: s.u * s.x[0]),
    m.Integral("late_work", lambda s: s.u * s.x[0], after=AFTER, before=BEFORE),
    m.Mean("power", lambda s: s.u**2, after=AFTER),
    m.Final("end", lambda s: s.x[0]),
    m.Final("middle", lambda s: s.x[0], before=BEFORE),
    m.Variation("travel", lambda s: s.x[0]),
    m.LastTime("above", lambda s: s.x[0] - 0.2, unit="s"),
    m.LastTime("is_above", lambda s: s.x[0] > 0.2, unit="s"),
    m.FirstTime("reached", lambda s: s.x[0] - 0.45),
    m.FirstTime("never", lambda s: s.x[0] - 5.0),
    m.LastTime("not_once", lambda s: s.x[0] - 5.0, after=AFTER),
    m.LastTime("still", lambda s: 5.0 - s.x[0]),
    m.Custom(
        "distance",
        start=lambda s: (jnp.zeros(()), jnp.array(0), jnp.array(True)),
        advance=lambda state, step: (state[0] + (step.t1 - step.t0) * step.at(0.5).x[0] ** 2, state[1] + 1, state[2]),
        result=lambda state: jnp.where(state[2] & (state[1] > 3), state[0], jnp.nan),
    ),
)


def scenario(draw):
    """x' = d - g sgn(g) tan(pi/2 sigma/rho), sigma = x - a sin 3 t: of order 1, with a sign drawn."""
    gain, amplitude = draw.uniform("g", 1.0, 3.0) * draw.sign("side"), draw.uniform("a", 0.3, 0.6)
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, 1.0, 0.1), gain_sign=jnp.sign(gain))
    reference = qj.references.Smooth(eqx.Partial(lambda a, t: a * jnp.sin(3.0 * t), amplitude))
    loop = qj.ClosedLoop(Integrator(gain), reference, qj.disturbances.Sine(0.4, 2.0, 0.0), control)
    return qj.Scenario(loop, x0=draw.uniform("x0", -0.5, 0.5, shape=(1,)), t1=T1)


STUDY = qj.Study(scenario, bandwidth=0.3, metrics=METRICS)


def reference(row):
    """State and input on a fine grid, for a row's numbers, by SciPy."""
    gain, amplitude = row["g"], row["a"]

    def law(t, x):
        return np.tan(0.5 * math.pi * (x - amplitude * np.sin(3.0 * t)) / (np.exp(-t) + 0.1))

    ts = np.linspace(0.0, T1, 2**15 + 1)
    options = {"t_eval": ts, "rtol": 1e-11, "atol": 1e-13}
    rate = lambda t, x: 0.4 * np.sin(2.0 * t) - gain * law(t, x)  # noqa: E731
    x = scipy.integrate.solve_ivp(rate, (0.0, T1), [row["x0[0]"]], "Radau", **options).y[0]
    return ts, x, -row["side"] * law(ts, x), x - amplitude * np.sin(3.0 * ts)


def crossing(ts, values, which):
    """The first or last time at which linear pieces cross zero upwards or downwards."""
    found = np.flatnonzero(np.diff(np.sign(values)))
    i = found[0 if which == "first" else -1]
    return ts[i] - values[i] * (ts[i + 1] - ts[i]) / (values[i + 1] - values[i])


@pytest.fixture(scope="module")
def rows():
    return qj.monte_carlo(STUDY, 12, settings=qj.tight())


@pytest.mark.parametrize("i", range(6))
def test_all_kinds_agree_with_scipy(rows, i):
    row = rows.row(i)
    ts, x, u, e = reference(row)
    inside, simpson = (ts >= AFTER) & (ts <= BEFORE), scipy.integrate.simpson
    assert row["top"] == pytest.approx(x.max(), abs=1e-5)
    assert row["late"] == pytest.approx(abs(e)[inside].max(), abs=1e-5)
    assert row["work"] == pytest.approx(simpson(u * x, x=ts), rel=1e-5, abs=1e-6)
    assert row["late_work"] == pytest.approx(simpson((u * x)[inside], x=ts[inside]), rel=1e-5, abs=1e-6)
    assert row["power"] == pytest.approx(simpson((u**2)[ts >= AFTER], x=ts[ts >= AFTER]) / (T1 - AFTER), rel=1e-5)
    assert row["end"] == pytest.approx(x[-1], abs=1e-6)
    assert row["middle"] == pytest.approx(np.interp(BEFORE, ts, x), abs=1e-6)
    assert row["travel"] == pytest.approx(abs(np.diff(x)).sum(), rel=1e-4)
    assert row["above"] == pytest.approx(crossing(ts, x - 0.2, "last"), abs=1e-5)
    assert row["is_above"] == pytest.approx(row["above"], abs=1e-9)
    expected = 0.0 if x[0] >= 0.45 else crossing(ts, x - 0.45, "first") if x.max() > 0.45 else math.inf
    assert row["reached"] == pytest.approx(expected, abs=1e-5)
    assert (row["never"], row["not_once"], row["still"]) == (math.inf, AFTER, math.inf)
    assert row["distance"] == pytest.approx(simpson(x**2, x=ts), rel=1e-3)


@pytest.mark.slow
def test_a_replay_and_another_block_give_the_same_numbers(rows):
    run = STUDY.replay(3, settings=qj.tight())
    larger = qj.monte_carlo(STUDY, 12, settings=qj.tight(), block=128)
    for metric in METRICS:
        np.testing.assert_array_equal(larger[metric.name], rows[metric.name])
        assert float(run.metrics.own[metric.name]) == pytest.approx(rows[metric.name][3], rel=1e-9)
    assert f"top {rows['top'][3]:.6g} m" in str(run)


def wave(theta, phase):
    return jnp.sin(3.0 * theta + phase)


@pytest.mark.parametrize("phase", [0.3, 1.0, 2.2, 3.0, 4.4])
def test_peaks_and_valleys_inside_a_step_count(phase):
    step, x = (
        UnitStep(jnp.array(phase), wave),
        np.sin(np.linspace(phase, phase + 3.0, 200_001)),
    )
    view, of = View(step), lambda s: s.x[0]
    found = {
        kind: kind.read(kind.add(kind.first(step), view), step) for kind in (m.Peak("p", of), m.Variation("v", of))
    }
    assert list(found.values()) == pytest.approx([x.max(), abs(np.diff(x)).sum()], rel=2e-5)


def implemented(draw):
    loop = qj.paper.example1()
    made = qj.Implementation(sample_period=draw.uniform("period", 5e-3, 2e-2), saturation=8.0)
    return qj.Scenario(
        eqx.tree_at(lambda each: each.implementation, loop, made, is_leaf=lambda x: x is None), [0.4, 0.3], t1=3.0
    )


def test_a_sampled_loop_has_them_too():
    known = {
        "peak_ratio": m.Peak("a", lambda s: jnp.abs(s.ratio)),
        "peak_u": m.Peak("b", lambda s: jnp.abs(s.u)),
        "energy_u": m.Integral("c", lambda s: s.u**2),
        "total_variation_u": m.Variation("d", lambda s: s.u),
        "reach_time": m.LastTime("f", lambda s: jnp.abs(s.sigma) - 0.1),
        "peak_excess": m.Peak("g", lambda s: jnp.abs(s.sigma) - s.rho),
    }
    study = qj.Study(implemented, bandwidth=0.1, metrics=[*known.values(), m.Mean("e", lambda s: s.e[0] ** 2)])
    rows = qj.monte_carlo(study, 16)
    for column, metric in known.items():
        np.testing.assert_allclose(rows[metric.name], rows[column], rtol=2e-5, atol=2e-6, err_msg=column)
    np.testing.assert_allclose(np.sqrt(rows["e"]), rows["rms_error"], rtol=1e-5)


@pytest.mark.slow
def test_gradients_reach_them():
    def tuned(draw):
        mu = draw.parameter("mu", 1.0, bounds=(0.5, 2.0))
        control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, mu, 0.1))
        loop = qj.ClosedLoop(Integrator(2.0), qj.references.Constant(0.0), qj.disturbances.Constant(0.5), control)
        return qj.Scenario(loop, x0=[0.8], t1=3.0)

    kinds = [
        m.Peak("a", lambda s: s.u**2, after=0.5),
        m.Integral("b", lambda s: s.x[0] ** 2),
        m.LastTime("c", lambda s: s.x[0] - 0.2),
        m.FirstTime("d", lambda s: 0.4 - s.x[0]),
        m.Final("e", lambda s: s.x[0], before=1.0),
    ]
    study = qj.Study(tuned, bandwidth=0.3, metrics=kinds)

    settings, step = qj.tight().replace(adjoint="forward"), 1e-4
    options = {"names": ("mu",), "metrics": tuple(kind.name for kind in kinds), "block": 64}
    found = differentiate(study, np.arange(1), 0, settings=settings, **options)
    low, high = (qj.monte_carlo(study.substitute(mu=1.0 + by), 1, settings=settings) for by in (-step, step))
    slopes = [(high[kind.name][0] - low[kind.name][0]) / (2.0 * step) for kind in kinds]
    np.testing.assert_allclose(found.jacobian[0, :, 0], slopes, rtol=2e-4, atol=1e-6)


def peaked(draw):
    return qj.Scenario(
        qj.paper.example1(),
        x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)),
        t1=draw.parameter("t1", 2.0, bounds=(1.0, 3.0)),
    )


@pytest.mark.slow
def test_a_newcomers_column_shows_everywhere(tmp_path):
    source = tmp_path / "study.py"
    source.write_text(
        "import jax.numpy as jnp\n"
        "import qsmc_jax as qj\n"
        "def scenario(draw):\n"
        "    funnel = qj.Funnel(4.0, draw.parameter('mu', 3.0, bounds=(2.0, 4.0)), 0.05)\n"
        "    control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), funnel)\n"
        "    model = qj.paper.example1()\n"
        "    loop = qj.ClosedLoop(model.plant, model.reference, qj.disturbances.Zero(), control)\n"
        "    return qj.Scenario(loop, x0=draw.uniform('x0', 0.1, 0.9, shape=(2,)), t1=3.0)\n"
        "peak_sigma = qj.metrics.Peak('peak_sigma', lambda s: jnp.abs(s.sigma), after=1.7, unit='rad/s')\n"
        "study = qj.Study(scenario, bandwidth=0.1, metrics=[peak_sigma])\n"
    )
    runner, out = CliRunner(), tmp_path / "run"
    small = ["--no-cache", "--block", "64"]
    result = runner.invoke(app, ["verify", str(source), "--runs", "64", "--out", str(out), *small])
    assert result.exit_code == 0, result.output
    (block,) = (out / "blocks").iterdir()
    column = pq.read_table(block)["peak_sigma"].to_numpy()
    assert pq.read_schema(block).field("peak_sigma").metadata[b"unit"] == b"rad/s"
    worst = int(column.argmax())
    assert f"to {column.max():.6g} rad/s (run {worst})" in result.output
    assert f"qsmc show {out} --run {worst}" in (out / "report.html").read_text()
    shown = runner.invoke(app, ["show", str(out), "--run", str(worst), "--no-cache", "--study", str(source)])
    assert f"peak_sigma {column.max():.6g} rad/s" in shown.output
    (said,) = json.loads((out / "summary.json").read_text())["metrics"]
    assert (said["largest"], said["unit"], said["largest_run"]) == (column.max(), "rad/s", worst)


@pytest.mark.slow
def test_maps_comparisons_and_tuning_know_them():
    def tunable(draw):
        funnel = qj.Funnel(4.0, draw.parameter("mu", 3.0, bounds=(2.0, 4.0)), 0.05)
        loop = eqx.tree_at(lambda each: each.control.funnel, qj.paper.example1(), funnel)
        return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=2.0)

    own = m.Integral("effort", lambda s: s.u**2, unit="N^2 s")
    study = qj.Study(tunable, bandwidth=0.1, metrics=[own])
    found = qj.robustness_map(study, over={"mu": [2.0, 4.0]}, runs=64, block=64)
    rows = qj.monte_carlo(study.substitute(mu=4.0), 64, block=64)
    assert found.medians["effort"][1] == pytest.approx(np.median(rows["energy_u"]), rel=1e-4)
    assert "N^2 s" in "".join(ax.get_ylabel() for ax in found.plot())
    compared = qj.compare({"slow": study.substitute(mu=2.0), "fast": study.substitute(mu=4.0)}, runs=64, block=64)
    assert compared["fast"].medians["effort"].median == pytest.approx(np.median(rows["energy_u"]), rel=1e-4)
    assert "effort [N^2 s]" in "".join(ax.get_title() for ax in compared.plot())
    short = {"runs": 2, "starts": 1, "steps": 3, "certificate_runs": 0, "block": 64}
    by_own, by_ours = (qj.tune(study, ["mu"], f"mean({name})", **short) for name in ("effort", "energy_u"))
    assert by_own.gains["mu"] == pytest.approx(by_ours.gains["mu"], rel=1e-6)
    with pytest.raises(qj.InputError, match=r"names `effor`, but must name .*effort.* Did you mean `effort`"):
        qj.tune(study, ["mu"], "mean(effor)", **short)


def test_what_has_no_derivative_is_not_tuned():
    study = qj.Study(peaked, bandwidth=0.1, metrics=[m.LastTime("late", lambda s: jnp.abs(s.e[0]) > 0.05)])
    with pytest.raises(qj.InputError, match="names `late`, which has no derivative"):
        qj.tune(study, ["t1"], "mean(late)", runs=2, certificate_runs=0)


def test_a_run_that_did_not_end_or_ended_before_the_window_has_none():
    late = m.Peak("late", lambda s: s.x[0], after=1.0, before=2.5)
    open_end = m.Peak("open", lambda s: s.x[0], after=1.5)
    study = qj.Study(peaked, bandwidth=0.1, metrics=[late, open_end], values={"t1": 3.0})
    short = study.substitute(t1=2.0)
    assert np.isfinite(qj.monte_carlo(study, 2)["late"]).all()
    assert np.isnan(qj.monte_carlo(short, 2)["late"]).all()
    assert np.isfinite(qj.monte_carlo(short, 2)["open"]).all()
    assert np.isnan(qj.monte_carlo(study.substitute(t1=1.2), 2)["open"]).all()
    cut = qj.SolverSettings(max_steps=5)
    assert np.isnan(qj.monte_carlo(study, 2, settings=cut)["open"]).all()


def test_where_the_function_is_no_number_nothing_is_known():
    """x falls through 0, where the root ends: nobody may take that for a condition that no longer holds."""
    root = lambda s: jnp.sqrt(s.x[0]) - 0.1  # noqa: E731
    kinds = [
        m.LastTime("last", root),
        m.FirstTime("first", lambda s: -root(s)),
        m.Peak("top", root),
        m.Mean("mean", root),
    ]

    def falling(draw):
        control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, 1.0, 0.1))
        loop = qj.ClosedLoop(Integrator(2.0), qj.references.Constant(-0.5), qj.disturbances.Zero(), control)
        return qj.Scenario(loop, x0=[draw.uniform("x0", 0.2, 0.4)], t1=3.0)

    rows = qj.monte_carlo(qj.Study(falling, bandwidth=0.3, metrics=kinds), 4)
    assert all(np.isnan(rows[name]).all() for name in ("last", "top", "mean"))


@pytest.mark.parametrize(
    ("metric", "said"),
    [
        (lambda: m.Peak("x0[0]", lambda s: s.u), "must have no '\\['"),
        (lambda: m.Peak("peak_u", lambda s: s.u), "`peak_u` is the name of a column already"),
        (lambda: m.Peak("p", lambda s: s.speed), "asks for `speed`"),
        (lambda: m.Peak("p", lambda s: s.sigm), "Did you mean `sigma`"),
        (lambda: m.Peak("p", lambda s: jnp.stack(s.x)), "must return one number, but returns shape \\(2,\\)"),
        (lambda: m.Peak("p", lambda s: s.x), "must return one number"),
        (lambda: m.Peak("p", lambda s: "high"), "must return one number"),
        (lambda: m.Peak("p", lambda s: jnp.log(s.u - 1.0)), "returns nan at the start"),
        (lambda: m.Peak("p", lambda s: math.sin(s.t)), "must be written with `jax.numpy`"),
        (lambda: m.Peak("p", lambda s, t: s.u), "must take the signals at one instant"),
        (lambda: m.Peak("p", lambda s: s.x[2]), "must take the signals at one instant"),
        (lambda: m.Peak("p", lambda s: s.u, after=2.0, before=1.0), "must be a window of times"),
        (lambda: m.Peak("p", lambda s: s.u, after=-1.0), "must be a window of times"),
        (lambda: m.Peak("p", lambda s: s.u, after=math.nan), "must be a window of times"),
        (lambda: m.Peak("p", lambda s: s.u, after=3.0), "must lie before the horizon, 2 s, but is 3 s"),
        (lambda: m.Peak("a=b", lambda s: s.u), "must have no '='"),
        (lambda: m.Peak("", lambda s: s.u), "must be a string that is not empty"),
        (lambda: qj.Metrics, "Argument `metrics` must"),
        (
            lambda: m.Custom("p", lambda s: jnp.zeros(2), lambda state, step: state[0], lambda state: state),
            "must keep what `start` returns",
        ),
        (lambda: m.Peak("p", eqx.Partial(lambda a, s: a * s.u, jnp.ones(()))), "must be made of plain functions"),
    ],
)
def test_what_does_not_fit_is_named(metric, said):
    with pytest.raises(qj.InputError, match=said):
        qj.Study(peaked, bandwidth=0.1, metrics=[metric()])


def test_a_recorded_number_is_a_column_whatever_it_is_worked_out_from():
    def recording(draw):
        x0 = draw.uniform("x0", 0.1, 0.9, shape=(2,))
        draw.record("start", 2.0 * x0[0] + x0[1])
        return qj.Scenario(qj.paper.example1(), x0=x0, t1=1.0)

    study = qj.Study(recording, bandwidth=0.1)
    rows = qj.monte_carlo(study, 8)
    np.testing.assert_allclose(rows["start"], 2.0 * rows["x0[0]"] + rows["x0[1]"], rtol=1e-15)
    assert "start" in rows.names
    with pytest.raises(qj.InputError, match="Name `start` can't be given a value"):
        study.substitute(start=1.0)


def test_a_metric_alone_is_no_list():
    with pytest.raises(qj.InputError, match="must be a list of metrics, but is a `Peak`"):
        qj.Study(peaked, bandwidth=0.1, metrics=m.Peak("p", lambda s: s.u))


def test_a_name_is_taken_once():
    twice = [m.Peak("p", lambda s: s.u), m.Final("p", lambda s: s.u)]
    with pytest.raises(qj.InputError, match="`p` is the name of a column already"):
        qj.Study(peaked, bandwidth=0.1, metrics=twice)


LEVEL = 0.05


def test_a_metric_that_changed_is_another_study():
    global LEVEL
    study = qj.Study(peaked, bandwidth=0.1, metrics=[m.LastTime("late", lambda s: jnp.abs(s.e[0]) - LEVEL)])
    LEVEL = 0.06
    try:
        with pytest.raises(qj.InputError, match="its metric `late` has changed"):
            qj.monte_carlo(study, 2)
    finally:
        LEVEL = 0.05
