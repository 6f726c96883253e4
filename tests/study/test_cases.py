"""Designs of one's own: points as they are, and physical values by name; what their rows are, and what they are not."""

import numpy as np
import pytest
from scipy import stats

import qsmc_jax as qj
from qsmc_jax.campaign.config import CampaignConfig
from qsmc_jax.campaign.replay import replay
from qsmc_jax.study.draw import Draw
from studies_for_tests import Integrator

MATRIX = np.array([[1.0, 0.6], [0.6, 1.0]])
WAVES = [[3.0, 0.4], [7.0, 1.5], [5.0, 1.1]]


def scenario(draw):
    """Every way to draw, one of them with an argument that depends on another, and a loop that they move a little."""
    low = draw.uniform("low", 0.2, 0.4)
    total = low + draw.log_uniform("high", low, 1.0) + draw.normal("bias", 0.0, 0.1)
    total = total + draw.truncated_normal("cut", 0.0, 1.0, -1.0, 2.0) + draw.lognormal("friction", 0.01, 0.3)
    total = total + draw.weibull("gust", 2.0, 1.0) + draw.beta("grip", 2.0, 3.0) + draw.exponential("gap", 0.5)
    total = total + sum(draw.multivariate_normal(["mass", "drag"], [1.0, 3.0], 0.01 * MATRIX))
    with draw.gaussian_copula(MATRIX):
        total = total + draw.gamma("load", 2.5, 0.3) + draw.from_scipy("wind", GUMBEL)
    total = total + draw.choice("step", [1.0, 2.0, 5.0], [1, 2, 1]) + draw.empirical("wave", WAVES).sum()
    total = draw.record("total", total + draw.triangular("delay", 0.0, 0.2, 1.0) + draw.sign("side"))
    gain = draw.parameter("gain", 1.0, bounds=(0.5, 2.0))
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(2.0, 1.0, 0.1))
    disturbance = qj.disturbances.Constant(1e-3 * total)
    loop = qj.ClosedLoop(Integrator(gain), qj.references.Constant(0.0), disturbance, control)
    return qj.Scenario(loop, x0=draw.uniform("x0", 0.2, 0.8, shape=(1,)), t1=0.5)


GUMBEL = stats.gumbel_r(8.0, 2.0)
STUDY = qj.Study(scenario, bandwidth=0.2)
POINTS = qj.Sobol().points(0, range(64), STUDY.dimension)
DRAWN = tuple(column for spec in STUDY.specs if spec.is_drawn for column in spec.columns)


@pytest.fixture(scope="module")
def runs():
    return qj.monte_carlo(STUDY, 64, sampling=qj.Table(POINTS), block=64, threads=1)


def test_columns_hold_physical_values(runs):
    """By SciPy's quantiles at the points; of what is correlated, of its first number."""
    u = {spec.name: POINTS[:, spec.start] for spec in STUDY.specs if spec.is_drawn}
    exact = {
        "low": 0.2 + 0.2 * u["low"],
        "high": runs["low"] * (1.0 / runs["low"]) ** u["high"],
        "bias": stats.norm(0.0, 0.1).ppf(u["bias"]),
        "cut": stats.truncnorm(-1.0, 2.0).ppf(u["cut"]),
        "friction": stats.lognorm(0.3, scale=0.01).ppf(u["friction"]),
        "gust": stats.weibull_min(2.0).ppf(u["gust"]),
        "grip": stats.beta(2.0, 3.0).ppf(u["grip"]),
        "mass": stats.norm(1.0, 0.1).ppf(u["mass"]),
        "load": stats.gamma(2.5, scale=0.3).ppf(u["load"]),
        "step": np.select([u["step"] < 0.25, u["step"] < 0.75], [1.0, 2.0], 5.0),
        "wave[1]": np.array([0.4, 1.1, 1.5])[(3 * u["wave"]).astype(int)],
    }
    for name, values in exact.items():
        np.testing.assert_allclose(runs[name], values, rtol=1e-12, err_msg=name)


def test_values_given_by_name_are_the_values_of_the_runs(runs):
    """From the values back to points, and from these by the programs of a batch to the values."""
    some = runs[:12]
    design = qj.table_of(STUDY, {name: some[name] for name in DRAWN})
    again = qj.monte_carlo(STUDY, 12, sampling=design, block=64, threads=1)
    for name in DRAWN:
        np.testing.assert_allclose(again[name], some[name], rtol=1e-11, atol=1e-13, err_msg=name)
    smooth = [spec.start for spec in STUDY.specs if spec.is_drawn and spec.kind not in ("choice", "empirical", "sign")]
    np.testing.assert_allclose(design.rows[:, smooth], POINTS[:12, smooth], rtol=1e-9, atol=1e-11)


@pytest.mark.slow
def test_a_replay_is_the_run_of_the_table(runs, tmp_path):
    draw = Draw(POINTS[17])
    scenario(draw)
    assert {name: runs[name][17] for name in DRAWN} == pytest.approx(
        {
            column: value
            for spec in STUDY.specs
            if spec.is_drawn
            for column, value in zip(spec.columns, np.ravel(draw.recorded[spec.name]), strict=True)
        },
        rel=1e-12,
    )
    run = STUDY.replay(17, sampling=qj.Table(POINTS))
    assert float(run.metrics.peak_ratio) == pytest.approx(runs["peak_ratio"][17], rel=1e-9)
    config, folder = kept(tmp_path / "run")
    assert replay(folder, config, 17, None).agrees


def test_a_list_of_cases_is_a_design_too():
    cases = [{"low": 0.25, "x": 1.0}, {"low": 0.3, "x": -2.0}]
    design = qj.table_of(small(lambda d: d.normal("x", 1.0, 2.0)), cases)
    np.testing.assert_allclose(design.rows, [[0.25, 0.5], [0.5, stats.norm.cdf(-1.5)]], rtol=1e-12)


def test_ends_of_an_interval_are_met():
    """The corners of a box; a coordinate is never 0 or 1."""
    study = small(lambda d: d.uniform("x", -3.0, 1.0))
    design = qj.table_of(study, {"low": [0.2, 0.4], "x": [1.0, -3.0]})
    found = [Draw(row) for row in design.rows]
    for draw in found:
        study.scenario(draw)
    values = [(d.recorded["low"], d.recorded["x"]) for d in found]
    np.testing.assert_allclose(values, [(0.2, 1.0), (0.4, -3.0)], rtol=1e-15)


def test_a_name_that_the_study_fixes_is_left_out():
    study = small(lambda d: d.normal("x", 1.0, 2.0)).substitute(x=3.0)
    np.testing.assert_allclose(qj.table_of(study, {"low": [0.25]}).rows, [[0.25, 0.5]], rtol=1e-12)
    with pytest.raises(qj.InputError, match="must not have `x`, which is fixed in the study. Use `study.substitute"):
        qj.table_of(study, {"low": [0.25], "x": [3.0]})


def small(draw_x):
    """A study of two names, the second as given."""

    def drawn(draw):
        low, x = draw.uniform("low", 0.2, 0.4), draw_x(draw)
        control = qj.QuasiSlidingControl(
            qj.SlidingSurface([]), qj.Funnel(2.0, draw.parameter("mu", 1.0, bounds=(0.5, 2.0)), 0.1)
        )
        disturbance = qj.disturbances.Constant(
            1e-3 * (low + draw.record("sum", np.sum(x) if isinstance(x, np.ndarray) else x.sum()))
        )
        loop = qj.ClosedLoop(Integrator(1.0), qj.references.Constant(0.0), disturbance, control)
        return qj.Scenario(loop, x0=[0.5], t1=0.5)

    return qj.Study(drawn, bandwidth=0.2)


@pytest.fixture(scope="module")
def pair():
    return small(lambda d: d.normal("x", 1.0, 2.0))


@pytest.fixture(scope="module")
def waves():
    return small(lambda d: d.empirical("wave", WAVES))


CASES = {
    "missing": ({"low": [0.3]}, "must have all columns that the study draws, but lacks `x`"),
    "unknown": (
        {"low": [0.3], "x": [1.0], "loww": [0.3]},
        "a column `loww`, which the study does not draw. Did you mean `low`",
    ),
    "parameter": ({"low": [0.3], "x": [1.0], "mu": [1.0]}, "must not have `mu`, which is a parameter in the study"),
    "recorded": ({"low": [0.3], "x": [1.0], "sum": [1.0]}, "must not have `sum`, which is a record in the study"),
    "lengths": ({"low": [0.3], "x": [1.0, 2.0]}, "must have columns of equal length"),
    "none": ({"low": [], "x": []}, "must have at least one case"),
    "outside": ({"low": [0.3, 0.5], "x": [1.0, 2.0]}, r"In case 1 of `cases`: Argument `low` must lie in \[0.2, 0.4\]"),
    "nan": ({"low": [0.3], "x": [np.nan]}, "In case 0 of `cases`: Argument `x` must be finite, but is nan"),
    "far out": ({"low": [0.3], "x": [20.0]}, "In case 0 of `cases`: Value 20.0 of `x` must be one that can be drawn"),
    "unequal": ([{"low": 0.3, "x": 1.0}, {"low": 0.3}], "must have the same names in every case, but case 1 lacks `x`"),
}


@pytest.mark.parametrize(("cases", "message"), CASES.values(), ids=CASES)
def test_a_case_that_can_not_be_run_is_named(pair, cases, message):
    with pytest.raises(qj.InputError, match=message):
        qj.table_of(pair, cases)


def test_a_row_must_be_one_of_the_data(waves):
    found = qj.table_of(waves, {"low": [0.3], "wave[0]": [5.0], "wave[1]": [1.1]})
    np.testing.assert_allclose(found.rows, [[0.5, 0.5]], rtol=1e-12)
    with pytest.raises(qj.InputError, match=r"Value \[5.0, 1.5\] of `wave` must be one that can be drawn"):
        qj.table_of(waves, {"low": [0.3], "wave[0]": [5.0], "wave[1]": [1.5]})
    with pytest.raises(qj.InputError, match=r"must give `wave` by its columns `wave\[0\]`, `wave\[1\]`"):
        qj.table_of(waves, {"low": [0.3], "wave": [5.0]})


@pytest.mark.parametrize("bad", [0.0, 1.0, -0.1, 1.5, np.nan])
def test_points_must_lie_within_the_cube(bad):
    with pytest.raises(qj.InputError, match=f"strictly between 0 and 1.* row 1, column 0 is {bad:g}"):
        qj.Table([[0.5, 0.5], [bad, 0.5]])


def test_a_table_must_have_a_column_for_every_number_and_a_row_for_every_run(pair):
    with pytest.raises(qj.InputError, match="`rows` must have 2 columns, as the study draws, but has 3"):
        qj.monte_carlo(pair, 2, sampling=qj.Table(np.full((2, 3), 0.5)))
    with pytest.raises(qj.InputError, match=r"must be in \[0, 2\) for this design, but has 2"):
        qj.Table(np.full((2, 2), 0.5)).points(0, [2], 2)


def test_no_interval_is_claimed_for_a_table(pair, tmp_path):
    table = qj.Table(np.full((2, 2), 0.5))
    with pytest.raises(qj.InputError, match="must be independent for `verify`: whether the rows of a `Table` are"):
        qj.verify(pair, 2, sampling=table)
    config = CampaignConfig(pair, b"study", block=64, sampling=table)
    with pytest.raises(
        qj.InputError, match="must be independent for `run_campaign`: whether the rows of a `Table` are"
    ):
        qj.campaign.run_campaign(qj.campaign.prepare(tmp_path / "run", config), config, 2)


def kept(place):
    """The rows of the table in a run folder."""
    config = CampaignConfig(STUDY, b"study", block=64, threads=1, sampling=qj.Table(POINTS))
    folder = qj.campaign.prepare(place, config)
    folder.ask_for(64, is_anytime=False)
    assert qj.campaign.work_shard(folder, config, 0, 1)
    return config, folder


def test_rows_of_a_table_are_kept_in_a_folder(runs, tmp_path):
    """Physical values in the files, the same to the last bit."""
    _, folder = kept(tmp_path / "run")
    (rows,) = folder.tables()
    for name in DRAWN:
        np.testing.assert_array_equal(rows[name], runs[name], err_msg=name)


def test_another_table_is_refused(pair, tmp_path):
    """One that differs by a digit, too."""
    points = POINTS[:, :2].copy()
    qj.campaign.prepare(tmp_path / "run", CampaignConfig(pair, b"study", sampling=qj.Table(points)))
    points[40, 1] = np.nextafter(points[40, 1], 1.0)
    for other in (qj.Table(points), qj.Sobol(), None):
        with pytest.raises(qj.InputError, match="belongs to another study: `sampling`"):
            qj.campaign.prepare(tmp_path / "run", CampaignConfig(pair, b"study", sampling=other))


def test_a_random_campaign_is_what_it_was_before_there_were_others(pair):
    assert "sampling" not in CampaignConfig(pair, b"study").identity
    assert CampaignConfig(pair, b"study", sampling=qj.Random()).identity == CampaignConfig(pair, b"study").identity
    latin = CampaignConfig(pair, b"study", sampling=qj.LatinHypercube(8)).identity["sampling"]
    assert latin == ["LatinHypercube(runs=8)"]
