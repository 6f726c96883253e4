"""Where a guarantee breaks: the violation probability over a grid of values of one or two names of a study."""

import dataclasses
import itertools as it
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from qsmc_jax.base.checks import require, require_count, require_finite, require_fraction
from qsmc_jax.display.notebook import as_dataset
from qsmc_jax.display.result import AbstractResult
from qsmc_jax.metrics.claims import breaching, require_claim, verdict_column
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.robustness.limits import Threshold, limits
from qsmc_jax.robustness.map_plots import plot_map
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.statistics.simultaneous import simultaneous_intervals
from qsmc_jax.study.monte_carlo import Progress
from qsmc_jax.study.runs import Runs, concatenate
from qsmc_jax.study.specs import check_values
from qsmc_jax.study.study import Study, require_study
from qsmc_jax.verification.counts import HEADING, Counts
from qsmc_jax.verification.resolve import decide, part_of

METRICS = ("peak_ratio", "excess_variation_u", "reversal_rate")


@dataclasses.dataclass(frozen=True, repr=False)
class RobustnessMap(AbstractResult):
    """What `robustness_map` found. Arrays have one axis for each name, in the order of `names`.

    Attributes:
        study: The study.
        names: The names that were swept, one or two.
        grids: Their values.
        claims: By its name, each claim of Theorem 1 and each requirement of the study, an entry a cell.
        medians: Medians of some metrics over the runs of a cell, in which a run that left the funnel or could not be
            decided and has no metric counts as infinitely bad; NaN where no run has one.
        runs: Runs of each cell, the same ones in all.
        seed: Their seed.
        confidence: That all intervals of one claim hold together.
        thresholds: Lines to draw; see `limits`.
        claim: The claim that is printed and drawn.
        scales: By name, the factor that makes its values dimensionless and the label of the axis then.

    Examples:
        >>> import equinox as eqx
        >>> import jax.numpy as jnp
        >>> import qsmc_jax as qj
        >>> def scenario(draw):  # the gain has the wrong sign with probability p
        ...     p = draw.parameter("p", 0.0, bounds=(0.0, 1.0))
        ...     sign = jnp.where(draw.uniform("coin", 0.0, 1.0) < p, -1.0, 1.0)
        ...     loop = eqx.tree_at(lambda loop: loop.control.gain_sign, qj.paper.example1(), sign)
        ...     return qj.Scenario(loop, x0=[0.9, 0.9], t1=2.0)
        >>> study = qj.Study(scenario, bandwidth=0.1)
        >>> found = qj.robustness_map(study, over={"p": [0.0, 1.0]}, runs=64, block=64)
        >>> found.funnel.estimate.tolist(), found.table()["p"].tolist()
        ([0.0, 1.0], [0.0, 1.0])
    """

    study: Study
    names: tuple[str, ...]
    grids: tuple[Float[np.ndarray, " _"], ...]
    claims: Mapping[str, Counts]
    medians: Mapping[str, np.ndarray]
    runs: int
    seed: int
    confidence: float
    thresholds: tuple[Threshold, ...] = ()
    scales: Mapping[str, tuple[float, str]] = dataclasses.field(default_factory=dict)
    claim: str = "funnel"

    @property
    def funnel(self) -> Counts:
        """The funnel claim, |sigma(t)| < rho(t) for all t."""
        return self.claims["funnel"]

    @property
    def shown(self) -> Counts:
        """The claim that is printed and drawn."""
        return self.claims[self.claim]

    @property
    def low(self) -> np.ndarray:
        """Lower ends of the intervals of the probability of violating `claim`."""
        return self.shown.low

    @property
    def high(self) -> np.ndarray:
        """Upper ends of the intervals of the probability of violating `claim`."""
        return self.shown.high

    def table(self) -> dict[str, np.ndarray]:
        """Everything as columns, a row a cell: the values, and for each claim the counts and the interval."""
        mesh = np.meshgrid(*self.grids, indexing="ij")
        columns = {name: values.ravel() for name, values in zip(self.names, mesh, strict=True)}
        for claim, found in self.claims.items():
            columns.update({f"{claim}.{key}": value.ravel() for key, value in vars(found).items()})
        return {**columns, **{f"median.{key}": value.ravel() for key, value in self.medians.items()}}

    def summary(self) -> dict[str, Any]:
        """Everything as plain numbers and texts, ready for JSON."""
        return {
            "names": list(self.names),
            "grids": [grid.tolist() for grid in self.grids],
            "runs": self.runs,
            "seed": self.seed,
            "confidence": self.confidence,
            "claim": self.claim,
            "bandwidth": self.study.bandwidth,
            "values": {name: value.tolist() for name, value in self.study.values.items()},
            "claims": {name: _lists(vars(claim)) for name, claim in self.claims.items()},
            "medians": _lists(self.medians),
            "thresholds": [dataclasses.asdict(threshold) for threshold in self.thresholds],
            "scales": {name: {"factor": float(scale[0]), "label": scale[1]} for name, scale in self.scales.items()},
        }

    def to_xarray(self) -> Any:
        """Counts, intervals and medians, with units, as an `xarray.Dataset` over the names; needs `notebook`."""
        found = {
            f"{claim}.{key}": (self.names, value)
            for claim, each in self.claims.items()
            for key, value in vars(each).items()
        }
        medians = {
            f"median.{key}": (self.names, value, self.study.record_of(key).attributes)
            for key, value in self.medians.items()
        }
        attributes = {"runs": self.runs, "seed": self.seed, "confidence": self.confidence}
        return as_dataset({**found, **medians}, dict(zip(self.names, self.grids, strict=True)), attributes)

    def plot(self, ax: Any = None, *, dimensionless: bool = False) -> Any:
        """The probability of violating the claim over the grid, and the medians, with the thresholds as lines.

        Args:
            ax: One matplotlib `Axes` and one more for each known median; None for a new figure, which also gets a
                heading.
            dimensionless: Whether to multiply the values by their `scales`; a name that has none keeps its units.

        Returns:
            The axes, (1 + known medians,).

        Raises:
            InputError: No name has a scale.
        """
        has_scale = any(name in self.scales for name in self.names)
        require(has_scale or not dimensionless, "Argument `dimensionless` must be False for a map without `scales`.")
        return plot_map(self, self.scales if dimensionless else {}, ax)

    def __str__(self) -> str:
        cells = self.shown.held.size
        head = (
            f"{cells} cells of the same {self.runs} runs, seed {self.seed}: probability of {breaching(self.claim)}\n"
            f"All {cells} intervals hold together with {100 * self.confidence:g} % confidence."
        )
        body = _rows(self) if len(self.names) == 1 else _picture(self)
        return "\n".join(
            (head, *body, *(f"{t.kind}: {t.name}, {t.axis_name} = {t.value:.6g}" for t in self.thresholds))
        )


def robustness_map(
    study: Study,
    over: Mapping[str, Any],
    runs: int = 1000,
    seed: int = 0,
    confidence: float = 0.95,
    *,
    claim: str = "funnel",
    settings: SolverSettings | None = None,
    block: int | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> RobustnessMap:
    """Estimates the violation probability for every value of one name, or every pair of values of two.

    Each cell of the grid has the same runs (common random numbers): only the swept names differ, so that neighbours
    differ by what the names do and not by chance. Doubtful runs are solved again on firmer tiers, as in `verify`. The
    values are data: nothing is compiled a second time for them.

    Args:
        study: The study.
        over: One or two names, each with its values in increasing order. A swept distribution gets these values in
            all runs.
        runs: Runs of each cell, at least 1.
        seed: Seed, 0 <= seed < 2**63.
        confidence: That all intervals of one claim hold together, strictly between 0 and 1.
        claim: The claim to print and draw: "funnel", "reaching", "tracking" or a requirement; all are counted.
        settings: Method and tolerances of the first solve; None for the defaults.
        block: Runs solved together, a multiple of 64; None for what suits the platform, on CPUs 512.
        threads: Blocks solved at the same time; None for one a core of a CPU.
        progress: Called as `progress(done, runs * cells)` after each block.

    Returns:
        The map; `print` it, or `plot` it.

    Raises:
        InputError: An argument is out of range, or the study refuses a value; before anything is solved.

    Examples:
        >>> import equinox as eqx
        >>> import jax.numpy as jnp
        >>> import qsmc_jax as qj
        >>> def scenario(draw):  # the gain has the wrong sign with probability p
        ...     p = draw.parameter("p", 0.0, bounds=(0.0, 1.0))
        ...     sign = jnp.where(draw.uniform("coin", 0.0, 1.0) < p, -1.0, 1.0)
        ...     loop = eqx.tree_at(lambda loop: loop.control.gain_sign, qj.paper.example1(), sign)
        ...     return qj.Scenario(loop, x0=[0.9, 0.9], t1=2.0)
        >>> study = qj.Study(scenario, bandwidth=0.1)
        >>> found = qj.robustness_map(study, over={"p": [0.0, 1.0]}, runs=64, block=64)
        >>> found.funnel.violated.tolist(), found.high.round(2).tolist()
        ([0, 64], [0.07, 1.0])
    """
    require_study(study)
    require_claim("claim", claim, study.claims)
    require_count("runs", runs)
    require_fraction("confidence", confidence)
    require(1 <= len(over) <= 2, f"Argument `over` must have one or two names, but has {len(over)}.")
    names, grids = tuple(over), tuple(_grid(study, name, values) for name, values in over.items())
    cells = [study.substitute(**dict(zip(names, values, strict=True))) for values in it.product(*grids)]
    settings, total = settings or SolverSettings(), runs * len(cells)
    tables, wanted = [], (*METRICS, *study.measured)
    for number, cell in enumerate(cells):
        told = part_of(progress, number * runs, total)
        rows = decide(cell, range(runs), seed, settings=settings, block=block, threads=threads, progress=told)
        tables.append(_kept(concatenate(list(rows)), wanted))
    shape, known = tuple(len(grid) for grid in grids), limits(study, dict(zip(names, grids, strict=True)))
    return RobustnessMap(
        study=study,
        names=names,
        grids=grids,
        claims={claim: _counts(tables, claim, shape, confidence) for claim in tables[0].claims},
        medians={
            name: np.array([_median(table, name) for table in tables]).reshape(shape)
            for name in wanted
            if name in tables[0]
        },
        runs=runs,
        seed=seed,
        confidence=confidence,
        thresholds=known.thresholds,
        scales=known.scales,
        claim=claim,
    )


def _grid(study: Study, name: str, values: Any) -> Float[np.ndarray, " _"]:
    """The values of one name as float64, checked as far as they can be on their own."""
    grid = np.atleast_1d(np.asarray(values, dtype=np.float64))
    require(
        grid.ndim == 1 and grid.size > 0,
        f"Argument `over` must give `{name}` a list of at least one value, but has shape {grid.shape}.",
    )
    require_finite(f"over` for `{name}", grid)
    is_sorted = bool(np.all(np.diff(grid) > 0))
    require(is_sorted, f"Argument `over` must give the values of `{name}` in increasing order, but has {values}.")
    for value in grid:
        check_values(study.specs, {name: value})
    return grid


def _kept(table: Runs, metrics: tuple[str, ...]) -> Runs:
    """The columns that a map needs."""
    wanted = ("index", *map(verdict_column, table.claims), *metrics)
    return dataclasses.replace(table, columns={name: table[name] for name in wanted if name in table}, names=())


def _counts(tables: list[Runs], claim: str, shape: tuple[int, ...], confidence: float) -> Counts:
    counts = [table.counts(claim) for table in tables]
    cells = {verdict: np.array([count[verdict] for count in counts], np.int64).reshape(shape) for verdict in Verdict}
    return Counts.of(cells, confidence, simultaneous_intervals)


def _median(table: Runs, name: str) -> float:
    """The median of a metric; a run that is lost is worse than any other."""
    values, worst = table[name], -np.inf if table.record_of(name).worse == "low" else np.inf
    is_lost = np.isnan(values) & np.isin(table["verdict"], (Verdict.VIOLATED, Verdict.UNDECIDED))
    known = np.where(is_lost, worst, values)[is_lost | ~np.isnan(values)]
    return float("nan") if np.isinf(known).all() else float(np.median(known))


def _lists(arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    return {name: array.tolist() for name, array in arrays.items()}


def _rows(found: RobustnessMap) -> Iterator[str]:
    """A line a value."""
    yield f"{found.names[0]:>14}{HEADING}   interval"
    for i, value in enumerate(found.grids[0]):
        yield f"{value:14.6g}{found.shown.row(i)}"


def _picture(found: RobustnessMap) -> Iterator[str]:
    """A character a cell, the second name upwards."""
    shown = found.shown
    (x, y), (xs, ys) = found.names, found.grids
    clean = (shown.violated == 0) & (shown.undecided == 0) & (shown.total > 0)
    conditions = [shown.total == 0, shown.estimate >= 0.5, shown.violated > 0, shown.undecided > 0]
    marks = np.select(conditions, [" ", "#", "+", "?"], ".")
    yield f"`{x}` to the right, {xs[0]:.6g} to {xs[-1]:.6g}; `{y}` upwards, {ys[0]:.6g} to {ys[-1]:.6g}"
    for j in reversed(range(len(ys))):
        yield f"{ys[j]:14.6g}  {''.join(marks[:, j])}"
    yield "'.' no run violated, '+' less than half, '#' half or more, '?' none but some undecided, ' ' none admissible"
    least = float(shown.high[clean].min()) if clean.any() else float("nan")
    sound = f"{int(clean.sum())} have runs, none of them violated or undecided"
    yield f"Of {marks.size} cells {sound}; the best of them lies below {least:.3g}."
