"""Random disturbances: plain functions that draw the parameters of a deterministic one.

Each takes the `draw` of a scenario and a `name`; what it draws is labelled `name.frequency`, `name.phase` and so on.
The bound may itself be drawn. Whatever is drawn, the bound holds.
"""

import math
from itertools import count

import numpy as np
from scipy.special import pdtrc

from qsmc_jax.base.checks import is_traced, require, require_count, require_positive
from qsmc_jax.base.types import DrawLike, RealScalarLike
from qsmc_jax.model.disturbances.switching import SmoothSteps, Telegraph
from qsmc_jax.model.disturbances.waveforms import BandLimitedNoise, Sine, SumOfSines

# Probability that a random telegraph runs out of switches before its horizon.
_EXHAUSTION = 1e-12


def random_sine(
    draw: DrawLike, name: str, bound: RealScalarLike, frequencies: tuple[float, float] = (0.1, 10.0)
) -> Sine:
    """A sine with amplitude uniform on [0, bound], frequency log-uniform, phase uniform on the circle.

    Args:
        draw: The scenario's source of named numbers.
        name: Prefix of the names `.amplitude`, `.frequency` [rad/s], `.phase` [rad].
        bound: Largest amplitude, positive.
        frequencies: Lowest and highest angular frequency [rad/s].

    Returns:
        A `Sine` whose bound is its amplitude, at most `bound`.

    Raises:
        InputError: If the bound is not positive, or the frequencies are not positive and increasing.

    Examples:
        >>> import dataclasses
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     gust = qj.disturbances.random_sine(draw, "gust", bound=0.5)
        ...     return qj.Scenario(dataclasses.replace(qj.paper.example1(), disturbance=gust), x0=[0.9, 0.9], t1=20.0)
        >>> [spec.name for spec in qj.Study(scenario, bandwidth=0.1).specs]
        ['gust.amplitude', 'gust.frequency', 'gust.phase']
    """
    require_positive("bound", bound)
    low, high = _checked_range(frequencies)
    return Sine(
        amplitude=draw.uniform(f"{name}.amplitude", 0.0, bound),
        frequency=draw.log_uniform(f"{name}.frequency", low, high),
        phase=draw.uniform(f"{name}.phase", 0.0, 2 * math.pi),
    )


def random_sines(
    draw: DrawLike, name: str, bound: RealScalarLike, terms: int = 8, frequencies: tuple[float, float] = (0.1, 10.0)
) -> SumOfSines:
    """A sum of sines whose amplitudes are uniform over all non-negative ones that sum to the bound.

    The bound is sharp: with incommensurate frequencies, almost surely so, the supremum over all time equals it.

    Args:
        draw: The scenario's source of named numbers.
        name: Prefix of the names `.amplitude` (before normalisation), `.frequency` [rad/s], `.phase` [rad].
        bound: Sum of the amplitudes, positive.
        terms: Number of sines, at least 1.
        frequencies: Lowest and highest angular frequency [rad/s], log-uniform between.

    Returns:
        A `SumOfSines` with the given bound.

    Raises:
        InputError: If the bound is not positive, there are no terms, or the frequencies are not positive and
            increasing.

    Examples:
        >>> import dataclasses
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     gust = qj.disturbances.random_sines(draw, "gust", bound=0.5, terms=4)
        ...     return qj.Scenario(dataclasses.replace(qj.paper.example1(), disturbance=gust), x0=[0.9, 0.9], t1=20.0)
        >>> round(float(qj.Study(scenario, bandwidth=0.1).nominal.loop.disturbance.bound), 6)
        0.5

    Source: normalised exponentials are Dirichlet(1, ..., 1); Devroye, Non-Uniform Random Variate Generation, XI.4.
    """
    require_positive("bound", bound)
    require_count("terms", terms)
    low, high = _checked_range(frequencies)
    weights = draw.exponential(f"{name}.amplitude", 1.0, shape=(terms,))
    return SumOfSines(
        amplitudes=bound * (weights / weights.sum()),
        frequencies=draw.log_uniform(f"{name}.frequency", low, high, shape=(terms,)),
        phases=draw.uniform(f"{name}.phase", 0.0, 2 * math.pi, shape=(terms,)),
        bound=bound,
    )


def random_telegraph(
    draw: DrawLike, name: str, bound: RealScalarLike, rate: RealScalarLike, horizon: RealScalarLike
) -> Telegraph:
    """A Poisson telegraph: exponential holding times, and levels independent and uniform on [-bound, bound].

    The number K of switches is fixed, the smallest for which a Poisson process of this rate has more than K events
    within the horizon with probability below 1e-12; after the last switch the level stays.

    Args:
        draw: The scenario's source of named numbers.
        name: Prefix of the names `.holding_time` [s], `.level`.
        bound: Largest level, positive.
        rate: Mean number of switches per second [1/s], positive, a plain number since it fixes K.
        horizon: Duration of the run [s], positive, a plain number since it fixes K.

    Returns:
        A `Telegraph` whose bound is its largest level, at most `bound`.

    Raises:
        InputError: If the bound, the rate or the horizon is not positive, or rate or horizon is traced.

    Examples:
        >>> import dataclasses
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     gust = qj.disturbances.random_telegraph(draw, "gust", bound=0.5, rate=0.2, horizon=20.0)
        ...     return qj.Scenario(dataclasses.replace(qj.paper.example1(), disturbance=gust), x0=[0.9, 0.9], t1=20.0)
        >>> [spec.name for spec in qj.Study(scenario, bandwidth=0.1).specs]
        ['gust.holding_time', 'gust.level']
    """
    require_positive("bound", bound)
    for argument, value in (("rate", rate), ("horizon", horizon)):
        require(
            not is_traced(value),
            f"Argument `{argument}` must be a plain number, but is {value}: it fixes the number of switches. "
            "Do not draw it.",
        )
        require_positive(argument, value)
    switches = _enough_switches(float(rate) * float(horizon))
    return Telegraph(
        switch_times=draw.exponential(f"{name}.holding_time", 1.0 / float(rate), shape=(switches,)).cumsum(),
        levels=draw.uniform(f"{name}.level", -bound, bound, shape=(switches + 1,)),
    )


def random_steps(
    draw: DrawLike, name: str, bound: RealScalarLike, steps: int, horizon: RealScalarLike, rise_time: RealScalarLike
) -> SmoothSteps:
    """Smooth steps between levels uniform on [-bound, bound], one in each of `steps` equal parts of the horizon.

    Args:
        draw: The scenario's source of named numbers.
        name: Prefix of the names `.time` (uniform within the step's part), `.level`.
        bound: Largest level, positive.
        steps: Number of steps, at least 1.
        horizon: Duration of the run [s], positive.
        rise_time: Duration of each ramp [s], positive; ramps may overlap.

    Returns:
        A `SmoothSteps` whose bound is its largest level, at most `bound`.

    Raises:
        InputError: If the bound, the horizon or the rise time is not positive, or there are no steps.

    Examples:
        >>> import dataclasses
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     gust = qj.disturbances.random_steps(draw, "gust", 0.5, steps=2, horizon=20.0, rise_time=0.1)
        ...     return qj.Scenario(dataclasses.replace(qj.paper.example1(), disturbance=gust), x0=[0.9, 0.9], t1=20.0)
        >>> [spec.columns for spec in qj.Study(scenario, bandwidth=0.1).specs]
        [('gust.time[0]', 'gust.time[1]'), ('gust.level[0]', 'gust.level[1]', 'gust.level[2]')]
    """
    require_positive("bound", bound)
    require_count("steps", steps)
    require_positive("horizon", horizon)
    require_positive("rise_time", rise_time)
    within = draw.uniform(f"{name}.time", 0.0, 1.0, shape=(steps,))
    return SmoothSteps(
        times=horizon / steps * (np.arange(steps, dtype=float) + within),
        levels=draw.uniform(f"{name}.level", -bound, bound, shape=(steps + 1,)),
        rise_time=rise_time,
    )


def random_noise(
    draw: DrawLike,
    name: str,
    bound: RealScalarLike,
    cutoff: RealScalarLike,
    rms: RealScalarLike | None = None,
    terms: int = 32,
) -> BandLimitedNoise:
    r"""Band-limited white noise: a flat spectrum on [0, cutoff], bounded smoothly.

    Term j has amplitude $\sqrt{2/J}$ rms, a frequency uniform in the j-th of J equal parts of the band, so that the
    noise does not repeat itself, and a phase uniform on the circle.

    Args:
        draw: The scenario's source of named numbers.
        name: Prefix of the names `.frequency` (uniform within the term's part of the band), `.phase` [rad].
        bound: Bound of the noise, positive.
        cutoff: Highest angular frequency [rad/s], positive.
        rms: Root mean square before bounding, positive; None means a third of the bound.
        terms: Number J of terms, at least 1.

    Returns:
        A `BandLimitedNoise` with the given bound.

    Raises:
        InputError: If the bound, the cutoff or the rms is not positive, or there are no terms.

    Examples:
        >>> import dataclasses
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     gust = qj.disturbances.random_noise(draw, "gust", bound=0.5, cutoff=20.0)
        ...     return qj.Scenario(dataclasses.replace(qj.paper.example1(), disturbance=gust), x0=[0.9, 0.9], t1=20.0)
        >>> float(qj.Study(scenario, bandwidth=0.1).nominal.loop.disturbance.bound)
        0.5

    Source: see `BandLimitedNoise`.
    """
    require_positive("bound", bound)
    require_positive("cutoff", cutoff)
    require_count("terms", terms)
    rms = bound / 3.0 if rms is None else rms
    require_positive("rms", rms)
    within = draw.uniform(f"{name}.frequency", 0.0, 1.0, shape=(terms,))
    return BandLimitedNoise(
        amplitudes=rms * np.full(terms, math.sqrt(2.0 / terms)),
        frequencies=cutoff / terms * (np.arange(terms, dtype=float) + within),
        phases=draw.uniform(f"{name}.phase", 0.0, 2 * math.pi, shape=(terms,)),
        bound=bound,
    )


def _enough_switches(mean: float) -> int:
    """The smallest K with P(Poisson(mean) > K) < 1e-12."""
    return next(k for k in count() if pdtrc(k, mean) < _EXHAUSTION)


def _checked_range(frequencies: tuple[float, float]) -> tuple[float, float]:
    low, high = frequencies
    require(
        0 < low < high < math.inf,
        f"Argument `frequencies` must be (low, high) with 0 < low < high, but is {frequencies}.",
    )
    return low, high
