"""A loop that leaves its funnel with a probability known exactly: its gain has the wrong sign in that part of the runs.

x' = g u with g = -1 if `coin` < `p`, else 1, and x(0) = 0.5: with the wrong sign it leaves for sure, see `escape_time`.
With `flip` 1 the sides are exchanged, so that the probability is 1 - p.
"""

import jax.numpy as jnp

import qsmc_jax as qj
from studies_for_tests import Integrator


def scenario(draw):
    """P(violated) = p, or 1 - p."""
    p, flip = draw.parameter("p", 0.1, bounds=(0.0, 1.0)), draw.parameter("flip", 0.0, bounds=(0.0, 1.0))
    scale = draw.parameter("scale", 1.0, bounds=(0.5, 100.0))
    is_wrong = (draw.uniform("coin", 0.0, 1.0) < p) != (flip > 0.5)
    plant = Integrator(jnp.where(is_wrong, -1.0, 1.0) * scale)
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, 1.0, 0.1))
    loop = qj.ClosedLoop(plant, qj.references.Constant(0.0), qj.disturbances.Zero(), control)
    return qj.Scenario(loop, x0=[0.5 + 0.2 * draw.uniform("start", 0.0, 1.0)], t1=4.0)


study = qj.Study(scenario, bandwidth=0.2)
studies = {"slow": study, "fast": study.substitute(scale=4.0), "bad": study.substitute(p=0.5)}
