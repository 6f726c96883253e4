"""Points of the unit cube: pure functions of seed and index, open, and as uniform as they claim."""

import jax.random as jr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.stats import qmc

from qsmc_jax.base.precision import enable_x64
from qsmc_jax.study import sampling
from qsmc_jax.study.sampling import LatinHypercube, Random, Sobol

DESIGNS = pytest.mark.parametrize("design", [Random(), Sobol(), LatinHypercube(5000)], ids=["random", "sobol", "latin"])


def threefry2x32(key, counter):
    """Threefry-2x32-20 in NumPy (Salmon, Moraes, Dror, Shaw 2011); checked by its known-answer vectors below."""
    rotations = [[13, 15, 26, 6], [17, 29, 16, 24]]
    ks = [np.uint32(k) for k in key]
    ks.append(ks[0] ^ ks[1] ^ np.uint32(0x1BD11BDA))
    x, y = (np.atleast_1d(np.asarray(c, np.uint32)) for c in counter)
    x, y = x + ks[0], y + ks[1]
    for i in range(5):
        for r in rotations[i % 2]:
            x = x + y
            y = (y << np.uint32(r) | y >> np.uint32(32 - r)) ^ x
        x, y = x + ks[(i + 1) % 3], y + ks[(i + 2) % 3] + np.uint32(i + 1)
    return x, y


def reference_point(seed, index, dim):
    """Point of `Random` by the definition: key from seed, index folded in word by word, 52 bits a coordinate."""
    key = (seed >> 32, seed & 0xFFFFFFFF)
    for word in (index & 0xFFFFFFFF, index >> 32)[: 1 if index < 2**32 else 2]:
        key = tuple(int(k[0]) for k in threefry2x32(key, (0, word)))
    high, low = threefry2x32(key, (np.zeros(dim), np.arange(dim)))
    bits = high.astype(np.uint64) << np.uint64(32) | low.astype(np.uint64)
    return ((bits >> np.uint64(12)).astype(float) + 0.5) * 2.0**-52


@pytest.mark.filterwarnings("ignore:overflow")
def test_reference_generator_gives_the_published_known_answers():
    # Random123, kat_vectors: threefry2x32 20
    ones = 0xFFFFFFFF
    assert threefry2x32((0, 0), (0, 0)) == (0x6B200159, 0x99BA4EFE)
    assert threefry2x32((ones, ones), (ones, ones)) == (0x1CB996FC, 0xBB002BE7)
    assert threefry2x32((0x13198A2E, 0x03707344), (0x243F6A88, 0x85A308D3)) == (0xC4923A9C, 0x483DF7A0)


@pytest.mark.filterwarnings("ignore:overflow")
@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1))
def test_random_point_is_what_an_independent_generator_gives(seed, index):
    np.testing.assert_array_equal(Random().points(seed, [index], 3), reference_point(seed, index, 3)[None])


def test_random_point_is_fold_in_of_seed_and_index():
    key = jr.fold_in(jr.key(7), 1234)
    np.testing.assert_array_equal(Random().points(7, [1234], 5)[0], jr.uniform(key, (5,), np.float64) + 2.0**-53)


@DESIGNS
def test_points_do_not_depend_on_chunking(design):
    indices = np.arange(2500)
    whole = design.points(3, indices, 4)
    parts = [design.points(3, part, 4) for part in np.split(indices, [1, 17, 1024, 2048])]
    np.testing.assert_array_equal(whole, np.concatenate(parts))


@DESIGNS
def test_points_follow_the_order_of_the_indices(design):
    indices = [4000, 3, 3, 17]
    expected = np.stack([design.points(3, [i], 4)[0] for i in indices])
    np.testing.assert_array_equal(design.points(3, indices, 4), expected)


@DESIGNS
def test_points_depend_on_the_seed(design):
    assert not np.any(design.points(1, range(100), 3) == design.points(2, range(100), 3))


@DESIGNS
def test_points_do_not_collide(design):
    points = design.points(0, range(4096), 2)
    assert len(np.unique(points[:, 0])) == len(np.unique(points[:, 1])) == 4096


@DESIGNS
@pytest.mark.parametrize(("runs", "dim"), [(5, 0), (0, 3), (0, 0)])
def test_empty_sets_have_their_shape(design, runs, dim):
    points = design.points(0, range(runs), dim)
    assert points.shape == (runs, dim)
    assert points.dtype == np.float64


@DESIGNS
def test_points_are_numpy_float64_outside_a_64_bit_context(design):
    inside = design.points(5, range(20), 2)
    with enable_x64(False):
        outside = design.points(5, range(20), 2)
    assert isinstance(outside, np.ndarray)
    np.testing.assert_array_equal(inside, outside)


@pytest.mark.parametrize("seed", range(3))
def test_random_points_are_uniform(seed):
    n, dim = 20_000, 3
    u = Random().points(seed, range(n), dim)
    # mean 1/2, variance 1/12, correlation 0; 5 sigma with n = 20 000
    assert np.all(np.abs(u.mean(axis=0) - 0.5) < 5 * np.sqrt(1 / 12 / n))
    assert np.all(np.abs(u.var(axis=0) - 1 / 12) < 5 * np.sqrt(1 / 180 / n))
    assert np.all(np.abs(np.corrcoef(u.T)[np.triu_indices(dim, 1)]) < 5 / np.sqrt(n))
    assert np.all(stats.kstest(u, "uniform").pvalue > 1e-6)


def test_random_points_of_neighbouring_runs_and_seeds_are_uncorrelated():
    n = 20_000
    u = Random().points(0, range(n), 1)[:, 0]
    other = Random().points(1, range(n), 1)[:, 0]
    # 5 sigma with n = 20 000
    for a, b in ((u[:-1], u[1:]), (u, other)):
        assert abs(np.corrcoef(a, b)[0, 1]) < 5 / np.sqrt(n)


def test_random_indices_that_differ_in_the_high_word_only_give_other_points():
    indices = [5, 5 + 2**32, 5 + 2**33, 5 + 2**62, 2**32, 1]
    assert len(np.unique(Random().points(0, indices, 1))) == len(indices)


def test_random_is_traced_once_a_dimension(monkeypatch):
    traces = []
    point = sampling._random_point
    monkeypatch.setattr(sampling, "_random_point", lambda *a: traces.append(1) or point(*a))
    for seed, runs in ((0, 1), (1, 1024), (2, 3000)):
        Random().points(seed, range(runs), 37)
    assert len(traces) == 1


def test_sobol_agrees_with_scipys_sequence():
    engine = qmc.Sobol(6, scramble=True, bits=32, rng=np.random.default_rng(11))
    np.testing.assert_array_equal(Sobol().points(11, range(1024), 6), engine.random(1024) + 2.0**-33)


def test_sobol_agrees_with_scipy_far_along_the_sequence():
    start = 3_000_017
    engine = qmc.Sobol(6, scramble=True, bits=32, rng=np.random.default_rng(11))
    engine.fast_forward(start)
    np.testing.assert_array_equal(Sobol().points(11, range(start, start + 9), 6), engine.random(9) + 2.0**-33)


def test_sobol_has_one_point_in_each_slice():
    points = Sobol().points(0, range(256), 3)
    np.testing.assert_array_equal(np.sort(np.floor(256 * points), axis=0), np.arange(256.0)[:, None].repeat(3, axis=1))


def test_sobol_discrepancy_is_far_below_random():
    sobol, random = (qmc.discrepancy(design.points(0, range(1024), 2)) for design in (Sobol(), Random()))
    assert sobol < 0.1 * random


@pytest.mark.parametrize("runs", [1, 7, 100])
def test_latin_hypercube_has_one_point_in_each_slice(runs):
    points = LatinHypercube(runs).points(4, range(runs), 3)
    np.testing.assert_array_equal(
        np.sort(np.floor(runs * points), axis=0), np.arange(runs, dtype=float)[:, None].repeat(3, 1)
    )


def test_points_touching_the_cube_are_moved_inside(monkeypatch):
    monkeypatch.setattr(qmc.LatinHypercube, "random", lambda self, n: np.array([[0.0, 1.0]]))
    sampling._latin_hypercube.cache_clear()
    point = LatinHypercube(1).points(987, [0], 2)
    sampling._latin_hypercube.cache_clear()
    assert np.all((point > 0) & (point < 1))


def test_returned_points_may_be_changed():
    design = LatinHypercube(4)
    design.points(0, range(4), 2)[:] = 9.0
    assert np.all(design.points(0, range(4), 2) < 1)


def test_only_random_points_are_independent():
    assert Random().is_independent
    assert not Sobol().is_independent
    assert not LatinHypercube(2).is_independent


@pytest.mark.parametrize("design", [Sobol(), LatinHypercube(2)], ids=["sobol", "latin"])
def test_dependent_designs_say_why_no_interval_holds(design):
    assert "not independent, so no exact interval holds; use `Random()`" in design.why_not


@DESIGNS
@pytest.mark.parametrize("seed", [-1, 2**63])
def test_seed_must_be_in_range(design, seed):
    with pytest.raises(ValueError, match=rf"`seed` must be in \[0, 2\*\*63\), but is {seed}"):
        design.points(seed, [0], 1)


@pytest.mark.parametrize(
    ("design", "limit"),
    [(Random(), 2**63), (Sobol(), 2**32), (LatinHypercube(10), 10)],
    ids=["random", "sobol", "latin"],
)
def test_indices_must_be_in_range(design, limit):
    for index in (-1, limit):
        with pytest.raises(ValueError, match=rf"`indices` must be in \[0, {limit}\) for this design, but has {index}"):
            design.points(0, [index], 1)


def test_indices_must_be_integers():
    with pytest.raises(ValueError, match=r"`indices` must be a one-dimensional list of integers .* type float64"):
        Random().points(0, np.array([0.0, 1.5]), 1)


def test_sobol_has_a_largest_dimension():
    with pytest.raises(ValueError, match="`dim` must be at most 21201 for `Sobol`, but is 21202"):
        Sobol().points(0, [0], 21202)


def test_latin_hypercube_needs_a_run():
    with pytest.raises(ValueError, match="`runs` must be at least 1, but is 0"):
        LatinHypercube(0)
