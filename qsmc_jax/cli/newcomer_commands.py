"""The commands `qsmc init` and `qsmc doctor`: a study to begin with, and what this installation can do.

Exit codes: 0 done, 2 bad input.
"""

import importlib.metadata
import importlib.util
import os
import platform
import sys
import time
from importlib import resources
from pathlib import Path
from typing import Annotated

import typer

from qsmc_jax.base.errors import InputError
from qsmc_jax.cli.cache import cache_folder, keep_compiled_programs
from qsmc_jax.cli.console import say
from qsmc_jax.cli.options import Cache
from qsmc_jax.cli.session import session

_PACKAGES = ("qsmc_jax", "jax", "jaxlib", "diffrax", "equinox", "numpy", "scipy", "pyarrow", "matplotlib")
_EXTRAS = {"cluster": ("distributed",), "notebook": ("ipykernel", "ipywidgets", "jupytext", "pandas", "xarray")}


def register_newcomer(app: typer.Typer) -> None:
    """Adds the commands to the application."""
    app.command("init")(write_study)
    app.command("doctor")(examine)


def write_study(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="New Python file.")] = Path("my_study.py"),
) -> None:
    """Write a commented study that runs at once, to begin with."""
    with session(cache=False):
        if path.suffix != ".py":
            raise InputError(f"Argument `FILE` must be a Python file, such as `{path.name}.py`, but is `{path}`.")
        text = resources.files("qsmc_jax.cli").joinpath("templates", "new_study.py").read_text(encoding="utf-8")
        try:
            with path.open("x", encoding="utf-8") as file:
                file.write(text.replace("my_study.py", str(path)))
        except FileExistsError:
            raise InputError(f"Argument `FILE` must be a new file, but `{path}` exists. Choose another.") from None
        except OSError as error:
            raise InputError(f"Argument `FILE` can't be written: {path}: {error.strerror}.") from None
        say(f"Written to {path}. Next:\n  qsmc verify {path} --runs 1000\nthen read it, and put in your own plant.")


def examine(cache: Cache = True) -> None:
    """Print versions, devices, precision, cache and cores, and try functions and a solve whose values are known."""
    with session(cache=False):
        import jax

        import qsmc_jax as qj
        from qsmc_jax.base.self_test import wrong_functions
        from qsmc_jax.base.vectorise import why_not_vectorised

        if cache:
            keep_compiled_programs()
        lines = [f"python {platform.python_version()} at {sys.executable}", platform.platform()]
        lines += [f"{name} {importlib.metadata.version(name)}" for name in _PACKAGES]
        for extra, names in _EXTRAS.items():
            missing = [name for name in names if importlib.util.find_spec(name) is None]
            hint = f"without {', '.join(missing)}: pip install 'qsmc_jax[{extra}]'" if missing else "there"
            lines.append(f"extra {extra}: {hint}")
        lines.append(f"devices: {', '.join(f'{each.platform} ({each.device_kind})' for each in jax.devices())}")
        lines.append(f"cores: {os.cpu_count()}")
        lines.append(f"precision: float64 in every entry point; JAX's own default is {_default_precision()}")
        lines.append(f"compiled programs: {_cache_size()}")
        begin = time.perf_counter()
        run = qj.simulate(qj.paper.example1(), x0=[0.9, 0.9], t1=20.0)
        first = time.perf_counter() - begin
        # Theorem 1 of the paper: the funnel holds.
        lines.append(f"Example 1 of the paper: {run.verdict.name} in {first:.2f} s, compilation included")
        lines.append(f"sines and the like by vector instructions: {why_not_vectorised() or 'yes, on CPUs'}")
        wrong = wrong_functions()
        found = f"wrong: {', '.join(wrong)}" if wrong else "right"
        lines.append(f"elementary functions under the batches' compiler options: {found}")
        say("\n".join(lines))
    raise typer.Exit(0 if run.verdict.name == "HELD" and not wrong else 1)


def _default_precision() -> str:
    import jax

    return str(jax.dtypes.canonicalize_dtype(float))


def _cache_size() -> str:
    folder = cache_folder()
    if not folder.is_dir():
        return f"none yet, to be kept in {folder}"
    sizes = [file.stat().st_size for file in folder.iterdir() if file.is_file()]
    return f"{len(sizes)} files, {sum(sizes) / 1e6:.0f} MB in {folder}"
