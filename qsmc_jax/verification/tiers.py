"""The solves that a run may get until it is decided, and the one that checks it."""

import contextlib
import dataclasses
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.simulation.stiffness import OTHER
from qsmc_jax.study.batches import LANE_MULTIPLE, BatchSolver
from qsmc_jax.study.study import Study

# Tiers that decide; one more only checks.
TIERS = 3


@dataclasses.dataclass(frozen=True)
class Tiers:
    """The settings of each solve.

    Tier 0 is the solve of the study. Tier 1 has a hundredth of its tolerance. Tier 2 is independent of both, and so is
    tier 3 of tier 2, which decides nothing: it checks what tier 2 decided.

    Attributes:
        settings: Settings by tier, four of them.
        is_sampled: Whether the loop is sampled: solved by one method, so that only other cells make another solve.
    """

    settings: tuple[SolverSettings, ...]
    is_sampled: bool

    @classmethod
    def of(cls, study: Study, settings: SolverSettings) -> "Tiers":
        """The tiers above the given settings.

        Args:
            study: The study.
            settings: Settings of its first solve.
        """
        is_sampled = study.nominal.loop.implementation is not None
        second = independent(settings, is_sampled)
        # A method of its own for the ideal loop: neither of those that the tiers below have, whichever it was.
        third = firmer(second) if is_sampled else second.replace(method="rodas4")
        if len(study.nominal.loop.channels) > 1:  # several inputs are stiff, and dear to an explicit method
            second, third = third.replace(method="rodas5p" if settings.method == "rodas4" else "rodas4"), second
        return cls((settings, firmer(settings), second, third), is_sampled)

    def options(self, tier: int) -> dict[str, Any]:
        """Arguments of `stream` for a tier: another program is compiled for few lanes, as few runs come to it.

        Args:
            tier: Which, from 0.
        """
        settings = self.settings[tier]
        is_same_program = settings.choices == self.settings[0].choices
        return {"settings": settings} if is_same_program else {"settings": settings, "block": LANE_MULTIPLE}

    @contextlib.contextmanager
    def compiling_check(self, study: Study, first: BatchSolver | None) -> Iterator[None]:
        """Meanwhile a thread compiles what checks tier 0, which is needed last; the end waits for it.

        Args:
            study: The study.
            first: Solver of tier 0, to be traced before, so that its compilation comes first; None if not needed here.
        """
        if first is not None:
            first.trace_nominal()
        with ThreadPoolExecutor(1) as aside:
            options = self.options(self.check_of(0))
            # Without a number of lanes of its own it is the program that solves.
            solver = BatchSolver(study, options["settings"], options["block"]) if "block" in options else None
            compiled = aside.submit(solver.compile_nominal) if solver else None
            yield
            if compiled:
                compiled.result()

    def check_of(self, tier: int) -> int:
        """The tier that checks what was decided on one: at least as firm, and by another method or other cells.

        Args:
            tier: The tier that decided, 0, 1 or 2.
        """
        return tier + 1 if self.is_sampled else max(tier + 1, TIERS - 1)


def firmer(settings: SolverSettings) -> SolverSettings:
    """The same method at a hundredth of the tolerance."""
    return settings.replace(rtol=settings.rtol / 100.0, atol=settings.atol / 100.0)


def independent(settings: SolverSettings, is_sampled: bool) -> SolverSettings:
    """A solve that shares no step with tiers 0 and 1, firmer than tier 0, and with ten times as many to spend.

    The ideal loop is solved by the other method, explicit against implicit, in the funnel coordinate. A sampled loop
    has one method: its cells are made others by a tolerance that is a hundredth of tier 1's.
    """
    firm = firmer(settings).replace(max_steps=10 * settings.max_steps)
    return firmer(firm) if is_sampled else firm.replace(method=OTHER[settings.method], coordinates="funnel")
