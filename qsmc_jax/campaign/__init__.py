"""Studies that last: rows in a run folder, block by block, to be gone on with, extended, spread and read again."""
