"""What each column of a table of runs is, for whoever opens it with another tool."""

from collections.abc import Mapping
from typing import Any

from qsmc_jax.metrics.claims import margin_column
from qsmc_jax.metrics.record import Record, without_index
from qsmc_jax.metrics.standard import catalogue, record_of

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


def texts_of(field: Any) -> dict[str, str]:
    """What is written with a column: `description`, and `unit` where it has one."""
    return {key.decode(): text.decode() for key, text in (field.metadata or {}).items()}


def own_records(schema: Any) -> dict[str, Record]:
    """The records of the columns that the study alone has, as far as they are written; see `described`.

    Args:
        schema: The schema of a block that was read.
    """
    records, is_margin = {}, margin_column("")
    for field in schema:
        if without_index(field.name) not in catalogue():
            texts, worse = texts_of(field), "low" if field.name.startswith(is_margin) else None
            meaning = texts.get("description", "").removesuffix(".")
            records[field.name] = Record(field.name, meaning, texts.get("unit", ""), worse=worse)
    return records
