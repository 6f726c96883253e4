"""A study that breaks an assumption on purpose: the controller believes g < 0 while g > 0.

Question: is a broken premise noticed, and named?
Claim: VIOLATED in every run; `least_gain`, the least of gain_sign * g, is negative and says why.
Time: seconds.
"""

import qsmc_jax as qj


def scenario(draw: qj.Draw) -> qj.Scenario:
    """Example 1 with the wrong sign."""
    control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05), gain_sign=-1)
    disturbance = qj.disturbances.random_sine(draw, "d", bound=0.5)
    reference = qj.references.SumOfSines([1.0], [1.0])
    loop = qj.ClosedLoop(qj.plants.InvertedPendulum(), reference, disturbance, control)
    return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=20.0)


study = qj.Study(scenario, bandwidth=0.1)
