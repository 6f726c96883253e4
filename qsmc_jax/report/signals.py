"""One run as plain numbers and as a table of its signals."""

from typing import Any

import numpy as np

from qsmc_jax.simulation.outcome import Verdict
from qsmc_jax.simulation.trajectory import Trajectory


def figures_as_numbers(run: Trajectory) -> dict[str, Any]:
    """The figures of a run, with verdicts and outcome by name."""
    plain = {
        name: [float(v) for v in value] if isinstance(value, tuple) else value.item()
        for name, value in run.figures.named().items()
    }
    verdicts = {name: Verdict(int(plain[name])).name for name in plain if name.startswith("verdict")}
    return {
        **plain,
        **verdicts,
        "outcome": run.outcome.name,
        "advice": run.outcome.advice,
        "reaching_time": run.reaching_time,
    }


def signals_table(run: Trajectory) -> dict[str, Any]:
    """The signals, one row a time."""
    vectors = {"x": run.x, "e": run.e, "desired": run.desired}
    columns = {"t": run.ts, "sigma": run.sigma, "rho": run.rho, "u": run.u, "d": run.d}
    for name, values in vectors.items():
        columns.update({f"{name}[{i}]": np.ascontiguousarray(values[:, i]) for i in range(values.shape[1])})
    return columns
