"""A fresh process with the defaults of JAX, as users have it: float64 inside entry points, nothing changed outside."""

import json
import os
import subprocess
import sys

import pytest

import places

SETTINGS = """
import json, logging, os, sys, warnings
import jax, numpy as np, diffrax, optimistix, scipy.stats  # what these change on import is their own doing

def settings():
    names = ("jax", "numpy", "warnings", "logging", "environ")
    values = (jax.config.values, np.geterr(), warnings.filters, logging.root.handlers, dict(os.environ))
    return {name: repr(value) for name, value in zip(names, values)}

before = settings()
import qsmc_jax as qj
for name in dir(qj):
    getattr(qj, name)
after = settings()
changed = [name for name in before if before[name] != after[name]]
print(json.dumps({"changed": changed, "modules": sorted(sys.modules)}))
"""

# Example 1 of the paper, sup |sigma|/rho from an independent integrator (DOP853, rtol 1e-12).
EXAMPLE_1 = """
import json
import jax, jax.numpy as jnp
import qsmc_jax as qj

control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
reference, disturbance = qj.references.SumOfSines([1.0], [1.0]), qj.disturbances.Sine(0.5, 1.0)
loop = qj.ClosedLoop(qj.plants.InvertedPendulum(), reference, disturbance, control)
run = qj.simulate(loop, [0.9, 0.9], 20.0)
inside = jax.jit(lambda a: a + float(qj.simulate(loop, [0.9, 0.9], 20.0).metrics.peak_ratio))(0.0)
arrays = (run.ts, run.x, run.e, run.sigma, run.rho, run.u, run.d, run.metrics.peak_ratio, run.metrics.energy_u)
dtypes = sorted({f"{type(array).__module__} {array.dtype}" for array in arrays})
peaks = [float(run.metrics.peak_ratio), float(inside)]
print(json.dumps({"peaks": peaks, "dtypes": dtypes, "outside": str(jnp.ones(1).dtype)}))
"""
PEAK_RATIO = 0.6322785613
OPTIONAL = {"matplotlib", "pyarrow", "typer", "rich"}


def in_a_fresh_process(program):
    environment = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    command = [sys.executable, "-W", "error::UserWarning", "-c", program]
    options = {"cwd": places.ROOT, "env": environment, "timeout": 300}
    done = subprocess.run(command, capture_output=True, text=True, check=False, **options)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def imported():
    return in_a_fresh_process(SETTINGS)


@pytest.fixture(scope="module")
def example_1():
    return in_a_fresh_process(EXAMPLE_1)


def test_importing_changes_no_global_setting(imported):
    assert imported["changed"] == []


def test_importing_loads_nothing_for_pictures_files_or_the_terminal(imported):
    assert OPTIONAL.isdisjoint(imported["modules"])


def test_a_run_in_a_32_bit_process_is_numpy_float64(example_1):
    assert example_1["dtypes"] == ["numpy float64"]


def test_a_run_in_a_32_bit_process_has_64_bit_numbers(example_1):
    assert example_1["peaks"][0] == pytest.approx(PEAK_RATIO, abs=2e-5)


def test_plain_numbers_are_solved_at_once_even_in_a_function_that_is_being_traced(example_1):
    assert example_1["peaks"][1] == pytest.approx(PEAK_RATIO, abs=2e-5)


def test_a_run_leaves_the_process_at_32_bits(example_1):
    assert example_1["outside"] == "float32"
