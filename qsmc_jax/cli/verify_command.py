"""The command `qsmc verify`: at once, or as a campaign in a run folder that can be resumed."""

import contextlib
import dataclasses
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from qsmc_jax.base.errors import InputError
from qsmc_jax.cli.blame import told
from qsmc_jax.cli.configs import config_of
from qsmc_jax.cli.console import say, say_json
from qsmc_jax.cli.exit_codes import HELD, code_of
from qsmc_jax.cli.interrupts import Interruption, finishing
from qsmc_jax.cli.options import Atol, Block, Cache, Json, MaxSteps, Method, Overrides, Rtol, Seed, StudyFile, Threads
from qsmc_jax.cli.progress import progress_bar, waiting
from qsmc_jax.cli.session import session

if TYPE_CHECKING:
    from qsmc_jax.campaign.config import CampaignConfig
    from qsmc_jax.campaign.folder import RunFolder
    from qsmc_jax.verification.result import Verification
    from qsmc_jax.verification.stopping import AbstractRule

Scheduler = Annotated[str | None, typer.Option(metavar="tcp://...", help="Dask scheduler whose workers solve.")]
Metrics = Annotated[str | None, typer.Option(metavar="M,...", help="Columns: claims (fast), standard, or names.")]
Workers = Annotated[int | None, typer.Option(help="Dask workers to start on this machine.")]


def verify_study(
    study_file: StudyFile,
    runs: Annotated[int, typer.Option(help="Number of runs; at most so many with a stopping rule.")] = 10_000,
    seed: Seed = 0,
    confidence: Annotated[float, typer.Option(help="Confidence of each interval.")] = 0.95,
    overrides: Overrides = None,
    metrics: Metrics = None,
    out: Annotated[Path | None, typer.Option(help="Run folder; one of the same study is resumed.")] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Begin in a new folder beside an existing one.")] = False,
    prepare: Annotated[bool, typer.Option("--prepare", help="Make the run folder for `qsmc worker`, no more.")] = False,
    until_below: Annotated[float | None, typer.Option(metavar="P", help="Stop once P(violation) <= P or > P.")] = None,
    until_width: Annotated[float | None, typer.Option(metavar="W", help="Stop once the interval is so narrow.")] = None,
    sprt: Annotated[str | None, typer.Option(metavar="P0,P1", help="Stop by Wald's test: p >= P0 or p <= P1.")] = None,
    scheduler: Scheduler = None,
    workers: Workers = None,
    file_runs: Annotated[int, typer.Option(help="Runs in each block file of a new run folder.")] = 32_768,
    as_json: Json = False,
    worst: Annotated[int, typer.Option(help="How many of the worst runs to list.")] = 5,
    rtol: Rtol = 1e-6,
    atol: Atol = None,
    max_steps: MaxSteps = 100_000,
    method: Method = "auto",
    block: Block = None,
    threads: Threads = None,
    cache: Cache = True,
) -> None:
    """Verify the claims of Theorem 1 and the requirements of a study by random runs, with exact intervals.

    With `--out`, rows are kept block by block: the same command goes on where it stopped, more `--runs` extend it.
    """
    with session(cache):
        from qsmc_jax import SolverSettings
        from qsmc_jax.campaign.campaign import prepare as prepare_folder
        from qsmc_jax.report.provenance import provenance
        from qsmc_jax.verification.accumulate import check_request

        settings = SolverSettings(rtol, atol, max_steps, method)
        rule = _rule(until_below, until_width, sprt)
        check_request(runs, confidence, worst, rule)
        solving = {"seed": seed, "settings": settings, "block": block, "threads": threads}
        config = config_of(study_file, overrides or [], metrics, **solving)
        if out is None and (fresh or prepare or scheduler or workers):
            raise InputError("Arguments `--fresh`, `--prepare`, `--scheduler` and `--workers` need a folder: `--out`.")
        origin = provenance(study_file, config.source, sys.argv)
        fixed = [word for override in overrides or [] for word in ("-S", override)]
        if out is None:
            again = ["qsmc", "simulate", str(study_file), "--seed", str(seed), *fixed, "--index"]
            result = _at_once(config, runs, confidence, worst, rule, as_json)
            _tell(result, study_file, again, None, origin, as_json)
        else:
            place, about = _beside(out) if fresh else out, {"file_runs": file_runs, "provenance": origin}
            folder = prepare_folder(place, config, study_file=str(study_file), **about)
            if prepare:
                folder.ask_for(runs, rule is not None)
                said = f"Prepared {folder.path} for {runs} runs. Now: qsmc worker {folder.path} --shard 0/4, 1/4, ..."
                say_json({"prepared": str(folder.path), "runs": runs}) if as_json else say(said)
                raise typer.Exit(HELD)
            with _engine(scheduler, workers) as engine:
                campaign = _Campaign(folder, config, origin, runs, confidence, worst, rule, engine)
                result = campaign.run(as_json)
            _tell(result, study_file, ["qsmc", "show", str(folder.path), "--run"], folder.path, origin, as_json)
            _write_report(folder, result, as_json)
    raise typer.Exit(code_of(result.verdict.name))


@dataclasses.dataclass(frozen=True)
class _Campaign:
    """What `run_campaign` is asked for."""

    folder: "RunFolder"
    config: "CampaignConfig"
    origin: dict[str, Any]
    runs: int
    confidence: float
    worst: int
    rule: "AbstractRule | None"
    engine: Any

    def run(self, as_json: bool) -> "Verification":
        """Solves what is missing, and writes the summary; ends the program if it is interrupted."""
        from qsmc_jax.campaign.campaign import run_campaign
        from qsmc_jax.report.campaign_report import write_summary

        with progress_bar("solving") as progress, finishing() as should_stop:
            result = run_campaign(
                self.folder,
                self.config,
                self.runs,
                self.confidence,
                worst=self.worst,
                until=self.rule,
                engine=self.engine,
                progress=progress,
                should_stop=should_stop,
                provenance=self.origin,
            )
        if result is None:
            message = f"interrupted: what is solved is kept in {self.folder.path}. The same command goes on."
            raise Interruption(message)
        write_summary(self.folder, result, self.origin)
        return result


def _write_report(folder: "RunFolder", result: "Verification", as_json: bool) -> None:
    """Pictures and page, after the verdict: no picture is worth more than that."""
    from qsmc_jax.report.campaign_report import write_report

    try:
        with waiting("writing the report"):
            write_report(folder, result)
    except Exception as error:  # noqa: BLE001  # whatever a picture may raise
        again = f"qsmc report {shlex.quote(str(folder.path))}"
        said = f"qsmc: the report could not be written ({told(error)}). The verdict stands. Once mended: {again}"
        say(said, is_error=True)
        return
    if not as_json:
        say(f"Written to {folder.path}; open {folder.path / 'report.html'}.")


def _at_once(
    config: "CampaignConfig", runs: int, confidence: float, worst: int, rule: "AbstractRule | None", as_json: bool
) -> "Verification":
    from qsmc_jax import verify

    options = {"settings": config.settings, "block": config.block, "threads": config.threads, "until": rule}
    with progress_bar("solving") as progress:
        return verify(config.study, runs, config.seed, confidence, worst=worst, progress=progress, **options)


def _rule(below: float | None, width: float | None, sprt: str | None) -> "AbstractRule | None":
    from qsmc_jax.verification.stopping import SequentialTest, UntilBelow, UntilWidth

    given = [each for each in (below, width, sprt) if each is not None]
    if len(given) > 1:
        raise InputError("Only one of `--until-below`, `--until-width` and `--sprt` can decide when to stop.")
    if below is not None:
        return UntilBelow(below)
    if width is not None:
        return UntilWidth(width)
    if sprt is None:
        return None
    try:
        probability, alternative = map(float, sprt.split(","))
    except ValueError:
        raise InputError(f"Argument `--sprt` must be P0,P1 such as 2e-3,1e-3, but is `{sprt}`.") from None
    return SequentialTest(probability, alternative)


def _beside(path: Path) -> Path:
    """The first of `path`, `path-2`, `path-3`, ... that does not exist."""
    number, candidate = 1, path
    while candidate.exists():
        number += 1
        candidate = path.with_name(f"{path.name}-{number}")
    return candidate


@contextlib.contextmanager
def _engine(scheduler: str | None, workers: int | None) -> Iterator[Any]:
    """The threads of this process, or the workers of a Dask cluster: one that exists, or one started for the time."""
    if scheduler is None and workers is None:
        yield None
        return
    try:
        import distributed
    except ImportError:
        raise InputError(
            "Arguments `--scheduler` and `--workers` need Dask: pip install 'qsmc_jax[cluster]'."
        ) from None
    from qsmc_jax.campaign.engines import Dask

    if scheduler is not None and workers is not None:
        raise InputError("Only one of `--scheduler` and `--workers` can be given.")
    if workers is not None and workers < 1:
        raise InputError(f"Argument `--workers` must be at least 1, but is {workers}.")
    where = {"address": scheduler} if scheduler else {"n_workers": workers, "dashboard_address": None}
    try:
        client = distributed.Client(**where, timeout="30s")
    except OSError as error:
        message = f"Argument `--scheduler` must be that of a running cluster, but is {scheduler}: {error}."
        raise InputError(message) from None
    with client:
        yield Dask(client)


def _tell(
    result: "Verification", study_file: Path, again: list[str], out: Path | None, origin: dict[str, Any], as_json: bool
) -> None:
    from qsmc_jax.campaign.commands import solver_options, verify_command

    if as_json:
        say_json({**result.summary(), "provenance": origin})
        return
    values = {name: value.tolist() for name, value in result.study.values.items()}
    about = result.runs, result.seed, result.confidence, values, result.firmer, result.study.asked
    firmer = verify_command(str(study_file), *about)
    firmer += ["--out", f"{out}-firmer"] if out else []
    rows = [result.worst.row(i) for i in range(len(result.worst))]
    # A run folder knows the settings of its runs; whoever solves one without it must be told.
    options = [[] if out else solver_options(result.settings_of(row)) for row in rows]
    speed = f"{result.runs / result.solve_seconds:.0f} runs/s, " if result.solve_seconds else ""
    lines = [
        str(result),
        f"{result.numerical_error}; doubtful runs solved again: {result.escalated[0]}",
        *([f"All runs by the solve that disagrees: {shlex.join(firmer)}"] if result.numerical_error.changed else []),
        f"{speed}{result.steps / result.runs:.0f} steps a run, lanes occupied {100 * result.occupancy:.0f} %",
        "Worst runs:",
        *(
            f"  {finding(row)}   {shlex.join([*again, str(row['index']), *words])}"
            for row, words in zip(rows, options, strict=True)
        ),
    ]
    say("\n".join(lines))


def finding(row: dict[str, Any]) -> str:
    """One run in half a line: how close it came, or when it left and how the premises fared."""
    from qsmc_jax.metrics.claims import told_of_breaches
    from qsmc_jax.metrics.verdict import Verdict
    from qsmc_jax.simulation.outcome import Outcome

    breaches = told_of_breaches(row)
    told = f", {breaches}" if breaches else ""

    if row["verdict"] == Verdict.HELD:
        return f"sup |sigma|/rho {row['peak_ratio']:.6f}, sup |u| {row['peak_u']:.4g}{told}"
    if row["verdict"] == Verdict.VIOLATED:
        premises = f"least gain_sign * g {row['least_gain']:.3g}, largest |d| {row['largest_disturbance']:.3g}"
        return f"left the funnel at {row['violation_time']:.6g} s, {premises}"
    return f"{Verdict(row['verdict']).name}, {Outcome(row['outcome']).name} at {row['end_time']:.6g} s"
