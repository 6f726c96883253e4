# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # The law at work
#
# Example 1 of the paper: a pendulum follows sin t. The controller knows the plant's order and the sign of its gain,
# nothing else, and keeps the sliding variable inside a funnel that shrinks from 4.05 to 0.05.

# %%
import qsmc_jax as qj

loop = qj.paper.example1()
run = qj.simulate(loop, x0=[0.9, 0.9], t1=20.0)
print(run)

# %% [markdown]
# The four pictures of the paper, and its Figure 1: the errors' path between surfaces that close in on the bandwidth.

# %%
run.plot()

# %%
run.plot_phase_plane()

# %% [markdown]
# One run says little. A study draws what is uncertain, and `verify` says how sure one may be.


# %%
def scenario(draw):
    """The same loop from anywhere in a square of starts."""
    return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=20.0)


result = qj.verify(qj.Study(scenario, bandwidth=0.1), runs=256, block=128)
print(result)

# %%
result.plot()
