"""Several studies on the same random numbers: how often each is violated, and what each costs, run by run."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from qsmc_jax.base.checks import require, require_count, require_fraction, require_kind
from qsmc_jax.display.result import AbstractResult
from qsmc_jax.metrics.record import Record
from qsmc_jax.metrics.standard import catalogue, record_of
from qsmc_jax.robustness.comparison_plots import plot_comparison
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.statistics.simultaneous import each_of, median_interval
from qsmc_jax.study.monte_carlo import Progress
from qsmc_jax.study.runs import Runs, concatenate
from qsmc_jax.study.study import Study, require_study
from qsmc_jax.verification.counts import HEADING, Counts
from qsmc_jax.verification.resolve import decide, part_of

METRICS = tuple(name for name, record in catalogue().items() if record.is_compared)


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A median and its interval.

    Attributes:
        median: The median; NaN if there is no value.
        low: Lower end of the interval.
        high: Upper end.
        runs: Runs in which the value is known.
    """

    median: float
    low: float
    high: float
    runs: int


@dataclasses.dataclass(frozen=True)
class Compared(Counts):
    """What was found for one study, counted for the funnel claim.

    Attributes:
        name: Its name.
        medians: By metric, its median over the runs in which it is known.
        ratios: By metric, the median of its ratio to the same run of the first study, over the runs in which both are
            finite and that of the first is positive; empty for the first study itself.
    """

    name: str
    medians: Mapping[str, Estimate]
    ratios: Mapping[str, Estimate]


@dataclasses.dataclass(frozen=True, repr=False)
class Comparison(AbstractResult):
    """What `compare` found.

    Attributes:
        studies: What was found for each study, in order; the first is the one that the others are held against.
        metrics: The metrics compared.
        runs: Runs of each study, with the same random numbers.
        seed: Their seed.
        confidence: That all intervals hold together.
        intervals: How many there are.
        records: What is known of each of the metrics, such as its unit.

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
        >>> studies = {"right": study, "wrong": study.substitute(p=1.0)}
        >>> found = qj.compare(studies, runs=64, metrics=["peak_ratio"], block=64)
        >>> found["right"].estimate, found["wrong"].estimate, found.intervals
        (0.0, 1.0, 5)
    """

    studies: tuple[Compared, ...]
    metrics: tuple[str, ...]
    runs: int
    seed: int
    confidence: float
    intervals: int
    records: Mapping[str, Record] = dataclasses.field(default_factory=dict)

    def __getitem__(self, name: str) -> Compared:
        found = {study.name: study for study in self.studies}
        require(name in found, f"There is no study `{name}`. There are: {', '.join(found)}.")
        return found[name]

    def table(self) -> dict[str, Any]:
        """All intervals as columns, a row each: study, quantity, kind, estimate, low, high, runs."""
        rows = list(self._intervals())
        keys = ("study", "quantity", "kind", "estimate", "low", "high", "runs")
        return {key: np.array(column) for key, column in zip(keys, zip(*rows, strict=True), strict=True)}

    def summary(self) -> dict[str, Any]:
        """Everything as plain numbers and texts, ready for JSON."""
        return dataclasses.asdict(self)

    def plot(self, ax: Any = None) -> Any:
        """The probability of leaving the funnel and the median of each metric, with their intervals.

        Args:
            ax: One matplotlib `Axes` and one more for each of `metrics`; None for a new figure, which also gets a
                heading.

        Returns:
            The axes, (1 + metrics,).
        """
        return plot_comparison(self, ax)

    def __str__(self) -> str:
        width = max(12, *(len(study.name) for study in self.studies))
        rows = [f"{self.runs} runs each, on the same random numbers, seed {self.seed}"]
        rows.append(f"{'study':{width}}{HEADING}   violation probability")
        rows += [f"{study.name:{width}}{study.row()}" for study in self.studies]
        rows += self._median_rows(width)
        rows.append(f"All {self.intervals} intervals hold together with {100 * self.confidence:g} % confidence.")
        return "\n".join(rows)

    def _median_rows(self, width: int) -> Iterator[str]:
        """A line a metric and study."""
        shown = [(m, s, _show(s.medians[m])) for m in self.metrics for s in self.studies if m in s.medians]
        wide = max((len(median) for _, _, median in shown), default=0)
        yield f"{'median of':22}{'study':{width}} {'':{wide}}  ratio to `{self.studies[0].name}`, run by run"
        for metric, study, median in shown:
            ratio = _show(study.ratios[metric]) if metric in study.ratios else ""
            yield f"{metric:22}{study.name:{width}} {median:{wide}}  {ratio}".rstrip()

    def _intervals(self) -> Iterator[tuple[Any, ...]]:
        for s in self.studies:
            yield s.name, "violation", "probability", s.estimate, s.low, s.high, s.total
            for kind, estimates in (("median", s.medians), ("ratio", s.ratios)):
                for metric, e in estimates.items():
                    yield s.name, metric, kind, e.median, e.low, e.high, e.runs


def compare(
    studies: Mapping[str, Study],
    runs: int = 1000,
    seed: int = 0,
    confidence: float = 0.95,
    *,
    metrics: Sequence[str] | None = None,
    settings: SolverSettings | None = None,
    block: int | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Compares studies that draw the same names, such as one loop under several controllers, run by run.

    Run i has the same point of the unit cube in all of them (common random numbers). Doubtful runs are solved again on
    firmer tiers, as in `verify`. Medians have exact intervals from order statistics; a metric that is not known in
    every run (most are unknown after a violation) has the median of those in which it is: mind the counts.

    Args:
        studies: The studies by name; the first is the one that the others are held against.
        runs: Runs of each study, at least 1.
        seed: Seed, 0 <= seed < 2**63.
        confidence: That all intervals hold together (Bonferroni), strictly between 0 and 1.
        metrics: Metrics to compare, columns of every study; None for peaks, energy, variation and error, and the
            chattering metrics of the studies that have them.
        settings: Method and tolerances of the first solve; None for the defaults.
        block: Runs solved together, a multiple of 64; None for what suits the platform, on CPUs 512.
        threads: Blocks solved at the same time; None for one a core of a CPU.
        progress: Called as `progress(done, runs * len(studies))` after each block.

    Returns:
        The comparison; `print` it, or `plot` it.

    Raises:
        InputError: An argument is out of range, the studies draw different names, or a metric does not exist.

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
        >>> studies = {"right": study, "wrong": study.substitute(p=1.0)}
        >>> found = qj.compare(studies, runs=64, metrics=["peak_ratio"], block=64)
        >>> [(each.name, each.violated, round(each.high, 2)) for each in found.studies]
        [('right', 0, 0.08), ('wrong', 64, 1.0)]
    """
    require_count("runs", runs)
    require_fraction("confidence", confidence)
    _require_same_names(studies)
    settings, tables = settings or SolverSettings(), {}
    own = dict.fromkeys(name for study in studies.values() for name in study.measured)
    wanted = (*METRICS, *own) if metrics is None else tuple(metrics)
    for number, (name, study) in enumerate(studies.items()):
        told = part_of(progress, number * runs, runs * len(studies))
        rows = decide(study, range(runs), seed, settings=settings, block=block, threads=threads, progress=told)
        tables[name] = _kept(concatenate(list(rows)), wanted, is_asked=metrics is not None)
    first = next(iter(tables.values()))
    pairs = {name: {} if table is first else _ratios(table, first) for name, table in tables.items()}
    known = {
        name: {m: _known(table[m]) for m in table if m not in ("index", "verdict")} for name, table in tables.items()
    }
    intervals = sum(1 + len(known[name]) + len(pairs[name]) for name in studies)
    each = each_of(intervals, confidence)
    return Comparison(
        studies=tuple(_compared(name, tables[name], known[name], pairs[name], each) for name in studies),
        metrics=tuple(m for m in wanted if any(m in table.columns for table in tables.values())),
        runs=runs,
        seed=seed,
        confidence=confidence,
        intervals=intervals,
        records=_records(studies, wanted),
    )


def _records(studies: Mapping[str, Study], metrics: Sequence[str]) -> dict[str, Record]:
    """What the first study that knows a metric says of it."""
    own = {name: record for study in reversed(list(studies.values())) for name, record in study.records.items()}
    return {metric: own.get(metric) or record_of(metric) for metric in metrics}


def _require_same_names(studies: Mapping[str, Study]) -> None:
    """Raises unless the studies take the same coordinates for the same names."""
    require_kind("studies", studies, Mapping, "Give each a name: {'mine': study, 'other': ...}.")
    require(len(studies) >= 1, "Argument `studies` must have at least one study, but is empty.")
    for name, study in studies.items():
        require_study(study, f"studies[{name!r}]")
    drawn = {name: tuple((s.name, s.shape) for s in study.specs if s.is_drawn) for name, study in studies.items()}
    (first, expected), *others = drawn.items()
    for name, found in others:
        require(
            found == expected,
            f"Argument `studies` must draw the same names, in the same order and of the same shapes, but `{first}` "
            f"draws {_listed(expected)} and `{name}` draws {_listed(found)}. Draw in all of them what one needs.",
        )


def _listed(drawn: tuple[tuple[str, tuple[int, ...]], ...]) -> str:
    return ", ".join(f"{name}{list(shape) if shape else ''}" for name, shape in drawn) or "nothing"


def _kept(table: Runs, wanted: Sequence[str], *, is_asked: bool) -> Runs:
    """The columns that are compared, in the order of the indices; of those asked for all must be there."""
    columns = {m: table[m].astype(np.float64) for m in wanted if is_asked or m in table.columns}
    return Runs({"index": table["index"], "verdict": table["verdict"], **columns}, ()).take(np.argsort(table["index"]))


def _ratios(table: Runs, first: Runs) -> dict[str, np.ndarray]:
    """By metric, the ratios to the same run of the first study where both are known."""
    ratios = {}
    for metric in table:
        if metric not in ("index", "verdict") and metric in first.columns:
            ours, theirs = table[metric], first[metric]
            known = np.isfinite(ours) & np.isfinite(theirs) & (theirs > 0.0)
            ratios[metric] = ours[known] / theirs[known]
    return ratios


def _known(values: np.ndarray) -> np.ndarray:
    return values[~np.isnan(values)]


def _compared(
    name: str, table: Runs, known: Mapping[str, np.ndarray], ratios: Mapping[str, np.ndarray], each: float
) -> Compared:
    medians = {metric: _estimate(values, each) for metric, values in known.items()}
    paired = {metric: _estimate(values, each) for metric, values in ratios.items()}
    return Compared.of(table.counts(), each, name=name, medians=medians, ratios=paired)


def _estimate(values: np.ndarray, confidence: float) -> Estimate:
    median = float(np.median(values)) if values.size else float("nan")
    return Estimate(median, *median_interval(values, confidence), values.size)


def _show(e: Estimate) -> str:
    return f"{e.median:.4g} [{e.low:.4g}, {e.high:.4g}] ({e.runs})"
