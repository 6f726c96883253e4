"""The commands `qsmc certify` and `qsmc check`.

Exit codes: 0 proved, 2 bad input or a proof that does not hold, 3 not proved or interrupted.
"""

import contextlib
import sys
from pathlib import Path
from typing import Annotated

import typer

from qsmc_jax.cli.console import say, say_json
from qsmc_jax.cli.exit_codes import HELD, UNDECIDED
from qsmc_jax.cli.options import Cache, Json, Out, Overrides, StudyFile
from qsmc_jax.cli.progress import waiting
from qsmc_jax.cli.session import session
from qsmc_jax.cli.study_file import Source, load_study


def register_proof(app: typer.Typer) -> None:
    """Adds the commands to the application."""
    app.command("certify")(certify_study)
    app.command("check")(check_proof)


def certify_study(
    study_file: StudyFile,
    boxes: Annotated[int, typer.Option(help="Most boxes of starts and parameters that are told apart.")] = 64,
    target: Annotated[float | None, typer.Option(help="Bound of |u| that is enough.")] = None,
    overrides: Overrides = None,
    out: Out = None,
    as_json: Json = False,
    cache: Cache = True,
) -> None:
    """Prove that every run of a study keeps its funnel, with certain bounds of input and errors.

    Exit codes: 0 proved, 2 bad input, 3 not proved (which says nothing against the loop), or interrupted.
    """
    with session(cache):
        from qsmc_jax.proof.certify import certify
        from qsmc_jax.report.folder import ResultFolder
        from qsmc_jax.report.provenance import provenance

        with ResultFolder(out) if out else contextlib.nullcontext() as folder:
            source = Source.read(study_file)
            study = load_study(source, overrides or [])
            with waiting("proving"):
                proof = certify(study, boxes, target)
            content = {**proof.summary(), "provenance": provenance(source.path, source.content, sys.argv)}
            say_json(content) if as_json else say(str(proof))
            if folder:
                for name, file in proof.files().items():
                    folder.add_file(name, file)
                folder.add_json("certify.json", content)
                folder.add_picture("proof.png", proof.plot)
                folder.commit()
                if not as_json:
                    say(f"Written to {out}. `qsmc check {out} {study_file}` checks it again.")
    raise typer.Exit(HELD if proof.is_proved else UNDECIDED)


def check_proof(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of `qsmc certify --out`.")],
    study_file: Annotated[Path | None, typer.Argument(metavar="STUDY", help="The study it should be of.")] = None,
    as_json: Json = False,
) -> None:
    """Check a proof again: every slab, and that its bounds follow; with STUDY also that it is of this study.

    Exit codes: 0 it holds, 2 it does not, or is of another study, 3 it proves nothing.
    """
    with session(cache=False):
        from qsmc_jax.proof.certify import load_proof

        study = None if study_file is None else load_study(Source.read(study_file), [])
        with waiting("checking"):
            proof = load_proof(folder, study)
        named = (
            "" if study_file else f" Give the study too, `qsmc check {folder} STUDY`, to see that it is of this study."
        )
        told = {**proof.summary(), "is_of_study": study is not None}
        say_json(told) if as_json else say(f"{proof}\nChecked.{named}" if proof.is_proved else str(proof))
    raise typer.Exit(HELD if proof.is_proved else UNDECIDED)
