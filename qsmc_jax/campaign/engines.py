"""Who solves what is missing of a campaign: this process, or the workers of a Dask cluster. The rows are the same."""

import abc
import collections
import dataclasses
import functools as ft
import threading
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from typing import Any

from qsmc_jax.base.checks import require
from qsmc_jax.base.script import run_script
from qsmc_jax.campaign.config import CampaignConfig, Solved, study_in
from qsmc_jax.study.study import Study


@dataclasses.dataclass(frozen=True)
class Task:
    """One block.

    Attributes:
        number: Number of the block.
        missing: Ranges of runs to be solved; none if the block is whole.
    """

    number: int
    missing: tuple[range, ...]


class AbstractEngine(abc.ABC):
    """Solves tasks."""

    @abc.abstractmethod
    def solve(self, config: CampaignConfig, tasks: Iterator[Task]) -> Iterator[tuple[Task, list[Solved]]]:
        """Yields each task with its rows, in any order; takes no more tasks than it can begin with soon.

        Args:
            config: How to solve runs.
            tasks: What to solve.
        """


class Threads(AbstractEngine):
    """This process: one block at a time, its pieces over threads, while the one before is written.

    Examples:
        >>> import pathlib
        >>> import tempfile
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=5.0)
        >>> config = qj.campaign.CampaignConfig(qj.Study(scenario, bandwidth=0.1), source=b"study = ...")
        >>> with tempfile.TemporaryDirectory() as place:
        ...     folder = qj.campaign.prepare(pathlib.Path(place, "run"), config)
        ...     qj.campaign.run_campaign(folder, config, runs=64, engine=qj.campaign.Threads()).verdict.name
        'HELD'
    """

    def solve(self, config: CampaignConfig, tasks: Iterator[Task]) -> Iterator[tuple[Task, list[Solved]]]:
        before: tuple[Task, Future[list[Solved]]] | None = None
        closed = threading.Event()

        def go_on(done: int, total: int) -> None:
            """Ends a solve that nobody waits for any more, between two of its pieces."""
            if closed.is_set():
                raise CancelledError

        with ThreadPoolExecutor(1) as pool:
            try:
                for task in tasks:
                    solving = pool.submit(lambda missing: [config.solve(runs, go_on) for runs in missing], task.missing)
                    if before is not None:
                        yield before[0], before[1].result()
                    before = task, solving
                if before is not None:
                    yield before[0], before[1].result()
            finally:
                closed.set()


@dataclasses.dataclass
class Dask(AbstractEngine):
    """The workers of a Dask cluster; a block that a lost worker held is solved by another.

    Attributes:
        client: A `distributed.Client`.
        retries: How often a block that failed is tried again.

    Examples:
        The client is that of your cluster, such as `distributed.Client("tcp://scheduler:8786")`:

        >>> import qsmc_jax as qj
        >>> qj.campaign.Dask(client=None, retries=5).retries
        5
    """

    client: Any
    retries: int = 2

    def solve(self, config: CampaignConfig, tasks: Iterator[Task]) -> Iterator[tuple[Task, list[Solved]]]:
        from distributed import as_completed

        # A worker's own threads take a task each: one thread a task, unless more are asked for.
        options = {
            "seed": config.seed,
            "sampling": config.sampling,
            "settings": config.settings,
            "block": config.block,
            "threads": config.threads or 1,
        }
        work = ft.partial(_solve, config.source, config.identity, options)
        held: dict[Any, Task] = {}
        done: collections.deque[tuple[Task, list[Solved]]] = collections.deque()
        arriving = as_completed()
        try:
            while True:
                for task in tasks:
                    if not task.missing:
                        done.append((task, []))
                    else:
                        future = self.client.submit(work, task.missing, pure=False, retries=self.retries)
                        held[future] = task
                        arriving.add(future)
                    if len(held) >= self._ahead():
                        break
                while done:
                    yield done.popleft()
                if not held:
                    return
                future = next(arriving)
                yield held.pop(future), future.result()
                future.release()
        finally:
            self.client.cancel(list(held))

    def _ahead(self) -> int:
        """Blocks to be under way: enough to keep every worker busy while rows are on their way."""
        threads = sum(self.client.nthreads().values())
        return 2 * max(threads, 1)


def _solve(
    source: bytes, identity: dict[str, Any], options: dict[str, Any], missing: tuple[range, ...]
) -> list[Solved]:
    """What a worker does: the study comes as the bytes of its file, to be run here."""
    config = CampaignConfig(study_in(identity, _study(source)), source, **options)
    return [config.solve(runs) for runs in missing]


@ft.lru_cache(maxsize=4)
def _study(source: bytes) -> Study:
    """The study that a file defines; run once in a worker, so that its programs are compiled once."""
    names = run_script(compile(source, "study.py", "exec"), "study.py")
    require(isinstance(names.get("study"), Study), "The study's file must define `study`.")
    return names["study"]
