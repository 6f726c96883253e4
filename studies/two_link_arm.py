"""A two-link arm in a vertical plane: two inputs, each of which moves both joints.

Question: do two laws, each of which sees its own joint only, hold both joints in their funnels, whatever the payload,
though either torque moves the other joint too?
Claim: funnel HELD in every run, since the inverse of the inertia is positive definite: the laws are scaled, so that
Lyapunov's inequality bounds how far both joints together get, and no run passes that bound.
Time: 1 000 runs in some 10 seconds on two cores, after a minute for compilation.
"""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

import qsmc_jax as qj
from qsmc_jax.base.module import float_field

GRAVITY = 9.81


class Arm(qj.AbstractStateSpace):
    r"""Angles of shoulder and elbow [rad] and their rates [rad/s]; inputs: torques [N m].

    m1, m2: masses [kg] at the ends of the links, l1, l2: their lengths [m]. The elbow's angle is measured from the
    upper link. $M(q) \ddot q + C(q, \dot q) \dot q + G(q) = u + d$.
    """

    m1: Float[Array, ""] = float_field(default=1.0)
    m2: Float[Array, ""] = float_field(default=1.0)
    l1: Float[Array, ""] = float_field(default=1.0)
    l2: Float[Array, ""] = float_field(default=0.8)

    states: ClassVar[int] = 4
    relative_degrees: ClassVar[tuple[int, ...]] = (2, 2)

    def vector_field(self, t, x, d):
        """Gravity, the Coriolis terms and the disturbing torques, by the inverse of the inertia."""
        q1, q2, v1, v2 = x
        swing = self.m2 * self.l1 * self.l2 * jnp.sin(q2)
        upper = (self.m1 + self.m2) * GRAVITY * self.l1 * jnp.cos(q1)
        lower = self.m2 * GRAVITY * self.l2 * jnp.cos(q1 + q2)
        torques = d[0] + swing * v2 * (2.0 * v1 + v2) - upper - lower, d[1] - swing * v1**2 - lower
        (a, b), (_, c) = self._inverse(q2)
        return v1, v2, a * torques[0] + b * torques[1], b * torques[0] + c * torques[1]

    def input_matrix(self, t, x):
        """The inverse of the inertia, symmetric and positive definite."""
        return (0.0, 0.0), (0.0, 0.0), *self._inverse(x[1])

    def output(self, t, x):
        """Both angles."""
        return x[0], x[1]

    def _inverse(self, q2):
        """The inverse of M(q), its rows."""
        bend = self.m2 * self.l1 * self.l2 * jnp.cos(q2)
        lower = self.m2 * self.l2**2
        upper, both = (self.m1 + self.m2) * self.l1**2 + lower + 2.0 * bend, lower + bend
        determinant = upper * lower - both**2
        return (lower / determinant, -both / determinant), (-both / determinant, upper / determinant)


def scenario(draw: qj.Draw) -> qj.Scenario:
    """Both joints follow sines, with a payload nobody weighed and torques nobody ordered."""
    arm = Arm(m2=draw.uniform("payload", 0.5, 1.5))
    references = (
        qj.references.SumOfSines([0.5], [1.0]),
        qj.references.SumOfSines([0.4], [1.3], phases=[0.5 * jnp.pi]),
    )
    disturbances = (
        qj.disturbances.random_sine(draw, "shoulder", 1.0, (1.0, 10.0)),
        qj.disturbances.random_sine(draw, "elbow", 0.5, (1.0, 10.0)),
    )
    mu = draw.parameter("mu", 2.0, bounds=(0.5, 5.0))
    controls = (
        qj.QuasiSlidingControl(qj.SlidingSurface([3.0]), qj.Funnel(4.0, mu, 0.2), gain=10.0, is_scaled=True),
        qj.QuasiSlidingControl(qj.SlidingSurface([3.0]), qj.Funnel(6.0, mu, 0.3), gain=10.0, is_scaled=True),
    )
    loop = qj.MultivariableLoop(arm, references, disturbances, controls)
    start = draw.uniform("q0", -0.3, 0.3, shape=(2,))
    return qj.Scenario(loop, x0=[start[0], 0.4 + start[1], 0.0, 0.0], t1=10.0)


study = qj.Study(scenario, bandwidth=(0.4, 0.6))
