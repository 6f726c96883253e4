"""What every test runs under: 64 bits, no silent promotion, checked annotations, reproducible examples."""

import gc
import itertools
import os
import time
from pathlib import Path

if "PYTEST_XDIST_WORKER" in os.environ:
    # The processes of pytest-xdist share the cores between them. To be set before JAX and NumPy start their threads.
    os.environ.update(NPROC="1", OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    # What one process, command or run of the tests compiles serves all: JAX keeps programs by what they do and how they
    # are compiled. Commands find them where users have them, in their cache folder.
    os.environ["XDG_CACHE_HOME"] = str(Path(__file__).resolve().parents[1] / ".pytest_cache" / "d")
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(Path(os.environ["XDG_CACHE_HOME"]) / "qsmc_jax")
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"

import hypothesis
import jax
import jaxtyping
import matplotlib as mpl
import pytest

import places

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

mpl.use("agg")

_DAYS_KEPT = 3
_QUICK_TO_COMPILE = "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0"

# As the program does: tracing makes many objects that stay, and looking through them each 700 new ones takes its time.
gc.set_threshold(50_000)


def pytest_configure(config):
    """Before anything imports the package: from here on beartype checks every call against its annotations.

    Not for the slow tests alone, which it would make a quarter slower: what they call, the default ones call too. All
    tests have XLA write kernels in the older of its two ways and optimise little: the same numbers but for rounding,
    less time to compile and more to run. Where `XLA_FLAGS` is set, if to nothing, programs are compiled as for users:
    `.ci/run` says which tests are.
    """
    if config.option.markexpr != "slow":
        jaxtyping.install_import_hook("qsmc_jax", "beartype.beartype")
    if jax.__version_info__ < (0, 11):  # XLA aborts where it does not know a flag
        os.environ.setdefault("XLA_FLAGS", _QUICK_TO_COMPILE)
    if not hasattr(config, "workerinput"):
        _forget_old_programs()


def pytest_runtest_setup(item):
    """What holds of programs compiled as for users only is asked of these alone."""
    if item.get_closest_marker("as_users") and os.environ.get("XLA_FLAGS") == _QUICK_TO_COMPILE:
        pytest.skip("of programs compiled as for users: put `XLA_FLAGS=` in front")


def _forget_old_programs():
    """Those of the tests' own folder, lest it grow with every change."""
    for program in (places.ROOT / ".pytest_cache" / "d" / "qsmc_jax").glob("*"):
        if time.time() - program.stat().st_mtime > _DAYS_KEPT * 86_400:
            program.unlink(missing_ok=True)


hypothesis.settings.register_profile("default", deadline=None, derandomize=True, max_examples=50, database=None)
hypothesis.settings.load_profile("default")

# Each compiled program takes some dozens of the 65530 pieces of memory that Linux maps for a process: then XLA aborts.
_MAPS, _MOST_MAPS, _EVERY = Path("/proc/self/maps"), 25_000, 20
_tests = itertools.count(1)


@pytest.fixture(autouse=True)
def few_programs():
    """Forgets compiled programs once a process holds very many."""
    yield
    if next(_tests) % _EVERY == 0 and _MAPS.exists() and _MAPS.read_bytes().count(b"\n") > _MOST_MAPS:
        from qsmc_jax.study import batches

        batches._traced.cache_clear()
        batches._compiled.cache_clear()
        jax.clear_caches()
        gc.collect()
