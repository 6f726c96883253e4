"""How far a name of a study may go: the last value at which the violation probability is shown to be small."""

import dataclasses
from collections import Counter
from collections.abc import Callable
from typing import Any, TypeAlias, get_args

import numpy as np

from qsmc_jax.base.checks import require, require_count, require_fraction
from qsmc_jax.display.scales import spans_decade
from qsmc_jax.metrics.claims import require_claim
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.robustness.critical_result import CriticalTest, CriticalValue, Side
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.statistics.intervals import runs_needed
from qsmc_jax.statistics.simultaneous import each_of
from qsmc_jax.study.monte_carlo import Progress
from qsmc_jax.study.specs import check_values
from qsmc_jax.study.study import Study, require_study
from qsmc_jax.verification.resolve import decide, part_of

# A test looks at its runs when it has 1, 2 and 4 times as many as show the claim if none of them is violated.
_LOOKS = (1, 2, 4)

# The runs of given indices at one value, counted by their verdict.
CountRuns: TypeAlias = Callable[[float, range], Counter[Verdict]]


@dataclasses.dataclass(frozen=True)
class Plan:
    """The tests of a search.

    Attributes:
        below: The probability to be compared with.
        tests: How many there may be.
        each: Confidence of the interval at each look of each.
        looks: Numbers of runs at which a test looks; the last is all it may have.
    """

    below: float
    tests: int
    each: float
    looks: tuple[int, ...]


def critical_value(
    study: Study,
    name: str,
    below: float,
    *,
    between: tuple[float, float] | None = None,
    side: Side | None = None,
    claim: str = "funnel",
    confidence: float = 0.95,
    seed: int = 0,
    steps: int = 12,
    budget_per_test: int | None = None,
    settings: SolverSettings | None = None,
    block: int | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> CriticalValue:
    r"""Searches the last value of a name at which the probability of violating a claim is shown to be below `below`.

    Bisection, the two ends first, in the logarithm if both are positive and more than a decade apart. Each test has
    fresh runs, since which value is tested depends on the runs before. It looks at them up to three times: with N runs,
    the fewest that can show the claim, 2 N and 4 N. A value is "below" when its Clopper-Pearson interval ends below
    `below`, "above" when it starts above it, else "open", which counts as not shown. Each interval is missed with
    probability at most $\alpha / (3\, (\mathrm{steps} + 2))$, so all findings are right together with the given
    confidence.

    Cost: at most (steps + 2) * 4 N runs, N about $\ln(6\, (\mathrm{steps} + 2) / \alpha) / \mathrm{below}$ (7 400 for
    1e-3 at 95 %), most tests N of them. Doubtful runs are solved again on up to two firmer tiers, as in `verify`.

    Args:
        study: The study.
        name: A name of it whose value is one number.
        below: The violation probability, strictly between 0 and 1.
        between: The two ends, in increasing order; None for the bounds of the name in the study.
        side: "largest" if small values are safe, "smallest" if large ones are (a saturation, say); None to find out
            from the two ends.
        claim: The claim whose violation is counted: "funnel", "reaching", "tracking" or a requirement of the study.
        confidence: That all findings are right, strictly between 0 and 1.
        seed: Seed of the runs.
        steps: Values to be tested after the two ends, at least 0.
        budget_per_test: Most runs of a test, at least N; None for 4 N.
        settings: Method and tolerances of the first solve; None for the defaults.
        block: Runs solved together, a multiple of 64; None for what suits the platform, on CPUs 512.
        threads: Blocks solved at the same time; None for one a core of a CPU.
        progress: Called as `progress(done, most)` after each block, `most` if every test takes all its runs.

    Returns:
        The last value shown below and the first not shown, with every test; `print` it.

    Raises:
        InputError: An argument is out of range, or the study refuses a value.

    Examples:
        >>> import equinox as eqx
        >>> import jax.numpy as jnp
        >>> import qsmc_jax as qj
        >>> def scenario(draw):  # the gain has the wrong sign with probability p
        ...     p = draw.parameter("p", 0.0, bounds=(0.0, 1.0))
        ...     sign = jnp.where(draw.uniform("coin", 0.0, 1.0) < p, -1.0, 1.0)
        ...     loop = eqx.tree_at(lambda loop: loop.control.gain_sign, qj.paper.example1(), sign)
        ...     return qj.Scenario(loop, x0=[0.9, 0.9], t1=2.0)
        >>> study = qj.Study(scenario, bandwidth=0.1)
        >>> found = qj.critical_value(study, "p", below=0.4, steps=2, block=64)
        >>> found.side, found.shown, found.not_shown
        ('largest', 0.25, 0.5)
    """
    require_study(study)
    require_claim("claim", claim, study.claims)
    require(side is None or side in get_args(Side), f"Argument `side` must be one of {[*get_args(Side)]}.")
    require_count("steps", steps, 0)
    ends = _ends(study, name, between)
    plan = plan_tests(below, confidence, steps, budget_per_test)
    settings = settings or SolverSettings()

    def count(value: float, indices: range) -> Counter[Verdict]:
        told = part_of(progress, indices.start, plan.tests * plan.looks[-1])
        there = study.substitute(**{name: value})
        tables = decide(there, indices, seed, settings=settings, block=block, threads=threads, progress=told)
        return sum((Counter(table.counts(claim)) for table in tables), Counter())

    side, tests = search(count, ends, plan, side)
    return CriticalValue(study, name, below, confidence, seed, ends, side, plan.each, plan.looks, tests, claim)


def plan_tests(below: float, confidence: float, steps: int, budget: int | None) -> Plan:
    """The tests that share the risk of a search of so many steps.

    Raises:
        InputError: A probability is not strictly between 0 and 1, or the budget is too small to show anything.
    """
    require_fraction("confidence", confidence)
    require_fraction("below", below)
    tests = steps + 2
    each = each_of(tests * len(_LOOKS), confidence)
    fewest = runs_needed(below, each)
    budget = _LOOKS[-1] * fewest if budget is None else budget
    require(
        budget >= fewest,
        f"Argument `budget_per_test` must be at least {fewest}, the fewest runs that can show a probability below "
        f"{below:g}, but is {budget}.",
    )
    return Plan(below, tests, each, tuple(look * fewest for look in _LOOKS if look * fewest <= budget))


def search(
    count: CountRuns, ends: tuple[float, float], plan: Plan, side: Side | None
) -> tuple[Side | None, tuple[CriticalTest, ...]]:
    """Tests the two ends, and then bisects if exactly the safe one of them is shown below.

    Args:
        count: Solves and counts runs.
        ends: Lowest and highest value.
        plan: The tests.
        side: As for `critical_value`.

    Returns:
        The side, None if the ends don't tell; and all tests in the order in which they were made.
    """
    tests = [_test(count, value, number, plan) for number, value in enumerate(ends)]
    low_is_safe, high_is_safe = (test.finding == "below" for test in tests)
    if side is None and low_is_safe != high_is_safe:
        side = "largest" if low_is_safe else "smallest"
    is_bracketed = low_is_safe and not high_is_safe if side == "largest" else high_is_safe and not low_is_safe
    if side is None or not is_bracketed:
        return side, tuple(tests)
    shown, other = ends if side == "largest" else ends[::-1]
    is_geometric = spans_decade(*ends)
    for number in range(2, plan.tests):
        middle = float(np.sqrt(shown) * np.sqrt(other)) if is_geometric else 0.5 * (shown + other)
        if not min(shown, other) < middle < max(shown, other):
            break
        tests.append(_test(count, middle, number, plan))
        shown, other = (middle, other) if tests[-1].finding == "below" else (shown, middle)
    return side, tuple(tests)


def _test(count: CountRuns, value: float, number: int, plan: Plan) -> CriticalTest:
    """One value against the probability, with runs of its own, until a look decides it or they are used up."""
    first, made = number * plan.looks[-1], 0
    counts: Counter[Verdict] = Counter()
    test = None
    for runs in plan.looks:
        counts += count(value, range(first + made, first + runs))
        made = runs
        test = CriticalTest.of(counts, plan.each, value=value, runs=made, below=plan.below)
        if test.finding != "open":
            break
    assert test is not None
    return test


def _ends(study: Study, name: str, between: Any) -> tuple[float, float]:
    """The two ends, checked."""
    spec = next((spec for spec in study.specs if spec.name == name), None)
    low, high = spec.bounds if spec is not None and between is None else between or (0.0, 0.0)
    check_values(study.specs, {name: low if np.isfinite(low) else 0.0})
    low, high = float(low), float(high)
    require(
        bool(np.isfinite(low) and np.isfinite(high)),
        f"Argument `between` must be given for `{name}`, whose bounds in the study are [{low:g}, {high:g}]: two finite "
        "numbers.",
    )
    require(low < high, f"Argument `between` must be two numbers in increasing order, but is ({low:g}, {high:g}).")
    is_listed = spec is not None and bool(spec.levels)
    require(
        not is_listed, f"Argument `name` must have values to bisect, but `{name}` has only a few: map them instead."
    )
    check_values(study.specs, {name: high})
    return low, high
