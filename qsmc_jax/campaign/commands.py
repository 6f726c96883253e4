"""Command lines that get something again, with every option that decides it."""

from collections.abc import Mapping, Sequence
from typing import Any

from qsmc_jax.metrics.standard import USUAL
from qsmc_jax.simulation.settings import SolverSettings


def solver_options(settings: SolverSettings) -> list[str]:
    """The options of `qsmc` for settings that are not the defaults, to the last digit.

    Examples:
        >>> import qsmc_jax as qj
        >>> from qsmc_jax.campaign.commands import solver_options
        >>> solver_options(qj.SolverSettings(rtol=1e-8, method="other"))
        ['--rtol', '1e-08', '--method', 'other']
    """
    given = {"--rtol": settings.rtol, "--atol": settings.atol, "--max-steps": settings.max_steps}
    given["--method"] = settings.method
    usual = SolverSettings()
    # The absolute tolerance follows from the relative one unless it is given.
    defaults = usual.rtol, SolverSettings(settings.rtol).atol, usual.max_steps, usual.method
    options = []
    for (option, value), default in zip(given.items(), defaults, strict=True):
        if value != default:
            options += [option, str(value if isinstance(value, str | int) else float(value))]
    return options


def verify_command(
    study_file: str,
    runs: int,
    seed: int,
    confidence: float,
    values: Mapping[str, Any],
    settings: SolverSettings,
    metrics: Sequence[str] = USUAL,
) -> list[str]:
    """The words of `qsmc verify` for so many runs of a study.

    Args:
        study_file: The study's file.
        runs: How many.
        seed: Their seed.
        confidence: Confidence of each interval.
        values: Values of the study's names that are fixed, numbers or lists of them.
        settings: Settings of the first solve.
        metrics: The words by which the study asks for standard metrics.

    Examples:
        >>> import qsmc_jax as qj
        >>> from qsmc_jax.campaign.commands import verify_command
        >>> settings = qj.SolverSettings(rtol=1e-7)
        >>> " ".join(verify_command("a.py", 100, 1, 0.99, {"mu": 2.0, "x0": [0.5, 0.1]}, settings))
        'qsmc verify a.py --runs 100 --seed 1 --confidence 0.99 -S mu=2.0 -S x0=0.5,0.1 --rtol 1e-07'
    """
    words = ["qsmc", "verify", study_file, "--runs", str(runs), "--seed", str(seed), "--confidence", str(confidence)]
    asked = [] if tuple(metrics) == USUAL else ["--metrics", ",".join(metrics)]
    return words + fixed_options(values) + asked + solver_options(settings)


def fixed_options(values: Mapping[str, Any]) -> list[str]:
    """The words that fix names of a study.

    Args:
        values: Values by name, numbers or lists of them.
    """
    listed = {name: value if isinstance(value, list) else [value] for name, value in values.items()}
    return [word for name, value in listed.items() for word in ("-S", f"{name}={','.join(map(str, value))}")]
