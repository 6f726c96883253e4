"""Ideal loops of several inputs under other laws than the paper's: against SciPy, closed forms and scalar loops."""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from jaxtyping import Array, Float

import qsmc_jax as qj
from own_plants import UNTOUCHED, Pair, beside_scalar_runs
from qsmc_jax.base.module import float_field
from qsmc_jax.simulation.engine import pose, solve

T1, X0, AT, BRIEF = 4.0, [1.5, -0.8], 2.345, 1e-4
WAVES, PUSHES = ((0.5, 2.0), (0.8, 1.1)), ((0.5, 3.0), (0.4, 4.0))
FUNNELS = (4.0, 1.5, 0.2), (3.0, 1.0, 0.3)
MATRIX = (2.0, 0.5), (-0.4, 1.0)
# `tight()`, but for its limit of steps, so that all runs share one program.
TIGHT = qj.SolverSettings(qj.tight().rtol, qj.tight().atol)


def bump(t, xp=jnp):
    """1 at an instant, and nothing a thousandth of a second before and after."""
    return xp.exp(-0.5 * ((t - AT) / BRIEF) ** 2)


class Integral(qj.AbstractDynamicControl):
    """u = -p e - q int e, with a pulse of the input and a kick of the integral that take no time."""

    surface: qj.SlidingSurface
    funnel: qj.AbstractFunnel
    p: Float[Array, ""] = float_field(default=5.0)
    q: Float[Array, ""] = float_field(default=0.5)
    pulse: Float[Array, ""] = float_field(default=0.0)
    kick: Float[Array, ""] = float_field(default=0.0)
    gain_sign: Float[Array, ""] = float_field(default=1.0)

    positive: ClassVar[tuple[str, ...]] = ("p",)

    def first_memory(self):
        """The integral."""
        return (jnp.zeros(()),)

    def command(self, sample, memory):
        """Its parts."""
        u = -self.p * sample.errors[0] - self.q * memory[0] + self.pulse * bump(sample.t)
        return u, (memory[0] + sample.period * sample.errors[0],)

    def memory_at_start(self, sample):
        """Off zero, to tell it from the first memory."""
        return (0.1,)

    def memory_rates(self, sample, memory):
        """That of an integral, and the kick."""
        return (sample.errors[0] + self.kick * bump(sample.t),)


def loop_of(limit=6.0, matrix=MATRIX, coupling=0.7, funnels=FUNNELS, offset=0.0, **own):
    """A limited quasi-sliding law beside an integral one: one program for all numbers."""
    (b11, b12), (b21, b22) = matrix
    surface, both = qj.SlidingSurface([]), [qj.Funnel(*each) for each in funnels]
    inner = qj.QuasiSlidingControl(surface, both[0], is_scaled=True)
    laws = qj.controllers.Saturated(inner, (-limit, limit)), Integral(surface, both[1], **own)
    references = tuple(qj.references.SumOfSines([a], [w], offset=offset) for a, w in WAVES)
    disturbances = tuple(qj.disturbances.Sine(*each) for each in PUSHES)
    return qj.MultivariableLoop(Pair(coupling, b11, b12, b21, b22), references, disturbances, laws)


def by_scipy(loop, x0=X0, offset=0.0):
    """Times, sigma/rho, inputs and states; it ends where a channel leaves its funnel, within 1e-9 of that time."""
    plant, own = loop.plant, {name: float(getattr(loop.controls[1], name)) for name in ("p", "q", "pulse", "kick")}
    b, limit = np.array([[plant.b11, plant.b12], [plant.b21, plant.b22]]), float(loop.controls[0].input_range[1])
    widths = [tuple(float(getattr(law.funnel, name)) for name in ("rho0", "mu", "rho_inf")) for law in loop.controls]

    def read(t, y):
        rho = np.array([r0 * np.exp(-mu * t) + r for r0, mu, r in widths])
        e = y[:2] - offset - np.array([a * np.sin(w * t) for a, w in WAVES])
        z = e / rho
        edge = np.where(np.abs(z[0]) < 1.0, np.tan(0.5 * np.pi * z[0]) / rho[0], np.copysign(np.inf, z[0]))
        second = -own["p"] * e[1] - own["q"] * y[2] + own["pulse"] * bump(t, np)
        return e, z, np.array([np.clip(-edge, -limit, limit), second])

    def rate(t, y):
        e, _, u = read(t, y)
        push = np.array([size * np.sin(w * t) for size, w in PUSHES])
        moved = float(plant.coupling) * np.array([np.sin(y[1]), -y[0]]) + push + b @ u
        return [*moved, e[1] + own["kick"] * bump(t, np)]

    edge = lambda t, y: 1.0 - np.abs(read(t, y)[1]).max()  # noqa: E731
    edge.terminal, y, ts, ys = True, np.array([*x0, 0.1]), [], []
    for begin, end in ((0.0, AT - 0.002), (AT - 0.002, AT + 0.002), (AT + 0.002, T1)):
        longest = 1e-5 if end - begin < 0.005 else 1e-2
        options = {"rtol": 1e-11, "atol": 1e-12, "max_step": longest, "dense_output": True, "events": edge}
        found = scipy.integrate.solve_ivp(rate, (begin, end), y, "DOP853", **options)
        ts.append(np.linspace(begin, found.t[-1], 20_001))
        ys.append(found.sol(ts[-1]))
        y = found.y[:, -1]
        if found.t_events[0].size:
            break
    ts, ys = np.concatenate(ts), np.concatenate(ys, axis=1)
    return ts, *read(ts, ys)[1:], ys


def check(run, truth, left=None):
    """Peaks of both channels, inputs, energy and the last state; or when the channel `left` leaves."""
    ts, z, u, y = truth
    f = run.metrics.channels
    if left is not None:
        assert float(run.metrics.violation_time) == pytest.approx(ts[-1], abs=1e-6)
        assert float(f[f"violation_time[{left}]"]) == float(run.metrics.violation_time)
        assert run.verdict.name == run.verdicts[f"funnel[{left}]"].name == "VIOLATED"
        assert run.verdicts[f"funnel[{1 - left}]"].name == "UNDECIDED"
        return
    assert {verdict.name for verdict in run.verdicts.values()} == {"HELD"}
    for i in range(2):
        assert float(f[f"peak_ratio[{i}]"]) == pytest.approx(np.abs(z[i]).max(), abs=1e-6)
        assert float(f[f"max_u[{i}]"]) == pytest.approx(u[i].max(), abs=1e-4 * np.abs(u[i]).max())
        assert float(f[f"min_u[{i}]"]) == pytest.approx(u[i].min(), abs=1e-4 * np.abs(u[i]).max())
    assert float(run.metrics.energy_u) == pytest.approx(np.trapezoid((u**2).sum(axis=0), ts), rel=1e-4)
    np.testing.assert_allclose(run.x[-1], y[:, -1], atol=5e-6)


def test_a_limited_law_beside_one_with_a_memory_is_what_scipy_makes_of_them():
    loop = loop_of(limit=1.2)
    run, truth = qj.simulate(loop, X0, T1, settings=TIGHT), by_scipy(loop)
    check(run, truth)
    assert float(run.metrics.channels["peak_u[0]"]) == 1.2  # it was at its limit, and came back
    assert run.x.shape[1] == loop.states == 3
    np.testing.assert_allclose(run.u[:, 1], -5.0 * run.e[:, 1] - 0.5 * run.x[:, 2], atol=1e-6)
    assert np.isnan(run.metrics.barrier_bound)
    value = np.log1p(np.tan(0.5 * np.pi * truth[1]) ** 2).sum(axis=0) / np.pi
    assert float(run.metrics.peak_barrier) == pytest.approx(value.max(), rel=1e-5)
    assert "of the quasi-sliding law alone is a bound known" in str(run)


WEAK = {"first": (0, {"limit": 0.4}), "second": (1, {"p": 0.3})}


@pytest.mark.parametrize("name", WEAK)
def test_a_law_that_is_too_weak_leaves_when_scipy_says(name):
    left, numbers = WEAK[name]
    loop = loop_of(**numbers)
    check(qj.simulate(loop, X0, T1, settings=TIGHT), by_scipy(loop), left)


def test_what_a_law_does_for_an_instant_moves_the_others():
    """The channel's own funnel is too wide to show it, and the states are too far away."""
    far, funnels = 1e5, (FUNNELS[0], (1e7, 1e-3, 1e6))
    numbers = {"matrix": ((2.0, 500.0), (0.0, 1e-3)), "coupling": 0.0, "funnels": funnels, "offset": far}
    loop, x0 = loop_of(**numbers, p=1e-9, q=1e-9, pulse=-4.0), [far + 1.5, far - 0.8]
    run = qj.simulate(loop, x0, T1)
    check(run, by_scipy(loop, x0, far), left=0)
    assert float(run.metrics.violation_time) == pytest.approx(AT, abs=3.0 * BRIEF)


def test_what_a_law_does_for_an_instant_moves_states_that_no_funnel_shows():
    funnels = (1e9, 1e-3, 1e8), (1e9, 1e-3, 1e8)
    numbers = {"matrix": ((1.0, 50.0), (0.0, 1.0)), "coupling": 0.0, "funnels": funnels}
    loop = loop_of(**numbers, p=1e-3, q=1e-3, pulse=100.0)
    run, truth = qj.simulate(loop, X0, T1), by_scipy(loop)
    np.testing.assert_allclose(run.x[-1], truth[3][:, -1], rtol=1e-3)
    assert abs(truth[3][0, -1] - X0[0]) > 0.5  # it was struck


def test_what_happens_to_a_memory_for_an_instant_is_seen():
    loop = loop_of(q=2.0, kick=4000.0)
    run, (ts, z, _, y) = qj.simulate(loop, X0, T1), by_scipy(loop)
    assert float(run.metrics.channels["peak_ratio[1]"]) == pytest.approx(np.abs(z[1]).max(), abs=1e-4)
    np.testing.assert_allclose(run.x[-1], y[:, -1], atol=1e-4)
    assert np.abs(y[2][ts > AT + 0.001]).min() > 0.3  # it was struck


def test_a_channel_that_moves_outwards_where_another_leaves_has_not_left():
    """Its gain has the wrong sign, and it would leave later."""
    loop, x0 = loop_of(limit=0.4, matrix=((2.0, 0.0), (0.0, -1.0)), coupling=0.0), [4.0, -0.5]
    truth = by_scipy(loop, x0)
    z = truth[1][1]
    assert abs(z[-2]) < abs(z[-1]) < 0.9
    check(qj.simulate(loop, x0, T1, settings=TIGHT), truth, left=0)


def test_each_law_has_its_own_memory_and_all_inputs_move_a_channel():
    surface, both = qj.SlidingSurface([]), [qj.Funnel(*each) for each in FUNNELS]
    laws = tuple(Integral(surface, funnel, p=3.0 + i, q=1.0 + i) for i, funnel in enumerate(both))
    loop = dataclasses.replace(loop_of(coupling=0.0), controls=laws)
    start = loop.start(X0)
    assert [float(each) for each in start] == [*X0, 0.1, 0.1]
    t, x, s = 0.4, (0.2, -0.3, 0.6, -0.9), (0.1, 0.1)
    e = np.array([x[i] - a * np.sin(w * t) for i, (a, w) in enumerate(WAVES)])
    u = [-(3.0 + i) * e[i] - (1.0 + i) * x[2 + i] for i in range(2)]
    pushes = [size * np.sin(w * t) for size, w in PUSHES]
    slopes = [a * w * np.cos(w * t) for a, w in WAVES]
    for i, channel in enumerate(loop.channels):
        y = (*x, *s)
        balance = channel.balance(t, y, channel.errors(t, y), channel.desired(t))
        expected = pushes[i] + MATRIX[i][1 - i] * u[1 - i] - slopes[i]
        assert float(balance.residual) == pytest.approx(expected, rel=1e-12)
        assert float(channel.input_at(t, y, channel.errors(t, y), channel.desired(t), s[i])) == pytest.approx(u[i])
    np.testing.assert_allclose(np.array(loop.channels[0].plant.memory_rates(t, (*x, *s))), e, rtol=1e-12)


def test_a_law_that_switches_or_has_no_rates_needs_an_implementation():
    loop = loop_of()
    surface, funnel = loop.controls[0].surface, loop.controls[0].funnel
    for law in (qj.controllers.Sign(surface, funnel, 1.0), qj.controllers.SuperTwisting(surface, funnel, 1.0, 1.0)):
        controls = loop.controls[0], law
        with pytest.raises(qj.InputError, match="`implementation` must be given for a"):
            dataclasses.replace(loop, controls=controls)
        dataclasses.replace(loop, controls=controls, implementation=qj.Implementation(1e-3))


@pytest.mark.slow
def test_channels_that_do_not_touch_are_scalar_runs():
    loop = loop_of(limit=1.2, matrix=np.diag(UNTOUCHED), coupling=0.0)
    tightest = qj.SolverSettings(1e-11, 1e-13, max_steps=1_000_000)
    run, scalar_runs = beside_scalar_runs(loop, UNTOUCHED, X0, T1, tightest)
    for i, alone in enumerate(scalar_runs):
        np.testing.assert_allclose(run.u[:, i], alone.u, atol=1e-7)


def scenario(draw):
    """The limit, the gain of the second law and the start are drawn; the funnels' rate is for tuning."""
    limit, start = draw.uniform("limit", 0.6, 2.0), draw.uniform("start", -0.5, 0.5, shape=(2,))
    mu, p = draw.parameter("mu", 1.5, bounds=(0.5, 3.0)), draw.parameter("p", 5.0, bounds=(1.0, 9.0))
    funnels = (4.0, mu, 0.2), (3.0, 1.0, 0.3)
    return qj.Scenario(loop_of(limit, funnels=funnels, p=p), x0=[1.5 + start[0], start[1] - 0.5], t1=T1)


OFTEN = qj.Study(
    scenario,
    bandwidth=(0.5, 0.7),
    metrics=[qj.metrics.Final("integral", lambda s: s.x[2])],
    requirements={"calm": qj.always(lambda s: 8.0 - jnp.abs(s.u[1]))},
)


@pytest.mark.slow
def test_rows_of_a_study_are_scipys_and_their_replays():
    rows = qj.monte_carlo(OFTEN, 64, block=64)
    assert np.isnan(rows["barrier_bound"]).all()
    for index in range(12):
        start = [offset + rows[f"start[{i}]"][index] for i, offset in enumerate((1.5, -0.5))]
        ts, z, u, y = by_scipy(loop_of(limit=float(rows["limit"][index])), start)
        has_left = ts[-1] < T1 - 1e-9
        assert (rows["verdict"][index] == qj.Verdict.VIOLATED) == has_left
        assert OFTEN.replay(index).verdict == rows["verdict"][index]
        if has_left:
            assert rows["violation_time"][index] == pytest.approx(ts[-1], abs=1e-4)
            continue
        assert rows["peak_ratio"][index] == pytest.approx(np.abs(z).max(), abs=1e-4)
        assert rows["integral"][index] == pytest.approx(y[2, -1], abs=1e-5)
        assert rows["margin_calm"][index] == pytest.approx(8.0 - np.abs(u[1]).max(), abs=1e-3)
    assert 0 < (rows["verdict"][:12] == qj.Verdict.VIOLATED).sum() < 12


def told(numbers, limit):
    """Metrics of a run, twice."""
    (mu, p), settings = numbers, qj.SolverSettings(1e-11, 1e-13, adjoint="forward")
    loop = loop_of(limit=limit, funnels=((4.0, mu, 0.2), (3.0, 1.0, 0.3)), p=p)
    start = loop.start(jnp.array(X0))
    f, _ = solve(pose(loop, start, (0.5, 0.7), settings), start, jnp.asarray(T1), settings)
    values = jnp.stack([f.peak_ratio, f.rms_error, f.energy_u, f.channels["peak_u[1]"], f.channels["peak_ratio[1]"]])
    return values, values


@pytest.mark.slow
def test_gradients_are_central_differences():
    """A step over a kink, where an input comes to its limit or leaves it, has the slopes of one side."""
    program, numbers = jax.jit(jax.jacfwd(told, has_aux=True)), np.array([1.5, 5.0])
    for limit, apart in ((6.0, 1e-5), (1.3, 2e-3)):
        gradient, _ = program(numbers, limit)
        for j, step in enumerate(1e-3 * np.diag(numbers)):
            up, down = (program(numbers + sign * step, limit)[1] for sign in (1.0, -1.0))
            np.testing.assert_allclose(gradient[:, j], (up - down) / (2.0 * step[j]), rtol=apart, atol=1e-6)
