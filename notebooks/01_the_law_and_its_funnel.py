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
# # 1. The law and its funnel
#
# Mishra and Jagtap propose a controller that knows almost nothing of its plant,
#
# $$\dot x_i = x_{i+1}, \qquad \dot x_n = f(x) + g(x)\,u + d(t), \qquad y = x_1 .$$
#
# It is told the order $n$ and the sign of $g$. Neither $f$ nor $d$ nor the size of $g$ is known to it. This notebook
# shows the law at work on Example 1 of the paper, and why one should not trust a simulation of it that was put
# together quickly.

# %%
import os

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

import qsmc_jax as qj

small = bool(os.environ.get("QSMC_SMOKE"))

# %% [markdown]
# ## The four pieces
#
# **A surface.** The error is $e = y - x_{des}$. For order 2 the sliding variable is $\sigma = c_1 e + \dot e$ [rad/s],
# with $c_1 > 0$ [1/s]. Where $\sigma = 0$, the error dies out as $e^{-c_1 t}$, whatever the plant is.
#
# **A funnel.** $\rho(t) = \rho_0 e^{-\mu t} + \rho_\infty$: it starts at the width $\rho_0 + \rho_\infty$ and shrinks
# with the rate $\mu$ [1/s] to $\rho_\infty$.
#
# **The law.** $u = -\mathrm{sgn}(g) \tan\frac{\pi \sigma}{2 \rho(t)}$. In the middle of the funnel it does little.
# Towards the edge it grows without bound, and so $\sigma$ never gets there: $|\sigma(t)| < \rho(t)$ for all $t$.
#
# **A promise.** For a bandwidth $\varepsilon > \rho_\infty$, $|\sigma| < \varepsilon$ from $t_r = \frac{1}{\mu} \ln
# \frac{\rho_0}{\varepsilon - \rho_\infty}$ [s] on, and then $e$ ends below $\varepsilon / c_1$.

# %%
surface = qj.SlidingSurface([2.0])
funnel = qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05)
control = qj.QuasiSlidingControl(surface, funnel, gain_sign=1)
print("reaching time [s]:", float(funnel.reaching_time(0.1)))
print("bounds on e and its rate in the end:", surface.error_bounds(0.1))

# %% [markdown]
# ## Example 1
#
# A pendulum of 10 g on a rod of 9.8 m is to follow $\sin t$ while $d = 0.5 \sin t$ disturbs it. The numbers of the
# surface and of the funnel above are the paper's.

# %%
plant = qj.plants.InvertedPendulum(mass=0.01, length=9.8, friction=0.01, gravity=9.8)
reference = qj.references.SumOfSines([1.0], [1.0])
disturbance = qj.disturbances.Sine(0.5, 1.0)
loop = qj.ClosedLoop(plant, reference, disturbance, control)

run = qj.simulate(loop, x0=[0.9, 0.9], t1=20.0)
print(run)

# %% [markdown]
# `sup |sigma|/rho` is how close the run came to the edge: 0 is the middle, 1 is the edge. `margin` is what was left.
# Three claims are judged: the *funnel* is kept, the bandwidth is *reached* in time, and the *tracking* errors
# keep their bounds from the time on at which the funnel guarantees it.
#
# The four pictures of the paper: output, error, input, and the sliding variable in its funnel. Every picture gives back
# its axes, and can be drawn in axes of yours: `run.plot_funnel(ax=ax)`.

# %%
axes = run.plot()

# %% [markdown]
# Figure 1 of the paper is the plane of $e$ and $\dot e$. The funnel's edges $\sigma = \pm\rho(t)$ are two parallel
# lines that close in on the surface, and the run (red) stays between them. Then it slides along the surface to the
# middle.

# %%
ax = run.plot_phase_plane()

# %% [markdown]
# The paper starts from four points. All stay in the funnel, with different margins.

# %%
for start in qj.paper.STARTS[1]:
    each = qj.simulate(loop, x0=[start, start], t1=qj.paper.HORIZON)
    print(f"from ({start}, {start}): {each.verdict.name}, sup |sigma|/rho = {float(each.metrics.peak_ratio):.4f}")

# %% [markdown]
# ## Try it
#
# Move the sliders, and see what each number does. A narrow funnel costs nothing here: the loop is ideal. A start that
# is not inside the funnel is INADMISSIBLE: the theorem says nothing of it, and there is nothing to draw. Without
# `ipywidgets` there is one picture instead.


# %%
def picture(mu=3.0, rho_inf=0.05, c=2.0, start=0.9):
    """Example 1 with these numbers, from (start, start)."""
    law = qj.QuasiSlidingControl(qj.SlidingSurface([c]), qj.Funnel(rho0=4.0, mu=mu, rho_inf=rho_inf))
    changed = qj.ClosedLoop(plant, reference, disturbance, law)
    tried = qj.simulate(changed, x0=[start, start], t1=10.0, bandwidth=0.1)
    print(tried.verdict.name, "-", tried.outcome.advice)
    tried.plot()


try:
    import ipywidgets
except ImportError:
    picture()
else:
    ipywidgets.interact(
        picture,
        mu=ipywidgets.FloatSlider(3.0, min=0.5, max=10.0, step=0.5, continuous_update=False),
        rho_inf=ipywidgets.FloatSlider(0.05, min=0.005, max=0.095, step=0.005, continuous_update=False),
        c=ipywidgets.FloatSlider(2.0, min=0.5, max=5.0, step=0.5, continuous_update=False),
        start=ipywidgets.FloatSlider(0.9, min=-2.0, max=3.0, step=0.1, continuous_update=False),
    )

# %% [markdown]
# ## Why not simply simulate?
#
# The equations are short, and SciPy has solvers. So write them down.


# %%
def plain(t, x, rho_inf, gain=lambda t: 1.0):
    """Example 1 as it stands in the paper."""
    sigma = 2.0 * (x[0] - np.sin(t)) + x[1] - np.cos(t)
    u = -np.tan(0.5 * np.pi * sigma / (4.0 * np.exp(-3.0 * t) + rho_inf))
    drift = -np.sin(x[0]) - x[1] + np.sin(x[1])
    return np.array([x[1], drift + gain(t) * u / (0.01 * 9.8**2) + 0.5 * np.sin(t)])


def ratios(ts, xs, rho_inf):
    """|sigma| / rho at the steps of a solver."""
    sigma = 2.0 * (xs[0] - np.sin(ts)) + xs[1] - np.cos(ts)
    return np.abs(sigma) / (4.0 * np.exp(-3.0 * ts) + rho_inf)


def euler(step, rho_inf):
    """Euler's method with a fixed step [s]."""
    ts = np.arange(0.0, 20.0, step)
    xs = [np.array([0.9, 0.9])]
    for t in ts[:-1]:
        xs.append(xs[-1] + step * plain(t, xs[-1], rho_inf))
    return ratios(ts, np.array(xs).T, rho_inf)


# %% [markdown]
# Then narrow the funnel, step by step, and note the largest $|\sigma| / \rho$ that each method finds. The theorem says
# that it is below 1, at every width.


# %%
def naive(method, rho_inf):
    """SciPy's `solve_ivp` at its default tolerance."""
    return solve_ivp(plain, (0.0, 20.0), [0.9, 0.9], method=method, args=(rho_inf,))


def ideal(rho_inf):
    """The same loop, by `qj.simulate`."""
    law = qj.QuasiSlidingControl(surface, qj.Funnel(rho0=4.0, mu=3.0, rho_inf=rho_inf))
    return qj.simulate(qj.ClosedLoop(plant, reference, disturbance, law), x0=[0.9, 0.9], t1=20.0)


print(f"{'rho_inf':>8}{'Euler 50 ms':>14}{'Euler 10 ms':>14}{'RK45':>14}{'Radau':>14}{'qj.simulate':>14}")
for rho_inf in (0.05, 0.02, 0.01, 0.005):
    found = [euler(step, rho_inf).max() for step in (0.05, 0.01)]
    found += [ratios(each.t, each.y, rho_inf).max() for each in (naive(m, rho_inf) for m in ("RK45", "Radau"))]
    found.append(float(ideal(rho_inf).metrics.peak_ratio))
    print(f"{rho_inf:8}" + "".join(f"{value:14.4g}" for value in found))

# %% [markdown]
# Numbers above 1 are **violations that never happened**. No solver complained. What happened is seen here.

# %%
rho_inf = 0.02
wrong, right = naive("RK45", rho_inf), ideal(rho_inf)
figure, ax = plt.subplots(figsize=(9, 4), layout="constrained")
ax.plot(wrong.t, ratios(wrong.t, wrong.y, rho_inf), label="solve_ivp, RK45")
ax.plot(right.ts, np.abs(right.sigma) / right.rho, label="qj.simulate")
ax.axhline(1.0, color="black", ls="--", label="edge of the funnel, pole of the tangent")
ax.set(xlabel="t [s]", ylabel=r"$|\sigma| / \rho$ [-]", title="A step over the pole")
ax.legend(loc="upper right")
ax.set(ylim=(0.0, 1.35 * ax.get_ylim()[1]))
plt.show()

# %% [markdown]
# The tangent has a pole at the edge, $\sigma = \rho$, and is periodic. A step that lands beyond the pole gets a
# finite, plausible input from the next branch. On that branch the law holds $|\sigma|$ near $2 \rho$, on the one after
# it near $4 \rho$, and the solver's error estimate is happy there. To know that this is wrong one must know the
# answer.
#
# ## A violation that is missed
#
# Now break the premise in earnest. At 3 s the actuator is reversed for less than 0.1 s, so that $g$ changes its sign.
# While it is reversed, the law pushes $\sigma$ out of its funnel.


# %%
def factor(t, xp=np):
    """What the gain is multiplied by."""
    return 1.0 - 2.0 * xp.exp(-(((t - 3.0) / 0.05) ** 2))


class Reversed(qj.AbstractPlant):
    """The pendulum of Example 1 with that gain."""

    order = 2

    def drift(self, t, x):
        """Gravity and friction."""
        return plant.drift(t, x)

    def gain(self, t, x):
        """The gain, reversed around 3 s."""
        return plant.gain(t, x) * factor(t, jnp)


truth = qj.simulate(qj.ClosedLoop(Reversed(), reference, disturbance, control), x0=[0.9, 0.9], t1=10.0)
missed = solve_ivp(plain, (0.0, 10.0), [0.9, 0.9], args=(0.05, factor))
print("solve_ivp:", missed.message, f"Largest |sigma|/rho {ratios(missed.t, missed.y, 0.05).max():.2f}")
print("qj.simulate:", truth.verdict.name, f"at {float(truth.metrics.violation_time):.4f} s.", truth.outcome.advice)

# %% [markdown]
# SciPy's steps went past those few hundredths of a second, and it reports a run that never came near the edge. At a
# tolerance of 1e-6 it would see the edge, and then chatter about it for a hundred thousand steps. `least_gain` names
# the broken premise:

# %%
print("least of sgn(g) g met on the way:", float(truth.metrics.least_gain))

# %% [markdown]
# ## What is done instead
#
# The loop is integrated in the coordinate $s = \operatorname{asinh} \tan \frac{\pi \sigma}{2 \rho}$. The funnel is
# then the whole line, the law is $u = -\mathrm{sgn}(g) \sinh s$, and there is no pole to step over. A loop that leaves
# its funnel shows as $|s|$ growing without bound in finite time. Peaks are found inside the steps. So a verdict does
# not hang on the tolerance:

# %%
for settings in (qj.SolverSettings(), qj.tight()):
    again = qj.simulate(loop, x0=[0.9, 0.9], t1=20.0, settings=settings)
    print(
        f"rtol {float(settings.rtol):g}: {again.verdict.name}, sup |sigma|/rho = {float(again.metrics.peak_ratio):.9f}"
    )

# %% [markdown]
# One run says little, though. Notebook 2 asks thousands.
