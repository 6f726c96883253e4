"""The rows of a campaign as one file that other tools read."""

from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv
from scipy.io import netcdf_file

from qsmc_jax.campaign.columns import texts_of
from qsmc_jax.campaign.folder import RunFolder
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.study.runs import concatenate


def write_csv(folder: RunFolder, path: Path) -> None:
    """All rows as comma-separated values, block by block; verdicts are codes of `Verdict`."""
    writer = None
    try:
        for table in folder.tables():
            # A spreadsheet would run a name that looks like a formula.
            rows = pa.table({f"'{name}" if name[:1] in "=+-@\t" else name: column for name, column in table.items()})
            writer = writer or csv.CSVWriter(path, rows.schema)
            writer.write_table(rows)
    finally:
        if writer is not None:
            writer.close()


def write_netcdf(folder: RunFolder, path: Path) -> None:
    """All rows as NetCDF 3 with the dimension `run`, descriptions and units; very large whole numbers as floats."""
    rows = concatenate(list(folder.tables()))
    about = {field.name: texts_of(field) for field in folder.schema()}
    with netcdf_file(path, "w", version=2) as file:
        file.createDimension("run", len(rows))
        for name in rows:
            column = rows[name]
            is_small = np.issubdtype(column.dtype, np.integer) and abs(column).max(initial=0) < 2**31
            variable = file.createVariable(name, "i4" if is_small else "f8", ("run",))
            variable[:] = column
            for key, text in about[name].items():
                setattr(variable, key, text)
            if name.startswith("verdict"):
                variable.flag_meanings = " ".join(each.name for each in sorted(Verdict))
