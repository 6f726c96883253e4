"""Signals of runs on a grid, one by one and in batches, against SciPy on the drawn numbers; and what they compile."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

import qsmc_jax as qj
from qsmc_jax.base.errors import InputError
from qsmc_jax.study.batches import BatchSolver
from studies_for_tests import Integrator, study

CLOSE = 1e-5
# `tight()`, but for its limit of steps, so that all share programs.
TIGHT = qj.SolverSettings(qj.tight().rtol, qj.tight().atol)


def wavy(draw):
    """A reference that is a function made anew in each call, and a horizon of its own in each run."""
    amplitude, mu = draw.uniform("amplitude", 0.2, 0.8), draw.parameter("mu", 1.0, bounds=(0.5, 4.0))
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(rho0=1.0, mu=mu, rho_inf=0.1))
    reference = qj.references.Smooth(eqx.Partial(lambda a, t: a * jnp.sin(3.0 * t), amplitude))
    loop = qj.ClosedLoop(Integrator(2.0), reference, qj.disturbances.Constant(0.3), control)
    return qj.Scenario(loop, x0=draw.uniform("x0", -0.9, 0.9, shape=(1,)), t1=draw.uniform("t1", 2.0, 6.0))


WAVY = qj.Study(wavy, bandwidth=0.2)


def sigma_of(row, ts):
    """sigma = x - a sin 3 t of x' = d - g tan(pi/2 sigma / rho), rho = e^-t + 0.1, for a row's numbers, by SciPy."""
    gain, push, amplitude = row.get("g", 2.0), row.get("d", 0.3), row.get("amplitude", 0.0)

    def rate(t, x):
        return push - gain * np.tan(0.5 * math.pi * (x - amplitude * math.sin(3.0 * t)) / (math.exp(-t) + 0.1))

    options = {"t_eval": ts, "rtol": 1e-10, "atol": 1e-12}
    found = scipy.integrate.solve_ivp(rate, (0.0, ts[-1]), [row["x0[0]"]], "Radau", **options).y[0]
    return found - amplitude * np.sin(3.0 * ts)


def held_rows(batch):
    return [i for i in range(len(batch)) if batch.runs["verdict"][i] == qj.Verdict.HELD]


def test_a_batch_has_the_signals_of_each_run_in_the_order_asked_for():
    ts, indices = np.linspace(0.0, 6.0, 25), [17, 3, 4, 250, 0]
    batch = qj.signals(study, indices, seed=5, ts=ts, settings=TIGHT)
    assert batch.runs["index"].tolist() == indices
    assert batch.sigma.shape == batch.rho.shape == batch.u.shape == (5, 25)
    assert batch.x.shape == batch.e.shape == batch.desired.shape == (5, 25, 1)
    assert len(held_rows(batch)) >= 3
    for i in held_rows(batch):
        row = batch.runs.row(i)
        truth = sigma_of(row, ts)
        assert batch.sigma[i] == pytest.approx(truth, abs=CLOSE)
        assert batch.x[i, :, 0] == pytest.approx(truth, abs=CLOSE)
        assert batch.rho[i] == pytest.approx(np.exp(-ts) + 0.1, rel=1e-12)
        assert batch.u[i] == pytest.approx(-np.tan(0.5 * math.pi * truth / (np.exp(-ts) + 0.1)), rel=1e-3, abs=1e-3)
        assert batch.d[i] == pytest.approx(np.full(25, row["d"]))


@pytest.mark.slow
def test_more_runs_than_a_window_stay_in_order():
    indices = np.arange(300)[::-1]
    batch = qj.signals(study, indices, ts=[0.0, 0.5])
    drawn = qj.monte_carlo(study, 300)["x0[0]"][::-1]
    assert batch.runs["index"].tolist() == indices.tolist()
    is_begun = batch.runs["outcome"] != qj.Outcome.STARTED_OUTSIDE
    assert batch.sigma[is_begun, 0] == pytest.approx(drawn[is_begun], abs=1e-12)
    assert np.isnan(batch.sigma[~is_begun]).all()
    assert (~is_begun).any()


def test_a_run_is_nan_after_its_own_horizon():
    ts = np.linspace(0.0, 4.0, 81)
    batch = qj.signals(WAVY, range(8), ts=ts, settings=TIGHT)
    for i, t1 in enumerate(batch.runs["t1"]):
        lasts = ts <= t1
        assert np.isfinite(batch.sigma[i, lasts]).all()
        assert np.isnan(batch.sigma[i, ~lasts]).all()
        assert batch.sigma[i, lasts] == pytest.approx(sigma_of(batch.runs.row(i), ts[lasts]), abs=CLOSE)
    assert (batch.runs["t1"] < 4.0).any()


@pytest.mark.slow
def test_a_replay_is_its_run_where_the_scenario_makes_functions():
    rows = qj.monte_carlo(WAVY, 4, settings=TIGHT)
    for i in range(4):
        row = rows.row(i)
        run = WAVY.replay(i, settings=TIGHT)
        assert run.sigma[::100] == pytest.approx(sigma_of(row, run.ts)[::100], abs=CLOSE)
        assert run.metrics.peak_ratio == pytest.approx(row["peak_ratio"], abs=1e-7)
        assert run.ts[-1] == pytest.approx(row["t1"], rel=1e-14)
        assert np.isfinite(run.sigma).all()
        assert float(run.loop.desired(0.5)[0]) == pytest.approx(row["amplitude"] * math.sin(1.5))


@pytest.mark.slow
def test_other_numbers_compile_nothing():
    compiled = []

    def listen(event, duration, **about):  # for good: not every JAX has a way to end it
        compiled.append(event) if "backend_compile" in event and not listen.is_over else None

    listen.is_over = False

    WAVY.replay(0)
    qj.signals(WAVY, [0], ts=[0.0, 1.0])
    WAVY.substitute(mu=1.5).simulate()
    other = WAVY.substitute(mu=2.5)
    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        WAVY.replay(1, seed=3)
        qj.signals(WAVY, [4, 5], ts=[0.5, 1.5], settings=qj.SolverSettings(rtol=1e-5))
        other.simulate()
        assert compiled == []
        jax.jit(lambda x: x + 17.0)(1.0)
        assert compiled
    finally:
        listen.is_over = True


@pytest.mark.parametrize("study", [study, WAVY], ids=["of a library", "of one's own"])
@pytest.mark.slow
def test_no_program_calls_the_host_since_none_that_does_is_kept_on_disk(study):
    solver = BatchSolver(study, qj.SolverSettings(), 64)
    assert "callback" not in solver.compile("tsit5", np.linspace(0.0, 1.0, 7)).as_text()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (([],), "Argument `indices` must name at least one run"),
        (([0], 0, [0.0, 7.0]), r"Argument `ts` must lie within \[0, t1\]"),
        (([0], 0, [0.5, 0.5]), "Argument `ts` must increase"),
        ((np.array([0.5]),), "Argument `indices` must be a one-dimensional list of integers"),
        ((np.array([True]),), "Argument `indices` must be a one-dimensional list of integers"),
        (([-1],), r"Argument `indices` must be in \[0, "),
    ],
)
def test_what_does_not_fit_is_named(arguments, said):
    indices, *rest = arguments
    options = {"seed": rest[0], "ts": rest[1]} if rest else {}
    with pytest.raises(InputError, match=said):
        qj.signals(study, indices, **options)


def test_a_dataset_says_which_run_and_when():
    pytest.importorskip("xarray")
    data = qj.signals(study, [7, 2], ts=np.linspace(0.0, 1.0, 25), settings=TIGHT).to_xarray()
    assert data["run"].values.tolist() == [7, 2]
    assert data["sigma"].dims == ("run", "t")
    assert data["t"].attrs["units"] == "s"
    assert data["x"].dims == ("run", "t", "derivative")
