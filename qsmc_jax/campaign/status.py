"""How far a campaign is, read from its folder."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from qsmc_jax.campaign.blocks import BlockError, BlockFile, block_files, gaps
from qsmc_jax.campaign.folder import RunFolder


@dataclasses.dataclass(frozen=True)
class Status:
    """How far a campaign is.

    Attributes:
        place: The folder.
        study_file: The study, as the user named it.
        fingerprint: What decides the rows, as a short hash.
        solved: Runs whose rows are there.
        asked_for: Runs asked for.
        damaged: Files that are not blocks of this campaign as they were written, each with what is wrong with it.
        sessions: Notes of the sessions, the oldest first.
        verdict: The verdict, once there is a summary.
    """

    place: str
    study_file: str
    fingerprint: str
    solved: int
    asked_for: int
    damaged: tuple[str, ...]
    sessions: tuple[Mapping[str, Any], ...]
    verdict: str | None

    def summary(self) -> dict[str, Any]:
        """Everything as plain values."""
        return dataclasses.asdict(self)

    def __str__(self) -> str:
        share = f" ({100 * self.solved / self.asked_for:.3g} %)" if self.asked_for else ""
        lines = [
            f"{self.place}: {self.solved} of {self.asked_for} runs{share}, verdict {self.verdict or 'not yet known'}",
            f"study {self.study_file}, fingerprint {self.fingerprint}",
            *(f"to be solved again: {name}" for name in self.damaged),
        ]
        for each in self.sessions:
            rate = f", {each['runs'] / each['seconds']:.0f} runs/s" if each["seconds"] else ""
            began, updated = each["began"][:19], each["updated"][:19]
            lines.append(f"session from {began}: {each['runs']} runs{rate}, {each['state']} at {updated}")
        return "\n".join(lines)


def status_of(folder: RunFolder) -> Status:
    """Reads the folder; nothing is changed.

    Args:
        folder: The run folder.

    Returns:
        The status; `print` it.

    Examples:
        >>> import pathlib
        >>> import tempfile
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=5.0)
        >>> config = qj.campaign.CampaignConfig(qj.Study(scenario, bandwidth=0.1), source=b"study = ...")
        >>> with tempfile.TemporaryDirectory() as place:
        ...     status = qj.campaign.status_of(qj.campaign.prepare(pathlib.Path(place, "run"), config))
        >>> status.solved, status.asked_for
        (0, 0)
    """
    manifest, files = folder.manifest, block_files(folder.path / "blocks")
    asked_for = max(folder.asked_for, default=0)
    faults = {file: _fault(file, manifest["fingerprint"]) for file in files}
    sound = [file for file, fault in faults.items() if not fault]
    summary = folder.summary()
    return Status(
        place=str(folder.path),
        study_file=manifest["study_file"],
        fingerprint=manifest["fingerprint"],
        solved=asked_for - sum(map(len, gaps(sound, 0, asked_for))),
        asked_for=asked_for,
        damaged=tuple(f"{file.path.name} {fault}" for file, fault in faults.items() if fault),
        sessions=tuple(folder.sessions()),
        verdict=summary["verdict"] if summary else None,
    )


def _fault(file: BlockFile, fingerprint: str) -> str:
    """What is wrong with a file; empty if nothing is."""
    try:
        file.read(fingerprint)
    except BlockError as fault:
        return str(fault)
    return ""
