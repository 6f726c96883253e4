"""The two-link arm of the study in NumPy: its rates, its sliding variables, and the widths of its funnels."""

import math

import numpy as np

# rho0, mu and rho_inf of each channel.
WIDTHS = (4.0, 2.0, 0.2), (6.0, 2.0, 0.3)


def by_hand(plant, pushes):
    """The arm's rates: the inertia is solved for, not inverted."""
    m1, m2, l1, l2 = (float(getattr(plant, name)) for name in ("m1", "m2", "l1", "l2"))
    bend = m2 * l1 * l2

    def rates(t, x, u):
        (q1, q2), v = x[:2], x[2:]
        d = [float(p.amplitude) * math.sin(float(p.frequency) * t + float(p.phase)) for p in pushes]
        corner = m2 * l2**2 + bend * math.cos(q2)
        inertia = [[(m1 + m2) * l1**2 + m2 * l2**2 + 2 * bend * math.cos(q2), corner], [corner, m2 * l2**2]]
        coriolis = bend * math.sin(q2) * np.array([[-v[1], -(v[0] + v[1])], [v[0], 0.0]])
        lower = m2 * 9.81 * l2 * math.cos(q1 + q2)
        weight = [(m1 + m2) * 9.81 * l1 * math.cos(q1) + lower, lower]
        return [*v, *np.linalg.solve(inertia, u + d - coriolis @ v - weight)]

    return rates


SIGMAS = (
    lambda t, x: 3.0 * (x[0] - 0.5 * np.sin(t)) + x[2] - 0.5 * np.cos(t),
    lambda t, x: 3.0 * (x[1] - 0.4 * np.cos(1.3 * t)) + x[3] + 0.52 * np.sin(1.3 * t),
)
