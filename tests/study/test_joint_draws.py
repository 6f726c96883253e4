"""Numbers drawn together: rows of data, correlated normals, a Gaussian copula."""

import jax
import numpy as np
import pytest
from scipy import stats

import qsmc_jax as qj
from qsmc_jax.study.draw import discover
from qsmc_jax.study.specs import check_values

ROWS = [[3.0, 0.4], [7.0, 1.5], [5.0, 1.1], [5.0, 0.9]]
MEAN, COVARIANCE = [1.0, -2.0, 1e3], np.array([[4.0, 1.2, -0.3], [1.2, 1.0, 0.1], [-0.3, 0.1, 0.25]])
CORRELATION = np.array([[1.0, 0.8, -0.3], [0.8, 1.0, 0.2], [-0.3, 0.2, 1.0]])


def together(draw):
    """Three numbers of different distributions under a copula, and one beside."""
    before = draw.uniform("before", 0.0, 1.0)
    with draw.gaussian_copula(CORRELATION):
        mass, drag = draw.uniform("mass", 1.0, 2.0), draw.gamma("drag", 2.5, 0.3)
        load = draw.choice("load", [1.0, 2.0, 5.0], [1, 1, 2])
    return before, mass, drag, load, draw.uniform("after", 0.0, 1.0)


def test_rows_of_data_are_equally_likely_and_stay_together():
    u = (np.arange(8) + 0.5) / 8
    rows = qj.Draw(u).empirical("wave", ROWS, shape=(8,))
    np.testing.assert_array_equal(rows, np.repeat([[3.0, 0.4], [5.0, 0.9], [5.0, 1.1], [7.0, 1.5]], 2, axis=0))
    np.testing.assert_array_equal(jax.jit(lambda u: qj.Draw(u).empirical("wave", ROWS, shape=(8,)))(u), rows)


def test_a_row_takes_one_coordinate_and_a_column_for_each_number():
    specs, _ = discover(lambda d: (d.empirical("wave", ROWS), d.empirical("gap", [2.0, 1.0]), d.sign("side")))
    assert [(s.columns, s.start, s.size) for s in specs] == [
        (("wave[0]", "wave[1]"), 0, 1),
        (("gap",), 1, 1),
        (("side",), 2, 1),
    ]


def test_the_covariance_is_that_of_the_linear_map():
    """x = mean + L z with L L^T the covariance: columns of L are what unit steps of single scores do."""
    names = ["a", "b", "c"]

    def value(z):
        draw = qj.Draw(jax.scipy.special.ndtr(z))
        return jax.numpy.stack(draw.multivariate_normal(names, MEAN, COVARIANCE))

    origin, factor = jax.jit(lambda z: (value(z), jax.jacfwd(value)(z + 0.7)))(np.zeros(3))
    np.testing.assert_allclose(origin, MEAN, rtol=1e-15)
    np.testing.assert_allclose(factor @ factor.T, COVARIANCE, rtol=1e-13, atol=1e-14)
    specs, _ = discover(lambda d: d.multivariate_normal(names, MEAN, COVARIANCE))
    assert [(s.name, s.start, s.size) for s in specs] == [("a", 0, 1), ("b", 1, 1), ("c", 2, 1)]


def test_a_fixed_name_does_not_move_the_others():
    point, names = np.array([0.2, 0.6, 0.9]), ["a", "b", "c"]
    free = qj.Draw(point).multivariate_normal(names, MEAN, COVARIANCE)
    fixed = qj.Draw(point, {"a": np.float64(5.0)}).multivariate_normal(names, MEAN, COVARIANCE)
    assert fixed == (5.0, *free[1:])
    fixed = together(qj.Draw(np.full(5, 0.3), {"mass": np.float64(1.5)}))
    assert fixed[2:] == together(qj.Draw(np.full(5, 0.3)))[2:]


def test_numbers_under_a_copula_are_scipys_quantiles_of_correlated_scores():
    """Against the definition, with SciPy's normal and gamma distributions."""
    point = np.array([0.1, 0.9, 0.35, 0.6, 0.7])
    u = stats.norm.cdf(np.linalg.cholesky(CORRELATION) @ stats.norm.ppf(point[1:4]))
    exact = [0.1, 1.0 + u[0], stats.gamma(2.5, scale=0.3).ppf(u[1]), 1.0 if u[2] < 0.25 else 2.0 if u[2] < 0.5 else 5.0]
    np.testing.assert_allclose(together(qj.Draw(point)), [*exact, 0.7], rtol=1e-12)
    np.testing.assert_allclose(jax.jit(lambda point: together(qj.Draw(point)))(point), [*exact, 0.7], rtol=1e-12)


def test_single_numbers_under_a_copula_keep_their_distribution_and_have_its_rank_correlation():
    """Over 4096 scrambled Sobol points: means to 1e-3, Spearman's 6/pi asin(rho/2) to 5e-3."""
    points = qj.Sobol().points(0, range(4096), 5)
    _, mass, drag, load, _ = jax.jit(jax.vmap(lambda point: together(qj.Draw(point))))(points)
    assert np.mean(mass) == pytest.approx(1.5, abs=1e-3)
    assert np.mean(drag) == pytest.approx(0.75, abs=1e-3)
    assert np.mean(load == 5.0) == pytest.approx(0.5, abs=2e-3)
    assert stats.spearmanr(mass, drag).statistic == pytest.approx(6 / np.pi * np.arcsin(0.4), abs=5e-3)


def test_an_array_may_be_drawn_under_a_copula():
    def drawn(draw):
        with draw.gaussian_copula(CORRELATION):
            return draw.normal("x0", 0.0, 1.0, shape=(3,))

    point = np.array([0.9, 0.35, 0.6])
    exact = np.linalg.cholesky(CORRELATION) @ stats.norm.ppf(point)
    np.testing.assert_allclose(drawn(qj.Draw(point)), exact, rtol=1e-13)


def test_a_number_drawn_together_with_others_can_be_substituted():
    specs, _ = discover(lambda d: d.empirical("wave", ROWS))
    assert check_values(specs, {"wave": [4.0, 1.0]})["wave"].tolist() == [4.0, 1.0]


def under(matrix, count=2):
    """Draws some numbers under a copula."""

    def scenario(draw):
        with draw.gaussian_copula(matrix):
            return [draw.uniform(f"a{i}", 0.0, 1.0) for i in range(count)]

    return scenario


def nested(draw):
    with draw.gaussian_copula(np.eye(2)), draw.gaussian_copula(np.eye(2)):
        pass


def traced(draw):
    rho = draw.uniform("rho", 0.0, 0.5)
    with draw.gaussian_copula(np.eye(2) + rho * np.array([[0.0, 1.0], [1.0, 0.0]])):
        draw.uniform("a", 0.0, 1.0, shape=(2,))


def normals(mean=(0.0, 0.0), covariance=((1.0, 0.0), (0.0, 1.0)), names=("a", "b")):
    return lambda d: d.multivariate_normal(list(names), list(mean), np.array(covariance))


REFUSED = {
    "rows empty": (lambda d: d.empirical("a", np.empty((0, 2))), r"`rows` of `a` must be numbers, or rows of them"),
    "rows nan": (lambda d: d.empirical("a", [1.0, np.nan]), "`rows` of `a` must be finite"),
    "mean short": (normals(mean=[0.0]), r"`mean` of `a, b` must have shape \(2,\)"),
    "mean nan": (normals(mean=[0.0, np.nan]), "`mean` of `b` must be finite, but is nan"),
    "covariance shape": (
        normals(covariance=np.eye(3)),
        r"`covariance` of `a, b` must be a matrix of 2 rows and columns",
    ),
    "covariance nan": (normals(covariance=[[np.nan, 0], [0, 1]]), "`covariance` of `a, b` must be finite"),
    "asymmetric": (normals(covariance=[[1, 0.5], [0.4, 1]]), "`covariance` of `a, b` must be symmetric"),
    "indefinite": (normals(covariance=[[1, 2], [2, 1]]), "must be positive definite, but its least eigenvalue is -1"),
    "names twice": (normals(names=["a", "a"]), "must be new in the scenario, but is `a` a second time"),
    "beyond 1": (under([[1, 1.5], [1.5, 1]]), r"`correlation` must have entries in \[-1, 1\]"),
    "correlation nan": (under([[1, np.nan], [np.nan, 1]]), r"`correlation` must have entries in \[-1, 1\]"),
    "diagonal": (under([[1, 0.5], [0.5, 0.9]]), "`correlation` must have 1 on its diagonal"),
    "no matrix": (under([1.0, 1.0]), "`correlation` must be a square matrix"),
    "correlation asymmetric": (under([[1, 0.5], [0.4, 1]]), "`correlation` must be symmetric"),
    "indefinite correlation": (under([[1, 1], [1, 1]]), "`correlation` must be positive definite"),
    "too few drawn": (under(np.eye(3)), "must have a row for every number that is drawn under it, but has 1 more"),
    "too many drawn": (under(np.eye(2), 3), "but has 2: too few for `a2`"),
    "nested": (nested, "must not stand under another"),
    "traced": (traced, "`correlation` must be fixed, but depends on other names"),
}


@pytest.mark.parametrize(("call", "message"), REFUSED.values(), ids=REFUSED)
def test_what_has_no_meaning_is_refused_by_name(call, message):
    with pytest.raises(qj.InputError, match=message):
        discover(call)


def test_a_matrix_that_numpy_worked_out_is_taken():
    """Its diagonal and symmetry are right to rounding."""
    data = np.random.default_rng(3).normal(size=(50, 3)) @ np.linalg.cholesky(COVARIANCE).T
    discover(under(np.corrcoef(data.T), 3))
    discover(normals(mean=[0.0] * 3, covariance=np.cov(data.T), names=["a", "b", "c"]))
