"""Block files: what is missing of a range, and what happens to bytes that are not as they were written."""

import errno
import os

import hypothesis.strategies as st
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given

from qsmc_jax.base.atomic import write_whole
from qsmc_jax.campaign.blocks import BlockError, BlockFile, block_files, gaps, write_block
from qsmc_jax.campaign.columns import described
from qsmc_jax.study.runs import Runs
from studies_for_tests import study

OWNER = "mine"
SPANS = st.lists(st.tuples(st.integers(0, 40), st.integers(1, 12)), max_size=8)


@given(spans=SPANS, start=st.integers(0, 40), length=st.integers(1, 30))
def test_gaps_are_what_no_file_has(spans, start, length):
    from pathlib import Path

    files = [BlockFile(first, first + size, Path()) for first, size in spans]
    there = {i for file in files for i in range(file.start, file.stop)}
    found = gaps(files, start, start + length)
    assert [i for gap in found for i in gap] == [i for i in range(start, start + length) if i not in there]


def table(start, stop):
    """Rows that look like those of the study."""
    index = np.arange(start, stop)
    return Runs({"index": index, "d": index / 7.0, "margin": np.sqrt(index), "verdict": index % 3}, ("d",))


def test_a_block_comes_back_as_it_was_written(tmp_path):
    file = write_block(tmp_path, table(5, 900), {"escalated": [1, 0], "defects": [7]}, study.records, OWNER)
    assert (file.start, file.stop) == (5, 900)
    assert block_files(tmp_path) == [file]
    read, about = file.read(OWNER)
    assert read.names == ("d",)
    for name in read:
        np.testing.assert_array_equal(read[name], table(5, 900)[name])
    assert about["escalated"] == [1, 0]
    assert about["defects"] == [7]


def test_equal_rows_have_equal_names(tmp_path):
    files = [write_block(tmp_path, table(0, 100), {"escalated": [0, 0]}, study.records, OWNER) for _ in range(2)]
    assert files[0] == files[1]
    assert len(list(tmp_path.iterdir())) == 1


@given(place=st.integers(0, 10**9), bit=st.integers(0, 7))
def test_a_flipped_bit_anywhere_is_noticed(tmp_path_factory, place, bit):
    folder = tmp_path_factory.mktemp("blocks")
    file = write_block(folder, table(0, 50), {}, study.records, OWNER)
    content = bytearray(file.path.read_bytes())
    content[place % len(content)] ^= 1 << bit
    file.path.write_bytes(content)
    with pytest.raises(BlockError, match="is damaged"):
        file.read(OWNER)


def test_a_truncated_file_is_noticed(tmp_path):
    file = write_block(tmp_path, table(0, 50), {}, study.records, OWNER)
    file.path.write_bytes(file.path.read_bytes()[:-100])
    with pytest.raises(BlockError, match="is damaged"):
        file.read(OWNER)


def test_a_block_of_another_campaign_is_named(tmp_path):
    file = write_block(tmp_path, table(0, 50), {}, study.records, "another")
    with pytest.raises(BlockError, match=r"is of another campaign \(fingerprint another there, mine here\)"):
        file.read(OWNER)


@pytest.mark.parametrize(("start", "stop"), [(50, 100), (0, 49), (1, 50), (0, 51)])
def test_a_block_under_the_name_of_another_is_named(tmp_path, start, stop):
    file = write_block(tmp_path, table(0, 50), {}, study.records, OWNER)
    other = file.path.with_name(f"{start:012d}-{stop:012d}-{file.path.name[26:]}")
    file.path.rename(other)
    (there,) = block_files(tmp_path)
    with pytest.raises(BlockError, match="has the runs 0 to 49, not those of its name"):
        there.read(OWNER)


@pytest.mark.parametrize("columns", [{"x": [1, 2]}, {"index": [1, 0]}, {"index": ["a", "b"]}])
def test_another_table_is_no_block(tmp_path, columns):
    import hashlib

    path = tmp_path / "file"
    pq.write_table(pa.table(columns), path)
    name = f"{0:012d}-{2:012d}-{hashlib.sha256(path.read_bytes()).hexdigest()[:16]}.parquet"
    path.rename(tmp_path / name)
    (file,) = block_files(tmp_path)
    with pytest.raises(BlockError, match="is no block of rows"):
        file.read(OWNER)


def test_any_parquet_reader_sees_descriptions_and_units(tmp_path):
    file = write_block(tmp_path, table(0, 50), {}, study.records, OWNER)
    schema = pq.read_schema(file.path)
    assert schema.field("d").metadata[b"description"] == b"Drawn by the study: uniform."
    assert b"1 - peak_ratio" in schema.field("margin").metadata[b"description"]
    assert schema.field("margin").metadata[b"unit"] == b"-"


def test_every_column_of_a_run_is_described():
    import qsmc_jax as qj

    rows = qj.monte_carlo(study, 1, block=64)
    schema = described(pa.table(dict(rows.columns)).schema, study.records)
    assert [field.name for field in schema if not field.metadata[b"description"]] == []


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_a_full_disk_leaves_nothing_behind_and_says_what_to_do(tmp_path, monkeypatch, step):
    (tmp_path / "file").write_bytes(b"before")

    def fail(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, step, fail)
    with pytest.raises(ValueError, match="No space left on device. What was written before is whole"):
        write_whole(tmp_path / "file", b"after")
    assert (tmp_path / "file").read_bytes() == b"before"
    assert len(list(tmp_path.iterdir())) == 1
