"""Pictures: drawn in the axes given or in a new figure that pyplot knows; files and reports leave pyplot alone."""

import inspect

import numpy as np
import pytest
from matplotlib import pyplot as plt

import qsmc_jax as qj
from drawing import draws_in_given_axes
from qsmc_jax.display.plotting import off_screen
from studies_for_tests import Integrator, study

PLOTS = [
    (kind, name)
    for kind in (getattr(qj, name) for name in qj._HOMES)
    if inspect.isclass(kind)
    for name in vars(kind)
    if name.startswith("plot")
]


@pytest.fixture(scope="module")
def run():
    return study.simulate(ts=np.linspace(0.0, 6.0, 301))


@pytest.fixture(scope="module")
def result():
    return qj.verify(study, 64, block=64, threads=1)


@pytest.fixture(autouse=True)
def no_figure_is_left():
    yield
    plt.close("all")


@pytest.mark.parametrize(("kind", "name"), PLOTS, ids=[f"{kind.__name__}.{name}" for kind, name in PLOTS])
def test_every_picture_takes_axes(kind, name):
    assert inspect.signature(getattr(kind, name)).parameters["ax"].default is None


def test_there_are_pictures_of_every_result():
    assert {kind.__name__ for kind, _ in PLOTS} == {
        "Band",
        "Card",
        "Comparison",
        "CriticalValue",
        "Falsification",
        "Landscape",
        "Proof",
        "RobustnessMap",
        "Trajectory",
        "Tuning",
        "Verification",
    }


@pytest.mark.slow
def test_a_verification_is_drawn_in_axes_of_the_caller(result):
    draws_in_given_axes(result.plot, 3)


@pytest.mark.slow
def test_a_run_is_drawn_in_axes_of_the_caller(run, result):
    output, errors, inputs, funnel = draws_in_given_axes(run.plot, 4)
    np.testing.assert_array_equal(output.lines[0].get_ydata(), run.x[:, 0])
    np.testing.assert_array_equal(errors.lines[0].get_ydata(), run.e[:, 0])
    np.testing.assert_array_equal(inputs.lines[0].get_ydata(), run.u)
    np.testing.assert_array_equal(funnel.lines[0].get_ydata(), run.sigma)
    draws_in_given_axes(run.plot_funnel)
    draws_in_given_axes(result.plot_margin)


def test_axes_are_the_first_argument_of_every_picture():
    first = {(kind.__name__, name): list(inspect.signature(getattr(kind, name)).parameters)[1] for kind, name in PLOTS}
    assert {key for key, parameter in first.items() if parameter != "ax"} == set()


def test_axes_in_a_grid_serve_in_reading_order(run):
    figure, grid = plt.subplots(2, 2)
    assert list(run.plot(ax=grid)) == [grid[0, 0], grid[0, 1], grid[1, 0], grid[1, 1]]
    assert plt.get_fignums() == [figure.number]


def test_a_new_figure_is_one_that_pyplot_shows(run):
    axes = run.plot()
    assert plt.get_fignums() == [axes[0].figure.number]


def test_off_screen_and_in_a_notebook_s_table_pyplot_is_left_alone(run, result):
    assert len(off_screen(run.plot).axes) == 4
    run._repr_html_()
    result._repr_html_()
    assert plt.get_fignums() == []


def test_off_screen_ends_when_drawing_fails(run):
    with pytest.raises(ZeroDivisionError):
        off_screen(lambda: 1 / 0)
    run.plot_funnel()
    assert len(plt.get_fignums()) == 1


@pytest.mark.parametrize("ax", ["left", [], 3], ids=str)
def test_what_is_no_axes_is_refused(run, ax):
    with pytest.raises(ValueError, match="ax must be matplotlib Axes, 1 for this picture"):
        run.plot_funnel(ax=ax)


def test_another_number_of_axes_is_refused(run):
    with pytest.raises(ValueError, match=r"ax must be matplotlib Axes, 4 for this picture, but is .*Leave it out"):
        run.plot(ax=plt.figure().subplots(1, 3))


@pytest.mark.slow
def test_the_worst_run_is_drawn_to_its_own_end():
    """It is the one with the largest push, which has the longest horizon: longer than that of the nominal run."""

    def scenario(draw):
        push = draw.uniform("push", 2.0, 6.0)
        control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(rho0=1.0, mu=1.0, rho_inf=0.1))
        disturbance = qj.disturbances.Constant(push)
        loop = qj.ClosedLoop(Integrator(2.0), qj.references.Constant(0.0), disturbance, control)
        return qj.Scenario(loop, x0=[0.0], t1=push)

    result = qj.verify(qj.Study(scenario, bandwidth=0.2), 64)
    row = result.worst.row(0)
    lines = {line.get_label(): line for line in result.plot()[0].lines}
    drawn = lines[f"worst, run {row['index']}"]
    assert row["push"] > 5.0
    assert drawn.get_xdata()[-1] == pytest.approx(row["push"])
    assert np.isfinite(drawn.get_ydata()).all()
