"""Falsification: a search for the scenario that is worst for a claim or a metric."""

from typing import Any

import numpy as np

from qsmc_jax.base.checks import require, require_count
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.precision import in_64_bits
from qsmc_jax.falsification.adversary import against
from qsmc_jax.falsification.confirmation import Confirmed, confirm
from qsmc_jax.falsification.cube import cube_of
from qsmc_jax.falsification.evaluation import Evaluator
from qsmc_jax.falsification.objective import Objective
from qsmc_jax.falsification.result import Falsification
from qsmc_jax.falsification.search import search
from qsmc_jax.metrics.record import without_index
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.study.draw import Draw
from qsmc_jax.study.monte_carlo import Progress
from qsmc_jax.study.sampling import require_seed
from qsmc_jax.study.specs import RECORDED
from qsmc_jax.study.study import Study, require_study
from qsmc_jax.tuning.gradient_check import refuse_jumps
from qsmc_jax.verification.tiers import Tiers

_MOST_SWITCHES = 64


def falsify(
    study: Study,
    objective: str = "funnel",
    *,
    budget: int = 1000,
    seed: int = 0,
    adversary: int | None = None,
    tail: float = 1e-3,
    settings: SolverSettings | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Falsification:
    r"""Searches the uncertainty of a study for the scenario that is worst for a claim or a metric.

    Where Monte Carlo says how probable a bad run is, this says how bad a run is found that the study allows. It starts
    from the worst of some random runs, goes by gradients through the simulation to the faces of the unit cube, then
    moves coordinates one by one, to faces, to other values of a choice, and by ever smaller lengths. Several such
    searches are simulated together, by one program. It proves nothing of scenarios that it did not simulate.

    What is reported was decided as in `verify`, by firmer solves and another method where there is doubt, and was then
    confirmed by another method; the value is the less bad of the two.

    Args:
        study: The study.
        objective: A claim ("funnel", "reaching", "tracking" or a requirement), whose margin is made small until it is
            violated (of the claims of Theorem 1 the margin is the funnel's); or a metric of which a direction is worse,
            such as "peak_u".
        budget: Simulations at most, at least 1. A gradient counts as one, and one for each number it is taken by. What
            confirms the finding is not counted: up to 16 runs, on up to three firmer tiers.
        seed: Seed of the random runs.
        adversary: Puts the worst disturbance in the place of the study's: one that switches so many times at most, 0
            for a constant, between levels within the bound that the study's own disturbance has at its largest. None
            for the study's own.
        tail: Probability that is cut off at each end where a distribution has none, in (0, 1/2).
        settings: Method and tolerances of the search; None for the defaults.
        threads: Batches solved at the same time; None for one a core of a CPU.
        progress: Called as `progress(simulations, budget)`.

    Returns:
        The worst scenario; `print` it, `replay()` it.

    Raises:
        InputError: The objective is neither a claim nor such a metric, or an argument is out of range, or there is no
            disturbance that an adversary could replace.

    Examples:
        The worst constant disturbance is the one that pushes outwards, at its bound:

        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=2.0)
        >>> found = qj.falsify(qj.Study(scenario, bandwidth=0.1), "peak_u", budget=100, adversary=0)
        >>> print(found)
        NO VIOLATION FOUND ...
        >>> round(float(found.values["adversary.level"]), 6), bool(found.value > found.random_value)
        (-1.0, True)
    """
    require_study(study)
    require_count("budget", budget)
    require_seed(seed)
    if adversary is not None:
        require_count("adversary", adversary, 0)
        require(
            adversary <= _MOST_SWITCHES, f"Argument `adversary` must be at most {_MOST_SWITCHES}, but is {adversary}."
        )
    require(0.0 < tail < 0.5, f"Argument `tail` must lie strictly between 0 and 1/2, but is {tail!r}.")
    wanted, settings = Objective.of(study, objective), settings or SolverSettings()
    attacked = _asking(against(study, adversary), wanted)
    plain = None if adversary is None else study
    cube, refusal = cube_of(attacked, plain, tail), _why_no_gradient(attacked, wanted)
    evaluator = Evaluator(attacked, wanted, settings, budget, threads)
    tiers = Tiers.of(attacked, settings)
    with tiers.compiling_check(attacked, None):
        random = search(evaluator, cube, seed, budget, not refusal, progress)
    assert evaluator.worst is not None
    found = confirm(attacked, wanted, evaluator.worst, evaluator.points, tiers)
    sign = -1.0 if wanted.is_low_worse else 1.0
    return Falsification(
        study=study,
        objective=objective,
        column=wanted.column,
        is_low_worse=wanted.is_low_worse,
        claims=wanted.claims,
        budget=budget,
        seed=seed,
        adversary=adversary,
        settings=settings,
        verdict=_verdict(found, evaluator),
        value=found.value if found else np.nan,
        change=found.change if found else np.nan,
        values=_values(attacked, found),
        point=found.point if found else np.full(attacked.dimension, 0.5),
        simulations=evaluator.simulations,
        random_value=sign * random if np.isfinite(random) else np.nan,
        first_violation_at=evaluator.first_violation_at,
        undecided=evaluator.undecided,
        unconfirmed=found.unconfirmed if found else len(evaluator.worst),
        progress=tuple((at, sign * score if np.isfinite(score) else np.nan) for at, score in evaluator.progress),
        replaced=cube.replaced,
        cut=cube.cut,
        outside=cube.outside,
        without_gradient=refusal,
    )


def _asking(study: Study, objective: Objective) -> Study:
    """The study with no more standard metrics than a search needs, so that its programs are small."""
    own = [] if objective.column in study.measured else [without_index(objective.column)]
    return study.asking("claims", "peak_u_bound", *own)


def _why_no_gradient(study: Study, objective: Objective) -> str:
    """Why the gradient can't be used; empty if it can."""
    if not objective.has_gradient:
        return f"`{objective.column}` has no derivative."
    try:
        refuse_jumps(study)
    except InputError as error:
        return str(error)
    return ""


def _verdict(found: Confirmed | None, evaluator: Any) -> Verdict:
    """The verdict on the worst run; UNDECIDED where something in doubt may be worse."""
    if found is not None and found.verdict == Verdict.VIOLATED:
        return Verdict.VIOLATED
    if found is None or evaluator.first_violation_at is not None or evaluator.undecided:
        return Verdict.UNDECIDED
    return found.verdict


def _values(study: Study, found: Confirmed | None) -> dict[str, np.ndarray]:
    """What a point draws, by name; nothing for none."""
    if found is None:
        return {}
    draw = Draw(found.point, study.values)
    with in_64_bits():
        study.scenario(draw)
    told = [spec.name for spec in study.specs if spec.kind != RECORDED or spec.name.startswith("adversary.")]
    return {name: np.asarray(draw.recorded[name], np.float64) for name in told}
