"""Studies to be proved, and a program that proves them as for users: `python proofs.py FOLDER NAME...`."""

import runpy
import sys
from pathlib import Path

import jax.numpy as jnp

import places
import qsmc_jax as qj
from problems import STILL, STILL_BANDWIDTH, WIDTH
from studies_for_tests import Integrator

REST = qj.references.Constant(0.0)


def still(gain=1.0, bound=2.0, reach=0.2, sign=1.0):
    """Order 1, s' = d + g u, sigma = x, in a funnel that stands still.

    Args:
        gain: g, or a function that draws it.
        bound: Bound of |d|.
        reach: |x(0)| is up to so much of the funnel.
        sign: Sign that the law takes g to have.
    """

    def scenario(draw):
        control = qj.QuasiSlidingControl(qj.SlidingSurface([]), STILL, sign)
        pushed = qj.disturbances.Constant(bound * draw.uniform("d", -1.0, 1.0))
        loop = qj.ClosedLoop(Integrator(gain(draw) if callable(gain) else gain), REST, pushed, control)
        return qj.Scenario(loop, x0=[draw.uniform("x0", -reach, reach) * WIDTH], t1=30.0)

    return qj.Study(scenario, bandwidth=STILL_BANDWIDTH)


class Third(qj.AbstractPlant):
    """A plant of order 3 whose drift has a kink, and whose gain depends on the time and a number in its field."""

    order = 3
    stiffness: float

    def drift(self, t, x):
        """A spring, a damper that only resists one way, and a push in time."""
        return -self.stiffness * x[0] - jnp.maximum(x[2], 0.0) + 0.2 * jnp.tanh(x[1]) * jnp.cos(t)

    def gain(self, t, x):
        """Always positive."""
        return 2.0 + jnp.sin(t) * x[0] / (1.0 + x[0] ** 2)


def third(c=(4.5, 4.0), offset=0.3):
    """Of order 3: the law has a gain, an offset and is scaled; the funnel has a centre; roots may be a pair."""

    def scenario(draw):
        funnel = qj.funnels.Asymmetric(qj.funnels.Smooth(lambda t: 1.0 + 2.0 * jnp.exp(-t)), qj.Funnel(2.0, 1.0, 0.8))
        control = qj.QuasiSlidingControl(qj.SlidingSurface(list(c)), funnel, gain=1.5, offset=offset, is_scaled=True)
        plant = Third(draw.uniform("stiffness", 0.5, 1.5))
        wave = qj.references.SumOfSines([0.1], [1.0])
        loop = qj.ClosedLoop(plant, wave, qj.disturbances.Constant(draw.uniform("d", -0.3, 0.3)), control)
        return qj.Scenario(loop, x0=draw.uniform("x0", -0.1, 0.1, shape=(3,)), t1=4.0)

    return qj.Study(scenario, bandwidth=1.2)


def example(number):
    """The study of an example of the paper with everything uncertain."""
    return runpy.run_path(str(places.STUDIES / f"example{number}_uncertain.py"))["study"]


STUDIES = {
    "still": lambda: still(),
    "far": lambda: still(bound=1.0, reach=0.8),
    "weak": lambda: still(gain=0.5, bound=3.0, reach=0.1),
    "third": lambda: third(),
    "example1": lambda: example(1),
}

if __name__ == "__main__":
    for name in sys.argv[2:]:
        qj.certify(STUDIES[name](), boxes=2 if name == "third" else 1).save(Path(sys.argv[1]) / name)
