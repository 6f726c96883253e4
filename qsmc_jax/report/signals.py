"""One run as plain numbers."""

from typing import Any

from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.simulation.trajectory import Trajectory


def metrics_as_numbers(run: Trajectory) -> dict[str, Any]:
    """The metrics of a run, with verdicts and outcome by name."""
    plain = {
        name: [float(v) for v in value] if isinstance(value, tuple) else value.item()
        for name, value in run.metrics.named().items()
    }
    verdicts = {name: Verdict(int(plain[name])).name for name in plain if name.startswith("verdict")}
    return {
        **plain,
        **verdicts,
        "outcome": run.outcome.name,
        "advice": run.outcome.advice,
        "reaching_time": run.reaching_time,
    }
