"""Runs solved and decided: what every verb that counts verdicts shares."""

import functools as ft
from collections.abc import Iterator, Sequence

import numpy as np

from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.study.batches import block_size
from qsmc_jax.study.monte_carlo import Progress, stream
from qsmc_jax.study.runs import Runs
from qsmc_jax.study.study import Study
from qsmc_jax.verification.escalation import Escalation
from qsmc_jax.verification.tiers import Tiers


def decide(
    study: Study,
    indices: Sequence[int] | np.ndarray,
    seed: int,
    *,
    settings: SolverSettings,
    block: int | None,
    threads: int | None,
    progress: Progress | None,
) -> Iterator[Runs]:
    """Solves independent runs of a study and yields their rows, decided by escalation, in no particular order.

    Args:
        study: The study.
        indices: Indices of the runs.
        seed: Seed of the study.
        settings: Method and tolerances of the first solve.
        block: Runs solved together, a multiple of 64; None for what suits the platform.
        threads: Blocks solved at the same time; None for one a core of a CPU.
        progress: Called as `progress(done, len(indices))` after each block.
    """
    solve = ft.partial(stream, study, seed=seed, block=block, threads=threads)
    escalation = Escalation(solve, Tiers.of(study, settings), block_size(block))
    yield from through(escalation, solve(indices, settings=settings, progress=progress))


def through(escalation: Escalation, tables: Iterator[Runs]) -> Iterator[Runs]:
    """The rows of all tables once they are decided, in no particular order."""
    for table in tables:
        yield from escalation.feed(table)
    yield from escalation.finish()


def part_of(progress: Progress | None, before: int, total: int) -> Progress | None:
    """The progress of one part of a longer work, told as that of the whole.

    Args:
        progress: To be told; None for nobody.
        before: Runs of the parts before this one.
        total: Runs of all parts.
    """
    if progress is None:
        return None
    tell = progress
    return lambda done, _: tell(before + done, total)
