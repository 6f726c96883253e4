"""A disk that is full at any one of a campaign's writes: told, and gone on from by the same command."""

import errno
import os

import numpy as np
import pytest

import places
import qsmc_jax as qj
from qsmc_jax.report.campaign_report import write_report, write_summary
from qsmc_jax.report.provenance import provenance
from qsmc_jax.study.runs import concatenate
from studies_for_tests import study

STUDY = places.STUDY
CONFIG = qj.campaign.CampaignConfig(study, STUDY.read_bytes(), block=64, threads=1)
RUNS = 192
# More writes than there are: folder, request, session, three blocks, summary, pictures, page.
MOST = 60

pytestmark = pytest.mark.slow


def verify(out):
    """What `qsmc verify --out` does, step by step."""
    folder = qj.campaign.prepare(out, CONFIG, study_file=str(STUDY), file_runs=64)
    origin = provenance(STUDY, CONFIG.source, ["qsmc", "verify"])
    result = qj.campaign.run_campaign(folder, CONFIG, RUNS, provenance=origin)
    write_summary(folder, result, origin)
    write_report(folder, result)
    return result.conclusion()


def rows(out):
    return concatenate(list(qj.campaign.RunFolder.open(out).tables()))


class Disk:
    """Has the k-th flush to the disk fail, and no other."""

    def __init__(self, number):
        self.number, self.count, self.flush = number, 0, os.fsync

    def __call__(self, descriptor):
        self.count += 1
        if self.count == self.number:
            raise OSError(errno.ENOSPC, "No space left on device")
        self.flush(descriptor)


def test_full_at_each_write_of_a_campaign(tmp_path, monkeypatch):
    conclusion = verify(tmp_path / "whole")
    truth = rows(tmp_path / "whole")
    for number in range(1, MOST + 1):
        out, disk = tmp_path / f"run{number}", Disk(number)
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", disk)
            try:
                verify(out)
            except qj.InputError as error:
                assert "No space left on device" in str(error)  # noqa: PT017
            else:
                break
        assert verify(out) == conclusion
        found = rows(out)
        for name in truth:
            np.testing.assert_array_equal(found[name], truth[name], err_msg=name)
        assert (out / "report.html").is_file()
        assert not [path for path in out.rglob(".*.tmp")]
    assert disk.count < number
    assert number > 15
