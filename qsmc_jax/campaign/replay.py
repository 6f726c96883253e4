"""One run of a campaign again, in full, and held against its recorded row."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from qsmc_jax.base.checks import require, require_count
from qsmc_jax.base.errors import InputError
from qsmc_jax.campaign.config import CampaignConfig
from qsmc_jax.campaign.folder import RunFolder
from qsmc_jax.metrics.claims import claims_of, require_claim, verdict_column
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.simulation.outcome import Outcome
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.simulation.trajectory import Trajectory
from qsmc_jax.study.runs import Runs
from qsmc_jax.verification.escalation import agreed
from qsmc_jax.verification.summary import worst_of
from qsmc_jax.verification.tiers import TIERS, Tiers

# By how much the peak may differ from the recorded one, in units of the relative tolerance: another program rounds
# otherwise, and takes other steps.
_AGREEMENT = 1e3


@dataclasses.dataclass(frozen=True)
class Replay:
    """A run, solved again.

    Attributes:
        trajectory: The run, as the solve that decided it; of one on which solves disagree, one that says VIOLATED.
        row: Its recorded row.
        agrees: Whether verdicts and sup |sigma|/rho are as recorded, or else whether the solves disagree again.
    """

    trajectory: Trajectory
    row: dict[str, Any]
    agrees: bool

    def __str__(self) -> str:
        recorded = f"{Verdict(self.row['verdict']).name}, sup |sigma|/rho {self.row['peak_ratio']:.9g}"
        found = f"recorded as run {self.row['index']}: {recorded}; "
        return f"{self.trajectory}\n{found}{'it agrees' if self.agrees else 'IT DOES NOT AGREE'}"


def replay(
    folder: RunFolder, config: CampaignConfig, index: int | None, worst: int | None, of: str | None = None
) -> Replay:
    """Solves a run again.

    Args:
        folder: The run folder.
        config: Its config.
        index: Index of the run; or else
        worst: which of the worst runs, from 1.
        of: The claim by which runs are the worst; None for the funnel, and of equals the requirements.

    Returns:
        The run, and whether it came out as recorded; `print` it.

    Raises:
        InputError: Not exactly one of the two is given, or there is no such row, or no such claim.

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
        ...     qj.campaign.replay(folder, config, index=17, worst=None).agrees
        True
    """
    require((index is None) != (worst is None), "One of `--run` and `--worst` must say which run.")
    require(
        of is None or worst is not None,
        "Argument `--of` names the claim by which runs are the worst: it needs `--worst`.",
    )
    row = _row(folder, index) if index is not None else _worst(folder, worst or 0, of)
    tiers = Tiers.of(config.study, config.settings)
    if row["outcome"] == Outcome.SOLVES_DISAGREE:
        tried = [_solved(config, row, tiers.settings[tier]) for tier in range(TIERS)]
        verdicts = [int(run.metrics.verdict) for run in tried]
        shown = verdicts.index(Verdict.VIOLATED) if Verdict.VIOLATED in verdicts else 0
        return Replay(tried[shown], row, bool(agreed([np.array([each]) for each in verdicts])[0] == Verdict.UNDECIDED))
    run = _solved(config, row, tiers.settings[int(row["tier"])])
    close = 1e-9 + _AGREEMENT * float(config.settings.rtol)
    is_near = np.isclose(float(run.metrics.peak_ratio), row["peak_ratio"], rtol=close, equal_nan=True)
    return Replay(run, row, bool(is_near) and _is_decided_alike(run.metrics.named(), row))


def _is_decided_alike(found: Mapping[str, Any], row: Mapping[str, Any]) -> bool:
    """Whether the verdicts are those of the row; but for the funnel's, where those of the row were decided by it."""
    columns = [verdict_column(claim) for claim in claims_of(row)]
    is_asked = [column == "verdict" or row[column] != Verdict.UNDECIDED for column in columns]
    return all(int(found[column]) == row[column] for column, asked in zip(columns, is_asked, strict=True) if asked)


def _solved(config: CampaignConfig, row: dict[str, Any], settings: SolverSettings) -> Trajectory:
    return config.study.replay(row["index"], config.seed, sampling=config.design, settings=settings)


def _row(folder: RunFolder, index: int) -> dict[str, Any]:
    for table in folder.tables(index, index + 1):
        if len(table):
            return table.row(0)
    raise InputError(f"Argument `--run` must be a run that is there, but `{folder.path}` has no row {index}.")


def _worst(folder: RunFolder, rank: int, claim: str | None) -> dict[str, Any]:
    require_count("--worst", rank)
    kept: list[Runs] = []
    for table in folder.tables():
        require_claim("--of", claim or "funnel", table.claims)
        kept = [worst_of([*kept, table], rank, claim)]
    require(bool(kept) and len(kept[0]) >= rank, f"Argument `--worst` is {rank}, but `{folder.path}` has fewer rows.")
    return kept[0].row(rank - 1)
