"""The commands `qsmc init` and `qsmc doctor`: a study to begin with, and what this installation can do.

Exit codes: 0 done, 2 bad input.
"""

import importlib.metadata
import importlib.util
import os
import platform
import shlex
import sys
import time
from importlib import resources
from pathlib import Path
from typing import Annotated

import typer

from qsmc_jax.base.errors import InputError
from qsmc_jax.cli.cache import cache_folder, keep_compiled_programs
from qsmc_jax.cli.console import say, say_json
from qsmc_jax.cli.exit_codes import HELD, VIOLATED
from qsmc_jax.cli.options import Cache, Json
from qsmc_jax.cli.session import session

_PACKAGES = ("qsmc_jax", "jax", "jaxlib", "diffrax", "equinox", "numpy", "scipy", "pyarrow", "matplotlib")
_EXTRAS = {"cluster": ("distributed",), "notebook": ("ipykernel", "ipywidgets", "jupytext", "pandas", "xarray")}


def register_newcomer(app: typer.Typer) -> None:
    """Adds the commands to the application."""
    app.command("init")(write_study)
    app.command("doctor")(examine)


def write_study(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="New Python file.")] = Path("my_study.py"),
    as_json: Json = False,
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
        following = shlex.join(["qsmc", "verify", str(path), "--runs", "1000"])
        said = f"Written to {path}. Next:\n  {following}\nthen read it, and put in your own plant."
        say_json({"written": str(path), "next": following}) if as_json else say(said)


def examine(as_json: Json = False, cache: Cache = True) -> None:
    """Print versions, devices, precision, cache and cores, and try functions and a solve whose values are known."""
    with session(cache=False):
        import jax

        import qsmc_jax as qj
        from qsmc_jax.tracing.platforms import platform as chosen_platform
        from qsmc_jax.tracing.self_test import wrong_functions
        from qsmc_jax.tracing.vectorise import why_not_vectorised

        if cache:
            keep_compiled_programs()
        begin = time.perf_counter()
        run = qj.simulate(qj.paper.example1(), x0=[0.9, 0.9], t1=20.0)
        first, wrong, chosen = time.perf_counter() - begin, wrong_functions(), chosen_platform()
        facts = {
            "python": f"{platform.python_version()} at {sys.executable}",
            "system": platform.platform(),
            **{name: importlib.metadata.version(name) for name in _PACKAGES},
            **{f"extra {extra}": _extra(extra, names) for extra, names in _EXTRAS.items()},
            "devices": ", ".join(f"{each.platform} ({each.device_kind})" for each in jax.devices()),
            "cores": os.cpu_count(),
            "batches": f"{chosen.block} runs together, {chosen.threads} at once",
            "precision": f"float64 in every entry point; JAX's own default is {_default_precision()}",
            "compiled programs": _cache_size(),
            # Theorem 1 of the paper: the funnel holds.
            "Example 1 of the paper": f"{run.verdict.name} in {first:.2f} s, compilation included",
            "sines and the like by vector instructions": _vectorised(chosen.rewrites, why_not_vectorised()),
            "elementary functions under the batches' compiler options": f"wrong: {', '.join(wrong)}"
            if wrong
            else "right",
        }
        is_well = run.verdict.name == "HELD" and not wrong
        say_json({**facts, "is_well": is_well}) if as_json else say("\n".join(f"{k}: {v}" for k, v in facts.items()))
    raise typer.Exit(HELD if is_well else VIOLATED)


def _extra(extra: str, names: tuple[str, ...]) -> str:
    missing = [name for name in names if importlib.util.find_spec(name) is None]
    return f"without {', '.join(missing)}: pip install 'qsmc_jax[{extra}]'" if missing else "there"


def _vectorised(rewrites: bool, problem: str) -> str:
    return problem or ("yes" if rewrites else "not needed on this platform")


def _default_precision() -> str:
    import jax

    return str(jax.dtypes.canonicalize_dtype(float))


def _cache_size() -> str:
    folder = cache_folder()
    if not folder.is_dir():
        return f"none yet, to be kept in {folder}"
    sizes = [file.stat().st_size for file in folder.iterdir() if file.is_file()]
    return f"{len(sizes)} files, {sum(sizes) / 1e6:.0f} MB in {folder}"
