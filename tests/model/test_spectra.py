"""Roads, gusts and waves against their published spectra, written out here in the variables of their sources."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal
from scipy.integrate import quad

from fake_draw import FakeDraw
from qsmc_jax.base.errors import InputError
from qsmc_jax.model import disturbances as qd

V, L, SIGMA, HS, TP = 60.0, 200.0, 1.5, 2.5, 9.0
WP = 2 * math.pi / TP


def road(n):
    """Class C over the wave number [cycles/m]."""
    return 256e-6 * (n / 0.1) ** -2


def along(k):
    """Dryden over the wave number [rad/m]; MIL-F-8785C."""
    return SIGMA**2 * 2 * L / math.pi / (1 + (L * k) ** 2)


def across(k):
    """In the form of MIL-HDBK-1797, whose scale is half of that of MIL-F-8785C."""
    half = L / 2
    return SIGMA**2 * 2 * half / math.pi * (1 + 12 * (half * k) ** 2) / (1 + 4 * (half * k) ** 2) ** 2


def jonswap(gamma):
    """Over the angular frequency [rad/s], from the sea of Pierson and Moskowitz, A w^-5 exp(-B w^-4)."""

    def density(w):
        calm = 5 / 16 * HS**2 * WP**4 * w**-5.0 * math.exp(-1.25 * (WP / w) ** 4)
        width = 0.07 if w <= WP else 0.09
        return (1 - 0.287 * math.log(gamma)) * calm * gamma ** math.exp(-0.5 * ((w - WP) / (width * WP)) ** 2)

    return density


def made(kind, draw, **options):
    build = {
        "road": lambda: qd.iso8608_road(draw, "d", **{"roughness": "C", "speed": V} | options),
        "along": lambda: qd.dryden_gust(draw, "d", V, L, SIGMA, "longitudinal", **options),
        "across": lambda: qd.dryden_gust(draw, "d", V, L, SIGMA, **options),
        "waves": lambda: qd.jonswap_waves(draw, "d", HS, TP, **options),
        "calm": lambda: qd.jonswap_waves(draw, "d", HS, TP, 1.0, **options),
    }
    return build[kind]()


# Published density, what its variable is of the angular frequency, and the default band in that variable.
PUBLISHED = {
    "road": (road, 1 / (2 * math.pi * V), (0.011, 2.83)),
    "along": (along, 1 / V, (0.02 / L, 50 / L)),
    "across": (across, 1 / V, (0.02 / L, 50 / L)),
    "waves": (jonswap(3.3), 1.0, (0.6 * WP, 4 * WP)),
    "calm": (jonswap(1.0), 1.0, (0.6 * WP, 4 * WP)),
}
each = pytest.mark.parametrize("kind", PUBLISHED)


def power(density, low, high, corner=math.inf):
    """The variance between two values of a density's variable."""
    middle = min(max(low, corner), high)
    return sum(quad(density, *part, limit=200)[0] for part in ((low, middle), (middle, high)))


def variance(d):
    return 0.5 * float(np.sum(np.square(d.amplitudes)))


@eqx.filter_jit
def values(d, ts):
    return jax.vmap(d)(ts)


# Power


@each
def test_the_mean_variance_is_the_integral_of_the_published_spectrum(kind):
    density, _, band = PUBLISHED[kind]
    found = [variance(made(kind, FakeDraw(seed))) for seed in range(400)]
    # A run scatters by 1 to 2 %, so the mean of 400 by 0.1 %.
    assert np.mean(found) == pytest.approx(power(density, *band, WP), rel=5e-3)
    assert np.std(found) < 0.03 * np.mean(found)


@each
def test_no_instant_is_special(kind):
    density, _, band = PUBLISHED[kind]
    # Over the runs: a mean of 400 within 5 of its standard deviations, a variance of 400 within 5 of its.
    starts = [float(made(kind, FakeDraw(seed))(0.0)) for seed in range(400)]
    sigma = math.sqrt(power(density, *band, WP))
    assert abs(np.mean(starts)) < 5 * sigma / 20
    assert np.var(starts) == pytest.approx(sigma**2, rel=5 * math.sqrt(2 / 400))


@each
def test_a_periodogram_follows_the_published_spectrum(kind):
    density, unit, (low, high) = PUBLISHED[kind]
    low, high = math.sqrt(low * high) / 4, math.sqrt(low * high) * 4
    option = "wave_numbers" if kind == "road" else "band"
    units = {"road": 1.0, "waves": WP, "calm": WP}.get(kind, 1 / L)
    draws = [made(kind, FakeDraw(seed), **{option: (low / units, high / units)}) for seed in range(150)]
    cycles = 1 / (2 * math.pi * unit)
    ts = np.arange(0.0, 80 / (low * cycles), 1 / (4 * high * cycles))
    runs = [signal.periodogram(values(d, ts), 4 * high * cycles, "hann") for d in draws]
    found, mean = runs[0][0] / cycles, np.mean([run[1] for run in runs], axis=0)
    edges = np.geomspace(1.1 * low, high / 1.1, 6)
    parts = list(zip(edges, edges[1:], strict=False))
    powers = [mean[(a <= found) & (found < b)].sum() * runs[0][0][1] for a, b in parts]
    # Some nine lines a run lie in each part; edges are blurred by the window.
    np.testing.assert_allclose(powers, [power(density, a, b, WP) for a, b in parts], rtol=0.03)


@pytest.mark.parametrize(("roughness", "size"), [(c, 16e-6 * 4.0**k) for k, c in enumerate("ABCDEFGH")])
def test_a_class_of_road_has_its_geometric_mean_at_a_tenth_of_a_cycle_a_metre(roughness, size):
    d = qd.iso8608_road(FakeDraw(), "d", roughness, 20.0, wave_numbers=(0.0999, 0.1001))
    assert variance(d) / 0.0002 == pytest.approx(size, rel=1e-4)


def test_a_roughness_may_be_a_number():
    by_class, by_number = (qd.iso8608_road(FakeDraw(), "d", each, 20.0) for each in ("D", 1024e-6))
    np.testing.assert_allclose(by_class.amplitudes, by_number.amplitudes, rtol=1e-15)


def test_a_road_is_the_same_at_any_speed_but_passes_faster():
    slow, fast = (qd.iso8608_road(FakeDraw(), "d", "C", speed) for speed in (10.0, 30.0))
    assert float(fast(0.7)) == pytest.approx(float(slow(2.1)), abs=1e-12)


@pytest.mark.parametrize("component", ["longitudinal", "lateral", "vertical"])
def test_a_gust_has_its_whole_intensity_on_a_wide_band(component):
    # Both tails together have less than 1e-4 of it.
    d = qd.dryden_gust(FakeDraw(), "d", V, L, SIGMA, component, band=(1e-5, 1e5), terms=2000)
    assert variance(d) == pytest.approx(SIGMA**2, rel=1e-3)


@pytest.mark.parametrize("gamma", [1.0, 2.0, 3.3, 5.0, 7.0])
def test_the_significant_height_is_four_times_the_root_mean_square(gamma):
    d = qd.jonswap_waves(FakeDraw(), "d", HS, TP, gamma, band=(0.3, 20.0), terms=2000)
    # The normalising factor of DNV-RP-C205 is fitted: 0.9 % of the height at 7, less below.
    assert 4 * math.sqrt(variance(d)) == pytest.approx(HS, rel=0.01 if gamma == 7.0 else 0.003)


@pytest.mark.parametrize("gamma", [1.0, 3.3, 7.0])
def test_waves_peak_at_their_period(gamma):
    d = qd.jonswap_waves(FakeDraw(), "d", HS, TP, gamma, terms=2000)
    # Cells are as wide as their frequency allows: the power of a line is in proportion to S w, nearly.
    peak = np.argmax(np.square(d.amplitudes) / d.frequencies)
    assert 2 * math.pi / d.frequencies[peak] == pytest.approx(TP, rel=0.03)


def test_peakedness_one_is_the_sea_of_pierson_and_moskowitz():
    # Whose variance below x times the peak is exp(-1.25 x^-4) of all, Hs^2 / 16.
    d = qd.jonswap_waves(FakeDraw(), "d", HS, TP, 1.0, band=(0.8, 1.5), terms=2000)
    share = math.exp(-1.25 / 1.5**4) - math.exp(-1.25 / 0.8**4)
    assert variance(d) == pytest.approx(share * HS**2 / 16, rel=1e-3)


def test_a_spectrum_of_ones_own_may_be_one_number():
    d = qd.random_spectrum(FakeDraw(), "d", lambda w: 0.5, (1.0, 9.0), terms=16)
    assert variance(d) == pytest.approx(0.5 * 8.0, rel=1e-14)


# Lines, bound, names


@each
def test_there_is_one_line_in_each_of_the_cells_of_equal_ratio(kind):
    _, unit, band = PUBLISHED[kind]
    d = made(kind, FakeDraw(), terms=20)
    share = np.log(d.frequencies * unit / band[0]) / np.log(band[1] / band[0])
    assert np.floor(20 * share).tolist() == list(range(20))


@each
@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), ts=st.lists(st.floats(0.0, 1e3), min_size=8, max_size=8))
def test_the_bound_is_never_exceeded_and_no_more_than_the_terms_allow(kind, seed, ts):
    d = made(kind, FakeDraw(seed))
    assert np.all(np.abs(values(d, np.array(ts))) <= float(d.bound) * (1 + 1e-12))
    assert float(d.bound) == pytest.approx(np.sum(d.amplitudes), rel=1e-14)
    assert float(d.bound) <= math.sqrt(2 * 48 * variance(d))


@each
def test_the_same_draw_gives_the_same_disturbance_under_the_given_names(kind):
    draws = FakeDraw(3), FakeDraw(3), FakeDraw(4)
    first, again, other = (made(kind, draw) for draw in draws)
    assert bool(eqx.tree_equal(first, again))
    assert not bool(eqx.tree_equal(first, other))
    assert draws[0].names == ["d.frequency", "d.phase"]


TRACED = {
    "speed": (lambda v: qd.iso8608_road(FakeDraw(), "d", "C", v), 15.0),
    "roughness": (lambda size: qd.iso8608_road(FakeDraw(), "d", size, 15.0), 64e-6),
    "airspeed": (lambda v: qd.dryden_gust(FakeDraw(), "d", v, L, SIGMA), V),
    "scale": (lambda scale: qd.dryden_gust(FakeDraw(), "d", V, scale, SIGMA), L),
    "intensity": (lambda sigma: qd.dryden_gust(FakeDraw(), "d", V, L, sigma), SIGMA),
    "height": (lambda height: qd.jonswap_waves(FakeDraw(), "d", height, TP), HS),
    "period": (lambda period: qd.jonswap_waves(FakeDraw(), "d", HS, period), TP),
    "peakedness": (lambda gamma: qd.jonswap_waves(FakeDraw(), "d", HS, TP, gamma), 2.0),
    "lowest frequency": (lambda low: qd.random_spectrum(FakeDraw(), "d", lambda w: 1 / w, (low, 9.0)), 1.0),
}


@pytest.mark.parametrize(("build", "value"), TRACED.values(), ids=TRACED)
def test_what_may_be_drawn_may_be_traced_and_has_a_derivative(build, value):
    found, slope = jax.jit(jax.value_and_grad(lambda x: build(x)(1.3)))(jnp.asarray(value))
    assert float(found) == pytest.approx(float(build(value)(1.3)), rel=1e-11)
    step = 1e-6 * value
    difference = (float(build(value + step)(1.3)) - float(build(value - step)(1.3))) / (2 * step)
    assert float(slope) == pytest.approx(difference, rel=1e-6)


# Refusals

REFUSED = {
    "unknown class": (lambda d: qd.iso8608_road(d, "d", "K", 15.0), "`roughness` must be a class, but is 'K'"),
    "two classes": (lambda d: qd.iso8608_road(d, "d", "AB", 15.0), "`roughness` must be a class, but is 'AB'"),
    "no roughness": (lambda d: qd.iso8608_road(d, "d", 0.0, 15.0), "`roughness` must be positive"),
    "standing": (lambda d: qd.iso8608_road(d, "d", "C", 0.0), "`speed` must be positive"),
    "waves upside down": (lambda d: qd.iso8608_road(d, "d", "C", 15.0, (3.0, 0.01)), "`wave_numbers` must have low <"),
    "infinite waves": (lambda d: qd.iso8608_road(d, "d", "C", 15.0, (0.01, math.inf)), "`wave_numbers` must be posit"),
    "unknown component": (lambda d: qd.dryden_gust(d, "d", V, L, 1.0, "vertica"), "Did you mean `vertical`?"),
    "no airspeed": (lambda d: qd.dryden_gust(d, "d", 0.0, L, 1.0), "`airspeed` must be positive"),
    "no scale": (lambda d: qd.dryden_gust(d, "d", V, -1.0, 1.0), "`scale` must be positive"),
    "no intensity": (lambda d: qd.dryden_gust(d, "d", V, L, 0.0), "`intensity` must be positive"),
    "gusts upside down": (lambda d: qd.dryden_gust(d, "d", V, L, 1.0, band=(9.0, 1.0)), "`band` must have low < high"),
    "negative height": (lambda d: qd.jonswap_waves(d, "d", -1.0, TP), "`height` must be positive"),
    "no period": (lambda d: qd.jonswap_waves(d, "d", HS, 0.0), "`period` must be positive"),
    "flat peak": (lambda d: qd.jonswap_waves(d, "d", HS, TP, 0.5), "`peakedness` must lie between 1 and 7, but is 0.5"),
    "sharp peak": (lambda d: qd.jonswap_waves(d, "d", HS, TP, 8.0), "`peakedness` must lie between 1 and 7, but is 8"),
    "band from zero": (lambda d: qd.jonswap_waves(d, "d", HS, TP, band=(0.0, 4.0)), "`band` must be positive"),
    "no terms": (lambda d: qd.jonswap_waves(d, "d", HS, TP, terms=0), "`terms` must be at least 1, but is 0"),
    "negative power": (lambda d: qd.random_spectrum(d, "d", lambda w: -w, (1.0, 2.0)), "`density` must be finite and"),
    "point band": (lambda d: qd.random_spectrum(d, "d", lambda w: w, (1.0, 1.0)), "`frequencies` must have low < high"),
}


@pytest.mark.parametrize(("call", "message"), REFUSED.values(), ids=REFUSED)
def test_a_wrong_argument_is_named(call, message):
    with pytest.raises(InputError, match=message.replace("?", r"\?")):
        call(FakeDraw())
