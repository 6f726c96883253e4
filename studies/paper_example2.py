"""The paper's Example 2 as printed: a system of order 4 from its three starts, under a disturbance that jumps.

Question: does the loop stay in its funnel from each start of the paper?
Claim: HELD; sup |sigma|/rho is 0.9673 from (0.7, 0.7, 0.7, 0.7), the worst of the three.
Time: seconds.
"""

import jax.numpy as jnp

import qsmc_jax as qj


def scenario(draw: qj.Draw) -> qj.Scenario:
    """One of the paper's three starts, all states alike."""
    start = draw.choice("start", qj.paper.STARTS[2])
    return qj.Scenario(qj.paper.example2(), x0=jnp.full(4, start), t1=qj.paper.HORIZON)


study = qj.Study(scenario, bandwidth=qj.paper.BANDWIDTH)
