"""Block files: rows of consecutive runs as Parquet, never changed, named for their range and the hash of their bytes.

`blocks/000000000000-000000016384-0123456789abcdef.parquet` has the rows 0 ... 16383. Whoever solves the same runs
writes the same bytes to the same name, so that a block delivered twice does no harm, and a byte that changed is
noticed.
"""

import dataclasses
import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qsmc_jax.base.atomic import write_whole
from qsmc_jax.campaign.columns import described
from qsmc_jax.metrics.record import Record
from qsmc_jax.study.runs import Runs

_NAME = re.compile(r"(\d{12})-(\d{12})-([0-9a-f]{16})\.parquet")
_KEY = b"qsmc_jax"


@dataclasses.dataclass(frozen=True, order=True)
class BlockFile:
    """A block file, by its name.

    Attributes:
        start: Its first run.
        stop: The run after its last.
        path: Where it is.
    """

    start: int
    stop: int
    path: Path

    def read(self, fingerprint: str) -> "Block":
        """Its rows, in order, and the metadata written with them.

        Args:
            fingerprint: That of the campaign.

        Raises:
            BlockError: Its bytes are not those that were written, or it is of another campaign, or of other runs.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        content = self.path.read_bytes()
        named = _NAME.fullmatch(self.path.name)
        if named is None or named[3] != _hash(content):
            raise BlockError("is damaged")
        try:
            table = pq.read_table(pa.BufferReader(content))
            about = json.loads((table.schema.metadata or {})[_KEY])
            columns = {name: table[name].to_numpy() for name in table.column_names}
            names, index, owner = tuple(about["names"]), columns["index"], about["fingerprint"]
            start, stop = about["runs"]
        except (pa.ArrowException, KeyError, TypeError, ValueError) as error:
            raise BlockError(f"is no block of rows ({type(error).__name__}: {error})") from None
        if owner != fingerprint:
            raise BlockError(f"is of another campaign (fingerprint {owner} there, {fingerprint} here)")
        if (start, stop) != (self.start, self.stop) or not np.array_equal(index, np.arange(self.start, self.stop)):
            raise BlockError(f"has the runs {start} to {stop - 1}, not those of its name")
        return Block(Runs(columns, names), about)


class BlockError(Exception):
    """Why a file is not a block of the campaign: a sentence without its subject."""


class Block(NamedTuple):
    """What is in a block file.

    Attributes:
        rows: Its rows, in order.
        about: How many runs were solved again, and the defects.
    """

    rows: Runs
    about: dict[str, Any]


def write_block(
    folder: Path, table: Runs, about: dict[str, Any], records: Mapping[str, Record], fingerprint: str
) -> BlockFile:
    """Writes rows of consecutive runs.

    Args:
        folder: Where block files are.
        table: The rows, in order.
        about: Metadata to write with them, plain numbers; equal for equal rows.
        records: What is known of the columns that the study alone has.
        fingerprint: That of the campaign.

    Returns:
        The file.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = pa.table(dict(table.columns))
    start, stop = int(table["index"][0]), int(table["index"][-1]) + 1
    written = {"names": table.names, "fingerprint": fingerprint, "runs": (start, stop), **about}
    schema = described(rows.schema, records).with_metadata({_KEY: json.dumps(written)})
    sink = pa.BufferOutputStream()
    # Drawn numbers and metrics hardly ever repeat: without a dictionary they take less room, and a third of the time.
    pq.write_table(rows.cast(schema), sink, compression="zstd", use_dictionary=False)
    content = sink.getvalue().to_pybytes()
    path = folder / f"{start:012d}-{stop:012d}-{_hash(content)}.parquet"
    write_whole(path, content)
    return BlockFile(start, stop, path)


def block_files(folder: Path) -> list[BlockFile]:
    """The block files in a folder, by their range, the longest of equal start first."""
    named = [(path, _NAME.fullmatch(path.name)) for path in folder.iterdir()]
    found = [BlockFile(int(name[1]), int(name[2]), path) for path, name in named if name is not None]
    return sorted(found, key=lambda file: (file.start, -file.stop, file.path))


def gaps(files: list[BlockFile], start: int, stop: int) -> list[range]:
    """What of the runs start ... stop - 1 none of the files has."""
    missing, reached = [], start
    for file in sorted(files):
        if file.start >= stop:
            break
        if file.start > reached:
            missing.append(range(reached, file.start))
        reached = max(reached, file.stop)
    return [*missing, range(reached, stop)] if reached < stop else missing


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]
