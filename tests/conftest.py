"""What every test runs under: 64 bits, no silent promotion, checked annotations, reproducible examples."""

import os

if "PYTEST_XDIST_WORKER" in os.environ:
    # The processes of pytest-xdist share the cores between them. To be set before JAX and NumPy start their threads.
    os.environ.update(NPROC="1", OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import hypothesis
import jax
import jaxtyping
import matplotlib as mpl

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

mpl.use("agg")

# Before anything imports the package: from here on beartype checks every call against its annotations.
jaxtyping.install_import_hook("qsmc_jax", "beartype.beartype")

hypothesis.settings.register_profile("default", deadline=None, derandomize=True, max_examples=50, database=None)
hypothesis.settings.load_profile("default")
