"""Tuning: gains by gradients through the simulation, and a certificate from runs that had no say in them."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import qmc

from qsmc_jax.base.checks import require, require_count, require_fraction, require_list
from qsmc_jax.base.errors import InputError
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.study.monte_carlo import Progress
from qsmc_jax.study.study import Study
from qsmc_jax.tuning.batch import KEPT, Batch, Evaluation
from qsmc_jax.tuning.bounds import bounds_of
from qsmc_jax.tuning.certificate import Certificate, certify, confidence_of
from qsmc_jax.tuning.descent import METHODS, Method, Slope, descend
from qsmc_jax.tuning.gradient_check import check_start, refuse_jumps
from qsmc_jax.tuning.objectives import Constraint, Objective, parse_constraint, parse_objective
from qsmc_jax.tuning.result import Tuning

# Widths of the smooth maximum, in standard deviations, for one descent after the other from where the last one ended.
# The maximum as it is comes first: it was as good on fourteen of fifteen sets of training runs, for a third less, and
# got out of the infeasible start of the other, where the smooth one stuck.
_EXACT, _ANNEALED = (0.0,), (0.2, 0.0)
# A design that is not certified is followed by one whose bounds are this part of its own.
_TIGHTER = 0.9
# Additional points to try where every start loses runs: leaving later is not always on the way to not leaving.
_WIDER = 16


def tune(
    study: Study,
    parameters: Sequence[str],
    objective: str | Objective,
    subject_to: Sequence[str | Constraint] = (),
    *,
    runs: int = 256,
    seed: int = 0,
    method: Method = "slsqp",
    steps: int = 50,
    tolerance: float = 1e-5,
    starts: int = 4,
    descents: int = 1,
    certificate_runs: int = 10_000,
    risk: float = 1e-2,
    confidence: float = 0.95,
    designs: int = 3,
    settings: SolverSettings | None = None,
    block: int | None = None,
    threads: int | None = None,
    tell: Callable[[Evaluation], None] | None = None,
    progress: Progress | None = None,
) -> Tuning:
    """Chooses parameters of a study by gradients through the simulation, and certifies the choice on fresh runs.

    Each evaluation solves the same training runs (common random numbers). Starts are tried together, the best are
    descended from, and the best feasible point met on the way of each descent becomes a candidate. Fresh runs, of a
    seed that training never saw, certify the candidates; if all fail, everything is done again with new training runs
    and constraints a tenth tighter, and with less of the risk that all designs share.

    Gains are feasible only if every admissible run has the metrics that the objective needs: a run that left an ideal
    loop's funnel, or could not be decided, has none. Such runs lead the search by how soon they left, not by nothing.

    Tune a loop as it is implemented: on the ideal one a narrower funnel costs nothing, and rho_inf runs to its bound.
    Metrics of the steady phase start at t_r, which moves with the gains: bound `reach_time` if you use them.

    Args:
        study: The study.
        parameters: Names drawn by `draw.parameter`, each one number with finite bounds.
        objective: What to make small, such as `"cvar(peak_error[0], 0.9) + 0.01 * mean(energy_u)"`.
        subject_to: What to keep, such as `["worst(peak_u) <= 20", "violation <= 0.01"]`.
        runs: Training runs of each evaluation, at least 2.
        seed: Seed of the training runs; design j uses seed + 2 j to train and seed + 2 j + 1 to certify.
        method: "slsqp" (constraints as they are); "adam" or any optax transformation, "bfgs" or any optimistix
            minimiser (constraints as penalties).
        steps: Steps of a descent at most.
        tolerance: Relative change of the objective below which a descent stops.
        starts: Starting points: the study's own, and others spread over the bounds.
        descents: From how many of them to descend; each gives a candidate. If none is feasible, the others follow.
        certificate_runs: Fresh runs of each candidate; 0 for no certificate.
        risk: Probability of failure that each certified statement may have, strictly between 0 and 1.
        confidence: That every statement of all certificates holds, strictly between 0 and 1.
        designs: Designs at most.
        settings: Method, tolerances and, by `adjoint`, the mode of differentiation; None for forward mode;
            reverse mode suits many parameters and runs of at most 4096 steps.
        block: Runs solved together at most, a multiple of 64; None for what suits the platform.
        threads: Blocks solved at the same time; None for one a core of a CPU.
        tell: Called with each evaluation.
        progress: Called as `progress(done, all)` while certifying.

    Returns:
        The gains, the history and the certificate; `print` it.

    Raises:
        InputError: An argument is out of range, the gradient can't be trusted, the objective is not known at the
            start, or no point that keeps the constraints was found (the message says which fails, and by how much).

    Examples:
        >>> import dataclasses
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     rho0, mu = draw.parameter("rho0", 4.0, bounds=(3.0, 8.0)), draw.parameter("mu", 3.0, bounds=(2.0, 4.0))
        ...     control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0, mu, rho_inf=0.05))
        ...     loop = dataclasses.replace(qj.paper.example1(), control=control)
        ...     return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=2.0)
        >>> study = qj.Study(scenario, bandwidth=0.1)
        >>> tuned = qj.tune(study, ["mu"], "mean(energy_u)", runs=2, starts=1, steps=3, certificate_runs=0, block=64)
        >>> round(tuned.gains["mu"], 6), tuned.best.objective < tuned.before.objective
        (2.0, True)
    """
    require_count("runs", runs, 2)
    require_list("parameters", parameters)
    require_list("subject_to", subject_to)
    search, claim = (
        Search(method, steps, tolerance, starts, descents),
        Claim(certificate_runs, risk, confidence, designs),
    )
    names, objective = tuple(parameters), parse_objective(objective)
    constraints, bounds = tuple(map(parse_constraint, subject_to)), bounds_of(study, names)
    refuse_jumps(study)
    settings = settings or SolverSettings(adjoint="forward")
    batch = Batch(study, bounds, objective, constraints, runs, seed, settings, block, threads, 0, tell)
    before = check_start(batch, bounds.point(study))
    batch.allowed = before.inadmissible
    best, chosen, certificates = _designed(batch, search, claim, progress)
    sensitivity = _sensitivity(batch, best)
    found = (before, best, tuple(batch.history), certificates, chosen, sensitivity)
    return Tuning(study, names, objective, constraints, runs, seed, confidence, *found)


@dataclasses.dataclass(frozen=True)
class Search:
    """How to search; see `tune`."""

    method: Method
    steps: int
    tolerance: float
    starts: int
    descents: int

    def __post_init__(self):
        for name in ("steps", "starts", "descents"):
            require_count(name, getattr(self, name))
        fits = 1 <= self.descents <= self.starts
        require(fits, f"Argument `descents` must lie in [1, {self.starts}], the `starts`, but is {self.descents}.")
        is_known = not isinstance(self.method, str) or self.method in METHODS
        require(is_known, f"Argument `method` must be one of {', '.join(METHODS)}, but is `{self.method}`.")


@dataclasses.dataclass(frozen=True)
class Claim:
    """What to certify; see `tune`."""

    runs: int
    risk: float
    confidence: float
    designs: int

    def __post_init__(self):
        for name in ("risk", "confidence"):
            require_fraction(name, getattr(self, name))
        require_count("designs", self.designs)
        require_count("certificate_runs", self.runs, 0)


def _has_maximum(batch: Batch) -> bool:
    """Whether anything is there to be smoothed."""
    parts = [batch.objective, *(constraint.objective for constraint in batch.constraints)]
    return any(term.statistic in ("worst", "least") for part in parts for term in part.terms)


class _Infeasible(InputError):
    """No gains were found that keep the constraints."""


def _designed(
    batch: Batch, search: Search, claim: Claim, progress: Progress | None
) -> tuple[Evaluation, Certificate | None, tuple[Certificate, ...]]:
    """One design after the other until one is certified: the choice, its certificate, and all certificates."""
    seed, certificates = batch.seed, []
    best, chosen = None, None
    for attempt in range(claim.designs):
        batch.attempt, batch.seed = attempt, seed + 2 * attempt
        batch.inside = 1.0 - _TIGHTER**attempt
        try:
            candidates = _candidates(batch, search)
        except _Infeasible:
            if best is None:
                raise
            break  # a later design is tighter than what was asked for: the refused one before it is all there is
        if not claim.runs:
            return candidates[0], None, ()
        made = certify(
            batch.study,
            [(each.gains, each.objective) for each in candidates],
            batch.objective,
            batch.constraints,
            runs=claim.runs,
            seed=seed + 2 * attempt + 1,
            risk=claim.risk,
            confidence=confidence_of(attempt, claim.confidence),
            settings=batch.settings,
            block=batch.block,
            threads=batch.threads,
            progress=progress,
        )
        certificates += made
        number = next((number for number, each in enumerate(made) if each.is_granted), 0)
        best, chosen = candidates[number], made[number]
        if chosen.is_granted:
            break
    assert best is not None
    return best, chosen, tuple(certificates)


def _candidates(batch: Batch, search: Search) -> list[Evaluation]:
    """The best feasible point of each descent, the best first."""
    points = _starts(batch, search.starts)
    tried = [batch.evaluate(v) for v in points]
    if all(each.lost > 0.0 for each in tried):
        wider = _starts(batch, search.starts + _WIDER)[search.starts :]
        points, tried = points + wider, tried + [batch.evaluate(v) for v in wider]
    order = sorted(range(len(points)), key=lambda i: tried[i].merit)[: search.starts]
    first, others = order[: search.descents], order[search.descents :]
    found = [_descended(batch, search, points[i], tried[i], i, _EXACT) for i in first]
    widths = _ANNEALED if _has_maximum(batch) else _EXACT
    for i in others:
        if any(each.is_feasible for each in found):
            break
        found.append(_descended(batch, search, points[i], tried[i], i, widths))
    found.sort(key=lambda each: each.merit)
    feasible = [each for each in found if each.is_feasible]
    if not feasible:
        raise _Infeasible(_infeasible(batch, found[0]))
    return feasible


def _descended(
    batch: Batch, search: Search, v: np.ndarray, first: Evaluation, number: int, widths: Sequence[float]
) -> Evaluation:
    """The best point of one descent, its start included."""
    scale = abs(first.objective) if np.isfinite(first.objective) else 0.0
    since, best = len(batch.history), first
    for width in widths:
        descend(Slope(batch, width, number, scale), v, search.method, search.steps, search.tolerance)
        best = min((first, *batch.history[since:]), key=lambda each: each.merit)
        v = batch.bounds.place(best.gains)
    return best


def _starts(batch: Batch, count: int) -> list[np.ndarray]:
    """The study's own point, and Sobol points of the unit cube's inner part."""
    spread = qmc.Sobol(len(batch.bounds.names), rng=np.random.default_rng(batch.seed)).random_base2(
        max(count - 2, 0).bit_length()
    )
    return [batch.bounds.point(batch.study), *(0.05 + 0.9 * spread)][:count]


def _infeasible(batch: Batch, nearest: Evaluation) -> str:
    """Which constraints fail at the point that lacks least, and by how much."""
    gains = ", ".join(f"{name} = {value:.4g}" for name, value in nearest.gains.items())
    lacks = [
        f"`{constraint}` by {100 * lack:.3g} % of its bound" if np.isfinite(lack) else f"`{constraint}`"
        for constraint, lack in zip(batch.constraints, nearest.violations, strict=True)
        if not lack <= KEPT
    ]
    if nearest.inadmissible > nearest.allowed:
        lacks.append(
            f"to admit all but {100 * nearest.allowed:.3g} % of the runs ({100 * nearest.inadmissible:.3g} % are not)"
        )
    reason = f"fails {' and '.join(lacks)}" if lacks else "keeps the constraints"
    if not np.isfinite(nearest.objective):
        reason += f", and its objective is not known in {100 * nearest.unknown:.3g} % of the runs"
    if nearest.lost > 0.0:
        reason += f": {100 * nearest.lost:.3g} % left the funnel or could not be decided"
    return (
        f"No gains within the bounds were found that keep the constraints: the nearest, {gains}, {reason}. Loosen it, "
        "widen the bounds, or allow more `starts`."
    )


def _sensitivity(batch: Batch, best: Evaluation) -> np.ndarray:
    """Relative derivatives of objective and constrained metrics at the best gains, by relative change of each gain."""
    constraints, there = batch.constraints, dataclasses.replace(batch, tell=None, history=[])
    v = batch.bounds.place(best.gains)
    made, values, slopes = there.differentiate(v, 0.0, best.start)
    bounds = np.array([constraint.bound for constraint in constraints])
    sides = np.array([constraint.side for constraint in constraints])
    scales = np.abs(np.where(bounds == 0.0, 1.0, bounds)) if len(bounds) else np.empty(0)
    values, slopes = values[:-1], slopes[:-1]
    metrics = np.array([values[0], *(bounds + sides * scales * values[1:])])
    by_gain = slopes / batch.bounds.slopes(v) * np.array([1.0, *(sides * scales)])[:, None]
    x = np.array([made.gains[name] for name in batch.bounds.names])
    return by_gain * x / np.where(metrics == 0.0, 1.0, metrics)[:, None]
