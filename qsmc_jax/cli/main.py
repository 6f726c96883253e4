"""The commands `qsmc verify`, `qsmc simulate` and `qsmc paper`; `map`, `critical`, `compare`, `tune` stand beside it.

Exit codes: 0 held, 1 violated, 2 bad input, 3 undecided or interrupted.
"""

import contextlib
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from qsmc_jax.cli.console import progress_bar, say, waiting
from qsmc_jax.cli.options import Block, Cache, Json, MaxSteps, Out, Overrides, Rtol, Seed, StudyFile, Threads
from qsmc_jax.cli.robustness_commands import register
from qsmc_jax.cli.session import UNDECIDED, session
from qsmc_jax.cli.study_file import load_study
from qsmc_jax.cli.tune_command import tune_study

if TYPE_CHECKING:
    from qsmc_jax.simulation.outcome import Verdict

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Simulate, verify and tune quasi-sliding-mode control loops. "
    "Exit codes: 0 held, 1 violated, 2 bad input, 3 undecided or interrupted.",
)


@app.command()
def verify(
    study_file: StudyFile,
    runs: Annotated[int, typer.Option(help="Number of runs.")] = 10_000,
    seed: Seed = 0,
    confidence: Annotated[float, typer.Option(help="Confidence of each interval.")] = 0.95,
    overrides: Overrides = None,
    out: Out = None,
    as_json: Json = False,
    worst: Annotated[int, typer.Option(help="How many of the worst runs to list.")] = 5,
    rtol: Rtol = 1e-6,
    max_steps: MaxSteps = 100_000,
    block: Block = 512,
    threads: Threads = None,
    cache: Cache = True,
) -> None:
    """Verify the three claims of Theorem 1 by independent random runs, each with an exact interval."""
    with session(cache):
        from qsmc_jax import SolverSettings
        from qsmc_jax import verify as run_verification
        from qsmc_jax.report.folder import ResultFolder, to_json
        from qsmc_jax.report.provenance import provenance

        with ResultFolder(out) if out else contextlib.nullcontext() as folder:
            study = load_study(study_file, overrides or [])
            with progress_bar("solving", quiet=as_json) as progress:
                result = run_verification(
                    study,
                    runs,
                    seed,
                    confidence,
                    worst=worst,
                    settings=SolverSettings(rtol=rtol, max_steps=max_steps),
                    block=block,
                    threads=threads,
                    progress=progress,
                    sink=folder.add_rows if folder else None,
                )
            content = {**result.summary(), "provenance": provenance(study_file, sys.argv)}
            if folder and out:
                folder.add_json("verdict.json", content)
                with waiting("drawing", quiet=as_json):
                    folder.add_figure("verification.png", result.plot())
                folder.commit()
        say(
            to_json(content)
            if as_json
            else "\n".join((str(result), _details(result, study_file, overrides or [], out)))
        )
    raise typer.Exit(_exit_code(result.verdict))


@app.command()
def simulate(
    study_file: StudyFile,
    index: Annotated[int | None, typer.Option(help="Run to replay; default the nominal run.")] = None,
    seed: Seed = 0,
    overrides: Overrides = None,
    out: Out = None,
    as_json: Json = False,
    rtol: Rtol = 1e-6,
    max_steps: MaxSteps = 100_000,
    cache: Cache = True,
) -> None:
    """Solve the nominal run of a study, or replay one run of a verification, in full."""
    with session(cache):
        from qsmc_jax import SolverSettings
        from qsmc_jax.report.folder import ResultFolder, to_json
        from qsmc_jax.report.signals import figures_as_numbers, signals_table

        with ResultFolder(out) if out else contextlib.nullcontext() as folder:
            study = load_study(study_file, overrides or [])
            settings = SolverSettings(rtol=rtol, max_steps=max_steps)
            with waiting("solving", quiet=as_json):
                run = (
                    study.simulate(settings=settings) if index is None else study.replay(index, seed, settings=settings)
                )
            numbers = figures_as_numbers(run)
            if folder:
                folder.add_json("run.json", numbers)
                folder.add_table("signals.parquet", signals_table(run))
                folder.add_figure("run.png", run.plot())
                if run.loop.order == 2:
                    folder.add_figure("phase_plane.png", run.plot_phase_plane())
                folder.commit()
        say(to_json(numbers) if as_json else str(run) + (f"\nWritten to {out}." if out else ""))
    raise typer.Exit(_exit_code(run.verdict))


@app.command()
def paper(out: Out = None, as_json: Json = False, cache: Cache = True) -> None:
    """Both examples of the paper from all their starts: a table of claim, paper's number and ours, and the pictures."""
    with session(cache):
        from qsmc_jax.report.folder import ResultFolder, to_json
        from qsmc_jax.report.paper_table import as_text, rows, simulate_example
        from qsmc_jax.simulation.trajectory_plots import plot_phase_plane, plot_trajectory

        with ResultFolder(out) if out else contextlib.nullcontext() as folder:
            table = []
            for number in (1, 2):
                with waiting(f"example {number}", quiet=as_json):
                    runs = simulate_example(number)
                    table += rows(number, runs)
                    if folder:
                        labels = tuple(f"$x_i(0)$ = {run.x[0, 0]:g}" for run in runs)
                        folder.add_figure(f"example{number}.png", plot_trajectory(*runs, labels=labels))
                        if number == 1:
                            folder.add_figure("figure1_phase_plane.png", plot_phase_plane(runs[0]))
            content = {"claims": [vars(row) for row in table]}
            if folder:
                folder.add_json("paper.json", content)
                folder.commit()
        say(to_json(content) if as_json else as_text(table) + (f"\nWritten to {out}." if out else ""))
    raise typer.Exit(0 if all(row.is_met for row in table) else 1)


register(app)
app.command("tune")(tune_study)


def _exit_code(verdict: "Verdict") -> int:
    return {"HELD": 0, "VIOLATED": 1}.get(verdict.name, UNDECIDED)


def _details(result: Any, study_file: Path, overrides: list[str], out: Path | None) -> str:
    """What goes below the table: numerical error, and the worst runs with the command that shows each again."""
    error = result.numerical_error
    lines = [
        f"Numerical error of sup |sigma|/rho: {error.peak_ratio:.2g} ({error.checked} runs solved again at rtol / 100, "
        f"{error.changed} verdicts changed); doubtful runs solved again: {result.climbed[0]}",
        f"{result.runs / result.solve_seconds:.0f} runs/s, {result.steps / result.runs:.0f} steps a run, "
        f"lanes occupied {100 * result.occupancy:.0f} %",
        "Worst runs:",
    ]
    fixed = "".join(f" -S {shlex.quote(override)}" for override in overrides)
    for row in map(result.worst.row, range(len(result.worst))):
        again = f"qsmc simulate {shlex.quote(str(study_file))} --index {row['index']} --seed {result.seed}{fixed}"
        lines.append(f"  {_finding(row)}   {again}")
    return "\n".join(lines + ([f"Written to {out}."] if out else []))


def _finding(row: dict[str, Any]) -> str:
    """One run in half a line: how close it came, or when it left and how the premises fared."""
    from qsmc_jax.simulation.outcome import Outcome, Verdict

    if row["verdict"] == Verdict.HELD:
        return f"sup |sigma|/rho {row['peak_ratio']:.6f}, sup |u| {row['peak_u']:.4g}"
    if row["verdict"] == Verdict.VIOLATED:
        premises = f"least gain_sign * g {row['least_gain']:.3g}, largest |d| {row['largest_disturbance']:.3g}"
        return f"left the funnel at {row['violation_time']:.6g} s, {premises}"
    return f"{Verdict(row['verdict']).name}, {Outcome(row['outcome']).name} at {row['end_time']:.6g} s"
