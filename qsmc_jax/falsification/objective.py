"""What a falsification makes as bad as it can: a metric in its worse direction, or the margin of a claim."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from qsmc_jax.base.checks import nearest, require
from qsmc_jax.metrics.claims import margin_column, verdict_column
from qsmc_jax.metrics.record import Record
from qsmc_jax.metrics.standard import columns_of_channels, kinds_of
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.study.runs import Runs
from qsmc_jax.study.study import Study


@dataclasses.dataclass(frozen=True)
class Objective:
    """A column of the table of runs, and which runs of it are worse.

    Attributes:
        name: What was asked for: a claim, or a column.
        column: The column: of a claim its margin.
        is_low_worse: Whether small values are the worse ones.
        claims: The claims by which the worst run is judged: the one asked for; with a metric the funnel's and the
            requirements of the study.
        is_claim: Whether a claim was asked for: its first violation ends the search.
        has_gradient: Whether the column has a derivative.
    """

    name: str
    column: str
    is_low_worse: bool
    claims: tuple[str, ...]
    is_claim: bool
    has_gradient: bool

    @classmethod
    def of(cls, study: Study, name: str) -> "Objective":
        """The objective of that name.

        Args:
            study: The study.
            name: A claim of it, or a column of its table of runs.

        Raises:
            InputError: It is neither, or a column of which no direction is worse.
        """
        if name in study.claims:
            column = margin_column(name)
            return cls(name, column, True, (name,), True, study.record_of(column).has_gradient)
        known = metrics_of(study)
        listed = f"{nearest(name, (*study.claims, *known))} There are: {', '.join((*study.claims, *known))}."
        require(
            name in known,
            f"Argument `objective` must name a claim, or a metric of the study of which a direction is worse, but is "
            f"`{name}`.{listed}",
        )
        record = known[name]
        judged = ("funnel", *study.requirements)
        return cls(name, name, record.worse == "low", judged, False, record.has_gradient)

    def scores(self, rows: Runs) -> Float[np.ndarray, " runs"]:
        """How bad runs are, more is worse; -inf where it is not known or no premise holds, inf where a claim fell.

        With a metric, a run that violates a claim counts by its metric if that is known.
        """
        value = np.asarray(rows[self.column], np.float64)
        is_violated = self.is_violated(rows)
        scores = np.where(np.isnan(value), -np.inf, -value if self.is_low_worse else value)
        scores = np.where(is_violated & (self.is_claim | np.isnan(value)), np.inf, scores)
        return np.where(rows["verdict"] == Verdict.INADMISSIBLE, -np.inf, scores)

    def is_violated(self, rows: Runs) -> Bool[np.ndarray, " runs"]:
        """Runs that violate a claim by which they are judged."""
        return np.any([rows[verdict_column(claim)] == Verdict.VIOLATED for claim in self.claims], axis=0)

    def is_undecided(self, rows: Runs) -> Bool[np.ndarray, " runs"]:
        """Runs without a verdict on some claim by which they are judged, and with no violation."""
        undecided = np.any([rows[verdict_column(claim)] == Verdict.UNDECIDED for claim in self.claims], axis=0)
        return undecided & ~self.is_violated(rows)


def metrics_of(study: Study) -> dict[str, Record]:
    """The columns of a study's table of runs of which a direction is worse.

    Args:
        study: The study.
    """
    loop = study.nominal.loop
    kinds, columns = kinds_of(loop), list[str]()
    for name in study.standard:
        if study.record_of(name).loops in kinds:
            columns += [f"{name}[{i}]" for i in range(loop.order)] if name == "peak_error" else [name]
    columns += [*columns_of_channels(len(loop.channels)), *study.measured]
    records = {column: study.record_of(column) for column in columns}
    return {column: record for column, record in records.items() if record.worse is not None}
