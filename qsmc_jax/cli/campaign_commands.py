"""Commands on run folders: `qsmc status`, `show`, `report`, `export` and `worker`.

Exit codes: 0 done, 2 bad input, 3 interrupted, or (`show`) a run that does not come out as recorded.
"""

import os
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from qsmc_jax.base.errors import InputError
from qsmc_jax.cli.configs import config_again
from qsmc_jax.cli.console import say, say_json
from qsmc_jax.cli.exit_codes import HELD, UNDECIDED
from qsmc_jax.cli.interrupts import finishing
from qsmc_jax.cli.options import Block, Cache, Json, Out, Threads
from qsmc_jax.cli.progress import progress_bar, waiting
from qsmc_jax.cli.session import session

Folder = Annotated[Path, typer.Argument(metavar="RUN", help="Run folder that `qsmc verify --out` made.")]
Study = Annotated[Path | None, typer.Option("--study", help="The study's file, if it is no longer where it was.")]


def register_campaign(app: typer.Typer) -> None:
    """Adds the commands to the application."""
    for name, command in {
        "status": show_status,
        "show": show_run,
        "report": make_report,
        "export": export_rows,
        "worker": work,
    }.items():
        app.command(name)(command)


def show_status(run: Folder, as_json: Json = False) -> None:
    """How far a campaign is, and who worked on it."""
    with session(cache=False):
        from qsmc_jax.campaign.folder import RunFolder
        from qsmc_jax.campaign.status import status_of

        status = status_of(RunFolder.open(run))
        say_json(status.summary()) if as_json else say(str(status))


def show_run(
    run: Folder,
    index: Annotated[int | None, typer.Option("--run", help="Index of the run.")] = None,
    worst: Annotated[int | None, typer.Option(help="The k-th worst run instead, from 1.")] = None,
    of: Annotated[str | None, typer.Option(help="Claim by which runs are the worst, such as a requirement.")] = None,
    study: Study = None,
    out: Out = None,
    as_json: Json = False,
    cache: Cache = True,
) -> None:
    """Solve one run of a campaign again, in full, and hold it against the recorded row."""
    with session(cache):
        from qsmc_jax.campaign.folder import RunFolder
        from qsmc_jax.campaign.replay import replay
        from qsmc_jax.report.folder import ResultFolder
        from qsmc_jax.report.signals import metrics_as_numbers

        folder = RunFolder.open(run)
        with waiting("solving"):
            again = replay(folder, config_again(folder, study), index, worst, of)
        numbers = {**metrics_as_numbers(again.trajectory), "recorded": again.row, "agrees": again.agrees}
        say_json(numbers) if as_json else say(str(again))
        if out:
            with ResultFolder(out) as result:
                result.add_json("run.json", numbers)
                result.add_table("signals.parquet", again.trajectory.columns())
                result.add_result(again.trajectory)
                result.add_picture("run.png", again.trajectory.plot)
                result.commit()
            if not as_json:
                say(f"Written to {out}.")
    raise typer.Exit(HELD if again.agrees else UNDECIDED)


def make_report(run: Folder, as_json: Json = False) -> None:
    """Write the page of a campaign again, from what is in its folder; nothing is solved."""
    with session(cache=False):
        from qsmc_jax.campaign.folder import RunFolder
        from qsmc_jax.report.campaign_report import write_page

        write_page(RunFolder.open(run))
        path = run / "report.html"
        say_json({"written": str(path)}) if as_json else say(f"Written to {path}.")


def export_rows(
    run: Folder,
    to: Annotated[Literal["csv", "netcdf"], typer.Option(help="Format.")] = "csv",
    out: Annotated[Path | None, typer.Option(help="New file; default RUN.csv or RUN.nc beside the folder.")] = None,
    as_json: Json = False,
) -> None:
    """Write the rows of a campaign to one file that other tools read."""
    with session(cache=False):
        from qsmc_jax.base.atomic import temporary_beside
        from qsmc_jax.campaign.folder import RunFolder
        from qsmc_jax.report.export import write_csv, write_netcdf

        folder = RunFolder.open(run)
        path = out or run.with_name(run.name + {"csv": ".csv", "netcdf": ".nc"}[to])
        if path.exists():
            raise InputError(f"Argument `--out` must be a new file, but `{path}` exists. Choose another.")
        temporary = temporary_beside(path)
        try:
            {"csv": write_csv, "netcdf": write_netcdf}[to](folder, temporary)
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
        say_json({"written": str(path)}) if as_json else say(f"Written to {path}.")


def work(
    run: Folder,
    shard: Annotated[str, typer.Option(metavar="I/N", help="Which part of the blocks, from 0/N to N-1/N.")] = "0/1",
    study: Study = None,
    as_json: Json = False,
    block: Block = None,
    threads: Threads = None,
    cache: Cache = True,
) -> None:
    """Solve one shard of a campaign: for job arrays, with nothing but a shared folder between the workers."""
    with session(cache):
        from qsmc_jax.campaign.campaign import work_shard
        from qsmc_jax.campaign.folder import RunFolder
        from qsmc_jax.report.provenance import provenance

        folder = RunFolder.open(run)
        number, count = _shard(shard)
        config = config_again(folder, study, block=block, threads=threads)
        origin = provenance(study or Path(folder.manifest["study_path"]), config.source, sys.argv)
        with progress_bar(f"shard {shard}") as progress, finishing() as should_stop:
            options: dict[str, Any] = {"progress": progress, "should_stop": should_stop, "provenance": origin}
            is_done = work_shard(folder, config, number, count, **options)
        finish = "All shards done? `qsmc verify` with this folder as `--out` sums up."
        said = f"Shard {shard} of {run} is {'done' if is_done else 'interrupted'}. {finish}"
        say_json({"run": str(run), "shard": shard, "is_done": is_done}) if as_json else say(said)
    raise typer.Exit(HELD if is_done else UNDECIDED)


def _shard(text: str) -> tuple[int, int]:
    try:
        number, count = map(int, text.split("/"))
    except ValueError:
        raise InputError(f"Argument `--shard` must be I/N such as 0/4, but is `{text}`.") from None
    return number, count
