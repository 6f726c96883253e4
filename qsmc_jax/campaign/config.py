"""What decides the rows of a campaign, to the last bit: all of it, and nothing else."""

import ast
import dataclasses
import functools as ft
import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import jax
import numpy as np

from qsmc_jax.base.checks import require, require_kind
from qsmc_jax.metrics.standard import USUAL
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.study.batches import BatchSolver, block_size
from qsmc_jax.study.monte_carlo import Progress, stream
from qsmc_jax.study.runs import Runs, concatenate
from qsmc_jax.study.sampling import SAMPLINGS, AbstractSampling, Random
from qsmc_jax.study.schedule import Workload
from qsmc_jax.study.study import Study
from qsmc_jax.study.windows import Planner
from qsmc_jax.verification.escalation import Escalation
from qsmc_jax.verification.resolve import through
from qsmc_jax.verification.tiers import Tiers


@dataclasses.dataclass(frozen=True)
class CampaignConfig:
    """How to solve any runs of a campaign.

    Attributes:
        study: The study.
        source: The bytes of the file that defines it.
        seed: Seed of the runs.
        settings: Method and tolerances of the first solve.
        block: Runs solved together, a multiple of 64; None for what suits the platform. The rows do not depend on it.
        threads: Blocks solved at the same time; None for one a core of a CPU.
        files: Hashes of what the study read when it was loaded, by name: to name what changed, no more.
        sampling: Where the runs lie in the unit cube; None for `Random()`. Of another, rows can be solved, by
            `work_shard`, and nothing concluded from them.

    Examples:
        Comments and layout of the file do not count:

        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=5.0)
        >>> study = qj.Study(scenario, bandwidth=0.1)
        >>> identity = qj.campaign.CampaignConfig(study, source=b"gain = 1  # a first try").identity
        >>> identity == qj.campaign.CampaignConfig(study, source=b"gain=1").identity
        True
    """

    study: Study
    source: bytes
    seed: int = 0
    settings: SolverSettings = dataclasses.field(default_factory=SolverSettings)
    block: int | None = None
    threads: int | None = None
    files: Mapping[str, str] = dataclasses.field(default_factory=dict)
    sampling: AbstractSampling | None = None

    def __post_init__(self):
        BatchSolver(self.study, self.settings, block_size(self.block))  # checks them
        require_kind("sampling", self.design, AbstractSampling, SAMPLINGS)

    @ft.cached_property
    def identity(self) -> dict[str, Any]:
        """What changes the rows, as plain values by name.

        The file counts without its comments and its layout, and what it computes by its traced programs, with all
        numbers in them, wherever they come from.
        """
        study, settings = self.study, self.settings
        parameters = {spec.name: spec.flat_nominal for spec in study.specs if spec.kind == "parameter"}
        identity = {
            "study_code": code_hash(self.source),
            "contents": dict(study.contents),
            "parameters": parameters,
            "values": {name: value.tolist() for name, value in study.values.items()},
            "bandwidth": study.bandwidth,
            "seed": self.seed,
            "rtol": float(settings.rtol),
            "atol": float(settings.atol),
            "precision": "float64",
            **({} if study.asked == USUAL else {"metrics": study.asked}),
            **({} if isinstance(self.design, Random) else {"sampling": _told(self.design)}),
            **dict(settings.choices),
        }
        return json.loads(json.dumps(identity))

    @ft.cached_property
    def planner(self) -> Planner:
        """What the blocks so far taught of the cost of a run; compiles on first use."""
        self.solver.compile_nominal()
        return Planner(self.solver, self.seed, self.design)

    @property
    def design(self) -> AbstractSampling:
        """Where the runs lie in the unit cube."""
        return self.sampling or Random()

    @property
    def solver(self) -> BatchSolver:
        """The solver of the first tier."""
        return BatchSolver(self.study, self.settings, block_size(self.block))

    @property
    def stream(self) -> Callable[..., Iterator[Runs]]:
        """`stream` of the study, to be called with indices, `settings` and `block`."""
        how = {"sampling": self.design, "block": self.block, "threads": self.threads}
        return ft.partial(stream, self.study, seed=self.seed, **how)

    def solve(self, runs: Sequence[int], progress: Progress | None = None) -> "Solved":
        """Solves and decides runs; not by two threads at once.

        Args:
            runs: Their indices.
            progress: Called as `progress(done, len(runs))` after each piece of the first solve.
        """
        self.study.require_unchanged()
        planner, workload, begin = self.planner, Workload(), time.perf_counter()
        escalation = Escalation(self.stream, Tiers.of(self.study, self.settings), self.solver.count)
        options = {"settings": self.settings, "workload": workload, "planner": planner, "progress": progress}
        tables = list(through(escalation, self.stream(runs, **options)))
        table = concatenate(tables)
        rows = table.take(table["index"].argsort())
        seconds = time.perf_counter() - begin
        escalated, defects = tuple(escalation.escalated), tuple(escalation.defects)
        return Solved(rows, escalated, defects, workload.steps, workload.paid, seconds)


@dataclasses.dataclass(frozen=True)
class Solved:
    """Rows of consecutive runs, in order, and what they cost.

    Attributes:
        rows: The rows.
        escalated: Runs solved again on tier 1, 2.
        defects: Indices of runs whose peak broke the comparison bound.
        steps: Solver steps of the first solves.
        paid: Steps made by all lanes for them.
        seconds: Time taken [s].
    """

    rows: Runs
    escalated: tuple[int, ...]
    defects: tuple[int, ...]
    steps: int
    paid: int
    seconds: float


def code_hash(source: bytes) -> str:
    """A hash of a Python file that comments and layout do not change; of one that Python can't read, of its bytes."""
    try:
        code = ast.dump(ast.parse(source)).encode()
    except (SyntaxError, ValueError):
        code = source
    return hashlib.sha256(code).hexdigest()


def _told(sampling: AbstractSampling) -> list[str]:
    """A design, and a hash of each array in it."""
    arrays = (np.ascontiguousarray(leaf).tobytes() for leaf in jax.tree.leaves(sampling))
    return [repr(sampling), *(hashlib.sha256(each).hexdigest()[:16] for each in arrays)]


def fingerprint(identity: dict[str, Any]) -> str:
    """A short hash of what changes the rows."""
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]


def settings_in(identity: Mapping[str, Any]) -> SolverSettings:
    """The settings that an identity tells of."""
    settings = SolverSettings(identity["rtol"], identity["atol"])
    return settings.replace(**{name: identity[name] for name, _ in settings.choices if name in identity})


def study_in(identity: Mapping[str, Any], study: Study) -> Study:
    """A study with the values and the standard metrics that an identity tells of."""
    return study.substitute(**identity["values"]).asking(*identity.get("metrics", USUAL))


def require_same(found: dict[str, Any], asked: dict[str, Any], place: str, hint: str = "") -> None:
    """Raises, with the keys that differ, unless two identities are the same.

    Args:
        found: The identity there.
        asked: The one now.
        place: Where there is.
        hint: What may have changed, a sentence with a space before it.
    """
    there, now = _entries(found), _entries(asked)
    differ = [key for key in {**there, **now} if there.get(key) != now.get(key)]
    changes = ", ".join(f"{key} ({_short(there.get(key))} there, {_short(now.get(key))} now)" for key in differ)
    require(
        not differ,
        f"Folder `{place}` belongs to another study: {changes}.{hint} Continue with the study as it was, or begin "
        "beside it with --fresh.",
    )


def _entries(identity: dict[str, Any]) -> dict[str, Any]:
    """The entries of an identity, each under the name that a user should read."""
    own = {f"`{key}`": value for key, value in identity.items() if key != "contents"}
    return {**own, **{f"what the {part} computes": value for part, value in identity.get("contents", {}).items()}}


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:12] + "..."
