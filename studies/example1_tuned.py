"""Example 1 sampled at 1 kHz with noise on the rate: which mu and rho_inf wear the actuator least?

Question: how much quieter may the input be, if the bandwidth is still reached in 1.5 s and the input stays below 5?
Claim: with mu about 2.7 and rho_inf at its upper bound the total variation of the input is some 40 % below that of the
    paper's gains, and on fresh runs each constraint fails with a probability of at most 1 % (95 % confidence).
Time: half a minute on two cores for the search and its pictures:

    qsmc tune studies/example1_tuned.py --for mu,rho_inf --objective "mean(total_variation_u)" \
        --subject-to "worst(reach_time) <= 1.5" --subject-to "worst(peak_u) <= 5" \
        --subject-to "worst(peak_ratio) <= 0.9" --against "mean(rms_error)" --out results/tuned1
    qsmc verify studies/example1_tuned.py -S @results/tuned1 --seed 12345
"""

import qsmc_jax as qj


def scenario(draw: qj.Draw) -> qj.Scenario:
    """Example 1 with plant, disturbance, start and noise uncertain."""
    plant = qj.plants.InvertedPendulum(
        mass=draw.uniform("mass", 0.008, 0.012),
        length=draw.uniform("length", 7.84, 11.76),
        friction=draw.uniform("friction", 0.008, 0.012),
        gravity=9.8,
    )
    funnel = qj.Funnel(
        rho0=draw.parameter("rho0", 4.0, bounds=(2.5, 10.0)),
        mu=draw.parameter("mu", 3.0, bounds=(0.5, 10.0)),
        rho_inf=draw.parameter("rho_inf", 0.05, bounds=(0.005, 0.09)),
    )
    surface = qj.SlidingSurface.binomial(draw.parameter("pole", 2.0, bounds=(0.5, 5.0)), 2)
    disturbance = qj.disturbances.random_sine(draw, "d", bound=0.5, frequencies=(0.1, 10.0))
    implementation = qj.Implementation(
        sample_period=1e-3,
        saturation=draw.parameter("saturation", 20.0, bounds=(1.0, 100.0)),
        noise=qj.noises.uniform(draw, "noise_on_rate", [0.0, draw.parameter("noise", 1e-3, bounds=(0.0, 0.1))]),
    )
    control = qj.QuasiSlidingControl(surface, funnel)
    loop = qj.ClosedLoop(plant, qj.references.SumOfSines([1.0], [1.0]), disturbance, control, implementation)
    return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=5.0)


study = qj.Study(scenario, bandwidth=0.1)
