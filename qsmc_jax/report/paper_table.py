"""The paper's claims on its two examples, beside what the simulation gives."""

import dataclasses

import numpy as np

from qsmc_jax import paper
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.simulation.trajectory import Trajectory, simulate

_ROUNDING = 0.01  # the paper prints two digits behind the point


@dataclasses.dataclass(frozen=True)
class Row:
    """One claim.

    Attributes:
        example: 1 or 2.
        claim: What is claimed, of which start.
        paper: The paper's number or word.
        ours: What the simulation gives.
        is_met: Whether they agree.
        note: What to know about it.
    """

    example: int
    claim: str
    paper: str
    ours: str
    is_met: bool
    note: str = ""


def simulate_example(number: int) -> list[Trajectory]:
    """The runs of an example of the paper from all its starts."""
    loop = {1: paper.example1, 2: paper.example2}[number]()
    starts = paper.STARTS[number]
    return [simulate(loop, [start] * loop.order, paper.HORIZON, bandwidth=paper.BANDWIDTH) for start in starts]


def rows(number: int, runs: list[Trajectory]) -> list[Row]:
    """The claims on one example, and what its runs say."""
    printed, computed = paper.PRINTED_REACHING_TIME[number], runs[0].reaching_time
    note = "the printed bound is rounded down" if computed > printed else ""
    table = [
        Row(number, "reaching time t_r [s]", f"< {printed:g}", f"{computed:.4f}", computed < printed + _ROUNDING, note),
        *(_funnel(number, run) for run in runs),
        *(_reaching(number, run, computed) for run in runs),
    ]
    bounds, first = runs[0].error_bounds, runs[0]
    last_quarter = first.ts > 0.75 * paper.HORIZON
    for i, bound in enumerate(bounds):
        peak = max(float(np.abs(run.e[last_quarter, i]).max()) for run in runs)
        table.append(_row(number, f"|e^({i})| in the end, any start", f"<= {bound:.4g}", peak, peak <= float(bound)))
    return table


def _funnel(number: int, run: Trajectory) -> Row:
    claim = f"sup |sigma|/rho from x_i(0) = {run.x[0, 0]:g}"
    return _row(number, claim, "< 1", float(run.metrics.peak_ratio), run.verdict == Verdict.HELD)


def _reaching(number: int, run: Trajectory, t_r: float) -> Row:
    claim = f"|sigma| < 0.1 for good after [s], x_i(0) = {run.x[0, 0]:g}"
    held = int(run.metrics.verdict_reaching) == Verdict.HELD
    return _row(number, claim, f"<= {t_r:.4f}", float(run.metrics.reach_time), held)


def _row(number: int, claim: str, printed: str, value: float, is_met: bool) -> Row:
    return Row(number, claim, printed, f"{value:.6g}", bool(is_met))


def as_text(table: list[Row]) -> str:
    """The table for a terminal."""
    cells = [
        ("example", "claim", "paper", "ours", ""),
        *((str(r.example), r.claim, r.paper, r.ours, _mark(r)) for r in table),
    ]
    widths = [max(len(row[i]) for row in cells) for i in range(5)]
    return "\n".join(
        "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in cells
    )


def _mark(row: Row) -> str:
    mark = "met" if row.is_met else "NOT MET"
    return f"{mark} ({row.note})" if row.note else mark
