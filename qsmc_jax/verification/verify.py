"""Verification by Monte Carlo: the claims of Theorem 1 and the requirements of a study, with exact intervals."""

import functools as ft
import time
from collections.abc import Callable

from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.study.batches import BatchSolver, block_size, thread_count
from qsmc_jax.study.monte_carlo import Progress, stream
from qsmc_jax.study.runs import Runs
from qsmc_jax.study.sampling import AbstractSampling, Random, require_independent, require_seed
from qsmc_jax.study.schedule import Workload
from qsmc_jax.study.study import Study, require_study
from qsmc_jax.verification.accumulate import Cost, VerificationAccumulator, check_request
from qsmc_jax.verification.escalation import Escalation
from qsmc_jax.verification.resolve import part_of, through
from qsmc_jax.verification.result import Verification
from qsmc_jax.verification.stopping import LOOK, AbstractRule, decision_of
from qsmc_jax.verification.tiers import Tiers

Sink = Callable[[Runs], None]


def verify(
    study: Study,
    runs: int,
    seed: int = 0,
    confidence: float = 0.95,
    *,
    worst: int = 5,
    sampling: AbstractSampling | None = None,
    settings: SolverSettings | None = None,
    block: int | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
    sink: Sink | None = None,
    until: AbstractRule | None = None,
) -> Verification:
    """Finds out by independent runs whether the funnel guarantee holds, and how sure that is.

    Violated and undecided runs are solved again, at a hundredth of the tolerance and by another method, and never
    dropped; those on which the solves disagree, and all that stay undecided, widen the intervals both ways. A random
    sample of all runs and the worst are checked by another method too: a claim on which that changes a verdict is
    UNDECIDED. Memory does not grow with the number of runs.

    Args:
        study: The study.
        runs: Number of runs, at least 1; `runs_needed` plans it.
        seed: Seed, 0 <= seed < 2**63. Use a fresh one for a certificate of tuned gains.
        confidence: Confidence of each interval, strictly between 0 and 1.
        worst: How many of the worst runs to report, at least 1.
        sampling: `Random()` (None). Designs whose points are not independent are refused, a `Table` too.
        settings: Method and tolerances of the first solve; None for the defaults.
        block: Runs solved together, a multiple of 64; None for what suits the platform, on CPUs 512.
        threads: Blocks solved at the same time; None for one a core of a CPU.
        progress: Called as `progress(done, runs)` after each block.
        sink: Called with each table of final rows, in no particular order.
        until: Stops earlier, by a rule that looks every 32768 runs: `UntilBelow(1e-3)`, `UntilWidth(1e-3)` or
            `SequentialTest(2e-3, 1e-3)`. The intervals are then those of a confidence sequence.

    Returns:
        The verification; `print` it.

    Raises:
        InputError: An argument is out of range, or the sampling admits no exact interval.

    Examples:
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=5.0)
        >>> study = qj.Study(scenario, bandwidth=0.1)
        >>> print(qj.verify(study, runs=64, block=64).conclusion())
        HELD in all 64 admissible runs: the probability of leaving the funnel lies in [0, 0.056] with 95 % confidence.
    """
    require_study(study)
    check_request(runs, confidence, worst, until)
    require_seed(seed)
    threads, block = thread_count(threads), block_size(block)
    settings, sampling = settings or SolverSettings(), sampling or Random()
    require_independent(sampling, "verify")
    solve = ft.partial(stream, study, seed=seed, sampling=sampling, block=block, threads=threads)
    solver = BatchSolver(study, settings, block)
    workload, accumulator, tiers = Workload(), VerificationAccumulator(study, worst), Tiers.of(study, settings)
    escalation = Escalation(solve, tiers, block)
    decision, look = None, runs if until is None else LOOK
    with tiers.compiling_check(study, solver):
        solver.compile_nominal()
        begin = time.perf_counter()
        for start in range(0, runs, look):
            part = range(start, min(start + look, runs))
            options = {"settings": settings, "workload": workload, "progress": part_of(progress, start, runs)}
            for table in through(escalation, solve(part, **options)):
                accumulator.add(table)
                if sink is not None:
                    sink(table)
            decision = decision_of(until, accumulator.summary.headline, confidence)
            if decision is not None:
                break
        seconds = time.perf_counter() - begin
    cost = Cost(tuple(escalation.escalated), tuple(escalation.defects), workload.occupancy, seconds)
    about = {"seed": seed, "confidence": confidence, "settings": settings}
    return accumulator.conclude(solve, cost, **about, is_anytime=until is not None, decision=decision)
