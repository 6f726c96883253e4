"""The highest point of a function in a step against functions whose peak is known, kinks included."""

import functools as ft

import jax
import jax.numpy as jnp
import pytest

from fake_step import UnitStep
from qsmc_jax.metrics.summit import summit
from qsmc_jax.metrics.view import View

COURSES = [
    lambda x, c: -jnp.abs(x - c),
    lambda x, c: -jnp.where(x < c, 1.0, 5.0) * jnp.abs(x - c) - 0.3 * (x - c) ** 2,
    lambda x, c: -((x - c) ** 2) + 0.4 * (x - c) ** 3,
    lambda x, c: jnp.cos(2.0 * (x - c)) - jnp.abs(x - c) ** 3,
    lambda x, c: jnp.minimum(2.0 * (x - c), 1.5 * (c - x)),
    lambda x, c: jnp.minimum(jnp.sin(x - c), 0.5 * (c - x)),
    lambda x, c: jnp.minimum(x - c + 0.1 * (x - c) ** 2, 3.0 * (c - x) + 0.1 * (x - c) ** 2),
]


@ft.cache
def finder(course):
    """The highest point of a course by its place and by what was seen already; compiled once for all of both."""
    return jax.jit(lambda place, above: summit(lambda s: course(s.x[0], place), View(UnitStep()), above))


PLACES = [0.0, 0.03, 0.1727, 0.31, 0.5, 0.66, 0.9, 1.0]


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("course", COURSES)
def test_a_peak_in_a_step_is_found_and_bounded(course, place):
    """All of these peak at the place, kinks included, and nowhere else."""
    found = finder(course)(place, -jnp.inf)
    top = float(course(jnp.array(place), place))
    assert float(found.height) == pytest.approx(top, abs=1e-5)
    assert top - 1e-12 <= float(found.bound) <= top + 4e-4


@pytest.mark.parametrize("course", COURSES)
def test_a_peak_that_exceeds_what_was_seen_is_never_left_out(course):
    """What was seen is just below the top, which lies above where tangents meet if the branches bend upwards."""
    for place in PLACES:
        top = float(course(jnp.array(place), place))
        found = finder(course)(place, top - 1e-4)
        assert float(found.height) == pytest.approx(top, abs=1e-5)
