"""What happens to several channels for an instant only, between the stages of a step."""

import numpy as np
import pytest
import scipy.integrate
from jax import numpy as jnp
from jaxtyping import Array, Float

import qsmc_jax as qj
from qsmc_jax.base.module import float_field

T1, AT, WIDTH, FUNNEL = 4.0, 2.345, 1e-4, (4.0, 1.5, 0.4)


def bump(t, xp=jnp):
    """1 at an instant, and nothing a thousandth of a second before and after."""
    return xp.exp(-0.5 * ((t - AT) / WIDTH) ** 2)


class Struck(qj.AbstractStateSpace):
    """Two states, of which the second input moves the first for an instant, and something the second."""

    coupling: Float[Array, ""] = float_field(default=0.0)
    push: Float[Array, ""] = float_field(default=0.0)

    states, relative_degrees = 2, (1, 1)

    def vector_field(self, t, x, d):
        """A steady load on each, and a push on the second."""
        return d[0], -0.5 * x[0] + d[1] + self.push * bump(t)

    def input_matrix(self, t, x):
        """Each has its own input, but for that instant."""
        return (1.0, self.coupling * bump(t)), (0.2, 1.0)

    def output(self, t, x):
        """Both."""
        return x[0], x[1]


@pytest.mark.parametrize(("coupling", "push"), [(1500.0, 0.0), (0.0, -1200.0)], ids=["coupling", "push"])
def test_an_instant_is_met(coupling, push):
    law = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(*FUNNEL), is_scaled=True)
    rest, loads = (qj.references.Constant(0.0),) * 2, tuple(map(qj.disturbances.Constant, (0.6, 0.9)))
    loop = qj.MultivariableLoop(Struck(coupling, push), rest, loads, (law, law))
    run = qj.simulate(loop, [1.0, -1.0], T1, ts=np.array([0.0, AT + 0.01, T1]))

    def rate(t, x):
        rho = FUNNEL[0] * np.exp(-FUNNEL[1] * t) + FUNNEL[2]
        u = -np.tan(0.5 * np.pi * x / rho) / rho
        now = bump(t, np)
        return [0.6 + u[0] + coupling * now * u[1], 0.9 - 0.5 * x[0] + push * now + 0.2 * u[0] + u[1]]

    x, after = np.array([1.0, -1.0]), None
    for begin, end in ((0.0, AT - 0.002), (AT - 0.002, AT + 0.002), (AT + 0.002, AT + 0.01), (AT + 0.01, T1)):
        longest = 1e-5 if end - begin < 0.005 else np.inf
        found = scipy.integrate.solve_ivp(rate, (begin, end), x, "Radau", rtol=1e-9, atol=1e-11, max_step=longest)
        x = found.y[:, -1]
        after = x if end == AT + 0.01 else after
    assert run.verdict == qj.Verdict.HELD
    np.testing.assert_allclose(run.x[1], after, rtol=1e-4)
    np.testing.assert_allclose(run.x[2], x, rtol=1e-4)
    assert np.abs(after).max() > 0.1  # it was struck


def test_a_channel_sees_the_others_inputs_as_its_load():
    funnels = qj.Funnel(*FUNNEL), qj.Funnel(3.0, 1.0, 0.3)
    laws = tuple(qj.QuasiSlidingControl(qj.SlidingSurface([]), funnel, is_scaled=True) for funnel in funnels)
    rest, loads = (qj.references.SumOfSines([0.5], [2.0]),) * 2, tuple(map(qj.disturbances.Constant, (0.6, 0.9)))
    loop = qj.MultivariableLoop(Struck(1500.0, 0.0), rest, loads, laws)
    t, x, s = AT, (0.2, -0.3), (0.4, -0.7)
    u = [-np.sinh(each) / float(funnel(t)) for each, funnel in zip(s, funnels, strict=True)]
    slope = np.cos(2.0 * t)
    expected = 0.6 + 1500.0 * u[1] - slope, 0.9 - 0.5 * x[0] + 0.2 * u[0] - slope
    for channel, load in zip(loop.channels, expected, strict=True):
        errors = channel.errors(t, (*x, *s))
        balance = channel.balance(t, (*x, *s), errors, channel.desired(t))
        assert float(balance.residual) == pytest.approx(load, rel=1e-12)
        assert float(balance.gain) == 1.0
