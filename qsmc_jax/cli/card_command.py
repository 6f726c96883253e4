"""The command `qsmc card`: a proof, an attack and random runs of a study on one page."""

import contextlib
import sys
from typing import Annotated

import typer

from qsmc_jax.cli.console import say, say_json
from qsmc_jax.cli.exit_codes import code_of
from qsmc_jax.cli.options import Cache, Json, Out, Overrides, Seed, StudyFile
from qsmc_jax.cli.progress import progress_bar
from qsmc_jax.cli.session import session
from qsmc_jax.cli.study_file import Source, load_study


def card_of_study(
    study_file: StudyFile,
    runs: Annotated[int, typer.Option(help="Random runs.")] = 1000,
    budget: Annotated[int, typer.Option(help="Simulations of the attack at most.")] = 400,
    boxes: Annotated[int, typer.Option(help="Boxes of starts and parameters that the proof tells apart at most.")] = 64,
    seed: Seed = 0,
    overrides: Overrides = None,
    out: Out = None,
    as_json: Json = False,
    cache: Cache = True,
) -> None:
    """Tell on one page what is certain of a study, how bad a run was found, and how probable a violation is.

    Exit codes: 0 held, 1 a run violates a claim, 2 bad input, 3 undecided or interrupted.
    """
    with session(cache):
        from qsmc_jax.report.card import card
        from qsmc_jax.report.folder import ResultFolder
        from qsmc_jax.report.provenance import provenance

        source = Source.read(study_file)
        with ResultFolder(out) if out else contextlib.nullcontext() as folder:
            study = load_study(source, overrides or [])
            with progress_bar("solving") as progress:
                found = card(study, runs, budget=budget, boxes=boxes, seed=seed, progress=progress)
            content = {**found.summary(), "provenance": provenance(source.path, source.content, sys.argv)}
            say_json(content) if as_json else say(str(found))
            if folder:
                folder.add_file("card.html", found.page(str(study_file)).encode())
                folder.add_json("card.json", content)
                folder.add_result(found)
                folder.commit()
                if not as_json:
                    say(f"Written to {out}: see {out}/card.html.")
    raise typer.Exit(code_of(found.verdict.name))
