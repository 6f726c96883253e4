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
# # 6. Plants as they come
#
# Few plants come as a chain of integrators that one input drives. This notebook takes three as they are: a car on a
# measured road, with a wheel that the output does not show; a furnace with two inputs; and a tank whose heater cannot
# cool.

# %%
import os
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import qsmc_jax as qj

small = bool(os.environ.get("QSMC_SMOKE"))
runs = 64 if small else 256

# %% [markdown]
# ## A plant in its own coordinates
#
# A quarter of a car: a body on a wheel, spring and damper between them, and a force $u$ [N] that lifts the body off the
# wheel. Write down what the states do as the textbook has it,
#
# $$\dot x = f(t, x, d) + G(t, x)\,u, \qquad y = h(t, x),$$
#
# and put the disturbance $d$ where it enters. Here it is the height of the road, under the tyre. You say how often the
# output must be differentiated until the input shows, its *relative degree*: the force shows in the body's
# acceleration, so it is 2. The derivatives themselves are worked out for you.


# %%
class QuarterCar(qj.AbstractStateSpace):
    """Heights of body and wheel [m] above rest, then their rates [m/s]. Input: force between them [N]."""

    body: float = 250.0
    spring: float = 26000.0
    damper: float = 1500.0
    wheel: float = 43.0
    tyre: float = 1e5

    states: ClassVar[int] = 4
    relative_degrees: ClassVar[tuple[int, ...]] = (2,)

    def vector_field(self, t, x, d):
        """The strut between body and wheel, the tyre between wheel and road."""
        body, wheel, body_rate, wheel_rate = x
        strut = self.spring * (wheel - body) + self.damper * (wheel_rate - body_rate)
        return body_rate, wheel_rate, strut / self.body, (self.tyre * (d - wheel) - strut) / self.wheel

    def input_matrix(self, t, x):
        """The force lifts the body and presses on the wheel."""
        return 0.0, 0.0, 1.0 / self.body, -1.0 / self.wheel

    def output(self, t, x):
        """The body's height, which should not change."""
        return x[0]


# %% [markdown]
# ## A recorded signal
#
# A road is a file of samples. This one is made here, two bumps of 3 and 5 cm, 200 samples a second, in whole
# millimetres as an instrument has them. One of your own comes by `qj.Recording.from_csv("road.csv", time="t",
# value="height")`. `kind` says what is between the samples; the solver steps to each, so that none is missed.

# %%
times = np.arange(0.0, 3.005, 0.005)
bumps = [
    height * np.cos(5.0 * np.pi * np.clip(times - at, -0.1, 0.1)) ** 2 for at, height in ((0.8, 0.03), (1.6, 0.05))
]
road = qj.Recording(times, np.round(sum(bumps), 3), kind="linear")

funnel = qj.Funnel(rho0=1.0, mu=2.0, rho_inf=0.05)
control = qj.QuasiSlidingControl(qj.SlidingSurface([5.0]), funnel, gain=1000.0)
loop = qj.ClosedLoop(QuarterCar(), qj.references.Constant(0.0), qj.disturbances.Recorded(road), control)
run = qj.simulate(loop, x0=[0.02, 0.0, 0.0, 0.0], t1=3.0, bandwidth=0.1)
print(run)

# %% [markdown]
# The law has a `gain`, since tangents of 1 should mean 1000 N. `run.x` holds the states in the order in which you wrote
# them.

# %%
figure, (heights, forces) = plt.subplots(1, 2, figsize=(11.0, 3.6), layout="constrained")
heights.plot(run.ts, 1e3 * run.d, color="0.6", lw=3, label="road")
heights.plot(run.ts, 1e3 * run.x[:, 1], label="wheel")
heights.plot(run.ts, 1e3 * run.x[:, 0], label="body")
heights.set(xlabel="t [s]", ylabel="height above rest [mm]", title="What the output shows is the body alone")
heights.legend()
forces.plot(run.ts, 1e-3 * run.u)
forces.set(xlabel="t [s]", ylabel="u [kN]", title="The force that it takes")
plt.show()

# %% [markdown]
# The body hardly moves. The wheel is *internal dynamics*: nothing in Theorem 1 speaks of it, and it goes on hopping
# when the road is flat again. If the relative degree is not what you say, you are told.


# %%
class Slip(qj.AbstractStateSpace):
    """A mass that is pushed, with the wrong relative degree."""

    states: ClassVar[int] = 2
    relative_degrees: ClassVar[tuple[int, ...]] = (1,)

    def vector_field(self, t, x, d):
        """Free motion."""
        return x[1], d

    def input_matrix(self, t, x):
        """The push."""
        return 0.0, 1.0

    def output(self, t, x):
        """Where it is."""
        return x[0]


law = qj.QuasiSlidingControl(qj.SlidingSurface([]), funnel)
try:
    qj.simulate(qj.ClosedLoop(Slip(), qj.references.Constant(0.0), qj.disturbances.Zero(), law), [0.1, 0.0], 1.0)
except ValueError as error:
    print("ValueError:", error)

# %% [markdown]
# ## A requirement on what the output does not show
#
# Does the tyre stay on the road? At rest the weight presses it in by 29 mm: where the wheel rises by more above the
# road, it is off. Say so as a requirement, a function that is positive where all is well, and it gets a verdict and
# a margin [m] in each run, like the paper's claims. Spring and damper are drawn, and so is how high the bumps are.


# %%
def scenario(draw):
    """A car on worn springs and dampers, on bumps of uncertain height."""
    car = QuarterCar(spring=draw.uniform("spring", 22000.0, 30000.0), damper=draw.uniform("damper", 1000.0, 2000.0))
    bumpy = draw.uniform("scale", 0.2, 1.0) * qj.disturbances.Recorded(road)
    loop = qj.ClosedLoop(car, qj.references.Constant(0.0), bumpy, control)
    return qj.Scenario(loop, x0=[0.02, 0.0, 0.0, 0.0], t1=3.0)


PRESSED_IN = (250.0 + 43.0) * 9.81 / 1e5
on_road = qj.always(lambda s: PRESSED_IN - (s.x[1] - s.d), unit="m")
study = qj.Study(scenario, bandwidth=0.1, requirements={"road": on_road})
table = qj.monte_carlo(study, runs=runs)
held = [int(np.sum(table[name] == qj.Verdict.HELD)) for name in ("verdict", "verdict_road")]
print(f"of {runs} runs {held[0]} kept the funnel, and {held[1]} kept the tyre on the road")

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 3.6), layout="constrained")
left.plot(50.0 * table["scale"], table["margin"], ".")
left.set(xlabel="higher bump [mm]", ylabel="margin to the funnel [-]", ylim=(0.0, 1.0))
right.plot(50.0 * table["scale"], 1e3 * table["margin_road"], ".")
right.axhline(0.0, color="0.5", lw=1.0)
right.set(xlabel="higher bump [mm]", ylabel="margin of the tyre [mm]")
plt.show()

# %% [markdown]
# Every run stays inside its funnel, and still the wheel leaves the road where bumps are high: it pays for a body that
# stands still. A plant made of the body alone would not have told.
#
# ## Several inputs
#
# A furnace has two zones, each with a heater that warms the other zone a little, too. Heat flows between the zones and
# into the piece between them, whose temperature nobody measures. Now `input_matrix` has a row for each state, with a
# number for each input in it, `output` returns two numbers, and `d` is a pair: draughts, say.


# %%
class Furnace(qj.AbstractStateSpace):
    """Temperatures above ambient of two zones and of the piece between them [K]. Inputs: heating of each zone [kW]."""

    loss: float = 0.008
    between: float = 0.005
    to_piece: float = 0.005

    states: ClassVar[int] = 3
    relative_degrees: ClassVar[tuple[int, ...]] = (1, 1)

    def vector_field(self, t, x, d):
        """Losses, and what flows between the three [K/s]."""
        one, two, piece = x
        flow = self.between * (one - two)
        taken = 0.3 * self.to_piece * (one - piece), 0.3 * self.to_piece * (two - piece)
        warms = 0.5 * self.to_piece * (one + two - 2.0 * piece)
        return -self.loss * one - flow - taken[0] + d[0], -self.loss * two + flow - taken[1] + d[1], warms

    def input_matrix(self, t, x):
        """A fifth of what a heater gives goes next door [K/s per kW]."""
        return (0.5, 0.1), (0.1, 0.5), (0.0, 0.0)

    def output(self, t, x):
        """What the two thermometers show."""
        return x[0], x[1]


# %% [markdown]
# Each zone has a law that sees its own thermometer only. With `is_scaled=True` both together have a proof if the matrix
# by which inputs drive outputs, here $\begin{pmatrix} 0.5 & 0.1 \\ 0.1 & 0.5 \end{pmatrix}$, has a positive definite
# symmetric part: heaters that warm their own zone more than the other have.


# %%
def furnace(draw):
    """Both zones are heated up within some minutes, in draughts, with an insulation that is roughly known."""
    plant = Furnace(loss=draw.uniform("loss", 0.006, 0.01), between=draw.uniform("between", 0.003, 0.007))
    references = tuple(
        qj.references.Smooth(lambda t, high=high: 0.5 * high * (1.0 + jnp.tanh((t - 200.0) / 80.0)))
        for high in (180.0, 150.0)
    )
    draughts = tuple(qj.disturbances.random_sine(draw, f"draught{i}", 0.3, (0.01, 0.1)) for i in (0, 1))
    narrow = qj.Funnel(rho0=20.0, mu=0.02, rho_inf=2.0)
    law = qj.QuasiSlidingControl(qj.SlidingSurface([]), narrow, gain=10.0, is_scaled=True)
    loop = qj.MultivariableLoop(plant, references, draughts, (law, law))
    return qj.Scenario(loop, x0=[0.0, 0.0, 0.0], t1=600.0)


heaters = {
    "power": qj.always(lambda s: 5.0 - jnp.maximum(s.u[0], s.u[1]), unit="kW"),
    "heats": qj.always(lambda s: jnp.minimum(s.u[0], s.u[1]), unit="kW"),
}
two_zones = qj.Study(furnace, bandwidth=4.0, requirements=heaters)
heated = two_zones.simulate()
print(heated)

# %%
axes = heated.plot()

# %%
figure, ax = plt.subplots(figsize=(7.0, 3.6), layout="constrained")
for i, name in enumerate(("zone 0", "zone 1", "piece")):
    ax.plot(heated.ts, heated.x[:, i], label=name)
ax.set(xlabel="t [s]", ylabel="temperature above ambient [K]")
ax.legend()
plt.show()

# %% [markdown]
# In a verification each claim has a line for both channels together and one for each. Requirements are about all
# signals: here that no heater needs more than 5 kW, and that none is asked to cool.

# %%
result = qj.verify(two_zones, runs=runs)
print(result)

# %%
ax = result.plot_margin()

# %% [markdown]
# The funnels are kept, but in many runs a warm draught would have a heater cool, which it cannot. (`result.plot()` adds
# bands of the runs in their funnels, for which it solves some again.)
#
# ## An input with a limit on one side
#
# A tank of water is heated, and then should cool down. Its heater has 2 kW, and **it cannot cool**: that is left to the
# losses. The law does not know that, so first ask the metric `min_u` how much it would cool if it could. The reference
# falls from 40 K above ambient to 10 K, at a pace that is drawn. `Saturated` puts the law
# between two limits, in continuous time. (The tank is a chain of one integrator, so drift and gain are enough.)


# %%
class Tank(qj.AbstractPlant):
    """Temperature of the water above ambient [K]. Input: heating [kW]."""

    loss: float = 0.002
    heating: float = 0.1

    order: ClassVar[int] = 1

    def drift(self, t, x):
        """Losses [K/s]."""
        return -self.loss * x[0]

    def gain(self, t, x):
        """What a kilowatt does [K/s]."""
        return self.heating


def falling(pace, t):
    """From 40 to 10 K about t = 1500 s, within some two paces [s]."""
    return 25.0 - 15.0 * jnp.tanh((t - 1500.0) / pace)


def tank_under(limit):
    """The study of a tank whose law is given a limit."""

    def cooling_down(draw):
        """A tank that follows such a reference."""
        pace = draw.uniform("pace", 100.0, 600.0)
        reference = qj.references.Smooth(eqx.Partial(falling, pace))
        law = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(rho0=5.0, mu=0.01, rho_inf=1.0), offset=0.5)
        calm = qj.disturbances.Zero()
        return qj.Scenario(qj.ClosedLoop(Tank(), reference, calm, limit(law)), x0=[38.0], t1=3000.0)

    return qj.Study(cooling_down, bandwidth=2.0)


free, heater = tank_under(lambda law: law), tank_under(lambda law: qj.controllers.Saturated(law, (0.0, 2.0)))
wanted, given = qj.monte_carlo(free, runs=runs), qj.monte_carlo(heater, runs=runs)
for name, rows in (("without a limit", wanted), ("0 to 2 kW", given)):
    print(f"{name}: {int(np.sum(rows['verdict'] == qj.Verdict.HELD))} of {runs} runs HELD")

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 3.6), layout="constrained")
left.plot(wanted["pace"], wanted["min_u"], ".")
left.axhline(0.0, color="0.5", lw=1.0)
left.set(xlabel="pace [s]", ylabel="least heating that is asked for [kW]", title="Without a limit")
right.plot(given["pace"], given["margin"], ".")
right.set(xlabel="pace [s]", ylabel="margin to the funnel [-]", ylim=(0.0, 1.0), title="With a heater that cannot cool")
plt.show()

# %% [markdown]
# The funnel is left (margin 0) where the reference falls faster than the losses can follow. Where a little less is
# missing, the heater is off for a while and the funnel is kept all the same. `studies/cstr.py` has a reactor that runs
# away if its coolant is not cold enough. A loop that is sampled has the limit in its `qj.Implementation(...,
# input_range=(0.0, 2.0))`.
