"""A design of one's own in physical values: each case's coordinates by the inverse of the draws."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from qsmc_jax.base.checks import nearest, require
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.module import as_float64
from qsmc_jax.base.precision import in_64_bits
from qsmc_jax.study.draw import Draw
from qsmc_jax.study.sampling import Table
from qsmc_jax.study.specs import DrawSpec, check_values
from qsmc_jax.study.study import Study, require_study


def table_of(study: Study, cases: Mapping[str, Any] | Sequence[Mapping[str, Any]] | Any) -> Table:
    """The design whose runs have given values, such as measured ones, or the corners of a box.

    A value that is drawn from a distribution becomes the coordinate that gives it; the draws that depend on it are
    taken at that value. The study calls its scenario once a case, in some milliseconds.

    Args:
        study: The study.
        cases: Values by column, as a dictionary of columns or a data frame; or a list of dictionaries, one a case. All
            columns that the study draws, `x0[0]` and `x0[1]` for an array; none that it fixes, records or has not.

    Returns:
        The design, for `monte_carlo`; run i is case i.

    Raises:
        InputError: A column is missing or unknown, or a value is not finite, is not one that the study draws, or lies
            so far out in a tail that no coordinate gives it to nine digits.

    Examples:
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     plant = qj.plants.InvertedPendulum(mass=draw.lognormal("mass", 0.01, 0.1))
        ...     loop = qj.paper.example1()
        ...     return qj.Scenario(loop, x0=draw.uniform("x0", 0.0, 1.0, shape=(2,)), t1=2.0)
        >>> study = qj.Study(scenario, bandwidth=0.1)
        >>> design = qj.table_of(study, {"mass": [0.01, 0.012], "x0[0]": [0.25, 0.5], "x0[1]": [0.75, 0.5]})
        >>> design.rows[0].round(12).tolist()
        [0.5, 0.25, 0.75]
    """
    require_study(study)
    drawn = [spec for spec in study.specs if spec.is_drawn and spec.name not in study.values]
    columns = _columns(study, cases, [column for spec in drawn for column in spec.columns])
    count = len(next(iter(columns.values()), []))
    require(count > 0, "Argument `cases` must have at least one case, but has none.")
    with in_64_bits():
        rows = [_point(study, drawn, columns, i) for i in range(count)]
    return Table(np.array(rows).reshape(count, study.dimension))


def _columns(study: Study, cases: Any, wanted: list[str]) -> dict[str, np.ndarray]:
    """The columns, each a list of numbers of the same length."""
    if not hasattr(cases, "keys"):
        names = list(dict.fromkeys(name for case in cases for name in case))
        for i, case in enumerate(cases):
            lacking = [f"`{name}`" for name in names if name not in case]
            same = "Argument `cases` must have the same names in every case"
            require(not lacking, f"{same}, but case {i} lacks {', '.join(lacking)}.")
        cases = {name: [case[name] for case in cases] for name in names}
    for name in cases:
        require(name in wanted, _unknown(study, str(name), wanted))
    missing = ", ".join(f"`{name}`" for name in wanted if name not in list(cases))
    require(not missing, f"Argument `cases` must have all columns that the study draws, but lacks {missing}.")
    columns = {name: as_float64(np.asarray(cases[name])) for name in wanted}
    lengths = {name: column.shape for name, column in columns.items()}
    alike = all(column.ndim == 1 for column in columns.values()) and len(set(lengths.values())) == 1
    require(alike or not wanted, f"Argument `cases` must have columns of equal length, but has shapes {lengths}.")
    return columns


def _unknown(study: Study, name: str, wanted: list[str]) -> str:
    """The message for a column that is none of those to be given."""
    known = next((spec for spec in study.specs if name in (spec.name, *spec.columns)), None)
    if known is None:
        return f"Argument `cases` has a column `{name}`, which the study does not draw.{nearest(name, wanted)}"
    if known.name in study.values or not known.is_drawn:
        why = "is fixed" if known.name in study.values else f"is a {known.kind}"
        return f"Argument `cases` must not have `{name}`, which {why} in the study. Use `study.substitute(...)`."
    return f"Argument `cases` must give `{name}` by its columns {', '.join(f'`{c}`' for c in known.columns)}."


def _point(study: Study, drawn: list[DrawSpec], columns: Mapping[str, np.ndarray], i: int) -> np.ndarray:
    """The point of one case."""
    case = {spec.name: np.reshape([columns[c][i] for c in spec.columns], spec.shape) for spec in drawn}
    try:
        draw = Draw(None, study.values, check_values(study.specs, case))
        study.scenario(draw)
    except InputError as error:
        raise InputError(f"In case {i} of `cases`: {error}") from None
    return np.array(draw.solved)
