"""How much the numbers of a verification owe to the solve: a sample and the worst runs, solved again another way."""

import dataclasses
import logging
import math
from collections.abc import Callable, Iterator, Mapping
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from qsmc_jax.metrics.claims import TOGETHER, together, verdict_column
from qsmc_jax.metrics.standard import record_of
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.study.runs import Runs, concatenate
from qsmc_jax.verification.escalation import said
from qsmc_jax.verification.tiers import TIERS, Tiers

_LOG = logging.getLogger(__name__)

# Runs that are kept to be solved again. A fault that changes one verdict in 100 is met in 99 % of samples of this size.
SAMPLE = 512

# Columns that are not metrics, apart from drawn names and verdicts: they describe the solve.
_NO_METRICS = ("index", "tier", "outcome", "steps", "coordinate_drift")

_MIX = ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB))

Solve: TypeAlias = Callable[..., Iterator[Runs]]


@dataclasses.dataclass(frozen=True)
class Change:
    """The largest change of one metric.

    Attributes:
        absolute: Largest difference, units of the metric; inf where one solve says inf or NaN and the other does not.
        relative: Largest difference over the larger of the two [-].
    """

    absolute: float
    relative: float


@dataclasses.dataclass(frozen=True)
class NumericalError:
    """What changed when runs were solved again, at a hundredth of the tolerance, by another method or in other cells.

    Attributes:
        checked: Runs that were: a random sample of all decided ones, and the worst.
        peak_ratio: Largest change of sup |sigma|/rho, relative to it where it is above 1; NaN if no run was checked.
        changed: Runs whose verdict on any claim changed.
        unchecked: Runs that could not be: solved again, some claim came to no verdict.
        metrics: Largest change of each metric, by its name, over the runs whose funnel verdict did not change.
    """

    checked: int
    peak_ratio: float
    changed: int
    unchecked: int
    metrics: Mapping[str, Change]

    @property
    def largest(self) -> tuple[str, ...]:
        """Names of the metrics that changed, those by most first, those that may jump last."""
        names = [name for name, change in self.metrics.items() if change.relative > 0.0]
        return tuple(sorted(names, key=lambda name: (record_of(name).may_jump, -self.metrics[name].relative)))

    def __str__(self) -> str:
        if not self.checked:
            return f"Numerical error not known: of {self.unchecked} runs solved again none came to a verdict."
        others = [name for name in self.largest if name != "peak_ratio"][:3]
        listed = "".join(f", {name} {100 * self.metrics[name].relative:.2g} %" for name in others)
        jumps = " (jumps where a run is changed a little)" if any(record_of(name).may_jump for name in others) else ""
        unknown = f", {self.unchecked} could not be checked" if self.unchecked else ""
        return (
            f"Numerical error of sup |sigma|/rho: {self.peak_ratio:.2g}{listed}{jumps} ({self.checked} runs solved "
            f"again another way at rtol / 100: {self.changed} verdicts changed{unknown})"
        )


@dataclasses.dataclass(frozen=True)
class ClaimCheck:
    """What the check says of one claim.

    Attributes:
        held: Runs that HELD in both solves.
        violated: Runs that were VIOLATED in both.
        changed: Runs whose verdict changed.
    """

    held: int
    violated: int
    changed: int


class Sample:
    """A random sample of all rows, whatever the order in which they come and however they are cut into tables.

    Kept are the rows whose index, scrambled, is smallest: of two sets of rows with the same indices the same ones.
    """

    def __init__(self, size: int = SAMPLE):
        """None yet; at most `size` will be kept."""
        self._size, self._kept = size, []

    def add(self, table: Runs) -> None:
        """Takes a table in."""
        together = concatenate([*self._kept, table.take(_smallest(table, self._size))])
        self._kept = [together.take(_smallest(together, self._size))]

    @property
    def rows(self) -> list[Runs]:
        """The sample, as at most one table."""
        return self._kept


def recheck(rows: Runs, solve: Solve, tiers: Tiers) -> tuple[NumericalError, dict[str, ClaimCheck]]:
    """Solves decided rows again, each by the tier that checks the one that decided it, and compares.

    Args:
        rows: Rows with their column `tier`; those of one index count once, those without a verdict not at all.
        solve: `stream` of the study.
        tiers: Settings of each tier.

    Returns:
        All changes, and what the check says of each claim, and of all together.
    """
    pair = solved_again(rows, solve, tiers)
    if pair is None:
        return NumericalError(0, math.nan, 0, 0, {}), dict.fromkeys((*rows.claims, TOGETHER), ClaimCheck(0, 0, 0))
    before, after = pair
    was, now = before.verdicts, said(after)
    is_changed = _changed(was, now)
    is_known = is_changed.any(axis=0) | ~((was != Verdict.UNDECIDED) & (now == Verdict.UNDECIDED)).any(axis=0)
    is_same = was[0] == now[0]
    error = NumericalError(
        checked=int(is_known.sum()),
        peak_ratio=_peak_change(before, after, is_same) if is_known.any() else math.nan,
        changed=int(is_changed.any(axis=0).sum()),
        unchecked=int((~is_known).sum()),
        metrics=_metrics(before, after, is_same),
    )
    of_each = zip((*was, together(was)), (*now, together(now)), strict=True)
    return error, {claim: _claim_check(*of) for claim, of in zip((*rows.claims, TOGETHER), of_each, strict=True)}


def solved_again(rows: Runs, solve: Solve, tiers: Tiers) -> tuple[Runs, Runs] | None:
    """Decided rows, and what they are by the tier that checks the one that decided each.

    Args:
        rows: Rows with their column `tier`; those of one index count once, those without a verdict not at all.
        solve: `stream` of the study.
        tiers: Settings of each tier.

    Returns:
        Both tables, row by row; None if there is no such row.
    """
    _, first = np.unique(rows["index"], return_index=True)
    rows = rows.take(first)
    rows = rows.take((rows["verdict"] == Verdict.HELD) | (rows["verdict"] == Verdict.VIOLATED))
    _LOG.info("solving %d runs another way, as a check", len(rows))
    parts = [rows.take(rows["tier"] == tier) for tier in range(TIERS)]
    pairs = [
        (part, concatenate(list(solve(part["index"], **tiers.options(tiers.check_of(tier))))))
        for tier, part in enumerate(parts)
        if len(part)
    ]
    if not pairs:
        return None
    before, after = (concatenate(tables) for tables in zip(*pairs, strict=True))
    return before, after


def _changed(was: Int[np.ndarray, "..."], now: Int[np.ndarray, "..."]) -> Bool[np.ndarray, "..."]:
    """Where one solve says the opposite of the other; that one says nothing is no change."""
    return (was != now) & (was != Verdict.UNDECIDED) & (now != Verdict.UNDECIDED)


def _claim_check(was: np.ndarray, now: np.ndarray) -> ClaimCheck:
    held, violated = (int(((was == verdict) & (now == verdict)).sum()) for verdict in (Verdict.HELD, Verdict.VIOLATED))
    return ClaimCheck(held, violated, int(_changed(was, now).sum()))


def _metrics(before: Runs, after: Runs, is_same: Bool[np.ndarray, " rows"]) -> dict[str, Change]:
    """The largest change of every column that is a metric, over the given rows."""
    no_metrics = (*_NO_METRICS, *before.names, *map(verdict_column, before.claims))
    names = [name for name in before if name not in no_metrics and name in after]
    return {name: _change(before[name][is_same], after[name][is_same]) for name in names}


def _peak_change(before: Runs, after: Runs, is_same: Bool[np.ndarray, " rows"]) -> float:
    """The largest change of sup |sigma|/rho, in units of the funnel's width inside it."""
    first, second = before["peak_ratio"][is_same], after["peak_ratio"][is_same]
    unit = np.fmax(1.0, np.fmax(first, second))
    return _change(first / unit, second / unit).absolute


def _change(before: np.ndarray, after: np.ndarray) -> Change:
    before, after = before.astype(np.float64), after.astype(np.float64)
    is_equal = (before == after) | (np.isnan(before) & np.isnan(after))
    with np.errstate(invalid="ignore"):
        absolute = np.where(is_equal, 0.0, np.nan_to_num(np.abs(after - before), nan=math.inf, posinf=math.inf))
        scale = np.fmax(np.abs(before), np.abs(after))
        relative = np.where(np.isinf(absolute), math.inf, absolute / np.where(scale > 0.0, scale, 1.0))
    return Change(_largest(absolute), _largest(relative))


def _largest(values: Float[np.ndarray, " rows"]) -> float:
    return float(values.max(initial=0.0))


def _smallest(table: Runs, count: int) -> np.ndarray:
    """The rows whose scrambled index is smallest, so many at most."""
    return np.argsort(_scrambled(table["index"]))[:count]


def _scrambled(index: Int[np.ndarray, " rows"]) -> np.ndarray:
    """Whole numbers that look random, different ones for different indices.

    Source: splitmix64 of Steele, Lea and Flood, OOPSLA 2014.
    """
    word = (index.astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    for shift, factor in _MIX:
        word = (word ^ (word >> np.uint64(shift))) * np.uint64(factor)
    return word ^ (word >> np.uint64(31))
