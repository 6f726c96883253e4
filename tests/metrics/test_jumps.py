"""Functions of the signals that jump, or only look as if they did."""

import runpy

import jax.numpy as jnp
import numpy as np
import pytest

import places
import qsmc_jax as qj

m = qj.metrics
TABLE = np.array([1.0, 2.0, 5.0])


def scenario(draw):
    return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=2.0)


def guarded(s):
    is_zero = s.g == 0.0
    return jnp.where(is_zero, 0.0, s.w / jnp.where(is_zero, 1.0, s.g))


@pytest.mark.parametrize(
    ("of", "said"),
    [
        (lambda s: jnp.where(jnp.abs(s.e[0]) > 0.1, 1.0, 0.0), r"`e\[0\]` is -0.1, between 1 and 0"),
        (lambda s: jnp.where(jnp.abs(s.x[1]) < 0.25, 0.0, s.x[1] ** 2), r"`x\[1\]` is .*0.25, between"),
        (lambda s: jnp.sign(s.u) * s.rho, "where `u` is 0, between"),
        (lambda s: s.x[0] + jnp.floor(s.t), "where `t` is 1, between"),
        (lambda s: jnp.arctan2(jnp.sin(s.x[0]), jnp.cos(s.x[0])), r"`x\[0\]` is .*3.14159, between"),
        (lambda s: jnp.asarray(TABLE)[jnp.clip(s.t, 0.0, 2.0).astype(int)], "where `t` is 1, between 2 and 1"),
        (lambda s: jnp.where(s.ratio > 0.5, 1.0, 0.0) * s.d, "where `ratio` is 0.5, between"),
    ],
)
def test_a_function_that_jumps_is_refused_with_the_place(of, said):
    with pytest.raises(qj.InputError, match=f"metric `p` must not jump.* {said}.*jumps=True"):
        qj.Study(scenario, bandwidth=0.1, metrics=[m.Peak("p", of)])


@pytest.mark.parametrize(
    "metric",
    [
        m.Peak("p", guarded),
        m.Peak("p", lambda s: jnp.where(s.x[0] > 0.5, s.x[0] - 0.5, 0.5 - s.x[0])),
        m.Peak("p", lambda s: jnp.abs(jnp.arctan2(jnp.sin(s.x[0]), jnp.cos(s.x[0])))),
        m.Peak("p", lambda s: jnp.where(s.rho > 0.0, 1.0 / s.rho, 0.0)),
        m.Peak("p", lambda s: jnp.where(jnp.abs(s.ratio) < 1.0, s.ratio, 0.0)),
        m.Peak("p", lambda s: jnp.where(s.t < 2.0, s.x[0], 7.0)),
        m.Peak("p", lambda s: s.x[0] - jnp.interp(s.t, jnp.array([0.0, 1.0]), jnp.array([1.0, 0.5]))),
        m.Peak("p", lambda s: qj.smoothed.step(s.x[0], 0.1)),
        m.LastTime("p", lambda s: s.x[0] > 0.5),
        m.Integral("p", lambda s: jnp.where(s.e[0] > 0.1, 1.0, 0.0), jumps=True),
        m.Peak("p", lambda s: jnp.where(s.t < 0.75, 7.0, s.x[0]), after=0.75),
        m.Peak("p", lambda s: jnp.where(s.t < 0.75, s.x[0], 7.0), before=0.75),
    ],
)
def test_what_joins_or_jumps_where_nothing_is_looked_at_passes(metric):
    qj.Study(scenario, bandwidth=0.1, metrics=[metric])


def test_a_limit_that_steps_is_two_requirements_each_in_its_window():
    limit = lambda s: jnp.where(s.t < 1.0, 9.0, 5.0) - jnp.abs(s.u)  # noqa: E731
    with pytest.raises(qj.InputError, match="`r` must not jump.*`t` is 1, between .* Make one of each window"):
        qj.Study(scenario, bandwidth=0.1, requirements={"r": qj.always(limit)})
    both = qj.always(limit, before=1.0) & qj.always(limit, after=1.0)
    qj.Study(scenario, bandwidth=0.1, requirements={"r": both})


def test_several_inputs_are_followed_one_by_one():
    arm = runpy.run_path(str(places.STUDIES / "two_link_arm.py"))["study"]
    study = lambda of: qj.Study(arm.scenario, bandwidth=arm.bandwidth, metrics=[m.Peak("p", of)])  # noqa: E731
    with pytest.raises(qj.InputError, match=r"where `u\[1\]` is 2, between"):
        study(lambda s: s.u[0] + jnp.where(s.u[1] > 2.0, 1.0, 0.0))
    study(lambda s: s.u[0] + jnp.maximum(s.u[1], 2.0))


def test_a_number_that_a_function_closes_over_may_change():
    height = [0.0]
    metric = m.Peak("p", lambda s: s.x[0] + height[0] * jnp.floor(s.t))
    qj.Study(scenario, bandwidth=0.1, metrics=[metric])
    height[0] = 1.0
    with pytest.raises(qj.InputError, match="where `t` is 1, between"):
        qj.Study(scenario, bandwidth=0.1, metrics=[metric])
