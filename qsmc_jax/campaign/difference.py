"""Two campaigns side by side: what was asked of each, what each found, and where they differ run by run."""

import dataclasses
import itertools as it
from typing import Any

import numpy as np

from qsmc_jax.base.checks import require
from qsmc_jax.campaign.folder import RunFolder
from qsmc_jax.metrics.claims import verdict_column
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.study.runs import Runs, concatenate

# Rows that are held against each other, and runs that are listed.
_ROWS, _LISTED = 100_000, 10


@dataclasses.dataclass(frozen=True)
class CampaignDifference:
    """Two campaigns side by side.

    Attributes:
        places: The two folders.
        changes: What decides the rows, where it differs: both values by name.
        verdicts: Runs with each verdict, by claim and by its name, in either.
        paired: Runs held against each other; 0 where seed or drawn numbers differ.
        changed: The first runs whose verdict differs on a claim that both have.
        changed_count: How many there are.
        margin_change: 5 %, 50 % and 95 % quantile of the second's margin less the first's.
    """

    places: tuple[str, str]
    changes: dict[str, tuple[Any, Any]]
    verdicts: tuple[dict[str, dict[str, int]], dict[str, dict[str, int]]]
    paired: int
    changed: tuple[int, ...]
    changed_count: int
    margin_change: tuple[float, float, float]

    def summary(self) -> dict[str, Any]:
        """Everything as plain values."""
        return dataclasses.asdict(self)

    def __str__(self) -> str:
        lines = [f"A: {self.places[0]}", f"B: {self.places[1]}", "Differences of what was asked:"]
        lines += [f"  {name}: {first} / {second}" for name, (first, second) in self.changes.items()] or ["  none"]
        claims = dict.fromkeys((*self.verdicts[0], *self.verdicts[1]))
        width = max(14, *(len(claim) + 14 for claim in claims))
        lines.append(f"{'':{width}}{'A':>12}{'B':>12}")
        for claim, verdict in it.product(claims, Verdict):
            counts = [each.get(claim, {}).get(verdict.name) for each in self.verdicts]
            if any(counts):
                shown = "".join(f"{'-' if count is None else count:>12}" for count in counts)
                lines.append(f"{f'{claim} {verdict.name}':{width}}{shown}")
        if not self.paired:
            return "\n".join([*lines, "Not the same draws: nothing to hold against each other run by run."])
        more = ", ..." if self.changed_count > _LISTED else ""
        listed = f" (runs {', '.join(map(str, self.changed))}{more})" if self.changed else ""
        low, middle, high = self.margin_change
        lines.append(f"Of {self.paired} runs with the same draws {self.changed_count} differ in verdict{listed}.")
        lines.append(f"Margin of B less that of A: median {middle:.3g}, 5 to 95 % [{low:.3g}, {high:.3g}].")
        return "\n".join(lines)


def difference(first: RunFolder, second: RunFolder) -> CampaignDifference:
    """Reads both folders; if the first rows of both have equal indices and draws, they are held against each other.

    Args:
        first: One campaign.
        second: Another, say with other gains.

    Returns:
        The difference; `print` it.

    Examples:
        >>> import pathlib
        >>> import tempfile
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=5.0)
        >>> config = qj.campaign.CampaignConfig(qj.Study(scenario, bandwidth=0.1), source=b"study = ...")
        >>> with tempfile.TemporaryDirectory() as place:
        ...     folder = qj.campaign.prepare(pathlib.Path(place, "run"), config)
        ...     _ = qj.campaign.run_campaign(folder, config, runs=64)
        ...     found = qj.campaign.difference(folder, folder)
        >>> found.changes, found.paired, found.changed_count
        ({}, 64, 0)
    """
    asked = [folder.manifest["identity"] for folder in (first, second)]
    names = {**asked[0], **asked[1]}
    both = {name: (asked[0].get(name), asked[1].get(name)) for name in names}
    changes = {name: pair for name, pair in both.items() if pair[0] != pair[1]}
    verdicts = _counts(first), _counts(second)
    a, b = (_head(folder) for folder in (first, second))
    count = min(len(a), len(b))
    a, b = a.take(slice(count)), b.take(slice(count))
    shared = ("index", *_random(a.names, changes))
    is_same = a.names == b.names and all(np.array_equal(a[name], b[name]) for name in shared)
    paired = count if is_same and asked[0]["seed"] == asked[1]["seed"] else 0
    shared_claims = [verdict_column(claim) for claim in a.claims if claim in b.claims]
    rows = np.flatnonzero(np.any([a[name][:paired] != b[name][:paired] for name in shared_claims], axis=0))
    change = (b["margin"] - a["margin"])[:paired]
    known = change[np.isfinite(change)]
    low, middle, high = np.quantile(known, (0.05, 0.5, 0.95)).tolist() if len(known) else [float("nan")] * 3
    return CampaignDifference(
        places=(str(first.path), str(second.path)),
        changes=changes,
        verdicts=verdicts,
        paired=paired,
        changed=tuple(a["index"][rows[:_LISTED]].tolist()),
        changed_count=len(rows),
        margin_change=(low, middle, high),
    )


def _random(columns: tuple[str, ...], changes: dict[str, tuple[Any, Any]]) -> list[str]:
    """Columns that neither side fixed or tuned."""
    fixed = {name for key in ("values", "parameters") for each in changes.get(key, ()) for name in each}
    return [column for column in columns if column.partition("[")[0] not in fixed]


def _counts(folder: RunFolder) -> dict[str, dict[str, int]]:
    """Runs with each verdict, by claim."""
    total: dict[str, dict[str, int]] = {}
    for table in folder.tables():
        for claim in table.claims:
            counts = total.setdefault(claim, {verdict.name: 0 for verdict in Verdict})
            for verdict, count in table.counts(claim).items():
                counts[verdict.name] += count
    return total


def _head(folder: RunFolder) -> Runs:
    """The first rows."""
    tables = list(folder.tables(0, _ROWS))
    require(bool(tables), f"Folder `{folder.path}` has no rows yet.")
    return concatenate(tables)
