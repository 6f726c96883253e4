"""The table of a study: one row a run, one column a name or a metric."""

import dataclasses
import math
from collections.abc import ItemsView, Iterator, KeysView, Mapping, Sequence, ValuesView
from typing import Any, overload

import numpy as np
from jaxtyping import Int

from qsmc_jax.base.checks import nearest
from qsmc_jax.base.errors import InputError
from qsmc_jax.display.notebook import as_dataset, as_frame, as_html
from qsmc_jax.display.short_repr import short_repr
from qsmc_jax.metrics.claims import claims_of, verdict_column
from qsmc_jax.metrics.record import Record
from qsmc_jax.metrics.standard import record_of
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.statistics.bands import Band, next_run

# Rows that a notebook shows.
_SHOWN = 5


class MissingColumnError(InputError, KeyError):
    """A column that is not in a table."""

    __str__ = Exception.__str__  # that of `KeyError` would quote the sentence


@dataclasses.dataclass(frozen=True)
class Runs:
    """Runs of a study as NumPy columns, a mapping from column name to array.

    As in a data frame, `runs["mass"]` is a column and `runs[:100]` are rows; `len(runs)` counts rows, `runs.keys()`
    columns.

    Columns: `index`; one for each drawn name (`mass`, `x0[0]`, `x0[1]`); and the `Metrics` of the run, with
    `peak_error[i]` for each error derivative. Verdicts are codes of `Verdict`, outcomes of `Outcome`.

    Attributes:
        columns: Arrays of one length, by column name.
        names: The columns that hold drawn values.
        records: What is known of the columns that its study alone has, such as their units.

    Examples:
        Three runs, one of them violated:

        >>> import numpy as np
        >>> import qsmc_jax as qj
        >>> columns = {"index": np.arange(3), "verdict": np.array([0, 0, 1]), "peak_ratio": np.array([0.4, 0.6, 1.0])}
        >>> runs = qj.Runs(columns, names=())
        >>> print(runs)
        3 runs, 3 columns: 2 HELD, 1 VIOLATED; worst sup |sigma|/rho 1
        >>> runs.take(runs["verdict"] == qj.Verdict.VIOLATED).row(0)["index"]
        2
    """

    columns: Mapping[str, np.ndarray]
    names: tuple[str, ...]
    records: Mapping[str, Record] = dataclasses.field(default_factory=dict)

    @overload
    def __getitem__(self, column: str) -> np.ndarray: ...

    @overload
    def __getitem__(self, column: slice) -> "Runs": ...

    def __getitem__(self, column: str | slice) -> "np.ndarray | Runs":
        if isinstance(column, slice):
            return self.take(column)
        if column not in self.columns:
            listed = ", ".join(self.columns)
            message = f"There is no column `{column}`.{nearest(column, self.columns)} There are: {listed}."
            raise MissingColumnError(message)
        return self.columns[column]

    def __len__(self) -> int:
        return len(self.columns["index"])

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __contains__(self, column: object) -> bool:
        return column in self.columns

    def keys(self) -> KeysView[str]:
        """The names of the columns."""
        return self.columns.keys()

    def values(self) -> ValuesView[np.ndarray]:
        """The columns."""
        return self.columns.values()

    def items(self) -> ItemsView[str, np.ndarray]:
        """Names and columns."""
        return self.columns.items()

    def get(self, column: str, default: Any = None) -> Any:
        """A column; `default` if there is none of that name.

        Args:
            column: Its name.
            default: What is returned instead.
        """
        return self.columns.get(column, default)

    def take(self, rows: Any) -> "Runs":
        """The rows that a NumPy index selects.

        Args:
            rows: A slice, a mask, or a list of row numbers.
        """
        return dataclasses.replace(self, columns={name: column[rows] for name, column in self.columns.items()})

    def row(self, i: int) -> dict[str, Any]:
        """Row `i` as a dictionary of plain numbers.

        Args:
            i: Number of the row in this table.
        """
        return {name: column[i].item() for name, column in self.columns.items()}

    @property
    def claims(self) -> tuple[str, ...]:
        """The claims on which it has verdicts: "funnel", "reaching", "tracking", and the requirements of the study."""
        return claims_of(self.columns)

    @property
    def verdicts(self) -> Int[np.ndarray, "claims rows"]:
        """The verdicts on all claims, codes of `Verdict`."""
        return np.array([self[verdict_column(claim)] for claim in self.claims])

    def counts(self, claim: str = "funnel") -> dict[Verdict, int]:
        """How many runs have each verdict on a claim.

        Args:
            claim: Its name, one of `claims`.
        """
        return count_verdicts(self[verdict_column(claim)])

    def record_of(self, column: str) -> Record:
        """What is known of a column: unit, meaning, label of an axis.

        Args:
            column: The column.
        """
        return self.records.get(column) or record_of(column)

    def band(self, column: str, confidence: float = 0.95, *, least: float = -math.inf, most: float = math.inf) -> Band:
        """What the runs say of the whole distribution of a column: CDF, quantiles, mean tail, all at once.

        For independent runs, those of `Random()`, whose number was not chosen by looking at them. INADMISSIBLE ones are
        left out; one in which the column is not known, as where it is undecided, may be anywhere.

        Args:
            column: A metric, or a name that the study draws.
            confidence: Confidence of the whole band, strictly between 0 and 1.
            least: What the column is never below, from a proof say; -inf for nothing known.
            most: What it never exceeds; inf for nothing known.

        Examples:
            >>> import qsmc_jax as qj
            >>> def scenario(draw):
            ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=2.0)
            >>> runs = qj.monte_carlo(qj.Study(scenario, bandwidth=0.1), runs=64, block=64)
            >>> low, high = runs.band("peak_u").quantile(0.5)
            >>> bool(low < high < runs["peak_u"].max())
            True
        """
        values, unknown = self._known(column)
        return Band(column, self.record_of(column).unit, values, unknown, confidence, least, most)

    def next_run(self, column: str, probability: float) -> float:
        """A number that one further run does not pass in the column's worse direction with the given probability.

        The probability is over these runs and the next together; `band` has statements with confidence.

        Args:
            column: As for `band`; where neither direction is worse, the number is an upper one.
            probability: Strictly between 0 and 1, at most n/(n + 1) for n runs: else the number is infinite.

        Examples:
            >>> import numpy as np
            >>> import qsmc_jax as qj
            >>> columns = {"index": np.arange(19), "verdict": np.zeros(19, int), "peak_u": np.arange(19.0)}
            >>> qj.Runs(columns, names=()).next_run("peak_u", 0.95)
            18.0
        """
        tail = "low" if self.record_of(column).worse == "low" else "high"
        return next_run(*self._known(column), probability, tail)

    def _known(self, column: str) -> tuple[np.ndarray, int]:
        """The known values of a column in admissible runs, and in how many it is not known."""
        values = np.asarray(self[column][self["verdict"] != Verdict.INADMISSIBLE], np.float64)
        is_known = ~np.isnan(values)
        return values[is_known], int((~is_known).sum())

    def to_pandas(self) -> Any:
        """The table as a `pandas.DataFrame` over the index of the run; needs the extra `notebook`."""
        return as_frame(self.columns, "index")

    def to_xarray(self) -> Any:
        """The table as an `xarray.Dataset` over the dimension `run`, with units; needs the extra `notebook`."""
        variables = {name: ("run", each, self.record_of(name).attributes) for name, each in self.columns.items()}
        del variables["index"]
        return as_dataset(variables, {"run": self["index"]}, {})

    def _repr_html_(self) -> str:
        shown = ("index", *self.names, "verdict", "margin", "peak_u", "reach_time")
        widths = {name: max(len(name), 10) for name in shown if name in self.columns}
        lines = ["  ".join(name.rjust(width) for name, width in widths.items())]
        for i in range(min(len(self), _SHOWN)):
            row = self.row(i)
            if "verdict" in row:
                row["verdict"] = Verdict(row["verdict"]).name
            cells = (f"{row[name]:.5g}" if isinstance(row[name], float) else str(row[name]) for name in widths)
            lines.append("  ".join(cell.rjust(width) for cell, width in zip(cells, widths.values(), strict=True)))
        return as_html("\n".join([str(self), *lines, *(["..."] if len(self) > _SHOWN else [])]))

    __repr__ = short_repr

    def __str__(self) -> str:
        counts = ", ".join(f"{count} {verdict.name}" for verdict, count in self.counts().items() if count)
        peak = self["peak_ratio"][np.isfinite(self["peak_ratio"])]
        worst = f"; worst sup |sigma|/rho {peak.max():.6g}" if peak.size else ""
        return f"{len(self)} runs, {len(self.columns)} columns: {counts or 'empty'}{worst}"


def count_verdicts(verdicts: Int[np.ndarray, " rows"]) -> dict[Verdict, int]:
    """How many of some verdicts are which."""
    return {verdict: int(np.sum(verdicts == verdict)) for verdict in Verdict}


def concatenate(tables: Sequence[Runs]) -> Runs:
    """One table of several, in order; they must have the same columns."""
    columns = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    return dataclasses.replace(tables[0], columns=columns)


def replace_rows(runs: Runs, rows: np.ndarray, new: Runs) -> Runs:
    """The table with the given rows replaced."""
    columns = {name: column.copy() for name, column in runs.columns.items()}
    for name, column in columns.items():
        column[rows] = new[name]
    return dataclasses.replace(runs, columns=columns)
