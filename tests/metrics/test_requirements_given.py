"""What is taken as a requirement, what is refused, and what of it belongs to the identity of a study."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import qsmc_jax as qj
from falling_funnel import falling


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (lambda: {"p": qj.always(lambda s: s.speed)}, "Function `of` of requirement `p`.* asks for `speed`"),
        (lambda: {"p": qj.always(lambda s: jnp.stack(s.x))}, "must return one number, but returns shape \\(1,\\)"),
        (lambda: {"p": qj.always(lambda s: "low")}, "must return one number"),
        (lambda: {"p": qj.always(lambda s: jnp.log(s.u - 1.0))}, "returns nan at the start"),
        (lambda: {"p": qj.always(lambda s: s.u < 5.0)}, "returns true or false. Write `limit - abs\\(s.u\\)`"),
        (lambda: {"p": ~qj.always(lambda s: s.u) | qj.eventually(lambda s: s.u > 1.0)}, "returns true or false"),
        (lambda: {"p": qj.always(lambda s: s.u, after=1.0, before=0.5)}, "must be a window of times"),
        (lambda: {"p": qj.always(lambda s: s.u, after=-1.0)}, "must be a window of times"),
        (lambda: {"p": qj.always(lambda s: s.u, after=2.0)}, "must lie before the horizon, 2 s"),
        (lambda: {"p": qj.eventually(lambda s: s.u, before=2.5)}, "must not lie beyond the horizon, 2 s, but is 2.5 s"),
        (lambda: {"a=b": qj.always(lambda s: s.u)}, "must have no '='"),
        (lambda: {"verdict_x": qj.always(lambda s: s.u)}, "must not begin with 'verdict_'"),
        (lambda: {"verdict": qj.always(lambda s: s.u)}, "must not begin with 'verdict_'"),
        (lambda: {"reaching": qj.always(lambda s: s.u)}, "`verdict_reaching` is the name of a column already"),
        (lambda: {"funnel": qj.always(lambda s: s.u)}, "`verdict` is the name of a column already"),
        (lambda: {"all": qj.always(lambda s: s.u)}, "`verdict_all` is the name of a column already"),
        (lambda: {"p": lambda s: s.u}, "Argument `requirements` must .* `qj.always`"),
        (lambda: [qj.always(lambda s: s.u)], "must be a dictionary, but is a `list`"),
        (
            lambda: {"p": qj.always(lambda s: s.u) & (lambda s: s.u)},
            "joined with another one only, not with a `function`",
        ),
        (lambda: {"p": qj.always(lambda s: s.u) and qj.always(lambda s: -s.u)}, "joined by `&`"),
        (lambda: {"p": qj.always(eqx.Partial(lambda a, s: a * s.u, jnp.ones(())))}, "must be made of plain functions"),
    ],
)
def test_what_does_not_fit_is_named(given, said):
    with pytest.raises(qj.InputError, match=said):
        qj.Study(falling, bandwidth=0.3, requirements=given())


def test_a_drawn_name_and_a_metric_may_not_look_like_a_verdict():
    def drawing(draw):
        made = falling(draw)
        return qj.Scenario(made.loop, x0=[draw.uniform("verdict_x", 0.0, 0.1)], t1=2.0)

    with pytest.raises(qj.InputError, match="must not begin with 'verdict_'"):
        qj.Study(drawing, bandwidth=0.3)
    with pytest.raises(qj.InputError, match="must not begin with 'verdict_'"):
        qj.Study(falling, bandwidth=0.3, metrics=[qj.metrics.Peak("verdict_u", lambda s: s.u)])


def test_numbers_that_a_function_closes_over_belong_to_the_study():
    """Tables stand in no text of a program."""

    def of(kind, level):
        table = np.linspace(0.0, 1.0, 50) + level
        function = lambda s: 2.0 + jnp.interp(s.x[0], jnp.linspace(-1.0, 1.0, 50), table)  # noqa: E731
        measures = {"metrics": [qj.metrics.Peak("p", function)], "requirements": {"p": qj.always(function)}}
        return qj.Study(falling, bandwidth=0.3, **{kind: measures[kind]}).contents

    for kind in ("metrics", "requirements"):
        assert of(kind, 0.0) == of(kind, 0.0)
        assert of(kind, 0.0) != of(kind, 1e-9)


def test_how_parts_are_joined_belongs_to_the_study():
    a, b = qj.always(lambda s: 5.0 - s.u), qj.eventually(lambda s: s.x[0] - 0.1)
    c = qj.always(lambda s: 4.0 - s.u)
    joined = [a & b, a | b, a.implies(b), b.implies(a), ~(a & b), ~a & b, a | (c & a), a | (c & c)]
    contents = {qj.Study(falling, bandwidth=0.3, requirements={"p": each}).contents for each in joined}
    assert len(contents) == len(joined)
