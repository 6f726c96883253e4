"""What each column of a table of runs is, for whoever opens it with another tool."""

import functools as ft
import inspect
import re
from typing import Any

from qsmc_jax.simulation.figures import Figures, SampledFigures
from qsmc_jax.study.draw import DrawSpec

_UNIT = re.compile(r"\[([^\]]+)\](?=[.;,: ]|$)")


def described(schema: Any, specs: tuple[DrawSpec, ...]) -> Any:
    """The schema of pyarrow with a description of each column, and its unit where it has one of its own."""
    import pyarrow as pa

    drawn = {column: f"Drawn by the study: {spec.kind}." for spec in specs for column in spec.columns}
    own = {"index": "Index of the run.", "rung": "The solve whose figures these are: 0 first, 1 firmer, 2 independent."}
    texts = {**own, **_figures(), **drawn}
    fields = []
    for field in schema:
        text = texts.get(field.name, texts.get(re.sub(r"\[\d+\]$", "", field.name), ""))
        unit = _UNIT.search(text)
        about = {"description": text, **({"unit": unit[1]} if unit else {})}
        fields.append(field.with_metadata(about))
    return pa.schema(fields)


@ft.lru_cache
def _figures() -> dict[str, str]:
    """Description of each figure: what the docstrings of `Figures` say of it."""
    texts: dict[str, str] = {}
    for kind in (Figures, SampledFigures):
        lines = inspect.cleandoc(kind.__doc__ or "").partition("Attributes:\n")[2]
        for entry in re.split(r"\n(?=    \w)", "\n" + lines):
            name, separator, text = entry.strip().partition(": ")
            if separator:
                texts[name] = " ".join(text.split())
    texts["peak_error"] = texts.pop("peak_errors", "")  # `python -OO` leaves no docstrings
    return texts
