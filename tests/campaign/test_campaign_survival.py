"""Campaigns as processes: killed, raced, short of room. Slow, but for what can be shown in this process."""

import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import places
from qsmc_jax.campaign.folder import RunFolder
from qsmc_jax.study.runs import concatenate

STUDY = places.STUDY
BLOCKS, SIZE = 200, 64
QSMC = [sys.executable, "-c", "from qsmc_jax.cli.main import app; app()"]
VERIFY = [
    "verify",
    str(STUDY),
    "--runs",
    str(BLOCKS * SIZE),
    "--file-runs",
    str(SIZE),
    "--block",
    "64",
    "--threads",
    "1",
]

pytestmark = pytest.mark.stress


def start(*arguments, **options):
    """Starts the command in a process group of its own."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([*QSMC, *map(str, arguments)], start_new_session=True, **pipes, **options)


def finish(*arguments):
    """Runs the command to its end: exit code, and all it printed."""
    process = start(*arguments)
    out, err = process.communicate(timeout=300)
    return process.returncode, out + err


def blocks(path):
    """Name, inode and time of each block file: what changes if it is written again."""
    folder = path / "blocks"
    if not folder.is_dir():
        return {}
    return {each.name: (each.stat().st_ino, each.stat().st_mtime_ns) for each in folder.glob("[!.]*.parquet")}


def rows(path):
    """All rows of a folder."""
    return concatenate(list(RunFolder.open(path).tables()))


def require_equal(first, second):
    assert list(first) == list(second)
    for name in first:
        np.testing.assert_array_equal(first[name], second[name], err_msg=name)


def wait_for(condition, process):
    deadline = time.monotonic() + 120.0
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.005)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The rows of an uninterrupted campaign."""
    path = tmp_path_factory.mktemp("whole") / "run"
    code, text = finish(*VERIFY, "--out", path)
    assert code == 0, text
    return rows(path)


def test_killed_at_ten_random_moments_it_ends_with_the_same_rows(tmp_path, whole):
    path, rng, kept = tmp_path / "run", np.random.default_rng(11), {}
    for _ in range(10):
        process = start(*VERIFY, "--out", path)
        wait_for(lambda: len(blocks(path)) > len(kept), process)  # noqa: B023
        time.sleep(rng.uniform(0.0, 0.1))
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        after = blocks(path)
        assert {name: after[name] for name in kept} == kept
        kept = after
    assert 10 <= len(kept) < BLOCKS
    code, text = finish(*VERIFY, "--out", path)
    assert code == 0, text
    after = blocks(path)
    assert {name: after[name] for name in kept} == kept
    assert len(after) == BLOCKS
    require_equal(rows(path), whole)


def test_an_interrupt_finishes_the_block_in_hand_and_exits_3(tmp_path):
    path = tmp_path / "run"
    process = start(*VERIFY, "--out", path)
    wait_for(lambda: blocks(path), process)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 3, out + err
    assert "The same command goes on" in err
    assert RunFolder.open(path).sessions()[-1]["state"] == "interrupted"


def test_two_shards_race_on_one_folder(tmp_path, whole):
    path = tmp_path / "run"
    assert finish(*VERIFY, "--out", path, "--prepare")[0] == 0
    # Two workers of the same shard besides, who do each other's work.
    options = ["worker", path, "--block", "64", "--threads", "1", "--shard"]
    workers = [start(*options, shard) for shard in ("0/2", "1/2", "1/2")]
    for worker in workers:
        out, err = worker.communicate(timeout=300)
        assert worker.returncode == 0, out + err
    assert len(blocks(path)) == BLOCKS
    code, text = finish(*VERIFY, "--out", path)
    assert code == 0, text
    require_equal(rows(path), whole)


@pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="needs the extra `cluster`")
@pytest.mark.parametrize("attempt", range(20))
def test_two_start_at_once_on_a_folder_that_is_not_there(tmp_path, attempt):
    """Both come to the same verdict, or one is told why not; the rows are those of one campaign."""
    path = tmp_path / "run"
    command = ["verify", STUDY, "--runs", "256", "--file-runs", "64", "--block", "64", "--threads", "1", "--out", path]
    both = [start(*command) for _ in range(2)]
    for process in both:
        out, err = process.communicate(timeout=300)
        assert process.returncode == 0, out + err
        assert "Traceback" not in out + err
    assert rows(path)["index"].tolist() == list(range(256))
    assert sorted(each.name for each in tmp_path.iterdir()) == ["run"]


def test_two_studies_start_at_once_on_a_folder_that_is_not_there(tmp_path):
    """One makes it; the other is refused, naming what differs."""
    path = tmp_path / "run"
    command = ["verify", STUDY, "--runs", "64", "--file-runs", "64", "--block", "64", "--threads", "1", "--out", path]
    both = [start(*command, "--seed", str(seed)) for seed in (1, 2)]
    texts = ["".join(process.communicate(timeout=300)) for process in both]
    assert sorted(process.returncode for process in both) == [0, 2], texts
    assert any("belongs to another study: `seed`" in text for text in texts), texts


def test_a_dask_worker_is_killed(tmp_path, whole):
    path = tmp_path / "run"
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard"]
    address = tmp_path / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
    started = [subprocess.Popen([*dask, "--scheduler-file", str(address)], **quiet)]
    try:
        wait_for(address.exists, started[0])
        worker = [
            sys.executable,
            "-m",
            "distributed.cli.dask_worker",
            "--scheduler-file",
            str(address),
            "--no-dashboard",
        ]
        started += [subprocess.Popen([*worker, "--nthreads", "1", "--no-nanny"], **quiet) for _ in range(2)]
        where = json.loads(address.read_text())["address"]
        process = start(*VERIFY, "--out", path, "--scheduler", where)
        wait_for(lambda: len(blocks(path)) >= 20, process)
        os.killpg(started[1].pid, signal.SIGKILL)
        assert len(blocks(path)) < BLOCKS
        out, err = process.communicate(timeout=300)
        assert process.returncode == 0, out + err
    finally:
        for each in started:
            each.kill()
            each.wait()
    assert len(blocks(path)) == BLOCKS
    require_equal(rows(path), whole)


def test_a_full_disk_is_told_and_gone_on_from(tmp_path, whole):
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(disk)], capture_output=True)
    if mounted.returncode:
        pytest.skip("needs the right to mount a small disk")
    try:
        code, text = finish(*VERIFY, "--out", disk / "run")
        assert code == 2, text
        assert "No space left on device" in text
        assert "Traceback" not in text
        there = len(blocks(disk / "run"))
        assert 0 < there < BLOCKS
        assert len(RunFolder.open(disk / "run").sound_files(0, BLOCKS * SIZE)) == there
        subprocess.run(["mount", "-o", "remount,size=100m", str(disk)], check=True)
        code, text = finish(*VERIFY, "--out", disk / "run")
        assert code == 0, text
        require_equal(rows(disk / "run"), whole)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_a_folder_that_cannot_be_written_is_told(tmp_path):
    path = tmp_path / "run"
    assert finish(*VERIFY, "--out", path, "--prepare")[0] == 0
    shutil.rmtree(path / "sessions")
    (path / "sessions").write_text("not a folder")
    code, text = finish(*VERIFY, "--out", path)
    assert code == 2, text
    assert "can't be written" in text
    assert "Traceback" not in text
