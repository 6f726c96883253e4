# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#       format_version: '1.3'
#       jupytext_version: 1.19.6
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # 4. Where the guarantee breaks
#
# The paper's proof needs an input that is continuous, unlimited and computed from exact states. A computer samples, is
# late, saturates, and measures with noise. How much of that does the guarantee survive?

# %%
import os

import matplotlib.pyplot as plt
import numpy as np

import qsmc_jax as qj

small = bool(os.environ.get("QSMC_SMOKE"))
runs = 64 if small else 256

# %% [markdown]
# ## An implementation
#
# An `Implementation` is what the computer does to the law. At $t_k = k \tau$ the states are read, with noise, and the
# input is computed from them, limited to $\pm u_{max}$, and held until the next one arrives, `delay` [s] later. Every
# number can be drawn or swept. Here is Example 1 of the paper, uncertain, and implemented: $\tau$ = 2 ms, a delay of 2
# ms, $|u| \le 20$ N m, noise of up to $10^{-3}$ rad/s on the rate.


# %%
def scenario(draw):
    """Example 1 with an uncertain mass, disturbance and start, as a computer runs it."""
    plant = qj.plants.InvertedPendulum(mass=draw.uniform("mass", 0.008, 0.012))
    funnel = qj.Funnel(rho0=4.0, mu=3.0, rho_inf=draw.parameter("rho_inf", 0.05, bounds=(0.005, 0.09)))
    control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), funnel)
    disturbance = qj.disturbances.random_sine(draw, "d", bound=0.5, frequencies=(0.1, 10.0))
    implementation = qj.Implementation(
        sample_period=draw.parameter("sample_period", 2e-3, bounds=(1e-4, 1.0)),
        delay=draw.parameter("delay", 2e-3, bounds=(0.0, 0.1)),
        saturation=draw.parameter("saturation", 20.0, bounds=(0.01, 1e3)),
        noise=qj.noises.uniform(draw, "noise_on_rate", [0.0, draw.parameter("noise", 1e-3, bounds=(0.0, 1.0))]),
        queue=64,
    )
    loop = qj.ClosedLoop(plant, qj.references.SumOfSines([1.0], [1.0]), disturbance, control, implementation)
    return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=4.0)


study = qj.Study(scenario, bandwidth=0.1)
run = study.replay(3)
print(run)
axes = run.plot()

# %% [markdown]
# Metrics are added: `sup (|sigma| - rho)` is how far outside the run got, and the last line is what "chattering-free"
# is worth. The *excess variation* is the total variation of $u$ beyond that of the equivalent input $-w / g$, which
# any controller needs.
#
# Slow the loop down, and it breaks.

# %%
slow = study.substitute(sample_period=0.1).replay(3)
print(slow)
axes = slow.plot()

# %% [markdown]
# ## A map
#
# `robustness_map` makes the same runs at each value of a name, so that neighbours differ by what the name does and not
# by chance. All intervals hold together. Lines are what theory knows:
#
# - *local*: where the loop, linearised along its nominal run, loses stability. A hold does at $\tau = 2 / k'$ with the
#   loop gain $k' = \frac{\pi g}{2 \rho} (1 + (w / g)^2)$ [1/s];
# - *sufficient*: up to here every run that meets the bounds on $w$ and $g$ keeps the funnel.

# %%
periods = np.geomspace(5e-3, 0.3, 5 if small else 16)
period_map = qj.robustness_map(study, over={"sample_period": periods}, runs=runs)
print(period_map)
axes = period_map.plot()

# %% [markdown]
# How low may the limit on the input be?

# %%
limits = np.geomspace(0.3, 20.0, 4 if small else 12)
saturation_map = qj.robustness_map(study, over={"saturation": limits}, runs=runs)
print(saturation_map)
axes = saturation_map.plot()

# %% [markdown]
# Two names make a picture: `.` no violation, `+` some, `#` half or more.

# %%
count = 3 if small else 8
both = {"delay": np.geomspace(2e-3, 0.08, count), "noise": np.geomspace(3e-3, 0.3, count)}
two = qj.robustness_map(study, over=both, runs=runs)
print(two)
axes = two.plot()

# %% [markdown]
# ## What theory says
#
# The thresholds are functions of their own, for planning before anything is simulated. With $g = 1 / (m l^2)$, a
# residual $w$ [rad/s²] at rest and the funnel's final width:

# %%
gain, residual, rho_inf, c = 1.0 / (0.01 * 9.8**2), 0.6, 0.05, [2.0]
thresholds = qj.thresholds
print(f"loop gain k'       {thresholds.small_signal_gain(gain, residual, rho_inf):8.4g} 1/s")
print(f"critical period    {thresholds.critical_period(gain, residual, rho_inf, c):8.4g} s")
print(f"critical delay     {thresholds.critical_delay(gain, residual, rho_inf, c):8.4g} s")
print(f"critical lag       {thresholds.critical_lag(gain, residual, rho_inf, c):8.4g} s")
funnel = qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05)
safe = thresholds.sufficient_period(residual_bound=6.0, gain_bounds=(0.87, 1.3), funnel=funnel, ratio0=0.5)
print(f"sufficient period  {safe.period:8.4g} s if |w| <= 6, with |sigma|/rho <= {safe.ratio:.3f}")

# %% [markdown]
# They go with $\rho_\infty$: a funnel half as wide wants a computer twice as fast. That is the price of accuracy, and
# it isn't visible in the ideal loop.

# %%
widths = np.geomspace(0.005, 0.09, 30)
figure, ax = plt.subplots(figsize=(7, 4), layout="constrained")
for name, limit in (("period", thresholds.critical_period), ("delay", thresholds.critical_delay)):
    ax.loglog(widths, [limit(gain, residual, width, c) for width in widths], label=f"critical {name}")
ax.set(xlabel=r"$\rho_\infty$ [rad/s]", ylabel="longest with a stable linearised loop [s]")
ax.legend()
plt.show()

# %% [markdown]
# ## A number to quote
#
# `critical_value` searches for the last value at which the probability of leaving the funnel is *shown* to be small.
# Each test has fresh runs, and the confidence holds over the whole search.

# %%
below, steps = (0.1, 3) if small else (0.02, 8)
critical = qj.critical_value(study, "sample_period", below, between=(2e-3, 0.3), steps=steps)
print(critical)
ax = critical.plot()

# %% [markdown]
# ## Rivals
#
# What else would one use? Every law gets the same loop, the same runs, the same limit and period. Laws with a slope at
# $\sigma = 0$ get that of the quasi-sliding-mode law, $\pi / (2 \rho_\infty)$. The sign law and super-twisting need
# what the quasi-sliding-mode law does without: bounds on the residual $w$ [rad/s²], on its rate, and on the gain.

# %%
RESIDUAL, RATE, LEAST_GAIN = 11.25, 8.0, 1.0 / (0.012 * 9.8**2)
laws = {
    "quasi-sliding mode": lambda law: law,
    "sign law": lambda law: qj.controllers.Sign.for_bound(law, RESIDUAL, LEAST_GAIN, 1.0),
    "super-twisting": lambda law: qj.controllers.SuperTwisting.for_rate(law, RATE, LEAST_GAIN),
    "funnel control": qj.controllers.FunnelControl.with_equal_slope,
}


def under(make):
    """The study of one law."""

    def rival(draw):
        """Example 1 under that law, sampled at 1 kHz."""
        law = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        plant = qj.plants.InvertedPendulum(mass=draw.uniform("mass", 0.008, 0.012))
        disturbance = qj.disturbances.random_sine(draw, "d", bound=0.5, frequencies=(0.1, 2.0))
        implementation = qj.Implementation(sample_period=1e-3, saturation=20.0)
        reference = qj.references.SumOfSines([1.0], [1.0])
        loop = qj.ClosedLoop(plant, reference, disturbance, make(law), implementation)
        return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=4.0)

    return qj.Study(rival, bandwidth=0.1)


chosen = ("quasi-sliding mode", "sign law") if small else tuple(laws)
metrics = ("peak_ratio", "peak_u", "excess_variation_u")
comparison = qj.compare({name: under(laws[name]) for name in chosen}, runs=runs, metrics=metrics)
print(comparison)

# %%
axes = comparison.plot()

# %% [markdown]
# All of them keep the funnel. The difference is in the last metric: the sign law pays for it with an input that never
# rests, and the quasi-sliding-mode law does not chatter. How much noise changes that, and more rivals, is in
# `studies/controllers_compared.py`.
