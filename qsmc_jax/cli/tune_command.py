"""The command `qsmc tune`.

Exit codes: 0 certified (or tuned, if no certificate was asked for), 2 bad input, 3 not certified, or interrupted.
"""

import contextlib
import sys
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from qsmc_jax.cli.console import say, say_json
from qsmc_jax.cli.exit_codes import HELD, UNDECIDED
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
)
from qsmc_jax.cli.progress import live_line, waiting
from qsmc_jax.cli.session import session
from qsmc_jax.cli.study_file import Source, load_study

if TYPE_CHECKING:
    from qsmc_jax.tuning.batch import Evaluation
    from qsmc_jax.tuning.result import Tuning


def tune_study(
    study_file: StudyFile,
    names: Annotated[str, typer.Option("--for", metavar="NAME,NAME", help="Parameters to tune, with commas.")],
    objective: Annotated[
        str, typer.Option(help='What to make small: "cvar(peak_error[0], 0.9) + 0.01 * mean(energy_u)".')
    ],
    subject_to: Annotated[
        list[str] | None,
        typer.Option(help='What to keep; repeatable: "worst(peak_u) <= 20", "violation <= 0.01".'),
    ] = None,
    against: Annotated[str | None, typer.Option(help="Second objective, for a Pareto front of two gains.")] = None,
    runs: Annotated[int, typer.Option(help="Training runs of each evaluation.")] = 256,
    search: Annotated[Literal["slsqp", "adam", "bfgs"], typer.Option(help="Method of descent.")] = "slsqp",
    mode: Annotated[Literal["forward", "reverse"], typer.Option(help="Differentiation of the simulation.")] = "forward",
    steps: Annotated[int, typer.Option(help="Steps of a descent at most.")] = 50,
    starts: Annotated[int, typer.Option(help="Starting points, the study's own among them.")] = 4,
    descents: Annotated[int, typer.Option(help="From how many of them to descend.")] = 1,
    certificate_runs: Annotated[int, typer.Option(help="Fresh runs for the certificate; 0 for none.")] = 10_000,
    risk: Annotated[float, typer.Option(help="Probability of failure to be shown.")] = 1e-2,
    confidence: Annotated[float, typer.Option(help="That all statements of all certificates hold.")] = 0.95,
    designs: Annotated[int, typer.Option(help="Designs at most, until one is certified.")] = 3,
    points: Annotated[int, typer.Option(help="Values of each gain in the pictures of two gains.")] = 12,
    seed: Seed = 0,
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
    """Tune parameters of a study by gradients through the simulation, and certify them on fresh runs.

    Exit codes: 0 certified, 2 bad input, 3 not certified or interrupted.
    """
    with session(cache):
        from qsmc_jax.report.folder import ResultFolder
        from qsmc_jax.report.provenance import provenance
        from qsmc_jax.simulation.settings import SolverSettings
        from qsmc_jax.tuning.tune import tune

        with ResultFolder(out) if out else contextlib.nullcontext() as folder:
            source = Source.read(study_file)
            study, parameters = load_study(source, overrides or []), tuple(part.strip() for part in names.split(","))
            settings = SolverSettings(rtol, atol, max_steps, method, adjoint=mode)
            solving: Any = {"runs": runs, "seed": seed, "settings": settings, "block": block, "threads": threads}
            how: Any = {"method": search, "steps": steps, "starts": starts, "descents": descents, "designs": designs}
            claim: Any = {"certificate_runs": certificate_runs, "risk": risk, "confidence": confidence}
            with live_line("tuning") as tell:
                watched = _Told(tell).watched
                result = tune(study, parameters, objective, subject_to or (), **how, **claim, **solving, **watched)
            content = {**result.summary(), "provenance": provenance(study_file, source.content, sys.argv)}
            say_json(content) if as_json else say(str(result))
            if folder:
                with waiting("drawing"):
                    drawn: Any = {"settings": settings, "block": block, "threads": threads}
                    _write(folder, result, content, {"against": against, "points": points, **drawn})
                if not as_json:
                    say(f"Written to {out}. Again: qsmc verify {study_file} -S @{out} --seed {seed + 1000}")
    raise typer.Exit(HELD if result.is_certified or not certificate_runs else UNDECIDED)


class _Told:
    """Says where a search stands."""

    def __init__(self, tell: Callable[[str], None]):
        self._tell, self._count, self._best = tell, 0, float("inf")

    def __call__(self, made: "Evaluation") -> None:
        self._count += 1
        if made.is_feasible:
            self._best = min(self._best, made.objective)
        gains = ", ".join(f"{name} {value:.4g}" for name, value in made.gains.items())
        lack = 100.0 * max(made.violations, default=0.0)
        reason = f"a constraint violated by {lack:.2g} %" if lack > 0.0 else "metrics not known"
        if made.lost > 0.0:
            reason = f"{100.0 * made.lost:.3g} % of the runs left the funnel or are undecided"
        kept = "" if made.is_feasible else f", {reason}"
        self._tell(
            f"evaluation {self._count}, {made.n_simulations} simulations, {gains}: {made.objective:.5g}{kept} "
            f"(best {self._best:.5g})"
        )

    @property
    def watched(self) -> dict[str, Any]:
        """The arguments of `tune` that tell."""
        return {"tell": self, "progress": self.certifying}

    def certifying(self, done: int, total: int) -> None:
        self._tell(f"certifying, {done} of {total} fresh runs")


def _write(folder: Any, result: "Tuning", content: Any, drawn: dict[str, Any]) -> None:
    """Numbers, table and pictures, all or nothing."""
    folder.add_json("tuning.json", content)
    folder.add_table("tuning.parquet", result.table())
    folder.add_result(result)
    _draw(folder.add_picture, result, drawn)
    folder.commit()


def _draw(add: Callable[[str, Callable[[], Any]], None], result: "Tuning", drawn: dict[str, Any]) -> None:
    """The pictures: the search, the loop before and after, and for two gains the landscape and the Pareto front."""
    from qsmc_jax.simulation.trajectory_plots import plot_trajectory
    from qsmc_jax.tuning.landscape import landscape

    add("tuning.png", result.plot)
    before = result.base.substitute(**result.before.gains)
    labels = [
        ", ".join(f"{name} = {value:.4g}" for name, value in gains.items())
        for gains in (result.before.gains, result.gains)
    ]
    runs = [study.simulate(settings=drawn["settings"]) for study in (before, result.study)]
    add("before_after.png", partial(plot_trajectory, *runs, labels=tuple(labels)))
    if len(result.parameters) == 2:
        made = landscape(
            result.base,
            result.parameters,
            result.objective,
            result.constraints,
            runs=min(result.runs, 128),
            seed=result.seed,
            mark={"before": result.before.gains, "tuned": result.gains},
            **drawn,
        )
        add("landscape.png", partial(made.plot, tuned=result))
        if drawn["against"] is not None:
            add("pareto.png", made.plot_pareto)
