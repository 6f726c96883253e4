"""What each column of a table of runs is, for whoever opens it with another tool."""

from collections.abc import Mapping
from typing import Any

from qsmc_jax.metrics.record import Record
from qsmc_jax.metrics.standard import record_of

_OWN = {"index": "Index of the run", "tier": "The solve whose metrics these are: 0 first, 1 firmer, 2 independent"}


def described(schema: Any, records: Mapping[str, Record]) -> Any:
    """The schema of pyarrow with a description of each column, and its unit where it has one of its own.

    Args:
        schema: The schema.
        records: What is known of the columns that the study alone has.
    """
    import pyarrow as pa

    known = {**{name: Record(name, meaning) for name, meaning in _OWN.items()}, **records}
    fields = []
    for field in schema:
        record = known.get(field.name) or record_of(field.name)
        about = {
            "description": f"{record.meaning}." if record.meaning else "",
            **({"unit": record.unit} if record.unit else {}),
        }
        fields.append(field.with_metadata(about))
    return pa.schema(fields)
