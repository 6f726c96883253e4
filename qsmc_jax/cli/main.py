"""The program `qsmc`: `simulate` and `paper` here, the other commands in files of their own.

What the exit codes mean is said in `exit_codes.py`.
"""

import contextlib
import gc
import os
import sys
from functools import partial
from typing import Annotated

import typer

from qsmc_jax import __version__
from qsmc_jax.base.stack import with_room
from qsmc_jax.cli.campaign_commands import register_campaign
from qsmc_jax.cli.card_command import card_of_study
from qsmc_jax.cli.console import say, say_json
from qsmc_jax.cli.exit_codes import HELD, MEANING, UNDECIDED, VIOLATED, code_of
from qsmc_jax.cli.interrupts import obeying
from qsmc_jax.cli.newcomer_commands import register_newcomer
from qsmc_jax.cli.options import Atol, Cache, Json, MaxSteps, Method, Out, Overrides, Rtol, Seed, StudyFile
from qsmc_jax.cli.program import Program
from qsmc_jax.cli.progress import waiting
from qsmc_jax.cli.proof_commands import register_proof
from qsmc_jax.cli.robustness_commands import register
from qsmc_jax.cli.session import session
from qsmc_jax.cli.study_file import Source, load_study
from qsmc_jax.cli.tune_command import tune_study
from qsmc_jax.cli.verify_command import verify_study

# After so many new ones Python looks for objects that nobody refers to.
_NEW_OBJECTS = 200_000

app = typer.Typer(
    cls=Program,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help=f"Simulate, verify and tune quasi-sliding-mode control loops. {MEANING}",
)


def _say_version(is_asked: bool) -> bool:
    if is_asked:
        say(f"qsmc_jax {__version__}")
        raise typer.Exit(HELD)
    return is_asked


@app.callback()
def configure(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_say_version, help="Print the version.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show results and errors only.")] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", help="Show what is compiled, solved again and written.")
    ] = False,
) -> None:
    """Simulate, verify and tune quasi-sliding-mode control loops."""
    del version, debug, quiet, verbose  # the first ends the program, `Program` sees the others before anything fails


@app.command()
def simulate(
    study_file: StudyFile,
    index: Annotated[int | None, typer.Option(help="Run to replay; default the nominal run.")] = None,
    seed: Seed = 0,
    overrides: Overrides = None,
    out: Out = None,
    as_json: Json = False,
    rtol: Rtol = 1e-6,
    atol: Atol = None,
    max_steps: MaxSteps = 100_000,
    method: Method = "auto",
    cache: Cache = True,
) -> None:
    """Solve the nominal run of a study, or replay one run of a verification, in full."""
    with session(cache):
        from qsmc_jax import SolverSettings
        from qsmc_jax.metrics.claims import gravest, is_requirement
        from qsmc_jax.report.folder import ResultFolder
        from qsmc_jax.report.signals import metrics_as_numbers

        with ResultFolder(out) if out else contextlib.nullcontext() as folder:
            study = load_study(Source.read(study_file), overrides or [])
            settings = SolverSettings(rtol, atol, max_steps, method)
            with waiting("solving"):
                run = (
                    study.simulate(settings=settings) if index is None else study.replay(index, seed, settings=settings)
                )
            numbers = metrics_as_numbers(run)
            say_json(numbers) if as_json else say(str(run))
            if folder:
                folder.add_json("run.json", numbers)
                folder.add_table("signals.parquet", run.columns())
                folder.add_result(run)
                folder.add_picture("run.png", run.plot)
                if len(run.loop.channels) == 1 and run.loop.order == 2:
                    folder.add_picture("phase_plane.png", run.plot_phase_plane)
                folder.commit()
                if not as_json:
                    say(f"Written to {out}.")
    # The horizon of one run may be too short for the later claims of Theorem 1.
    judged = [verdict for claim, verdict in run.verdicts.items() if claim == "funnel" or is_requirement(claim)]
    raise typer.Exit(code_of(gravest(judged).name))


@app.command()
def paper(out: Out = None, as_json: Json = False, cache: Cache = True) -> None:
    """Both examples of the paper from all their starts: a table of claim, paper's number and ours, and the pictures."""
    with session(cache):
        from qsmc_jax.report.folder import ResultFolder
        from qsmc_jax.report.paper_table import as_text, rows, simulate_example
        from qsmc_jax.simulation.trajectory_plots import plot_trajectory

        with ResultFolder(out) if out else contextlib.nullcontext() as folder:
            with waiting("solving"):
                runs = {number: simulate_example(number) for number in (1, 2)}
            table = [row for number, each in runs.items() for row in rows(number, each)]
            content = {"claims": [vars(row) for row in table]}
            say_json(content) if as_json else say(as_text(table))
            if folder:
                for number, each in runs.items():
                    labels = tuple(f"$x_i(0)$ = {run.x[0, 0]:g}" for run in each)
                    folder.add_picture(f"example{number}.png", partial(plot_trajectory, *each, labels=labels))
                folder.add_picture("figure1_phase_plane.png", runs[1][0].plot_phase_plane)
                folder.add_json("paper.json", content)
                folder.commit()
                if not as_json:
                    say(f"Written to {out}.")
    raise typer.Exit(HELD if all(row.is_met for row in table) else VIOLATED)


app.command("verify")(verify_study)
register(app)
register_campaign(app)
register_newcomer(app)
register_proof(app)
app.command("tune")(tune_study)
app.command("card")(card_of_study)


def main() -> None:
    """The program as a process of its own, in which signals are obeyed to the end."""
    # Tracing makes many objects that stay: looking through all of them each 700 new ones took a quarter of its time.
    gc.set_threshold(_NEW_OBJECTS)
    with obeying():
        try:
            with_room(app, prog_name="qsmc")
        except SystemExit as end:
            gc.freeze()  # or Python looks through them once more as it ends
            if end.code == UNDECIDED:
                # An interruption leaves threads at work, for which Python would wait.
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(UNDECIDED)
            raise
