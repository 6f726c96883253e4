"""The digital controller of a two-link arm: against SciPy from sample to sample, with the inertia written by hand."""

import dataclasses
import runpy

import numpy as np
import pytest

import places
import qsmc_jax as qj
from arm_by_hand import SIGMAS, WIDTHS, by_hand
from several_held_loops import Held, simulate, tangent

HORIZON = 1.5
STUDY = runpy.run_path(str(places.STUDIES / "two_link_arm.py"))["study"]


CASES = {
    "held": (qj.Implementation(1.5e-3), ({"period": 1.5e-3}, {"period": 1.5e-3})),
    "late and limited": (
        qj.Implementation(
            (1e-3, 8e-4),
            delay=(3e-4, 5e-4),
            saturation=(90.0, 25.0),
            input_resolution=(0.05, 0.0),
            actuator=(None, qj.actuators.FirstOrderLag(1e-3)),
        ),
        (
            {"period": 1e-3, "delay": 3e-4, "saturation": 90.0, "resolution": 0.05},
            {"period": 8e-4, "delay": 5e-4, "saturation": 25.0, "lag": 1e-3},
        ),
    ),
    "too weak": (
        qj.Implementation(1.5e-3, saturation=(22.0, 30.0)),
        ({"period": 1.5e-3, "saturation": 22.0}, {"period": 1.5e-3, "saturation": 30.0}),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_digital_controller_of_an_arm_is_what_scipy_makes_of_it(name):
    made, options = CASES[name]
    nominal = STUDY.nominal
    law = lambda sigma, rho, memory: (tangent(10.0, sigma, rho), memory)  # noqa: E731
    rhos = [lambda t, r0=r0, mu=mu, r=r: r0 * np.exp(-mu * t) + r for r0, mu, r in WIDTHS]
    both = [Held(*each, law, **more) for *each, more in zip(SIGMAS, rhos, options, strict=True)]
    x1, peaks, energy, first = simulate(
        by_hand(nominal.loop.plant, nominal.loop.disturbances), both, np.asarray(nominal.x0, float), HORIZON
    )
    loop = dataclasses.replace(nominal.loop, implementation=made)
    run = qj.simulate(loop, nominal.x0, HORIZON, bandwidth=STUDY.bandwidth, settings=qj.tight())
    assert (peaks.max() >= 1.0) == (name == "too weak")
    for i in range(2):
        assert float(run.metrics.channels[f"peak_ratio[{i}]"]) == pytest.approx(peaks[i], rel=1e-6)
        assert run.verdicts[f"funnel[{i}]"].name == ("HELD" if peaks[i] < 1.0 else "VIOLATED")
        assert float(run.metrics.channels[f"violation_time[{i}]"]) == pytest.approx(first[i], rel=1e-4)
    assert float(run.metrics.energy_u) == pytest.approx(energy.sum(), rel=1e-4)
    np.testing.assert_allclose(run.x[-1], x1, rtol=1e-5, atol=1e-6)


def scenario(draw):
    """The arm as it is drawn, sampled, each motor's delay drawn on its own."""
    drawn = STUDY.scenario(draw)
    delays = draw.uniform("delay", 0.0, 2e-3, shape=(2,))
    made = qj.Implementation(2e-3, delay=delays, saturation=draw.parameter("limit", 120.0, bounds=(10.0, 500.0)))
    return qj.Scenario(dataclasses.replace(drawn.loop, implementation=made), x0=drawn.x0, t1=HORIZON)


@pytest.mark.slow
def test_a_study_of_digital_arms_has_both_outcomes_and_its_rows_are_its_replays():
    study = qj.Study(scenario, bandwidth=STUDY.bandwidth)
    runs = qj.monte_carlo(study, 64, block=64)
    assert {qj.Verdict.HELD, qj.Verdict.VIOLATED} <= {qj.Verdict(int(v)) for v in runs["verdict"]}
    worst = np.fmax(runs["peak_ratio[0]"], runs["peak_ratio[1]"])
    np.testing.assert_array_equal(runs["peak_ratio"], worst)
    for index in (0, 7):
        again = study.replay(index)
        # The grid's times end cells too.
        np.testing.assert_allclose(again.metrics.peak_ratio, runs["peak_ratio"][index], rtol=1e-4)
        assert again.verdict == runs["verdict"][index]
