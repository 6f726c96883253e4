"""My study: a loop, what is uncertain in it, and how narrow sliding is to be.

    qsmc verify my_study.py --runs 10000                 does the guarantee hold, and how sure is that?
    qsmc verify my_study.py --runs 10000 --out results   the same, kept: rows, pictures, report.html
    qsmc simulate my_study.py                            one run in full: every uncertain number at its median
    qsmc verify my_study.py -S mu=2 -S x0=0.5,0.5        with names fixed at other values

Everything below is an example that runs as it stands. Change it piece by piece, and verify after each change.
"""

from typing import ClassVar

import jax.numpy as jnp

import qsmc_jax as qj


class MyPlant(qj.AbstractPlant):
    """A mass on a hardening spring, x'' = -(k x + k3 x^3 + b x') / m + u / m + d.

    `x` is (position [m], velocity [m/s]); the disturbance d is added to the last equation by the loop.
    """

    mass: float
    stiffness: float
    damping: float

    # x^(n) = drift + gain u + d: n = 2 for a plant that is moved by a force.
    order: ClassVar[int] = 2

    def drift(self, t, x):
        """What happens without input [m/s^2]. The controller never sees it."""
        spring = self.stiffness * (x[0] + 0.5 * x[0] ** 3)
        return -(spring + self.damping * x[1]) / self.mass

    def gain(self, t, x):
        """What the input does, in m/s^2 per unit; it must keep its sign, which is all the controller knows of it."""
        return 1.0 / self.mass


def scenario(draw: qj.Draw) -> qj.Scenario:
    """One run. Names that are drawn become columns of the result; `parameter`s are the same in every run."""
    plant = MyPlant(
        mass=draw.uniform("mass", 0.8, 1.2),
        stiffness=draw.uniform("stiffness", 1.0, 3.0),
        damping=draw.uniform("damping", 0.1, 0.5),
    )
    # What x[0] is to follow; its derivatives are found from it. A smooth function of t.
    reference = qj.references.Smooth(lambda t: jnp.sin(t))
    # Another sine in every run, |d| <= 0.5.
    disturbance = qj.disturbances.random_sine(draw, "d", bound=0.5, frequencies=(0.1, 10.0))
    # sigma = e' + 2 e: once sigma is small, the error dies out like exp(-2 t). It must be stable, as this one is.
    surface = qj.SlidingSurface([2.0])
    # |sigma| stays below rho(t) = rho0 exp(-mu t) + rho_inf; it must start below rho0 + rho_inf.
    funnel = qj.Funnel(
        rho0=draw.parameter("rho0", 5.0, bounds=(1.0, 20.0)),
        mu=draw.parameter("mu", 2.0, bounds=(0.5, 10.0)),
        rho_inf=draw.parameter("rho_inf", 0.05, bounds=(0.001, 0.09)),
    )
    control = qj.QuasiSlidingControl(surface, funnel)
    loop = qj.ClosedLoop(plant, reference, disturbance, control)
    return qj.Scenario(loop, x0=draw.uniform("x0", -0.8, 0.8, shape=(2,)), t1=10.0)


# Columns of your own, in addition to some twenty that every run has: functions of the signals at one instant.
overshoot = qj.metrics.Peak("overshoot", lambda s: jnp.abs(s.x[0]) - 1.0, after=3.0, unit="m")
settling = qj.metrics.LastTime("settling", lambda s: jnp.abs(s.e[0]) - 0.02)

# Quasi-sliding mode: |sigma| < 0.1 after the reaching time. It must lie between rho_inf and rho0.
study = qj.Study(scenario, bandwidth=0.1, metrics=[overshoot, settling])
