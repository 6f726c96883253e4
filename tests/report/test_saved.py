"""Results read back from files: the same numbers to the last bit, asked for code, and nothing in a file is run."""

import dataclasses
import json

import jax
import numpy as np
import pytest

import places
import qsmc_jax as qj
import studies_for_tests
from qsmc_jax.metrics.metric import AbstractMeasure
from qsmc_jax.report.saved import as_bytes

LIMIT = qj.always(lambda s: 9.0 - abs(s.u), unit="N")


def judged():
    peak = qj.metrics.Peak("top", lambda s: s.x[0], unit="m")
    return qj.Study(studies_for_tests.scenario, bandwidth=0.2, metrics=[peak], requirements={"limit": LIMIT})


@pytest.fixture(scope="module")
def study():
    return judged().substitute(mu=1.5, t1=3.0)


RESULTS = {
    "rows": lambda study: qj.monte_carlo(study, 130, block=64),
    "verification": lambda study: qj.verify(study, 64, block=64),
    "replay": lambda study: study.replay(3),
    "signals": lambda study: qj.signals(study, [3, 1], ts=[0.0, 1.0, 2.0]),
    "map": lambda study: qj.robustness_map(study, {"mu": [1.0, 2.0]}, runs=64, block=64),
    "critical value": lambda study: qj.critical_value(study, "t1", 0.2, between=(0.5, 4.0), steps=2, block=64),
    "falsification": lambda study: qj.falsify(study, "limit", budget=20, adversary=0),
    "comparison": lambda study: qj.compare({"one": study, "two": study}, 64, block=64),
    "landscape": lambda study: qj.landscape(study, ["mu", "t1"], "mean(peak_u)", points=2, runs=64, block=64),
}


def same(one, other):
    """Whether two results are made of the same numbers; NaN is NaN."""
    if dataclasses.is_dataclass(one) and not isinstance(one, qj.Study | AbstractMeasure):
        fields = [field.name for field in dataclasses.fields(one)]
        return type(one) is type(other) and all(same(getattr(one, f), getattr(other, f)) for f in fields)
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[name], other[name]) for name in one)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, np.ndarray | jax.Array | float | np.generic):
        return np.asarray(one).dtype == np.asarray(other).dtype and bool(np.array_equal(one, other, equal_nan=True))
    if isinstance(one, qj.Study):
        return (one.contents, one.bandwidth) == (other.contents, other.bandwidth) and same(one.values, other.values)
    return one.name == other.name if isinstance(one, AbstractMeasure) else one == other


@pytest.mark.parametrize("kind", RESULTS)
def test_a_result_is_what_it_was(kind, study, tmp_path):
    result = RESULTS[kind](study)
    qj.save(result, tmp_path / "result.npz")
    again = qj.load(tmp_path / "result.npz", of=judged())
    assert same(result, again)
    assert str(again) == str(result)
    assert same(getattr(result, "study", 0), getattr(again, "study", 0))


@pytest.mark.slow
def test_a_search_is_what_it_was(study, tmp_path):
    tuned = qj.tune(study, ["mu"], "mean(peak_u)", runs=64, certificate_runs=64, steps=2, starts=1, block=64)
    qj.save(tuned, tmp_path / "tuned")
    again = qj.load(tmp_path / "tuned", of=judged())
    assert str(again) == str(tuned)
    assert again.gains == tuned.gains


def test_what_a_result_needs_is_asked_for(study, tmp_path):
    file, run = tmp_path / "run.npz", study.replay(3)
    qj.save(run, file)
    with pytest.raises(qj.InputError, match="own metric `top`. Give the study, or the loop"):
        qj.load(file, of=run.loop)
    with pytest.raises(qj.InputError, match="a `Integrator`, a class of your own. Give the study"):
        qj.load(file)
    alone = qj.simulate(run.loop, [0.5], 1.0, bandwidth=0.2)
    qj.save(alone, file)
    assert same(alone, qj.load(file, of=alone.loop))


def test_another_study_is_refused(study, tmp_path):
    qj.save(qj.verify(study, 64, block=64), tmp_path / "found")
    other = qj.Study(studies_for_tests.scenario, bandwidth=0.2, requirements={"limit": qj.always(lambda s: 8.0 - s.u)})
    with pytest.raises(qj.InputError, match="differs in: metric `top`, requirement `limit`"):
        qj.load(tmp_path / "found", of=other)
    with pytest.raises(qj.InputError, match="must have the bandwidth 0.2, but has 0.3"):
        qj.load(tmp_path / "found", of=dataclasses.replace(judged(), bandwidth=0.3))
    with pytest.raises(qj.InputError, match="is of a study"):
        qj.load(tmp_path / "found")


def forged(content):
    def file(path):
        np.savez(path / "result.npz", content=np.array(json.dumps({"format": 1, "result": content})))

    return file


def pickled(path):
    np.savez(path / "result.npz", content=np.array([print], dtype=object))


@pytest.mark.parametrize(
    ("write", "said"),
    [
        (lambda path: None, "there is no `"),
        (lambda path: (path / "result.npz").write_bytes(b"PK\x03\x04"), "is no result of `qj.save`, or damaged"),
        (lambda path: (path / "result.npz").write_bytes(as_bytes(qj.tight())[:200]), "or damaged"),
        (pickled, "or damaged"),
        (forged({"class": "os:system", "fields": {"command": "true"}}), "`system`, a class of your own"),
        (forged({"class": "qsmc_jax.cli.main:sys", "fields": {}}), "which this version doesn't know"),
        (forged({"class": "qsmc_jax.cli.main:main", "fields": {}}), "which this version doesn't know"),
        (forged({"class": "qsmc_jax.nothing:Runs", "fields": {}}), "No module named"),
        (forged({"class": "qsmc_jax.study.runs:Runs", "fields": {"rows": 3}}), "which this version doesn.t know"),
        (forged({"array": "a7"}), "or damaged"),
        (lambda path: np.savez(path / "result.npz", content=np.array('{"format": 2, "result": 3}')), "has format 2"),
    ],
)
def test_what_is_no_result_is_named(write, said, tmp_path):
    write(tmp_path)
    with pytest.raises(qj.InputError, match=said):
        qj.load(tmp_path)


@pytest.mark.parametrize("place", [30, 300, 0.5, 0.9])
def test_a_damaged_file_is_named(place, study, tmp_path):
    content = bytearray(as_bytes(study.replay(0)))
    content[int(place * len(content)) if place < 1 else place] ^= 0x10
    (tmp_path / "run.npz").write_bytes(bytes(content))
    with pytest.raises(qj.InputError, match="or damaged"):
        qj.load(tmp_path / "run.npz", of=judged())
    (tmp_path / "run.npz").write_bytes(b"")
    with pytest.raises(qj.InputError, match="or damaged"):
        qj.load(tmp_path / "run.npz")


def test_values_of_the_study_that_is_given_are_not_those_of_the_result(study, tmp_path):
    qj.save(qj.robustness_map(study, {"d": [0.1]}, runs=64, block=64), tmp_path / "map")
    again = qj.load(tmp_path / "map", of=judged().substitute(g=1.2, mu=2.0)).study
    assert same(again, study)


def test_functions_of_a_loop_are_taken_from_the_one_given(tmp_path):
    def loop(level):
        made = qj.paper.example1()
        return dataclasses.replace(made, reference=qj.references.Smooth(lambda t: level + 0.0 * t))

    run, file = qj.simulate(loop(0.1), [0.2, 0.1], 1.0, bandwidth=0.1), tmp_path / "run"
    qj.save(run, file)
    again = qj.load(file, of=loop(0.1))
    assert str(again) == str(run)
    assert float(again.loop.desired(0.0)[0]) == 0.1
    with pytest.raises(qj.InputError, match="a function of your own. Give"):
        qj.load(file)
    with pytest.raises(qj.InputError, match="or damaged|has no function at"):
        qj.load(file, of=qj.paper.example1())


@pytest.mark.parametrize("place", [".", "nowhere/run.npz", ""])
def test_a_place_where_nothing_can_be_written_is_named(place, tmp_path):
    runs = qj.Runs({"index": np.arange(2)}, names=())
    with pytest.raises(qj.InputError, match="Argument `path` must be a file in a folder that exists"):
        qj.save(runs, tmp_path / place)


def test_only_results_are_saved(tmp_path):
    with pytest.raises(qj.InputError, match="must be a result of qsmc_jax, but is a `dict`"):
        qj.save({}, tmp_path / "it")
    assert not list(tmp_path.iterdir())


def test_the_folder_of_a_campaign_gives_its_rows(study, tmp_path):
    config = qj.campaign.CampaignConfig(study, source=places.STUDY.read_bytes(), block=64)
    folder = qj.campaign.prepare(tmp_path / "run", config)
    with pytest.raises(qj.InputError, match="has no rows yet"):
        qj.load(folder.path)
    qj.campaign.run_campaign(folder, config, runs=64)
    rows, again = qj.monte_carlo(study, 64, block=64), qj.load(folder.path)
    np.testing.assert_array_equal(again["peak_u"], rows["peak_u"])
    assert again.record_of("margin_limit").unit == "N"
