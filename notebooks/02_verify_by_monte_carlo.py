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
# # 2. Verify by Monte Carlo
#
# A theorem holds for the loop that it speaks of. Does the guarantee hold for *yours*, over all the starts,
# disturbances and plants that may come? Ask many runs, and say how sure the answer is.

# %%
import inspect
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy import stats

import qsmc_jax as qj

small = bool(os.environ.get("QSMC_SMOKE"))

# %% [markdown]
# ## A scenario
#
# A scenario is a function from named random numbers to one run: a loop, a start, a horizon [s]. `draw.uniform("mass",
# ...)` draws, as `lognormal`, `beta`, `from_scipy`, `empirical` and others do (see `help(qj.Draw)`);
# `draw.parameter("mu", ...)` stays at its default until somebody substitutes it. Here Example 1 of the
# paper has a pendulum that is known to 20 % only, a random disturbance with $|d| \le 0.5$ rad/s², and a random start.


# %%
def scenario(draw: qj.Draw) -> qj.Scenario:
    """Example 1 with everything uncertain."""
    plant = qj.plants.InvertedPendulum(
        mass=draw.uniform("mass", 0.008, 0.012),
        length=draw.uniform("length", 7.84, 11.76),
        friction=draw.uniform("friction", 0.008, 0.012),
    )
    funnel = qj.Funnel(rho0=4.0, mu=draw.parameter("mu", 3.0, bounds=(0.5, 10.0)), rho_inf=0.05)
    control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), funnel)
    disturbance = qj.disturbances.random_sine(draw, "d", bound=0.5, frequencies=(0.1, 10.0))
    loop = qj.ClosedLoop(plant, qj.references.SumOfSines([1.0], [1.0]), disturbance, control)
    return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=20.0)


study = qj.Study(scenario, bandwidth=0.1)
for spec in study.specs:
    print(f"{spec.name:12}{spec.kind:14}{spec.bounds}")

# %% [markdown]
# ## The verdict

# %%
result = qj.verify(study, runs=512 if small else 4000, seed=0)
print(result)

# %% [markdown]
# **How to read it.** Each line is a claim of Theorem 1. A run HELD, or was VIOLATED, or is UNDECIDED: the solver could
# not tell. INADMISSIBLE runs break a premise before they begin and are counted apart.
#
# The interval is about the *probability* that a run leaves the funnel. No violation in $N$ runs does not make it 0. It
# makes probabilities incredible that would have shown: with 95 % confidence it is at most about $3.7 / N$. The
# interval is Clopper and Pearson's, exact for independent runs. Undecided runs count as violated in its upper end and
# as held in its lower one.

# %%
axes = result.plot()

# %% [markdown]
# How many runs does it take to show a probability below $p$, if nothing is violated?

# %%
for probability in (1e-2, 1e-3, 1e-4, 1e-6):
    usual, careful = (qj.runs_needed(probability, confidence) for confidence in (0.95, 0.999))
    print(f"{probability:7g}: {usual:9d} runs, at 99.9 % confidence {careful:9d}")

# %% [markdown]
# ## The worst runs
#
# The worst runs are kept with everything that was drawn for them.

# %%
worst = result.worst
for i in range(len(worst)):
    row = worst.row(i)
    print(f"run {row['index']:5d}: sup |sigma|/rho {row['peak_ratio']:.4f} at {row['peak_time']:.3f} s,", end=" ")
    print(f"length {row['length']:.2f} m, start ({row['x0[0]']:.2f}, {row['x0[1]']:.2f})")

# %% [markdown]
# Run $i$ follows from study, seed and $i$ alone, so any of them can be solved again, in full.

# %%
again = study.replay(int(worst["index"][0]), seed=0)
print(again)
axes = again.plot()

# %% [markdown]
# `monte_carlo` gives the table itself: NumPy columns, one row a run. What makes a run bad?

# %%
runs = qj.monte_carlo(study, runs=512 if small else 4000, seed=0)
figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained", sharey=True)
for ax, name in zip(axes, ("x0[0]", "x0[1]", "length"), strict=True):
    ax.plot(runs[name], runs["peak_ratio"], ".", ms=3)
    ax.set(xlabel={"x0[0]": "start, angle [rad]", "x0[1]": "start, rate [rad/s]"}.get(name, "length [m]"))
axes[0].set(ylabel=r"sup $|\sigma| / \rho$ [-]")
plt.show()

# %% [markdown]
# The longer the pendulum, the less one unit of torque does ($g = 1 / (m l^2)$), and the further out the law has to go.
#
# ## Stopping when you like what you see
#
# An interval for a fixed number of runs is right 95 % of the time **at that number**. If you look after every hundred
# runs and stop at the look that suits you, you take the luckiest of many intervals. Try it with a coin that shows a
# violation with probability 0.02: how often does *some* interval on the way miss 0.02?

# %%
rng = np.random.default_rng(1)
truth, experiments, looks = 0.02, 60 if small else 300, np.arange(100, 3001, 100)
missed = {"fixed number": 0, "confidence sequence": 0}
for _ in range(experiments):
    counts = np.cumsum(rng.random(looks[-1]) < truth)[looks - 1]
    fixed = [stats.binomtest(int(k), int(n)).proportion_ci(0.95, "exact") for k, n in zip(counts, looks, strict=True)]
    always = [qj.confidence_sequence(int(k), 0, int(n), 0.95) for k, n in zip(counts, looks, strict=True)]
    missed["fixed number"] += any(not low <= truth <= high for low, high in fixed)
    missed["confidence sequence"] += any(not low <= truth <= high for low, high in always)
for name, count in missed.items():
    print(f"{name:20} missed at some look in {100 * count / experiments:.0f} % of {experiments} experiments")

# %% [markdown]
# A confidence sequence holds at all numbers of runs at once. While nothing is violated it ends at $3.7 / N$, like the
# interval for a fixed number; otherwise it is somewhat wider, and that is the price of looking. Here is the last of
# those experiments.

# %%
figure, ax = plt.subplots(figsize=(8, 4), layout="constrained")
for ends, label in ((fixed, "fixed number of runs"), (always, "confidence sequence")):
    low, high = np.array([tuple(each) for each in ends]).T
    ax.fill_between(looks, low, high, alpha=0.3, label=label)
ax.axhline(truth, color="black", ls="--", label="the truth")
ax.set(xlabel="runs [-]", ylabel="violation probability [-]", ylim=(0.0, 4.0 * truth))
ax.legend()
plt.show()

# %% [markdown]
# So there are stopping rules, and with one the intervals are those of a confidence sequence: `UntilBelow(p)` stops
# when the probability is known to be at most $p$ or known to be above it, `UntilWidth(w)` when the interval is narrow
# enough, and `SequentialTest(p0, p1)` is Wald's test. They look every 32768 runs.

# %%
early = qj.verify(study, runs=100_000, until=qj.stopping.UntilBelow(1e-3 if small else 2e-4))
print(early)

# %% [markdown]
# ## From the shell, in a folder that lasts
#
# The same thing is `qsmc verify STUDY.py --out RUN`. `STUDY.py` is a file with the scenario and the study, and `RUN`
# is a folder that keeps the rows. Interrupt it (Ctrl-C, a crash, a full disk), and the same command goes on where it
# stopped.

# %%
folder = Path(tempfile.mkdtemp())
text = "import qsmc_jax as qj\n\n\n" + inspect.getsource(scenario) + "\n\nstudy = qj.Study(scenario, bandwidth=0.1)\n"
(folder / "study.py").write_text(text, encoding="utf-8")
qsmc = shutil.which("qsmc", path=Path(sys.executable).parent)


def shell(*words):
    """Runs `qsmc` with these words in the folder, and prints the end of what it says."""
    print("$ qsmc", *words)
    done = subprocess.run([qsmc, *words], cwd=folder, capture_output=True, text=True, check=False)
    print(*(done.stdout or done.stderr).strip().splitlines()[-12:], sep="\n")


shell("verify", "study.py", "--runs", "500", "--out", "run")

# %% [markdown]
# Now ask for more. Nothing is solved a second time. Since you have seen the first result before you asked for more
# runs, the intervals are from now on those of a confidence sequence: the folder remembers.

# %%
if not small:
    shell("verify", "study.py", "--runs", "1000", "--out", "run")
shell("status", "run")
shutil.rmtree(folder)

# %% [markdown]
# `run/report.html` is one page to hand on. `run/blocks` are Parquet files for pandas, polars or duckdb. `qsmc show run
# --worst 1` shows the worst run again. With `--until-below 1e-4` it stops by itself.
