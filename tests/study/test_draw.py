"""Draws: values against SciPy's distributions, names, substitution and messages."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy import stats

from qsmc_jax.base.precision import enable_x64
from qsmc_jax.study.draw import Draw, discover
from qsmc_jax.study.specs import check_values, dimension, require_new_name

GUMBEL = stats.gumbel_r(8.0, 2.0)
# what is drawn, SciPy's distribution, and the bounds
DISTRIBUTIONS = {
    "uniform": (lambda d, **k: d.uniform("a", -2.0, 3.0, **k), stats.uniform(-2.0, 5.0), (-2.0, 3.0)),
    "log_uniform": (lambda d, **k: d.log_uniform("a", 1e-3, 10.0, **k), stats.loguniform(1e-3, 10.0), (1e-3, 10.0)),
    "normal": (lambda d, **k: d.normal("a", 1.0, 0.5, **k), stats.norm(1.0, 0.5), (-np.inf, np.inf)),
    "truncated_normal": (
        lambda d, **k: d.truncated_normal("a", 1.0, 0.5, 0.9, 3.0, **k),
        stats.truncnorm(-0.2, 4.0, 1.0, 0.5),
        (0.9, 3.0),
    ),
    "truncated_normal lower tail": (
        lambda d, **k: d.truncated_normal("a", 0.0, 1.0, -9.0, -8.0, **k),
        stats.truncnorm(-9.0, -8.0),
        (-9.0, -8.0),
    ),
    "truncated_normal upper tail": (
        lambda d, **k: d.truncated_normal("a", 0.0, 1.0, 12.0, 40.0, **k),
        stats.truncnorm(12.0, 40.0),
        (12.0, 40.0),
    ),
    "triangular": (lambda d, **k: d.triangular("a", 1.0, 1.5, 4.0, **k), stats.triang(1 / 6, 1.0, 3.0), (1.0, 4.0)),
    "triangular left": (lambda d, **k: d.triangular("a", 1.0, 1.0, 4.0, **k), stats.triang(0, 1.0, 3.0), (1.0, 4.0)),
    "triangular right": (lambda d, **k: d.triangular("a", 1.0, 4.0, 4.0, **k), stats.triang(1, 1.0, 3.0), (1.0, 4.0)),
    "exponential": (lambda d, **k: d.exponential("a", 0.3, **k), stats.expon(scale=0.3), (0.0, np.inf)),
    "lognormal": (lambda d, **k: d.lognormal("a", 2.0, 0.3, **k), stats.lognorm(0.3, scale=2.0), (0.0, np.inf)),
    "weibull": (lambda d, **k: d.weibull("a", 1.7, 0.3, **k), stats.weibull_min(1.7, scale=0.3), (0.0, np.inf)),
    "gamma": (lambda d, **k: d.gamma("a", 2.5, 0.3, **k), stats.gamma(2.5, scale=0.3), (0.0, np.inf)),
    "gamma steep": (lambda d, **k: d.gamma("a", 0.2, 0.3, **k), stats.gamma(0.2, scale=0.3), (0.0, np.inf)),
    "beta": (lambda d, **k: d.beta("a", 2.0, 5.0, -1.0, 3.0, **k), stats.beta(2.0, 5.0, -1.0, 4.0), (-1.0, 3.0)),
    "beta at both ends": (lambda d, **k: d.beta("a", 0.5, 0.4, **k), stats.beta(0.5, 0.4), (0.0, 1.0)),
    "from_scipy": (lambda d, **k: d.from_scipy("a", GUMBEL, **k), GUMBEL, (-np.inf, np.inf)),
}
CONTINUOUS = pytest.mark.parametrize(("draw_one", "truth", "bounds"), DISTRIBUTIONS.values(), ids=DISTRIBUTIONS.keys())


@CONTINUOUS
def test_value_is_scipys_quantile(draw_one, truth, bounds):
    u = np.array([1e-12, 0.03, 0.2, 0.5, 0.8, 0.99, 1 - 1e-9])
    np.testing.assert_allclose(draw_one(Draw(u), shape=(7,)), truth.ppf(u), rtol=1e-9)


@CONTINUOUS
def test_ends_of_the_cube_give_finite_values_within_bounds(draw_one, truth, bounds):
    value = draw_one(Draw(np.array([0.0, 1.0, 5e-324, np.nextafter(1.0, 0.0)])), shape=(4,))
    assert np.all(np.isfinite(value) & (bounds[0] <= value) & (value <= bounds[1]))


@CONTINUOUS
def test_traced_value_is_scipys_quantile_and_has_its_slope(draw_one, truth, bounds):
    u = np.array([1e-6, 0.1, 0.3, 0.5, 0.9])
    one = jax.value_and_grad(lambda point: draw_one(Draw(point[None])))
    value, slope = jax.jit(jax.vmap(one))(u)
    np.testing.assert_allclose(value, truth.ppf(u), rtol=1e-9)
    np.testing.assert_allclose(slope, 1 / truth.pdf(truth.ppf(u)), rtol=1e-7)


@CONTINUOUS
def test_traced_ends_of_the_cube_give_finite_values_within_bounds(draw_one, truth, bounds):
    value = jax.jit(jax.vmap(lambda point: draw_one(Draw(point))))(np.array([[0.0], [1.0], [5e-324]]))
    assert np.all(np.isfinite(value) & (bounds[0] <= value) & (value <= bounds[1]))


@CONTINUOUS
def test_spec_holds_bounds_and_median(draw_one, truth, bounds):
    (spec,), _ = discover(draw_one)
    assert spec.bounds == bounds
    assert float(spec.nominal) == pytest.approx(truth.median(), rel=1e-12)


@given(st.floats(-1e6, 1e6), st.floats(1e-9, 1e6), st.floats(0.0, 1.0))
@example(0.1, 0.2, 1.0)
def test_uniform_stays_within_bounds_whatever_they_are(low, width, u):
    high = low + width
    assert low <= Draw(np.array([u])).uniform("a", low, high) <= high


def test_choice_gives_each_value_the_same_share():
    u = (np.arange(6) + 0.5) / 6
    value = Draw(u).choice("a", [3.0, 1.0, 2.0], shape=(6,))
    np.testing.assert_array_equal(value, [3, 3, 1, 1, 2, 2])


def test_traced_choice_gives_each_value_the_same_share():
    value = jax.jit(lambda u: Draw(u).choice("a", [3.0, 1.0, 2.0], shape=(6,)))((np.arange(6) + 0.5) / 6)
    np.testing.assert_array_equal(value, [3, 3, 1, 1, 2, 2])


def test_choice_at_the_end_of_the_cube_is_the_last_value():
    assert Draw(np.array([1.0])).choice("a", [3.0, 1.0, 2.0]) == 2.0


def test_sign_is_minus_then_plus():
    np.testing.assert_array_equal(Draw(np.array([0.0, 0.49, 0.51, 1.0])).sign("a", shape=(4,)), [-1, -1, 1, 1])


def test_numbers_are_numpy_float64_even_outside_a_64_bit_context():
    with enable_x64(False):
        value = Draw(np.array([0.3])).uniform("a", 0.0, 1.0)
    assert isinstance(value, np.float64)
    assert value == 0.3


def test_a_fixed_point_can_be_drawn_while_something_else_is_traced():
    def doubled(mu):
        draw = Draw(np.array([0.25]), {"mu": mu})
        return draw.parameter("mu", 3.0, bounds=(0.5, 10.0)) * draw.uniform("a", 0.0, 4.0)

    assert jax.jit(jax.value_and_grad(doubled))(5.0) == (5.0, 1.0)


def scenario(draw):
    """One draw of each shape around a parameter."""
    mass = draw.uniform("mass", 0.008, 0.012)
    mu = draw.parameter("mu", 3.0, bounds=(0.5, 10.0))
    x0 = draw.uniform("x0", 0.0, 1.0, shape=(2,))
    table = draw.normal("table", 0.0, 1.0, shape=(2, 3))
    return mass, mu, x0, table, draw.sign("side")


def test_discover_allots_coordinates_in_order_of_appearance():
    specs, _ = discover(scenario)
    found = [(s.name, s.kind, s.shape, s.start, s.size) for s in specs]
    assert found == [
        ("mass", "uniform", (), 0, 1),
        ("mu", "parameter", (), 1, 0),
        ("x0", "uniform", (2,), 1, 2),
        ("table", "normal", (2, 3), 3, 6),
        ("side", "sign", (), 9, 1),
    ]
    assert dimension(specs) == 10


def test_discover_names_one_column_an_entry():
    specs, _ = discover(scenario)
    assert [s.columns for s in specs[:3]] == [("mass",), ("mu",), ("x0[0]", "x0[1]")]
    assert specs[3].columns == ("table[0,0]", "table[0,1]", "table[0,2]", "table[1,0]", "table[1,1]", "table[1,2]")


def test_discover_returns_the_scenario_at_medians_and_defaults():
    specs, (mass, mu, x0, table, side) = discover(scenario)
    assert (mass, mu, side) == (0.01, 3.0, 1.0)
    np.testing.assert_array_equal(x0, [0.5, 0.5])
    np.testing.assert_array_equal(table, np.zeros((2, 3)))
    assert all(isinstance(value, np.float64) for value in (mass, mu, side))
    np.testing.assert_array_equal(specs[2].nominal, x0)


def test_specs_are_hashable_values():
    assert hash(discover(scenario)[0]) == hash(discover(scenario)[0])
    assert discover(scenario)[0] == discover(scenario)[0]


def test_coordinates_go_to_their_names_in_c_order():
    point = (np.arange(10) + 0.5) / 10
    _, _, x0, table, side = scenario(Draw(point))
    np.testing.assert_allclose(x0, point[1:3])
    np.testing.assert_allclose(table, stats.norm.ppf(point[3:9]).reshape(2, 3), rtol=1e-14, atol=1e-15)
    assert side == 1.0


def test_record_holds_every_value_in_order():
    draw = Draw(np.full(10, 0.5), {"mu": 2.0})
    scenario(draw)
    assert list(draw.recorded) == ["mass", "mu", "x0", "table", "side"]
    assert draw.recorded["mu"] == 2.0


def derived(draw):
    side = draw.uniform("side", 1.0, 3.0, shape=(2,))
    area = draw.record("area", side[0] * side[1])
    return side, area, draw.record("squares", side**2), draw.uniform("after", 0.0, 1.0)


def test_what_is_recorded_is_told_and_takes_no_coordinate():
    point = np.array([0.5, 1.0, 0.25])
    side, area, squares, after = derived(Draw(point))
    assert (area, after) == pytest.approx((6.0, 0.25), rel=1e-15)
    np.testing.assert_array_equal(squares, side**2)
    specs, _ = discover(derived)
    assert [(s.name, s.columns, s.size) for s in specs[1:3]] == [
        ("area", ("area",), 0),
        ("squares", ("squares[0]", "squares[1]"), 0),
    ]
    assert dimension(specs) == 3


def test_what_is_recorded_can_not_be_chosen():
    specs, _ = discover(derived)
    with pytest.raises(ValueError, match="Name `area` can't be given a value: the scenario works it out"):
        check_values(specs, {"area": 2.0})
    with pytest.raises(ValueError, match="must be new in the scenario, but is `side` a second time"):
        discover(lambda draw: draw.record("side", draw.uniform("side", 0.0, 1.0)))


def test_substitution_moves_nothing_else():
    point = np.linspace(0.05, 0.95, 10)
    mass, mu, x0, table, side = scenario(Draw(point))
    new = scenario(Draw(point, {"x0": np.array([0.1, 0.2]), "mu": 7.0}))
    np.testing.assert_array_equal(new[2], [0.1, 0.2])
    assert (new[0], new[1], new[4]) == (mass, 7.0, side)
    np.testing.assert_array_equal(new[3], table)


def hierarchical(draw):
    """Bounds and levels that depend on earlier draws."""
    width = draw.uniform("width", 1.0, 2.0)
    shift = draw.parameter("shift", 0.5, bounds=(0.0, 1.0))
    inner = draw.uniform("inner", 0.0, width)
    level = draw.choice("level", [shift, width])
    return inner, level, draw.truncated_normal("noise", shift, width, -1.0, 1.0), draw.exponential("gap", width)


def test_bounds_that_depend_on_other_names_are_open():
    specs, _ = discover(hierarchical)
    bounds = [spec.bounds for spec in specs]
    free = (-np.inf, np.inf)
    assert bounds == [(1.0, 2.0), (0.0, 1.0), free, free, (-1.0, 1.0), (0.0, np.inf)]
    assert specs[3].levels == ()


def test_hierarchical_draws_use_the_drawn_arguments():
    point = np.array([0.5, 0.25, 0.9, 0.5, 0.5])
    traced = jax.jit(lambda point, values: hierarchical(Draw(point, values)))(point, {"shift": np.array(0.5)})
    np.testing.assert_allclose(traced, hierarchical(Draw(point)), rtol=1e-14)
    assert float(traced[0]) == pytest.approx(0.375)


def test_triangular_has_a_finite_gradient_in_its_arguments():
    def median(low, mode, high):
        return Draw(np.array([0.5])).triangular("a", low, mode, high)

    assert np.all(np.isfinite(jax.jit(jax.grad(median, argnums=(0, 1, 2)))(0.0, 0.0, 1.0)))


BAD_CALLS = {
    "uniform reversed": (
        lambda d: d.uniform("a", 2.0, 1.0),
        r"`low` of `a` must be below `high`, but is 2 \(`high` is 1",
    ),
    "uniform empty": (lambda d: d.uniform("a", 1.0, 1.0), r"`low` of `a` must be below `high`, but is 1 \(`high` is 1"),
    "uniform nan": (lambda d: d.uniform("a", float("nan"), 1.0), "`low` of `a` must be finite, but is nan"),
    "uniform inf": (lambda d: d.uniform("a", 0.0, float("inf")), "`high` of `a` must be finite, but is inf"),
    "log_uniform zero": (lambda d: d.log_uniform("a", 0.0, 1.0), "`low` of `a` must be positive and finite, but is 0"),
    "log_uniform reversed": (lambda d: d.log_uniform("a", 2.0, 1.0), "`low` of `a` must be below `high`"),
    "normal mean": (lambda d: d.normal("a", float("inf"), 1.0), "`mean` of `a` must be finite, but is inf"),
    "normal std": (lambda d: d.normal("a", 0.0, 0.0), "`std` of `a` must be positive and finite, but is 0"),
    "truncated std": (lambda d: d.truncated_normal("a", 0.0, -1.0, 0.0, 1.0), "`std` of `a` must be positive"),
    "truncated reversed": (lambda d: d.truncated_normal("a", 0.0, 1.0, 1.0, 0.0), "`low` of `a` must be below"),
    "truncated far": (
        lambda d: d.truncated_normal("a", 0.0, 1.0, 37.5, 50.0),
        r"`mean` of `a` must be within 37 standard deviations of \[low, high\], but is 37.5 away",
    ),
    "triangular mode": (lambda d: d.triangular("a", 0.0, 1.5, 1.0), r"`mode` of `a` must lie in \[0, 1\], but is 1.5"),
    "exponential": (lambda d: d.exponential("a", 0.0), "`mean` of `a` must be positive and finite, but is 0"),
    "choice empty": (
        lambda d: d.choice("a", []),
        r"`values` of `a` must be a list of at least one number, but has shape \(0,\)",
    ),
    "choice nan": (lambda d: d.choice("a", [1.0, float("nan")]), "`values` of `a` must be finite"),
    "parameter outside": (
        lambda d: d.parameter("a", 12.0, bounds=(0.5, 10.0)),
        r"`default` of `a` must lie in \[0.5, 10\], but is 12",
    ),
    "parameter reversed": (
        lambda d: d.parameter("a", 1.0, bounds=(10.0, 0.5)),
        r"`bounds\[0\]` of `a` must be below `bounds\[1\]`, but is 10",
    ),
    "parameter nan": (lambda d: d.parameter("a", float("nan"), bounds=(0.0, 1.0)), "`default` of `a` must be finite"),
    "empty name": (lambda d: d.uniform("", 0.0, 1.0), "`name` must be a string that is not empty, but is ''"),
    "second time": (
        lambda d: (d.uniform("a", 0.0, 1.0), d.normal("a", 0.0, 1.0)),
        "`name` must be new in the scenario, but is `a` a second time",
    ),
}


@pytest.mark.parametrize(("call", "message"), BAD_CALLS.values(), ids=BAD_CALLS.keys())
def test_wrong_arguments_are_named(call, message):
    with pytest.raises(ValueError, match=message):
        discover(call)


def test_a_name_must_be_a_string():
    with pytest.raises(ValueError, match="`name` must be a string that is not empty, but is 3"):
        require_new_name(3, {})


def test_the_ends_of_the_bounds_belong_to_them():
    (spec,), _ = discover(lambda draw: draw.parameter("a", 0.5, bounds=(0.5, 10.0)))
    assert check_values((spec,), {"a": 10.0}) == {"a": 10.0}


def test_a_point_must_have_every_coordinate():
    with pytest.raises(ValueError, match="`point` must have at least 3 coordinates when `x0` is drawn, but has 2"):
        scenario(Draw(np.full(2, 0.5)))


FUNNEL = discover(
    lambda d: (
        d.parameter("rho_inf", 0.05, bounds=(0.005, 0.09)),
        d.normal("bias", 0.0, 1.0),
        d.uniform("x0", 0.0, 1.0, shape=(2,)),
        d.sign("side"),
    )
)[0]


def test_checked_values_are_float64_arrays():
    values = check_values(FUNNEL, {"rho_inf": np.float32(0.0625), "x0": [0, 1], "side": -1})
    assert {name: (v.dtype, v.shape) for name, v in values.items()} == {
        "rho_inf": (np.float64, ()),
        "x0": (np.float64, (2,)),
        "side": (np.float64, ()),
    }
    assert values["rho_inf"] == 0.0625


def test_traced_values_pass_the_check():
    def funnel(value):
        return check_values(FUNNEL, {"rho_inf": value})["rho_inf"]

    assert jax.jit(funnel)(jnp.array(3.0)) == 3.0


BAD_VALUES = {
    "unknown": (
        {"rho_in": 0.05},
        "There is no name `rho_in` in this study. Did you mean `rho_inf`\\? It has: `rho_inf`, `bias`, `x0`, `side`.",
    ),
    "far from all": ({"zzz": 1.0}, "There is no name `zzz` in this study. It has: `rho_inf`"),
    "column": ({"x0[0]": 0.5}, r"There is no name `x0\[0\]` in this study. Did you mean `x0`\?"),
    "outside": ({"rho_inf": 0.5}, r"Argument `rho_inf` must lie in \[0.005, 0.09\], but is 0.5. Choose a value inside"),
    "one entry outside": ({"x0": [0.5, 1.5]}, r"Argument `x0` must lie in \[0, 1\], but is \[0.5, 1.5\]"),
    "shape": ({"x0": 0.5}, r"`x0` must have shape \(2,\) \(as drawn in the scenario\), but has shape \(\)"),
    "nan": ({"bias": float("nan")}, "`bias` must be finite, but is nan"),
    "inf": ({"bias": float("inf")}, "`bias` must be finite, but is inf"),
    "level": ({"side": 0.0}, "`side` must be one of -1, 1, but is 0"),
    "text": ({"bias": "large"}, "`bias` must be a number or an array, but is 'large'"),
}


@pytest.mark.parametrize(("values", "message"), BAD_VALUES.values(), ids=BAD_VALUES.keys())
def test_wrong_values_are_named(values, message):
    with pytest.raises(ValueError, match=message):
        check_values(FUNNEL, values)


def test_a_study_without_names_says_so():
    with pytest.raises(ValueError, match="There is no name `mu` in this study. It has: none."):
        check_values((), {"mu": 1.0})


def test_discover_handles_a_scenario_without_names():
    assert discover(lambda draw: 3) == ((), 3)
