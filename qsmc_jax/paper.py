"""The two examples of the paper, as loops.

Source: P. K. Mishra and P. Jagtap, Approximation- and Chattering-free Quasi Sliding Mode Control for Unknown Systems,
    Section V.
"""

import math
from types import MappingProxyType

from qsmc_jax.control.funnel import Funnel
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.control.surface import SlidingSurface
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.model.disturbances import Constant, Piecewise, Sine
from qsmc_jax.model.plants import FourthOrderExample, InvertedPendulum
from qsmc_jax.model.references import SumOfSines

BANDWIDTH = 0.1
HORIZON = 20.0

# Each start has all its states equal to one of these.
STARTS = MappingProxyType({1: (0.9, 0.7, 0.3, 0.1), 2: (0.5, 0.6, 0.7)})

# The reaching time as printed: rounded up to 1.5 s in Example 1, down to 1.53 s in Example 2 (by the formula 1.5351 s).
PRINTED_REACHING_TIME = MappingProxyType({1: 1.5, 2: 1.53})


def example1() -> ClosedLoop:
    """Example 1: an inverted pendulum follows sin t under d = 0.5 sin t; c_1 = 2, rho = 4 exp(-3 t) + 0.05.

    Examples:
        >>> import qsmc_jax as qj
        >>> loop = qj.paper.example1()
        >>> loop.order, loop.control.surface.c.tolist()
        (2, [2.0])
    """
    control = QuasiSlidingControl(SlidingSurface([2.0]), Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
    return ClosedLoop(InvertedPendulum(), SumOfSines([1.0], [1.0]), Sine(0.5, 1.0), control)


def example2() -> ClosedLoop:
    """Example 2: order 4, y_des = sin t + cos 0.5 t, a disturbance that kinks at 6 s and jumps at 9 s.

    Examples:
        >>> import qsmc_jax as qj
        >>> loop = qj.paper.example2()
        >>> loop.order, loop.control.surface.c.tolist(), float(loop.disturbance.bound)
        (4, [6.0, 12.0, 8.0], 2.0)
    """
    control = QuasiSlidingControl(SlidingSurface([6.0, 12.0, 8.0]), Funnel(rho0=5.0, mu=3.0, rho_inf=0.05))
    reference = SumOfSines([1.0, 1.0], [1.0, 0.5], [0.0, math.pi / 2])
    pieces = (Sine(0.5, math.pi / 2), Sine(1.0, math.pi), Sine(1.0, math.pi, math.pi / 2) + Constant(-1.0))
    return ClosedLoop(FourthOrderExample(), reference, Piecewise([6.0, 9.0], pieces), control)
