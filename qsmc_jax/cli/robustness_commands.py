"""The commands `qsmc map`, `qsmc critical`, `qsmc falsify` and `qsmc compare`.

Exit codes: 0 done, 1 (`falsify`) violated, 2 bad input, 3 interrupted, or (`critical`) nothing could be shown, or
(`falsify`) undecided.
"""

import contextlib
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from qsmc_jax.base.errors import InputError
from qsmc_jax.cli.console import say, say_json
from qsmc_jax.cli.exit_codes import HELD, UNDECIDED, code_of
from qsmc_jax.cli.grids import parse_grids, parse_interval
from qsmc_jax.cli.options import (
    Atol,
    Block,
    Cache,
    Json,
    MaxSteps,
    Method,
    Out,
    Overrides,
    Rtol,
    Seed,
    StudyFile,
    Threads,
    Together,
)
from qsmc_jax.cli.progress import progress_bar, waiting
from qsmc_jax.cli.session import session
from qsmc_jax.cli.study_file import Source, load_studies, load_study

Claim = Annotated[str, typer.Option("--of", help="Claim: funnel, reaching, tracking, or a requirement of the study.")]

_GRID = "NAME=LO:HI:log|lin:N"


def register(app: typer.Typer) -> None:
    """Adds the commands to the application."""
    app.command("map")(map_robustness)
    app.command("critical")(find_critical)
    app.command("falsify")(falsify_study)
    app.command("compare")(compare_studies)


def map_robustness(
    study_file: StudyFile,
    over: Annotated[
        list[str], typer.Option(metavar=_GRID, help="Values of a name, once or twice. A list: NAME=V1,V2,V3")
    ],
    runs: Annotated[int, typer.Option(help="Runs of each cell, the same in all.")] = 1000,
    seed: Seed = 0,
    confidence: Together = 0.95,
    of: Claim = "funnel",
    overrides: Overrides = None,
    out: Out = None,
    as_json: Json = False,
    dimensionless: Annotated[bool, typer.Option("--dimensionless", help="Draw axes in natural units.")] = False,
    rtol: Rtol = 1e-6,
    atol: Atol = None,
    max_steps: MaxSteps = 100_000,
    method: Method = "auto",
    block: Block = None,
    threads: Threads = None,
    cache: Cache = True,
) -> None:
    """Map the probability of violating a claim over a grid of one or two names of a study.

    Exit codes: 0 done, 2 bad input, 3 interrupted.
    """
    with session(cache):
        from qsmc_jax.robustness.limits import limits
        from qsmc_jax.robustness.map import robustness_map
        from qsmc_jax.simulation.settings import SolverSettings

        if dimensionless and not out:
            raise InputError("Argument `--dimensionless` is about the picture: it needs `--out`.")
        source, grids = Source.read(study_file), parse_grids(over)
        study = load_study(source, overrides or [])
        if dimensionless and not limits(study, grids).scales:
            names = ", ".join(f"`{name}`" for name in grids)
            raise InputError(f"Argument `--dimensionless` needs a name with a natural unit, but {names} has none.")
        settings = SolverSettings(rtol, atol, max_steps, method)

        def work(progress: Any) -> Any:
            options = {"claim": of, "settings": settings, "block": block, "threads": threads, "progress": progress}
            return robustness_map(study, grids, runs, seed, confidence, **options)

        _deliver("map", source, out, as_json, work, lambda found: found.plot(dimensionless=dimensionless))


def find_critical(
    study_file: StudyFile,
    name: Annotated[str, typer.Option(help="Name of the study whose value is searched.")],
    below: Annotated[float, typer.Option(help="Violation probability that is to be shown.")],
    between: Annotated[
        str | None, typer.Option(metavar="LO:HI", help="Ends of the search; default the bounds.")
    ] = None,
    side: Annotated[Literal["largest", "smallest"] | None, typer.Option(help="Default: what the ends say.")] = None,
    steps: Annotated[int, typer.Option(help="Values tested after the two ends.")] = 12,
    budget: Annotated[int | None, typer.Option(help="Most runs of a test; default 4 times the fewest.")] = None,
    of: Claim = "funnel",
    seed: Seed = 0,
    confidence: Together = 0.95,
    overrides: Overrides = None,
    out: Out = None,
    as_json: Json = False,
    rtol: Rtol = 1e-6,
    atol: Atol = None,
    max_steps: MaxSteps = 100_000,
    method: Method = "auto",
    block: Block = None,
    threads: Threads = None,
    cache: Cache = True,
) -> None:
    """Search the last value of a name at which the probability of violating a claim is shown to be small.

    Exit codes: 0 found, 2 bad input, 3 nothing could be shown, or interrupted.
    """
    with session(cache):
        from qsmc_jax.robustness.critical import critical_value
        from qsmc_jax.simulation.settings import SolverSettings

        source, ends = Source.read(study_file), parse_interval(between)
        study = load_study(source, overrides or [])
        settings = SolverSettings(rtol, atol, max_steps, method)

        def work(progress: Any) -> Any:
            options = {"confidence": confidence, "seed": seed, "steps": steps, "budget_per_test": budget}
            solving = {"settings": settings, "block": block, "threads": threads, "progress": progress}
            return critical_value(study, name, below, between=ends, side=side, claim=of, **options, **solving)

        found = _deliver("critical", source, out, as_json, work, lambda result: result.plot())
    raise typer.Exit(HELD if found.is_found else UNDECIDED)


def falsify_study(
    study_file: StudyFile,
    of: Annotated[str, typer.Option("--of", help="A claim to violate, or a metric to make as bad as possible.")] = (
        "funnel"
    ),
    budget: Annotated[int, typer.Option(help="Simulations at most.")] = 1000,
    adversary: Annotated[
        int | None, typer.Option(help="Worst disturbance that switches so often at most; default the study's own.")
    ] = None,
    tail: Annotated[float, typer.Option(help="Probability cut off where a distribution has no end.")] = 1e-3,
    seed: Seed = 0,
    overrides: Overrides = None,
    out: Out = None,
    as_json: Json = False,
    rtol: Rtol = 1e-6,
    atol: Atol = None,
    max_steps: MaxSteps = 100_000,
    method: Method = "auto",
    threads: Threads = None,
    cache: Cache = True,
) -> None:
    """Search the worst scenario that a study allows, for a claim or a metric.

    Exit codes: 0 no violation found, 1 a violation was found, 2 bad input, 3 undecided or interrupted.
    """
    with session(cache):
        from qsmc_jax.falsification.falsify import falsify
        from qsmc_jax.simulation.settings import SolverSettings

        source = Source.read(study_file)
        study = load_study(source, overrides or [])
        settings = SolverSettings(rtol, atol, max_steps, method)

        def work(progress: Any) -> Any:
            options = {"budget": budget, "seed": seed, "adversary": adversary, "tail": tail}
            return falsify(study, of, **options, settings=settings, threads=threads, progress=progress)

        found = _deliver("falsification", source, out, as_json, work, lambda result: result.plot())
    raise typer.Exit(code_of(found.verdict.name))


def compare_studies(
    studies_file: Annotated[
        Path, typer.Argument(metavar="STUDY|RUN", help="File that defines `studies`, or a run folder.")
    ],
    other: Annotated[Path | None, typer.Argument(metavar="RUN", help="Another run folder.")] = None,
    runs: Annotated[int, typer.Option(help="Runs of each study, on the same random numbers.")] = 1000,
    seed: Seed = 0,
    confidence: Together = 0.95,
    metric: Annotated[list[str] | None, typer.Option(help="Metric to compare; repeatable. Default the usual.")] = None,
    overrides: Overrides = None,
    out: Out = None,
    as_json: Json = False,
    rtol: Rtol = 1e-6,
    atol: Atol = None,
    max_steps: MaxSteps = 100_000,
    method: Method = "auto",
    block: Block = None,
    threads: Threads = None,
    cache: Cache = True,
) -> None:
    """Compare the studies of a file, such as one loop under several controllers, run by run; or two run folders.

    Exit codes: 0 done, 2 bad input, 3 interrupted.
    """
    with session(cache):
        from qsmc_jax.campaign.difference import difference
        from qsmc_jax.campaign.folder import RunFolder
        from qsmc_jax.robustness.comparison import compare
        from qsmc_jax.simulation.settings import SolverSettings

        if other is not None:
            found = difference(RunFolder.open(studies_file), RunFolder.open(other))
            say_json(found.summary()) if as_json else say(str(found))
            return
        source = Source.read(studies_file)
        studies = load_studies(source, overrides or [])
        settings = SolverSettings(rtol, atol, max_steps, method)

        def work(progress: Any) -> Any:
            options = {"metrics": metric or None, "settings": settings, "block": block, "threads": threads}
            return compare(studies, runs, seed, confidence, **options, progress=progress)

        _deliver("comparison", source, out, as_json, work, lambda result: result.plot())


def _deliver(
    stem: str,
    source: Source,
    out: Path | None,
    as_json: bool,
    work: Callable[[Any], Any],
    draw: Callable[[Any], Any],
) -> Any:
    """Does the work, writes its result as JSON, Parquet and picture into the folder, all or nothing, and prints it."""
    from qsmc_jax.report.folder import ResultFolder
    from qsmc_jax.report.provenance import provenance

    with ResultFolder(out) if out else contextlib.nullcontext() as folder:
        with progress_bar("solving") as progress:
            result = work(progress)
        content = {**result.summary(), "provenance": provenance(source.path, source.content, sys.argv)}
        say_json(content) if as_json else say(str(result))
        if folder:
            folder.add_json(f"{stem}.json", content)
            folder.add_table(f"{stem}.parquet", result.table())
            folder.add_result(result)
            with waiting("drawing"):
                folder.add_picture(f"{stem}.png", partial(draw, result))
            folder.commit()
            if not as_json:
                say(f"Written to {out}.")
    return result
