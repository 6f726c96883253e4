"""Example 2, of order 4, sampled at 1 kHz with noise on the last state: which mu and rho_inf wear the actuator least?

Question: how much quieter may the input be, if the bandwidth is reached in 1.6 s and the funnel kept with a margin?
Claim: with mu about 2.4 and rho_inf near its upper bound the total variation of the input is some 23 % below that of
    the paper's gains, and on fresh runs each constraint fails with a probability of at most 1 % (95 % confidence).
Time: a minute on two cores for the search and its pictures:

    qsmc tune studies/example2_tuned.py --for mu,rho_inf --objective "mean(total_variation_u)" \
        --subject-to "worst(reach_time) <= 1.6" --subject-to "worst(peak_ratio) <= 0.99" --out results/tuned2
"""

import math

import qsmc_jax as qj


def scenario(draw: qj.Draw) -> qj.Scenario:
    """Example 2 with plant, disturbance, start and noise uncertain; 3 s are twice the reaching time."""
    plant = qj.plants.FourthOrderExample(
        drift_scale=draw.uniform("drift_scale", 0.8, 1.2), gain_scale=draw.uniform("gain_scale", 0.8, 1.2)
    )
    funnel = qj.Funnel(
        rho0=draw.parameter("rho0", 5.0, bounds=(4.5, 12.0)),
        mu=draw.parameter("mu", 3.0, bounds=(1.0, 6.0)),
        rho_inf=draw.parameter("rho_inf", 0.05, bounds=(0.01, 0.09)),
    )
    control = qj.QuasiSlidingControl(qj.SlidingSurface([6.0, 12.0, 8.0]), funnel)
    disturbance = qj.disturbances.random_sines(draw, "sines", bound=0.5, terms=3)
    implementation = qj.Implementation(
        sample_period=1e-3,
        saturation=60.0,
        noise=qj.noises.uniform(draw, "measured", [0.0, 0.0, 0.0, draw.parameter("noise", 1e-3, bounds=(0.0, 0.1))]),
    )
    reference = qj.references.SumOfSines([1.0, 1.0], [1.0, 0.5], [0.0, math.pi / 2])
    loop = qj.ClosedLoop(plant, reference, disturbance, control, implementation)
    return qj.Scenario(loop, x0=draw.uniform("x0", 0.5, 0.7, shape=(4,)), t1=3.0)


study = qj.Study(scenario, bandwidth=0.1)
