"""A verification that lasts: blocks of rows in a run folder, resumed where it stopped."""

import dataclasses
from collections.abc import Callable, Generator, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from qsmc_jax.base.checks import require
from qsmc_jax.campaign.config import CampaignConfig
from qsmc_jax.campaign.engines import AbstractEngine, Task, Threads
from qsmc_jax.campaign.folder import FILE_RUNS, RunFolder, Session
from qsmc_jax.study.monte_carlo import Progress
from qsmc_jax.study.runs import Runs, concatenate
from qsmc_jax.study.sampling import require_independent
from qsmc_jax.verification.accumulate import Cost, VerificationAccumulator, check_request
from qsmc_jax.verification.result import Verification
from qsmc_jax.verification.stopping import AbstractRule, decision_of
from qsmc_jax.verification.tiers import Tiers

# By how much sup |sigma|/rho may differ where rounding does, in units of the relative tolerance, and a drawn number.
_AGREEMENT, _DRAWN = 1e3, 1e-9
# By how much may differ what depends on where the steps lie, which rounding decides in the end.
_BY_STEPS = dict.fromkeys(("steps", "settle_time", "total_variation_u", "least_gain"), 0.2)
# In a steady phase peaks are as high as one another to within rounding.
_NOT_COMPARED = "peak_time"
# Rows of each block that are solved again before going on, and blocks.
_PROBED, _PROBED_BLOCKS = 4, 64


def prepare(
    path: Path,
    config: CampaignConfig,
    *,
    study_file: str = "study.py",
    file_runs: int = FILE_RUNS,
    provenance: Mapping[str, Any] | None = None,
) -> RunFolder:
    """The run folder of a campaign: made, or opened if it is the same study's.

    Args:
        path: The folder.
        config: What decides its rows.
        study_file: The study's file, as the user named it.
        file_runs: Runs in each block file of a new folder, at least 1.
        provenance: Versions, machine and time, plain values.

    Raises:
        InputError: The folder belongs to another study (the keys that differ are named) or holds something else.

    Examples:
        >>> import pathlib
        >>> import tempfile
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=5.0)
        >>> config = qj.campaign.CampaignConfig(qj.Study(scenario, bandwidth=0.1), source=b"study = ...")
        >>> with tempfile.TemporaryDirectory() as place:
        ...     qj.campaign.prepare(pathlib.Path(place, "run"), config).manifest["identity"]["seed"]
        0
    """
    return RunFolder.create(path, config, study_file, file_runs, provenance or {})


def run_campaign(
    folder: RunFolder,
    config: CampaignConfig,
    runs: int,
    confidence: float = 0.95,
    *,
    worst: int = 5,
    until: AbstractRule | None = None,
    engine: AbstractEngine | None = None,
    progress: Progress | None = None,
    should_stop: Callable[[], bool] = lambda: False,
    provenance: Mapping[str, Any] | None = None,
) -> Verification | None:
    """Solves what is missing of the first `runs` runs, and verifies by all of them.

    Rows are those of `verify`, whoever solves them and however often it was interrupted. A stopping rule looks after
    each block, in the order of the blocks. Intervals hold at any time once a rule, or a second number of runs, shows
    that somebody may have looked before deciding how many.

    Args:
        folder: The run folder; see `prepare`.
        config: How to solve runs; the folder's own.
        runs: How many, at least 1; fewer than there are report on the first ones.
        confidence: Confidence of each interval, strictly between 0 and 1.
        worst: How many of the worst runs to report, at least 1.
        until: When to stop before.
        engine: Who solves; None for the threads of this process.
        progress: Called as `progress(done, runs)` after each block.
        should_stop: Called before each block starts; blocks under way are finished and written.
        provenance: Versions, machine and time, for the note of this session.

    Returns:
        The verification; None if it was told to stop.

    Raises:
        InputError: An argument is out of range, or a file can't be written, or the study gives other rows than the
            folder has.

    Examples:
        >>> import pathlib
        >>> import tempfile
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=5.0)
        >>> config = qj.campaign.CampaignConfig(qj.Study(scenario, bandwidth=0.1), source=b"study = ...")
        >>> with tempfile.TemporaryDirectory() as place:
        ...     folder = qj.campaign.prepare(pathlib.Path(place, "run"), config)
        ...     print(qj.campaign.run_campaign(folder, config, runs=64).conclusion())
        HELD in all 64 admissible runs: the probability of leaving the funnel lies in [0, 0.056] with 95 % confidence.
    """
    check_request(runs, confidence, worst, until)
    require_independent(config.design, "run_campaign")
    is_anytime = folder.ask_for(runs, until is not None)
    accumulator, session = VerificationAccumulator(config.study, worst), folder.begin_session(provenance or {})
    state, decision = "interrupted", None
    blocks, engine = Blocks(folder, config, runs, should_stop), engine or Threads()
    solving = blocks.solved(engine, session)
    is_solved_here = isinstance(engine, Threads) and bool(folder.missing(0, runs))
    try:
        first = config.solver if is_solved_here else None
        with Tiers.of(config.study, config.settings).compiling_check(config.study, first):
            for done in blocks.in_order(solving):
                for table in folder.tables(accumulator.runs, done):
                    accumulator.add(table)
                require(
                    accumulator.runs == done,
                    f"Folder `{folder.path}` lost rows while it was read: {accumulator.runs} of {done} are there. Give "
                    "the same command again: it solves what is missing.",
                )
                if progress is not None:
                    progress(done, runs)
                decision = decision_of(until, accumulator.summary.headline, confidence)
                if decision is not None:
                    break
        state = "done" if decision is not None or accumulator.runs >= runs else "interrupted"
    finally:
        solving.close()
        if session.runs or state == "interrupted":
            session.write(state)
    if state != "done":
        return None
    about = {"seed": config.seed, "confidence": confidence, "settings": config.settings}
    cost = _cost(folder, accumulator.runs)
    return accumulator.conclude(config.stream, cost, **about, is_anytime=is_anytime, decision=decision)


def work_shard(
    folder: RunFolder,
    config: CampaignConfig,
    shard: int,
    shards: int,
    *,
    progress: Progress | None = None,
    should_stop: Callable[[], bool] = lambda: False,
    provenance: Mapping[str, Any] | None = None,
) -> bool:
    """Solves every `shards`-th block that is missing, from block number `shard` on, and writes it to the folder.

    Args:
        folder: The run folder, shared by all workers.
        config: How to solve runs; the folder's own.
        shard: Which of the shards, 0 <= shard < shards.
        shards: How many there are.
        progress: Called as `progress(done, runs)` after each block, with the runs of all shards.
        should_stop: Asked before each block is begun.
        provenance: Versions, machine and time.

    Returns:
        Whether it came to the end.

    Examples:
        Worker 1 of 2 solves the second of two blocks:

        >>> import pathlib
        >>> import tempfile
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=5.0)
        >>> config = qj.campaign.CampaignConfig(qj.Study(scenario, bandwidth=0.1), source=b"study = ...")
        >>> with tempfile.TemporaryDirectory() as place:
        ...     folder = qj.campaign.prepare(pathlib.Path(place, "run"), config, file_runs=64)
        ...     _ = folder.ask_for(128, is_anytime=False)
        ...     qj.campaign.work_shard(folder, config, shard=1, shards=2), folder.missing(0, 128)
        (True, [range(0, 64)])
    """
    require(0 <= shard < shards, f"Argument `shard` must be i/n with 0 <= i < n, but is {shard}/{shards}.")
    asked_for = folder.asked_for
    require(bool(asked_for), f"Folder `{folder.path}` has no runs asked for: prepare it with `qsmc verify --prepare`.")
    folder.check(config)
    session, runs = folder.begin_session(provenance or {}), max(asked_for)
    blocks = Blocks(folder, config, runs, should_stop, lambda number: number % shards == shard)
    for number in blocks.solved(Threads(), session):
        if progress is not None:
            progress(min((number + 1) * blocks.size, runs), runs)
    session.write("interrupted" if blocks.is_stopped else "done")
    return not blocks.is_stopped


@dataclasses.dataclass
class Blocks:
    """The blocks of a campaign.

    Attributes:
        folder: Where they are.
        config: How to solve them.
        runs: Runs of all together.
        should_stop: Asked before each block is begun.
        is_mine: Which numbers of blocks are to be solved here.
    """

    folder: RunFolder
    config: CampaignConfig
    runs: int
    should_stop: Callable[[], bool]
    is_mine: Callable[[int], bool] = lambda _: True

    def __post_init__(self):
        self.size = int(self.folder.manifest["file_runs"])
        self.is_stopped = self._is_probed = False

    def solved(self, engine: AbstractEngine, session: Session) -> Generator[int, None, None]:
        """Numbers of blocks, each once all of its rows are in the folder, in any order."""
        for task, parts in engine.solve(self.config, self._tasks()):
            for solved in parts:
                self.folder.add(solved, self.config.study.records)
                session.add(solved)
            yield task.number

    def in_order(self, numbers: Iterator[int]) -> Iterator[int]:
        """The run after each block, in the order of the blocks, once it and all before it are there."""
        ready, following = set(), 0
        for number in numbers:
            ready.add(number)
            while following in ready:
                following += 1
                yield min(following * self.size, self.runs)

    def _tasks(self) -> Iterator[Task]:
        """Every block with what is missing of it now, so that what another worker has just done is not done again."""
        for number in range(-(-self.runs // self.size)):
            if self.should_stop():
                self.is_stopped = True
                return
            if self.is_mine(number):
                start, stop = number * self.size, min((number + 1) * self.size, self.runs)
                missing = self.folder.missing(start, stop)
                if missing:
                    self._probe()
                yield Task(number, tuple(missing))

    def _probe(self) -> None:
        """Raises unless the study gives the rows that the folder has: a module that it imports may have changed."""
        if self._is_probed:
            return
        self._is_probed = True
        some = [_spread(block.rows) for _, block in self.folder.blocks(_PROBED_BLOCKS)]
        if some:
            there = concatenate(some)
            _require_equal(there, self.config.solve(there["index"].tolist()).rows, self)


def _spread(rows: Runs) -> Runs:
    """Some rows, the first and the last among them."""
    return rows.take(np.unique(np.linspace(0, len(rows) - 1, _PROBED).astype(int)))


def _require_equal(there: Runs, now: Runs, blocks: Blocks) -> None:
    metrics = dict.fromkeys(there, _AGREEMENT * float(blocks.config.settings.rtol))
    tolerances = {**metrics, **dict.fromkeys(there.names, _DRAWN), **_BY_STEPS}
    for column in (each for each in there if each != _NOT_COMPARED):
        rtol = tolerances[column]
        is_same = column in now and np.allclose(there[column], now[column], rtol=rtol, atol=_DRAWN, equal_nan=True)
        require(
            bool(is_same),
            f"Folder `{blocks.folder.path}` has other rows than the study gives now: column `{column}` differs. Did a "
            "module that the study imports change, or a version? Go on as it was, or begin beside it with --fresh.",
        )


def _cost(folder: RunFolder, runs: int) -> Cost:
    """What all sessions together spent."""
    sessions = folder.sessions()
    steps, paid = (sum(each[name] for each in sessions) for name in ("steps", "paid"))
    seconds = sum(each["seconds"] for each in sessions)
    return Cost(**folder.cost(runs), occupancy=steps / paid if paid else 1.0, seconds=seconds)
