"""What a campaign is, and that nothing else gets in: files that the study reads, folders that are made, alien files."""

import errno
import hashlib
import itertools as it
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

import places
import qsmc_jax as qj
from qsmc_jax.base import atomic
from qsmc_jax.campaign.blocks import BlockFile, block_files
from qsmc_jax.campaign.config import CampaignConfig
from qsmc_jax.cli.main import app
from qsmc_jax.cli.study_file import Source, load_study
from studies_for_tests import study

STUDY = places.STUDY
# JAX warns whoever doubles the process; what is doubled here only writes files.
AT_FORK = pytest.mark.filterwarnings("ignore::RuntimeWarning", "ignore::DeprecationWarning")
SMALL = ["--block", "64", "--no-cache", "--file-runs", "64"]
TEXT = """
from pathlib import Path
import jax.numpy as jnp
import numpy as np
import qsmc_jax as qj
from plants_beside import GAIN

TABLE = np.loadtxt(Path(__file__).with_name("table.csv"))

class Mine(qj.AbstractPlant):
    order = 1

    def drift(self, t, x):
        return jnp.interp(x[0], jnp.linspace(-1.0, 1.0, 50), jnp.asarray(TABLE))

    def gain(self, t, x):
        return GAIN

def scenario(draw):
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(2.0, 1.0, 0.1))
    loop = qj.ClosedLoop(Mine(), qj.references.Constant(0.0), qj.disturbances.Zero(), control)
    return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.2, shape=(1,)), t1=4.0)

study = qj.Study(scenario, bandwidth=0.5)
"""


def qsmc(*arguments):
    return CliRunner().invoke(app, list(map(str, arguments)))


def plain_text(output):
    return " ".join(output.split())


@pytest.fixture
def beside(tmp_path, monkeypatch):
    """A study that reads a file of data and imports a module beside it."""
    folder = tmp_path / "mine"
    folder.mkdir()
    np.savetxt(folder / "table.csv", np.linspace(0.0, 1.0, 50))
    (folder / "plants_beside.py").write_text("GAIN = 1.0\n")
    (folder / "study.py").write_text(TEXT)
    monkeypatch.syspath_prepend(folder)
    yield folder
    sys.modules.pop("plants_beside", None)


def again(folder, out):
    sys.modules.pop("plants_beside", None)
    shutil.rmtree(folder / "__pycache__", ignore_errors=True)
    return qsmc("verify", folder / "study.py", "--runs", 64, *SMALL, "--out", out)


@pytest.mark.slow
def test_a_value_that_no_run_has_used_is_part_of_the_study(beside, tmp_path):
    out = tmp_path / "run"
    assert again(beside, out).exit_code == 0
    assert again(beside, out).exit_code == 0
    table = np.linspace(0.0, 1.0, 50)
    table[3] += 1e-12  # where no state ever is
    np.savetxt(beside / "table.csv", table)
    done = again(beside, out)
    assert done.exit_code == 2
    assert "what the drift of `Mine` computes" in plain_text(done.output)
    assert "Of what the study read, `table.csv` is not what it was." in plain_text(done.output)
    shown = qsmc("show", out, "--run", 0, "--no-cache")
    assert shown.exit_code == 2
    assert "`table.csv`" in shown.output


@pytest.mark.slow
def test_a_number_of_an_imported_module_is_part_of_the_study(beside, tmp_path):
    out = tmp_path / "run"
    assert again(beside, out).exit_code == 0
    (beside / "plants_beside.py").write_text("GAIN = 1.75\n")
    done = again(beside, out)
    assert done.exit_code == 2
    assert "what the gain of `Mine` computes" in plain_text(done.output)
    assert "`plants_beside.py`" in done.output


def test_contents_are_the_same_in_every_process():
    program = "import sys; sys.path.insert(0, 'tests'); from studies_for_tests import study;print(study.contents)"
    said = {
        subprocess.run(
            [sys.executable, "-c", program],
            env={**os.environ, "PYTHONHASHSEED": seed},
            cwd=STUDY.parents[1],
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    }
    assert said == {f"{study.contents}\n"}


NESTED = """
import jax
import qsmc_jax as qj
from studies_for_tests import Integrator

{comment}
def scenario(draw):
    twice = lambda fn: lambda t: fn(fn(t))
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(2.0, 1.0, 0.1))
    smooth = qj.references.Smooth(lambda t: 0.1 * jax.nn.softplus(twice(lambda s: s + {number})(t)))
    loop = qj.ClosedLoop(Integrator(1.0), smooth, qj.disturbances.Zero(), control)
    return qj.Scenario(loop, x0=[0.1], t1=4.0)

study = qj.Study(scenario, 0.5)
"""


def loop_of(folder, comment, number):
    """What a file computes whose functions are made by functions."""
    folder.mkdir()
    path = folder / "study.py"
    path.write_text(NESTED.format(comment=comment, number=number))
    return dict(load_study(Source.read(path), []).contents)


def test_neither_comments_nor_the_place_of_a_file_are_part_of_the_study(tmp_path):
    first = loop_of(tmp_path / "a", "", 1.0)
    assert loop_of(tmp_path / "b", "# a comment\n# of two lines", 1.0) == first
    changed = loop_of(tmp_path / "c", "", 1.5)
    assert {part for part in first if first[part] != changed[part]} >= {"reference `Smooth`"}


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Two campaigns of 128 runs, of other seeds, in blocks of 64."""
    places = [tmp_path_factory.mktemp("campaign") / f"run{seed}" for seed in (1, 2)]
    for seed, place in enumerate(places, start=1):
        assert qsmc("verify", STUDY, "--runs", 128, "--seed", seed, *SMALL, "--out", place).exit_code == 0
    return places


@pytest.fixture
def folder(runs, tmp_path):
    return Path(shutil.copytree(runs[0], tmp_path / "run"))


def rows_of(folder):
    return pq.read_table(folder / "blocks").sort_by("index").to_pydict()


@pytest.mark.slow
def test_rows_of_a_range_are_read_from_its_files_alone(folder, monkeypatch):
    read, files = BlockFile.read, []
    monkeypatch.setattr(BlockFile, "read", lambda file, owner: files.append(file.start) or read(file, owner))
    run = qj.campaign.RunFolder(folder)
    assert [len(table) for table in run.tables(64, 128)] == [64]
    assert [len(table) for table in run.tables(100, 101)] == [1]
    assert files == [64, 64]


@pytest.mark.parametrize(("most", "starts"), [(None, [0, 64]), (1, [0]), (2, [0, 64]), (9, [0, 64])])
@pytest.mark.slow
def test_of_many_blocks_some_are_read(folder, most, starts):
    assert [file.start for file, _ in qj.campaign.RunFolder(folder).blocks(most)] == starts


@pytest.mark.parametrize("seed", [1, 2])
def test_two_who_make_a_folder_at_once_agree_or_one_is_refused(tmp_path, monkeypatch, seed):
    """The other one is quicker by a hair: his folder is there when ours should get its name."""
    others, mine = (CampaignConfig(study, STUDY.read_bytes(), seed=each, block=64, threads=1) for each in (1, seed))
    rename, out = os.rename, tmp_path / "run"

    def late(source, target):
        monkeypatch.setattr(os, "rename", rename)
        qj.campaign.prepare(out, others)
        rename(source, target)

    monkeypatch.setattr(os, "rename", late)
    if seed == 1:
        assert qj.campaign.prepare(out, mine).manifest["identity"]["seed"] == 1
    else:
        with pytest.raises(qj.InputError, match=r"`seed` \(1 there, 2 now\)"):
            qj.campaign.prepare(out, mine)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def continued(folder):
    return qsmc("verify", STUDY, "--runs", 128, "--seed", 1, *SMALL, "--out", folder)


def swapped(folder, runs):
    """Two sound blocks under the ranges of each other."""
    first, second = block_files(folder / "blocks")
    names = [f"{other.path.name[:25]}-{mine.path.name[26:]}" for mine, other in ((first, second), (second, first))]
    for file, name in zip((first, second), names, strict=True):
        file.path.rename(file.path.with_name(name))


def replaced(folder, runs):
    first = block_files(folder / "blocks")[0]
    first.path.unlink()
    shutil.copy(block_files(runs[1] / "blocks")[0].path, folder / "blocks")


def added(folder, runs):
    """Beside ours, under names that come first: of two blocks with one range the first is read."""
    for ours, other in zip(block_files(folder / "blocks"), block_files(runs[1] / "blocks"), strict=True):
        for name, content in map(rewritten, it.repeat(other), it.count()):
            if name < ours.path.name:
                (folder / "blocks" / name).write_bytes(content)
                break


def rewritten(file, mark):
    """A block with the same rows under another name, by the hash of what is in the file."""
    table, sink = pq.read_table(file.path), pa.BufferOutputStream()
    pq.write_table(table.replace_schema_metadata({**table.schema.metadata, b"mark": str(mark).encode()}), sink)
    content = sink.getvalue().to_pybytes()
    return f"{file.path.name[:26]}{hashlib.sha256(content).hexdigest()[:16]}.parquet", content


@pytest.mark.slow
@pytest.mark.parametrize("spoil", [swapped, replaced, added])
def test_blocks_of_others_are_named_and_never_counted(folder, runs, spoil):
    spoil(folder, runs)
    exported = qsmc("export", folder, "--out", folder.parent / "rows.csv")
    assert "passed over" in exported.output
    done = continued(folder)
    assert done.exit_code == 0, done.output
    assert "is of another campaign" in plain_text(done.output) or "not those of its name" in plain_text(done.output)
    assert repr(rows_of(folder)) == repr(rows_of(runs[0]))  # to the last bit, where NaN is NaN


ALIEN = {
    "manifest.json": ["[]", '"text"', "3", "null", "{}", "{", '{"schema": "3"}', '{"schema": true}'],
    "summary.json": ["[]", "{}", "{", '{"verdict": 3}'],
    "sessions/alien.json": ["[]", "{}", "{", '{"began": 1}'],
    "requests/alien.json": ["[]", "{}", "{", '{"runs": "many", "is_anytime": false}'],
}


@pytest.mark.parametrize(("name", "text"), [(name, text) for name, texts in ALIEN.items() for text in texts])
def test_an_alien_file_is_named(folder, name, text):
    (folder / name).write_text(text)
    for command in (["status", folder], ["report", folder]):
        done = qsmc(*command)
        assert done.exit_code in (0, 2), done.output
        if done.exit_code == 2:
            assert name in done.output
    assert any(qsmc(*command).exit_code == 2 for command in (["status", folder], ["report", folder]))


def test_a_newer_folder_is_refused(folder):
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**manifest, "schema": manifest["schema"] + 1}))
    assert "It is of a newer version of qsmc_jax: use that." in plain_text(qsmc("status", folder).output)


def test_a_received_folder_runs_nothing(folder, tmp_path):
    """Neither a study beside it, nor one at a path that its sender chose, nor one whose code is another."""
    trap = tmp_path / "study.py"
    trap.write_text("raise SystemExit('run!')")
    manifest = json.loads((folder / "manifest.json").read_text())
    for path, machine in (("study.py", manifest["machine"]), (str(trap), manifest["machine"]), (str(trap), "other")):
        changed = {**manifest, "study_path": path, "machine": machine}
        (folder / "manifest.json").write_text(json.dumps(changed))
        done = CliRunner().invoke(app, ["show", str(folder), "--run", "0", "--no-cache"])
        assert done.exit_code == 2
        assert "run!" not in done.output
    named = qsmc("show", folder, "--run", 0, "--study", trap, "--no-cache")
    assert named.exit_code == 2
    assert "`study_code`" in named.output


@AT_FORK
def test_requests_are_kept_whoever_asks_at_once(folder):
    run = qj.campaign.RunFolder(folder)
    with multiprocessing.get_context("fork").Pool(8) as pool:
        pool.starmap(run.ask_for, [(128 + i, False) for i in range(20)])
    assert run.asked_for == [128 + i for i in range(20)]
    assert run.is_anytime


@AT_FORK
@pytest.mark.parametrize("number", range(12))
@pytest.mark.parametrize("cause", ["killed", "full"])
def test_a_folder_that_is_made_half_is_no_obstacle(tmp_path, monkeypatch, number, cause):
    """The process dies, or the disk is full, at the k-th operation on files; the same command then goes through."""
    config = CampaignConfig(study, STUDY.read_bytes(), seed=1, block=64, threads=1)
    out = tmp_path / "place" / "run"

    def make():
        qj.campaign.prepare(out, config, study_file=str(STUDY))

    def disturbed():
        count = 0

        def hear(event, arguments):
            nonlocal count
            if event in ("open", "os.mkdir", "os.rename") and "place" in str(arguments[0]):
                count += 1
                if count == number + 1:
                    if cause == "killed":
                        os.kill(os.getpid(), signal.SIGKILL)
                    raise OSError(errno.ENOSPC, "No space left on device")

        sys.addaudithook(hear)
        try:
            make()
        except qj.InputError as error:
            assert "No space left" in str(error)  # noqa: PT017
        os._exit(0)

    _ = config.identity  # is traced before the process is doubled
    process = multiprocessing.get_context("fork").Process(target=disturbed)
    process.start()
    process.join(120)
    assert not process.is_alive()
    make()
    assert qj.campaign.RunFolder.open(out).fingerprint
    assert sorted(path.name for path in out.parent.iterdir()) == ["run"]


def test_sessions_and_files_of_the_dead_are_swept(folder):
    process = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, check=True)
    dead, run = int(process.stdout), qj.campaign.RunFolder(folder)
    session = run.begin_session({})
    session.about["process"] = dead
    session.write("running")
    left = folder / "blocks" / f".x.parquet.{atomic.machine()}.{dead}.00000000.tmp"
    alive = left.with_name(left.name.replace(str(dead), str(os.getpid())))
    left.write_text("half")
    alive.write_text("half")
    run.begin_session({})
    assert not left.exists()
    assert alive.exists()
    assert [note["state"] for note in run.sessions()] == ["done", "interrupted"]


@pytest.mark.slow
def test_the_umask_is_respected(tmp_path):
    before = os.umask(0o077)
    try:
        qsmc("simulate", STUDY, "--out", tmp_path / "run", "--no-cache")
    finally:
        os.umask(before)
    assert (tmp_path / "run").stat().st_mode & 0o777 == 0o700
