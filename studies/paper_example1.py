"""The paper's Example 1 as printed: an inverted pendulum from its four starts.

Question: does the pendulum stay in its funnel from each start of the paper?
Claim: HELD; sup |sigma|/rho is 0.7251 from (0.1, 0.1), the worst of the four.
Time: seconds.
"""

import jax.numpy as jnp

import qsmc_jax as qj


def scenario(draw: qj.Draw) -> qj.Scenario:
    """One of the paper's four starts, both states alike."""
    start = draw.choice("start", qj.paper.STARTS[1])
    return qj.Scenario(qj.paper.example1(), x0=jnp.full(2, start), t1=qj.paper.HORIZON)


study = qj.Study(scenario, bandwidth=qj.paper.BANDWIDTH)
