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
# # 3. Your own plant
#
# A plant is a class with an order and two methods. This notebook brings one, step by step, verifies it, and then makes
# the mistakes that one makes.

# %%
import os
from typing import ClassVar

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import qsmc_jax as qj

small = bool(os.environ.get("QSMC_SMOKE"))

# %% [markdown]
# ## The plant
#
# A load hangs on a rope of length $l$ [m] under a trolley, and the input $u$ [m/s²] is the trolley's acceleration. The
# rope's angle $\varphi$ [rad] obeys
#
# $$\ddot\varphi = -\frac{G}{l} \sin\varphi - \delta \dot\varphi - \frac{\cos\varphi}{l} u + d(t).$$
#
# In the form $\dot x_1 = x_2$, $\dot x_2 = f + g u + d$ the *drift* $f$ is all that happens without input, and the
# *gain* $g$ is what one unit of input does. Here $g < 0$ as long as $|\varphi| < \pi / 2$: the load lags behind its
# trolley.
#
# Write the methods with `jax.numpy`, and index the state. Fields are numbers of the plant, all of which can be drawn.


# %%
class Crane(qj.AbstractPlant):
    """A load on a rope. State: angle [rad], angular velocity [rad/s]. Input: acceleration of the trolley [m/s^2]."""

    length: float
    damping: float

    order: ClassVar[int] = 2

    def drift(self, t, x):
        """Gravity and the resistance of the air [rad/s^2]."""
        return -9.81 / self.length * jnp.sin(x[0]) - self.damping * x[1]

    def gain(self, t, x):
        """What one m/s^2 of the trolley does [1/m]."""
        return -jnp.cos(x[0]) / self.length


# %% [markdown]
# ## The loop
#
# The **reference** is smooth: here a swing of 0.3 rad that builds up and dies out. Derivatives are found for you.
#
# The **disturbance** is bounded. Gusts of wind, $|d| \le 0.4$ rad/s².
#
# The **surface** $\sigma = 2 e + \dot e$ makes errors decay at 2 per second. The **funnel** must contain the start,
# and end below the bandwidth that you want.

# %%
reference = qj.references.Smooth(lambda t: 0.3 * jnp.sin(1.5 * t) * jnp.exp(-(((t - 7.5) / 4.0) ** 2)))
wind = qj.disturbances.SumOfSines([0.2, 0.1, 0.1], [0.7, 1.9, 4.3])
surface = qj.SlidingSurface([2.0])
funnel = qj.Funnel(rho0=2.0, mu=2.0, rho_inf=0.05)
control = qj.QuasiSlidingControl(surface, funnel, gain_sign=-1)
loop = qj.ClosedLoop(Crane(length=2.0, damping=0.1), reference, wind, control)
run = qj.simulate(loop, x0=[0.4, 0.0], t1=15.0, bandwidth=0.1)
print(run)

# %%
axes = run.plot()

# %% [markdown]
# ## The study
#
# The rope may be 1.5 to 2.5 m long, the wind is random, and so is the start.


# %%
def scenario(draw):
    """A crane that is only roughly known, in gusts."""
    crane = Crane(length=draw.uniform("length", 1.5, 2.5), damping=draw.uniform("damping", 0.0, 0.2))
    gusts = qj.disturbances.random_sines(draw, "wind", bound=0.4, terms=4)
    start = draw.uniform("x0", -0.4, 0.4, shape=(2,))
    return qj.Scenario(qj.ClosedLoop(crane, reference, gusts, control), x0=start, t1=15.0)


study = qj.Study(scenario, bandwidth=0.1)
result = qj.verify(study, runs=256 if small else 2000)
print(result)

# %%
axes = result.plot()

# %% [markdown]
# That is all. In a file, these cells are a study for `qsmc verify`.
#
# ## Mistakes
#
# What can be known before anything is solved raises a `ValueError` that says what to do.


# %%
def attempt(make):
    """Prints what comes of it, or the message."""
    try:
        print(make())
    except ValueError as error:
        print("ValueError:", error)


# %% [markdown]
# **A surface that is not Hurwitz.** On $\sigma = 0$ the error would grow.

# %%
attempt(lambda: qj.SlidingSurface([-2.0]))

# %% [markdown]
# **The wrong number of coefficients.** A plant of order $n$ needs $n - 1$ of them.

# %%
too_many = qj.QuasiSlidingControl(qj.SlidingSurface([1.0, 2.0]), funnel, gain_sign=-1)
attempt(lambda: qj.ClosedLoop(Crane(2.0, 0.1), reference, wind, too_many))

# %% [markdown]
# **A bandwidth below $\rho_\infty$.** The funnel never gets that narrow (condition C2 of the paper).

# %%
attempt(lambda: qj.simulate(loop, x0=[0.4, 0.0], t1=15.0, bandwidth=0.04))


# %% [markdown]
# **A drift that returns the wrong shape.** It is one number, the last state's rate, not the whole derivative.


# %%
class WrongShape(qj.AbstractPlant):
    """A crane whose drift is the derivative of the whole state."""

    order: ClassVar[int] = 2

    def drift(self, t, x):
        """Two numbers: one too many."""
        return jnp.stack([x[1], -4.9 * jnp.sin(x[0])])

    def gain(self, t, x):
        """The gain [1/m]."""
        return -0.5


attempt(lambda: qj.ClosedLoop(WrongShape(), reference, wind, control))

# %% [markdown]
# **NumPy in place of `jax.numpy`.** JAX runs a plant with stand-ins for numbers, which NumPy does not know. The same
# goes for a Python `if` on the state, and for numbers that a study draws.


# %%
class Plain(qj.AbstractPlant):
    """A crane written with NumPy."""

    order: ClassVar[int] = 2

    def drift(self, t, x):
        """Gravity [rad/s^2]."""
        return -4.9 * np.sin(x[0])

    def gain(self, t, x):
        """The gain [1/m]."""
        return -0.5


attempt(lambda: qj.ClosedLoop(Plain(), reference, wind, control))

# %% [markdown]
# **A function where a model belongs.** A reference has derivatives, a disturbance a bound: both are objects.

# %%
attempt(lambda: qj.ClosedLoop(Crane(2.0, 0.1), jnp.sin, wind, control))

# %% [markdown]
# **Dry friction by a sign.** Drift and gain may jump in time, but not in the state: a loop may stick on such a jump,
# where no solver goes on. A sign that turns over a small width, `qj.smoothed.sign(x[1], 1e-4)`, is as good.


# %%
class Rusty(qj.AbstractPlant):
    """A crane with dry friction in its joint."""

    order: ClassVar[int] = 2

    def drift(self, t, x):
        """Gravity and friction [rad/s^2]."""
        return -4.9 * jnp.sin(x[0]) - 0.2 * jnp.sign(x[1])

    def gain(self, t, x):
        """The gain [1/m]."""
        return -0.5


attempt(Rusty)

# %% [markdown]
# **A reference with a step.** It has no derivative there, and the law needs $n - 1$ of them.

# %%
attempt(lambda: qj.references.Smooth(lambda t: jnp.where(t < 5.0, 0.0, 0.3)))

# %% [markdown]
# **Derivatives that are not those of the reference.** Let `Smooth` find them, or find the slip.


# %%
class Swing(qj.AbstractReference):
    """A swing of which the second derivative lacks its sign."""

    def derivatives(self, t, order):
        """Value and derivatives [rad, rad/s, rad/s^2]."""
        return (0.3 * jnp.sin(t), 0.3 * jnp.cos(t), 0.3 * jnp.sin(t))[: order + 1]


attempt(lambda: qj.simulate(qj.ClosedLoop(Crane(2.0, 0.1), Swing(), wind, control), x0=[0.4, 0.0], t1=15.0))

# %% [markdown]
# ## Mistakes that show in a run
#
# A run that ends badly raises nothing. Its verdict and its outcome say what happened.


# %%
def told(run):
    """Verdict and advice."""
    return f"{run.verdict.name}, ended at {float(run.metrics.end_time):.4f} s\n{run.outcome.advice}"


# %% [markdown]
# **A start outside the funnel**, $|\sigma(0)| \ge \rho(0)$: INADMISSIBLE, since the theorem asks for more.

# %%
attempt(lambda: told(qj.simulate(loop, x0=[1.5, 0.0], t1=15.0)))

# %% [markdown]
# **The wrong sign of the gain**: VIOLATED, at a time, with the premise that broke.

# %%
wrong_sign = qj.QuasiSlidingControl(surface, funnel, gain_sign=+1)
broken = qj.simulate(qj.ClosedLoop(Crane(2.0, 0.1), reference, wind, wrong_sign), x0=[0.4, 0.0], t1=15.0)
attempt(lambda: told(broken))
print("least of gain_sign * g:", float(broken.metrics.least_gain))

# %% [markdown]
# ## Something that happens quickly
#
# Let something hit the load at 5 s, for a millisecond. A disturbance of your own has `break_times`, to which the solver
# steps. They are a hint that saves steps, no more: what is not declared, or declared at the wrong time, is found too.


# %%
class Blow(qj.AbstractDisturbance):
    """A push [rad/s^2] for a millisecond at 5 s, and the time at which it is declared to begin."""

    size: float
    declared: float

    def __call__(self, t):
        """The push at time t."""
        return jnp.where((t >= 5.0) & (t < 5.001), self.size, 0.0)

    @property
    def bound(self):
        """Its size."""
        return self.size

    @property
    def break_times(self):
        """When it begins and ends, as far as the solver is told."""
        return jnp.array([self.declared, self.declared + 0.001])


figure, ax = plt.subplots(figsize=(8, 3.6), layout="constrained")
for declared, label in ((5.0, "declared at 5 s"), (7.0, "declared at 7 s")):
    hit = qj.ClosedLoop(Crane(2.0, 0.1), reference, Blow(100.0, declared), control)
    blow = qj.simulate(hit, x0=[0.4, 0.0], t1=15.0, ts=np.linspace(4.95, 5.15, 401))
    peak = blow.metrics
    found = f"sup |sigma|/rho {float(peak.peak_ratio):.4f} at {float(peak.peak_time):.4f} s"
    print(f"{label:16} {found} in {int(peak.steps)} steps")
    ax.plot(blow.ts, np.abs(blow.sigma) / blow.rho, label=label)
ax.set(ylim=(0.0, 1.05), xlabel="t [s]", ylabel=r"$|\sigma| / \rho$ [-]", title="A blow of 1 ms at 5 s")
ax.legend()
plt.show()

# %% [markdown]
# What stands in `qj.disturbances` declares its jumps. A plant that changes at some time may do so too, and a reference
# whose highest derivative jumps.
