"""Plants in their own coordinates, and the same loops written for SciPy by hand: derivatives of the output, no jvp."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from jaxtyping import Array, Float

import qsmc_jax as qj
from qsmc_jax.base.module import float_field

T1 = 6.0
FUNNEL = 4.0, 1.5, 0.1
BANDWIDTH = 0.2
WAVE = 0.8, 1.3


class Tank(qj.AbstractStateSpace):
    """A cart that fills a tank (x3), which pushes back on it; d enters everywhere, and is not matched in x1."""

    states, relative_degrees = 3, (2,)

    def vector_field(self, t, x, d):
        """x3 is internal: stable, driven by the output."""
        return x[1] + 0.3 * d, -(x[0] ** 3) + x[2] * jnp.cos(t) + d, -2.0 * x[2] + x[0] * x[1] + 0.5 * d

    def input_matrix(self, t, x):
        """The input fills the tank too."""
        return 0.0, 2.0 + jnp.sin(x[0]), 0.0

    def output(self, t, x):
        """Where the cart is."""
        return x[0]


def tank(t, x, u, d):
    """The same by hand."""
    return [
        x[1] + 0.3 * d,
        -(x[0] ** 3) + x[2] * math.cos(t) + d + (2.0 + math.sin(x[0])) * u,
        -2 * x[2] + x[0] * x[1] + d / 2,
    ]


class Joint(qj.AbstractStateSpace):
    """A link on a spring, turned by a motor: the input shows in the fourth derivative of the link's angle only."""

    stiffness: float = float_field(default=3.0)

    states, relative_degrees = 4, (4,)

    def vector_field(self, t, x, d):
        """Angle and rate of the link, angle and rate of the motor; d is a load on the link."""
        twist = self.stiffness * (x[0] - x[2])
        return x[1], -jnp.sin(x[0]) - twist + d, x[3], twist - 0.5 * x[3]

    def input_matrix(self, t, x):
        """The motor's torque."""
        return 0.0, 0.0, 0.0, 2.0

    def output(self, t, x):
        """The link's angle."""
        return x[0]


def joint(t, x, u, d, stiffness=3.0):
    """The same by hand."""
    twist = stiffness * (x[0] - x[2])
    return [x[1], -math.sin(x[0]) - twist + d, x[3], twist - 0.5 * x[3] + 2.0 * u]


def joint_outputs(t, x, k=3.0):
    """The angle and its first three derivatives without load, by hand."""
    return [x[0], x[1], -math.sin(x[0]) - k * (x[0] - x[2]), -math.cos(x[0]) * x[1] - k * (x[1] - x[3])]


class Scaled(qj.AbstractStateSpace):
    """The tank with another output, of relative degree 1."""

    states, relative_degrees = 3, (1,)

    vector_field, input_matrix = Tank.vector_field, Tank.input_matrix

    def output(self, t, x):
        """A function of time and two states."""
        return jnp.exp(-t / 4) * (x[0] + x[1] / 5) * (1 + x[0] ** 2 / 10)


def scaled_outputs(t, x):
    """The same by hand."""
    return [math.exp(-t / 4) * (x[0] + x[1] / 5) * (1 + x[0] ** 2 / 10)]


class Pendulum(qj.AbstractStateSpace):
    """Example 1's, as a plant in its own coordinates."""

    states, relative_degrees = 2, (2,)

    def vector_field(self, t, x, d):
        """The paper's."""
        return x[1], -jnp.sin(x[0]) - x[1] + jnp.sin(x[1]) + d

    def input_matrix(self, t, x):
        """The paper's."""
        return 0.0, 1.0 / (0.01 * 9.8**2)

    def output(self, t, x):
        """The angle."""
        return x[0]


class Scalar(qj.AbstractStateSpace):
    """x' = g u + d, whose output is its state."""

    gain: float = float_field(default=2.0)

    states, relative_degrees = 1, (1,)

    def vector_field(self, t, x, d):
        """The disturbance."""
        return (d,)

    def input_matrix(self, t, x):
        """The gain."""
        return (self.gain,)

    def output(self, t, x):
        """The state."""
        return x[0]


class Pair(qj.AbstractStateSpace):
    """Two states that push each other: x' = A x + d + B u, each an output."""

    coupling: Float[Array, ""] = float_field(default=0.0)
    b11: Float[Array, ""] = float_field(default=1.0)
    b12: Float[Array, ""] = float_field(default=0.0)
    b21: Float[Array, ""] = float_field(default=0.0)
    b22: Float[Array, ""] = float_field(default=1.0)

    states, relative_degrees = 2, (1, 1)

    def vector_field(self, t, x, d):
        """The coupling, and a disturbance on each."""
        return self.coupling * jnp.sin(x[1]) + d[0], -self.coupling * x[0] + d[1]

    def input_matrix(self, t, x):
        """B."""
        return (self.b11, self.b12), (self.b21, self.b22)

    def output(self, t, x):
        """Both states."""
        return x[0], x[1]


# By plant: its class, rates, outputs, coefficients of the surface, where it starts, amplitude of the reference.
PLANTS = {
    "tank": (Tank, tank, lambda t, x: x[:2], [1.5], [0.4, 0.2, 0.3], 0.5),
    "joint": (Joint, joint, joint_outputs, [8.0, 12.0, 6.0], [0.1, 0.0, 0.12, 0.0], 0.2),
    "scaled": (Scaled, tank, scaled_outputs, [], [0.4, 0.2, 0.3], 0.5),
}


def loop_of(name, sign=1.0, disturbance=None, funnel=None):
    """The loop of a plant: it tracks a sine, under a sine."""
    make, _, _, c, _, amplitude = PLANTS[name]
    control = qj.QuasiSlidingControl(qj.SlidingSurface(c), qj.Funnel(*(funnel or FUNNEL)), sign)
    d = disturbance or qj.disturbances.Sine(*WAVE)
    return qj.ClosedLoop(make(), qj.references.SumOfSines([amplitude], [1.0]), d, control)


def solved(name, rtol=1e-11):
    """The loop of a plant by SciPy: the law is the tangent, the state the user's."""
    _, rates, outputs, c, x0, amplitude = PLANTS[name]
    rho0, mu, rho_inf = FUNNEL

    def desired(t):
        return [amplitude * math.sin(t + i * math.pi / 2) for i in range(len(c) + 1)]

    def ratio(t, x):
        errors = [y - r for y, r in zip(outputs(t, x), desired(t), strict=True)]
        return sum(ci * ei for ci, ei in zip([*c, 1.0], errors, strict=True)) / (rho0 * math.exp(-mu * t) + rho_inf)

    def rhs(t, x):
        u = -math.tan(math.pi * ratio(t, x) / 2)
        return rates(t, x, u, WAVE[0] * math.sin(WAVE[1] * t))

    found = scipy.integrate.solve_ivp(rhs, (0.0, T1), x0, "LSODA", rtol=rtol, atol=1e-13, dense_output=True)
    ts = np.linspace(0.0, T1, 20001)
    ratios = np.array([abs(ratio(t, x)) for t, x in zip(ts, found.sol(ts).T, strict=True)])
    k = int(np.argmax(ratios))
    bracket = ts[max(k - 1, 0)], ts[min(k + 1, len(ts) - 1)]
    best = scipy.optimize.minimize_scalar(
        lambda t: -abs(ratio(t, found.sol(t))), bounds=bracket, method="bounded", options={"xatol": 1e-12}
    )
    peak = max(-best.fun, ratios[k])
    states = found.sol(ts)
    return {"x1": found.y[:, -1], "peak_ratio": peak, "highest": states.max(axis=1), "states": states, "ts": ts}


# Gains of two inputs each of which moves its own channel alone.
UNTOUCHED = (2.0, 0.7)


def beside_scalar_runs(loop, gains, x0, t1, settings):
    """A run of channels that do not touch, and those of loops with one input each, whose metrics it must have."""
    widths = (0.5, 0.7)
    run, found = qj.simulate(loop, x0, t1, settings=settings, bandwidth=widths), []
    for i, (gain, width) in enumerate(zip(gains, widths, strict=True)):
        parts = loop.references[i], loop.disturbances[i], loop.controls[i]
        alone = qj.simulate(qj.ClosedLoop(Scalar(gain), *parts), x0[i : i + 1], t1, settings=settings, bandwidth=width)
        # The steps are others: what is read off an interpolant of u differs by its error.
        known = dict.fromkeys(("peak_ratio", "margin", "reach_time", "rms_error", "least_gain"), 1e-9)
        for name, rel in {**known, "max_u": 1e-7, "min_u": 1e-7}.items():
            expected = float(getattr(alone.metrics, name))
            assert float(run.metrics.channels[f"{name}[{i}]"]) == pytest.approx(expected, rel=rel), name
        np.testing.assert_allclose(run.x[:, i], alone.x[:, 0], atol=1e-9)
        found.append(alone)
    return run, found
