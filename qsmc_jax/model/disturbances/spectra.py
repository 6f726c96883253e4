r"""Random disturbances of a given spectrum, and the spectra of roads, gusts and sea waves as they are published.

A power spectral density is one-sided, over angular frequencies: the variance of a disturbance is
$\int_0^\infty S(\omega)\, d\omega$.
"""

import math
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from qsmc_jax.base.checks import (
    is_traced,
    nearest,
    require,
    require_count,
    require_nonnegative,
    require_positive,
    require_range,
    show,
)
from qsmc_jax.base.module import as_float64
from qsmc_jax.base.types import DrawLike, RealScalarLike
from qsmc_jax.model.disturbances.waveforms import SumOfSines

_ROAD_CLASSES = tuple("ABCDEFGH")
# Of x = omega L / V: densities of one-sided spectra with unit variance.
_DRYDEN = {
    "longitudinal": lambda x: 2.0 / math.pi / (1.0 + x**2),
    "lateral": lambda x: (1.0 + 3.0 * x**2) / (1.0 + x**2) ** 2 / math.pi,
    "vertical": lambda x: (1.0 + 3.0 * x**2) / (1.0 + x**2) ** 2 / math.pi,
}


def random_spectrum(
    draw: DrawLike,
    name: str,
    density: Callable[[Any], Any],
    frequencies: tuple[RealScalarLike, RealScalarLike],
    terms: int = 48,
) -> SumOfSines:
    r"""A sum of sines whose mean spectrum over the runs is a given one.

    The band is cut into cells of equal ratio. Term j has a frequency $\omega_j$ uniform in cell j, of width
    $\Delta_j$, the amplitude $\sqrt{2 S(\omega_j) \Delta_j}$ and a phase uniform on the circle. So the mean over the
    runs is $S$ itself on the band, and nothing beyond.

    What a finite number of terms costs: the variance of a single run scatters, by 1 to 2 % with 48 terms for the
    spectra below; peaks stay below $\sqrt{2 \cdot terms}$ times the root mean square, where Gaussian ones have no
    bound; and in records longer than terms / ln(high / low) periods of a frequency, the lines around it can be told
    apart. It does not repeat itself. A step of Example 1 of the paper takes twice as long with 48 terms as with 8.

    Args:
        draw: The scenario's source of named numbers.
        name: Prefix of the names `.frequency` (uniform on [0, 1] within the term's cell), `.phase` [rad].
        density: The one-sided power spectral density S of an array of angular frequencies [rad/s], in squared units
            of the disturbance times s/rad, not negative.
        frequencies: Lowest and highest angular frequency [rad/s], positive; either may be drawn.
        terms: Number of sines, at least 1.

    Returns:
        A `SumOfSines`, whose bound is the sum of its amplitudes.

    Raises:
        InputError: If the density is negative, the frequencies are not positive and increasing, or there are no terms.

    Examples:
        Ground motion by Kanai and Tajimi, of a soil with 15 rad/s and a damping of 0.6:

        >>> import dataclasses
        >>> import qsmc_jax as qj
        >>> def soil(w):
        ...     x, damping = (w / 15.0) ** 2, 4 * 0.6**2
        ...     return 0.01 * (1 + damping * x) / ((1 - x) ** 2 + damping * x)
        >>> def scenario(draw):
        ...     quake = qj.disturbances.random_spectrum(draw, "quake", soil, (1.0, 60.0))
        ...     return qj.Scenario(dataclasses.replace(qj.paper.example1(), disturbance=quake), x0=[0.9, 0.9], t1=20.0)
        >>> [spec.name for spec in qj.Study(scenario, bandwidth=0.1).specs]
        ['quake.frequency', 'quake.phase']

    Source: Shinozuka and Deodatis (1991), Simulation of stochastic processes by spectral representation.
    """
    frequencies = as_float64(frequencies)
    _require_band("frequencies", frequencies)
    require_count("terms", terms)
    low, high = frequencies
    edges = low * (high / low) ** (np.arange(terms + 1) / terms)
    widths = edges[1:] - edges[:-1]
    lines = edges[:-1] + widths * draw.uniform(f"{name}.frequency", 0.0, 1.0, shape=(terms,))
    powers = density(lines)
    require_nonnegative("density", powers)
    return SumOfSines(
        amplitudes=(2.0 * powers * widths) ** 0.5,
        frequencies=lines,
        phases=draw.uniform(f"{name}.phase", 0.0, 2 * math.pi, shape=(terms,)),
    )


def iso8608_road(
    draw: DrawLike,
    name: str,
    roughness: str | RealScalarLike,
    speed: RealScalarLike,
    wave_numbers: tuple[float, float] = (0.011, 2.83),
    terms: int = 48,
) -> SumOfSines:
    r"""The height of a road under a wheel [m], by ISO 8608.

    $G_d(n) = G_d(n_0) (n / n_0)^{-2}$ over the wave number n [cycles/m], $n_0 = 0.1$ cycles/m; at speed v it is passed
    with $\omega = 2 \pi v n$. Classes A to H have $G_d(n_0) = 16, 64, 256, \dots \cdot 10^{-6}$ m^3, each four times
    the one before. `road - road(0.0)` begins at height zero.

    Args:
        draw: The scenario's source of named numbers.
        name: Prefix of the names `.frequency`, `.phase`, as `random_spectrum` has them.
        roughness: The class, "A" (smooth) to "H", at its geometric mean; or $G_d(n_0)$ [m^3], positive, which may be
            drawn.
        speed: Speed v [m/s], positive; may be drawn.
        wave_numbers: Lowest and highest wave number [cycles/m], positive; by default the range of
            the standard's classes.
        terms: Number of sines, at least 1.

    Returns:
        A `SumOfSines`, whose bound is the sum of its amplitudes.

    Raises:
        InputError: If there is no such class, roughness or speed is not positive, the wave numbers are not positive
            and increasing, or there are no terms.

    Examples:
        >>> import qsmc_jax as qj
        >>> road = qj.disturbances.iso8608_road(qj.Draw([0.5] * 96), "road", "C", speed=15.0)
        >>> rms = (0.5 * (road.amplitudes**2).sum()) ** 0.5
        >>> f"{1000 * rms:.1f} mm, never more than {1000 * float(road.bound):.0f} mm"
        '15.2 mm, never more than 119 mm'

    Source: ISO 8608:2016, Mechanical vibration: road surface profiles, reporting of measured data.
    """
    if isinstance(roughness, str):
        known = f"Classes go from {_ROAD_CLASSES[0]!r} to {_ROAD_CLASSES[-1]!r}; or give G_d(0.1 cycles/m) [m^3]."
        require(roughness in _ROAD_CLASSES, f"Argument `roughness` must be a class, but is {roughness!r}. {known}")
        roughness = 16e-6 * 4.0 ** _ROAD_CLASSES.index(roughness)
    require_positive("roughness", roughness)
    require_positive("speed", speed)
    _require_band("wave_numbers", wave_numbers)
    cycles = 2.0 * math.pi * speed

    def density(w: Any) -> Any:
        return roughness * (w / cycles / 0.1) ** -2.0 / cycles

    low, high = wave_numbers
    return random_spectrum(draw, name, density, (cycles * low, cycles * high), terms)


def dryden_gust(
    draw: DrawLike,
    name: str,
    airspeed: RealScalarLike,
    scale: RealScalarLike,
    intensity: RealScalarLike,
    component: str = "vertical",
    band: tuple[float, float] = (0.02, 50.0),
    terms: int = 48,
) -> SumOfSines:
    r"""The velocity of a gust [m/s] along one axis of an aircraft, by Dryden's spectra.

    With $x = \omega L / V$: $S(\omega) = \sigma^2 \frac{L}{V} \frac{2}{\pi} \frac{1}{1 + x^2}$ along the path,
    $\sigma^2 \frac{L}{V} \frac{1}{\pi} \frac{1 + 3 x^2}{(1 + x^2)^2}$ across it. The whole spectrum has the variance
    $\sigma^2$; the default band has 97 % of it.

    Args:
        draw: The scenario's source of named numbers.
        name: Prefix of the names `.frequency`, `.phase`, as `random_spectrum` has them.
        airspeed: Airspeed V [m/s], positive; may be drawn.
        scale: Scale length L [m] as in MIL-F-8785C, positive; may be drawn. MIL-HDBK-1797 writes 2 L for it across
            the path.
        intensity: Standard deviation $\sigma$ [m/s], positive; may be drawn.
        component: "longitudinal", "lateral" or "vertical"; the last two have one spectrum.
        band: Lowest and highest angular frequency in units of V / L, positive.
        terms: Number of sines, at least 1.

    Returns:
        A `SumOfSines`, whose bound is the sum of its amplitudes.

    Raises:
        InputError: If there is no such component, airspeed, scale or intensity is not positive, the band is not
            positive and increasing, or there are no terms.

    Examples:
        >>> import qsmc_jax as qj
        >>> gust = qj.disturbances.dryden_gust(qj.Draw([0.5] * 96), "gust", airspeed=50.0, scale=150.0, intensity=1.5)
        >>> round(float((0.5 * (gust.amplitudes**2).sum()) ** 0.5), 2)
        1.48

    Source: MIL-F-8785C (1980), Flying qualities of piloted airplanes, 3.7.2.2; MIL-HDBK-1797 (1997), appendix A.
    """
    known = ", ".join(map(repr, _DRYDEN))
    wrong = f"Argument `component` must be one of {known}, but is {component!r}.{nearest(component, _DRYDEN)}"
    require(component in _DRYDEN, wrong)
    for argument, value in (("airspeed", airspeed), ("scale", scale), ("intensity", intensity)):
        require_positive(argument, value)
    _require_band("band", band)
    corner = airspeed / scale

    def density(w: Any) -> Any:
        return intensity**2 / corner * _DRYDEN[component](w / corner)

    return random_spectrum(draw, name, density, (band[0] * corner, band[1] * corner), terms)


def jonswap_waves(
    draw: DrawLike,
    name: str,
    height: RealScalarLike,
    period: RealScalarLike,
    peakedness: RealScalarLike = 3.3,
    band: tuple[float, float] = (0.6, 4.0),
    terms: int = 48,
) -> SumOfSines:
    r"""The elevation of the sea at a point [m], by the JONSWAP spectrum.

    With $x = \omega / \omega_p$, $\omega_p = 2 \pi / T_p$:
    $S(\omega) = (1 - 0.287 \ln \gamma) \frac{5}{16} \frac{H_s^2}{\omega_p} x^{-5} e^{-5/(4 x^4)} \gamma^r$,
    $r = e^{-(x - 1)^2 / (2 s^2)}$, s = 0.07 below the peak and 0.09 above. Its variance is $H_s^2 / 16$, to 2 % (its
    first factor is fitted); the default band has 99.5 % of it. $\gamma = 1$ is the sea of Pierson and Moskowitz.

    Args:
        draw: The scenario's source of named numbers.
        name: Prefix of the names `.frequency`, `.phase`, as `random_spectrum` has them.
        height: Significant height $H_s$ [m], positive; may be drawn.
        period: Peak period $T_p$ [s], positive; may be drawn.
        peakedness: $\gamma$, from 1 to 7; may be drawn.
        band: Lowest and highest angular frequency in units of $\omega_p$, positive.
        terms: Number of sines, at least 1.

    Returns:
        A `SumOfSines`, whose bound is the sum of its amplitudes.

    Raises:
        InputError: If height or period is not positive, the peakedness is out of range, the band is not positive and
            increasing, or there are no terms.

    Examples:
        >>> import qsmc_jax as qj
        >>> waves = qj.disturbances.jonswap_waves(qj.Draw([0.5] * 96), "waves", height=2.0, period=8.0)
        >>> round(float(4.0 * (0.5 * (waves.amplitudes**2).sum()) ** 0.5), 2)
        2.0

    Source: Hasselmann et al. (1973), JONSWAP; in the form of DNV-RP-C205, Environmental conditions and loads, 3.5.5.
    """
    require_positive("height", height)
    require_positive("period", period)
    if not is_traced(peakedness):
        is_known = bool(1.0 <= peakedness <= 7.0)
        require(is_known, f"Argument `peakedness` must lie between 1 and 7, but is {show(peakedness)}.")
    _require_band("band", band)
    peak = 2.0 * math.pi / period

    def density(w: Any) -> Any:
        x = w / peak
        near = jnp.exp(-0.5 * ((x - 1.0) / jnp.where(x > 1.0, 0.09, 0.07)) ** 2)
        calm = 5.0 / 16.0 * height**2 / peak * x**-5.0 * jnp.exp(-1.25 * x**-4.0)
        return (1.0 - 0.287 * jnp.log(peakedness)) * calm * peakedness**near

    return random_spectrum(draw, name, density, (band[0] * peak, band[1] * peak), terms)


def _require_band(name: str, band: Any) -> None:
    require_positive(name, band)
    require_range(name, band)
