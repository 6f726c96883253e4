"""Recordings from files: what is read, and what is said of a file that is not as it should be."""

import numpy as np
import pytest

import qsmc_jax as qj

GOOD = "t, speed,gust\n0.0,1.0,2.0\n\n0.5,3.0,4.0\n1.0,5.0,6.0\n"


def read(tmp_path, text, **options):
    path = tmp_path / "wind.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return qj.Recording.from_csv(path, **options)


@pytest.mark.parametrize("text", [GOOD, GOOD.replace("\n", "\r\n"), "\ufeff" + GOOD], ids=["unix", "windows", "marked"])
@pytest.mark.parametrize("columns", [dict(time="t", value="gust"), dict(value=2), dict(time=0, value="gust")])
def test_columns_are_found_by_name_or_number(tmp_path, text, columns):
    found = read(tmp_path, text, kind="hold", **columns)
    assert found.times.tolist() == [0.0, 0.5, 1.0]
    assert found.coefficients.tolist() == [[2.0, 2.0, 4.0, 6.0]]


def test_a_file_without_names_is_read_by_numbers(tmp_path):
    assert read(tmp_path, "0,1\n1,3\n").times.tolist() == [0.0, 1.0]


def test_every_digit_is_kept(tmp_path):
    times = np.cumsum(np.random.default_rng(1).uniform(0.1, 1.0, 50))
    rows = "\n".join(f"{t!r},{t!r}" for t in times.tolist())
    assert read(tmp_path, rows).times.tolist() == times.tolist()


NAMED = dict(time="t", value="speed")
REFUSED = {
    "missing column": (GOOD, dict(time="t", value="sped"), r"`value` .*`sped`. It has `t`, `speed`, `gust`. Did you"),
    "missing time": (GOOD, dict(time="time", value="speed"), r"`time` must be a column of .*wind.csv`"),
    "number too large": (GOOD, dict(value=3), r"`value` must be below the number of columns .*, 3, .*but is 3"),
    "negative number": (GOOD, dict(time=-1), r"`time` must be below"),
    "empty": ("", {}, r"wind.csv` must have rows, but is empty"),
    "one row": ("t,speed\n0.0,1.0\n", NAMED, r"wind.csv` must have at least two rows of numbers, but has 1"),
    "only names": ("t,speed\n", NAMED, r"but has 0"),
    "unsorted": (
        "t,speed\n0,1\n2,1\n1,1\n",
        NAMED,
        r"Row 4 of column `t` of .*wind.csv` must be a later .* 1 is before",
    ),
    "repeated": ("t,speed\n0,1\n\n1,1\n1,1\n", NAMED, r"Row 5 of column `t` .* repeats the time"),
    "nan": ("t,speed\n0,1\n1,nan\n", NAMED, r"Row 3 of column `speed` of .* must be finite, but is 'nan'"),
    "empty cell": ("t,speed\n0,1\n1,\n", NAMED, r"Row 3 of column `speed` of .* must be a number, but is empty"),
    "short row": ("t,speed\n0,1\n1\n", NAMED, r"Row 3 of column `speed` of .* but is empty"),
    "no number": ("t,speed\n0,1\none,2\n", NAMED, r"Row 3 of column `t` of .* must be a number, but is 'one'"),
    "a name in the middle": ("0,1\nt,2\n", {}, r"Row 2 of column 0 of .* must be a number, but is 't'"),
    "half a first row": ("0,x\n1,2\n2,3\n", {}, r"Row 1 of column 1 of .* but is 'x'"),
    "bytes": (b"\xff\xfe\x00", {}, r"must be a text in UTF-8"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_wrong_with_a_file_is_said_with_its_place(tmp_path, name):
    text, options, message = REFUSED[name]
    with pytest.raises(qj.InputError, match=message):
        read(tmp_path, text, **options)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(qj.InputError, match=r"nowhere.csv` can't be read: No such file"):
        qj.Recording.from_csv(tmp_path / "nowhere.csv")
