"""What a function may do between the instants at which it was looked at: bounds that hold, and are not absurd."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BarycentricInterpolator

import qsmc_jax as qj
from qsmc_jax.enclosures.unseen import Nodes, Step, unseen
from qsmc_jax.model.unseen import unseen_in_reference, unseen_in_signal
from qsmc_jax.simulation.probed import probed_functions
from qsmc_jax.solvers.rosenbrock import RODAS4, RODAS5P, Rosenbrock
from qsmc_jax.solvers.tsit5 import Tsit5

NODES = {"tsit5": Tsit5().nodes, "rodas4": Rosenbrock(RODAS4).nodes, "rodas5p": Rosenbrock(RODAS5P).nodes}
SPREAD = np.linspace(0.0, 1.0, 4001)


def missed(signal, t0, h, nodes):
    """By how much a signal departs from the polynomial through its values at the nodes."""
    places = t0 + h * np.asarray(nodes.places)
    polynomial = BarycentricInterpolator(places, [float(signal(t)) for t in places])
    within = t0 + h * SPREAD
    return float(np.max(np.abs(np.asarray(jax.vmap(signal)(within)) - polynomial(within))))


@pytest.mark.parametrize("name", NODES)
@pytest.mark.parametrize("cycles", [0.05, 0.3, 1.0, 3.0])
def test_a_sine_departs_from_its_stages_polynomial_by_no_more_than_is_said(name, cycles):
    nodes, frequency = NODES[name], 7.0
    h = cycles * 2.0 * np.pi / frequency
    for signal in (qj.disturbances.Sine(2.0, frequency, 0.3), qj.disturbances.SumOfSines([1.0, 0.5], [frequency, 3.0])):
        worst = max(missed(signal, t0, h, nodes) for t0 in (0.0, 0.1, 0.25))
        said = float(unseen_in_signal(signal, Step(0.0, h, nodes)).amount)
        within_bound = said == pytest.approx(2.0 * float(signal.bound))
        assert worst <= said * (1.0 + 1e-9) + 1e-13 or within_bound
        if cycles <= 0.3:
            assert said < 1e-2 * float(signal.bound)  # an ordinary step is not refused


def test_the_remainder_is_that_of_the_chebyshev_like_product():
    nodes = Nodes((0.0, 0.5, 1.0), few=(0.0, 0.5, 1.0))
    assert nodes.remainder == pytest.approx(1.0 / (12.0 * np.sqrt(3.0)) / 6.0, rel=1e-6)
    assert (nodes.order, nodes.gap) == (3, 0.5)


@pytest.mark.parametrize("t0", [0.0, 1.0, 2.3])
def test_bounded_noise_passes_its_values_at_the_stages_by_no_more_than_is_said(t0):
    generator = np.random.default_rng(3)
    signal = qj.disturbances.BandLimitedNoise(
        generator.uniform(0.0, 0.2, 16), np.linspace(1.0, 20.0, 16), generator.uniform(0.0, 6.0, 16), bound=0.5
    )
    nodes, h = NODES["tsit5"], 0.03
    values = np.asarray(jax.vmap(signal)(t0 + h * SPREAD))
    seen = [float(signal(t0 + h * place)) for place in nodes.places]
    said = float(unseen_in_signal(signal, Step(t0, t0 + h, nodes)).amount)
    assert values.max() - max(seen) <= said
    assert min(seen) - values.min() <= said
    assert said < 0.1


def test_smooth_steps_are_polynomials_of_the_fifth_degree_between_their_breaks():
    signal = qj.disturbances.SmoothSteps([1.0, 1.4], [0.0, 2.0, -1.0], rise_time=1.0)
    assert missed(signal, 1.4, 0.6, NODES["tsit5"]) < 1e-9
    assert unseen_in_signal(signal, Step(1.4, 2.0, NODES["tsit5"])).amount == 0.0
    cell = Nodes((0.0, 0.5, 0.75, 1.0), few=(0.0, 0.5, 1.0))
    assert missed(signal, 1.4, 0.2, cell) <= float(unseen_in_signal(signal, Step(1.4, 1.6, cell)).amount)


@pytest.mark.parametrize("order", [0, 1, 3])
def test_a_reference_of_sines_counts_each_derivative_for_itself(order):
    reference = qj.references.SumOfSines([1.0, 0.2], [2.0, 9.0])
    nodes, h = NODES["rodas5p"], 0.4
    derivative = lambda t: reference.derivatives(t, order)[order]  # noqa: E731
    said = float(unseen_in_reference(reference, order, Step(0.0, h, nodes)).amount)
    assert missed(derivative, 0.0, h, nodes) <= said < 0.05 * 9.0**order


PULSES = {
    "gaussian": lambda t, at, width: jnp.exp(-(((t - at) / width) ** 2)),
    "half-sine": lambda t, at, width: jnp.sin(jnp.pi * jnp.clip((t - at) / width + 0.5, 0.0, 1.0)),
    "jump and back": lambda t, at, width: jnp.where(jnp.abs(t - at) < width, 1.0, 0.0),
    "triangle": lambda t, at, width: jnp.maximum(0.0, 1.0 - jnp.abs(t - at) / width),
    "sech": lambda t, at, width: 1.0 / jnp.cosh((t - at) / width),
    "lorentzian": lambda t, at, width: 1.0 / (1.0 + ((t - at) / width) ** 2),
    "interpolated": lambda t, at, width: jnp.interp(
        t, at + width * jnp.array([-1.0, 0.0, 1.0]), jnp.array([0.0, 1.0, 0.0])
    ),
}


@pytest.mark.parametrize("pulse", PULSES.values(), ids=PULSES)
def test_a_pulse_between_the_nodes_is_never_unseen(pulse):
    nodes, generator = NODES["tsit5"], np.random.default_rng(4)
    at = generator.uniform(0.4, 0.85, 200)
    width = 10.0 ** generator.uniform(-9.0, -2.0, 200)
    amount = jax.jit(
        jax.vmap(lambda at, width: unseen(lambda t: 0.3 + 5.0 * pulse(t, at, width), Step(0.0, 1.0, nodes)).amount)
    )(at, width)
    seen = np.max([5.0 * np.asarray(jax.vmap(pulse)(np.full(200, p), at, width)) for p in nodes.few], axis=0)
    assert np.all(np.asarray(amount) >= 5.0 - seen - 1e-9)


@pytest.mark.parametrize("pulse", PULSES.values(), ids=PULSES)
def test_far_from_a_pulse_hardly_anything_is_unseen(pulse):
    step = Step(jnp.asarray(3.0), jnp.asarray(3.01), NODES["tsit5"])
    assert float(unseen(lambda t: 0.3 + 5.0 * pulse(t, 1.0, 1e-3), step).amount) < 1e-6


SMOOTH = {
    "product": lambda t: jnp.sin(3.0 * t) * jnp.sin(2.0 * t) - jnp.cos(t) ** 2,
    "softplus": lambda t: jax.nn.softplus(5.0 * jnp.sin(t)) - t,
    "quotient": lambda t: (1.0 + t) / (2.0 + jnp.cos(3.0 * t)),
    "sum of sines": lambda t: jnp.sum(jnp.array([1.0, -0.7, 0.2]) * jnp.sin(jnp.array([1.0, 3.0, 8.0]) * t)),
}


@pytest.mark.parametrize("fn", SMOOTH.values(), ids=SMOOTH)
def test_what_is_unseen_of_a_smooth_function_falls_with_the_square_of_the_step(fn):
    nodes = NODES["tsit5"]
    amounts = []
    for h in (0.04, 0.02, 0.01):
        starts = np.linspace(0.0, 6.0, 100)
        found = jax.jit(jax.vmap(lambda t0, h=h: unseen(fn, Step(t0, t0 + h, nodes)).amount))(starts)
        amounts.append(float(np.max(found)))
    assert amounts[1] < 0.45 * amounts[0]
    assert amounts[2] < 0.45 * amounts[1]


def test_a_constant_hides_nothing_and_costs_nothing():
    assert unseen(lambda t: 0.7, Step(0.0, 1.0, NODES["tsit5"])).amount == 0.0
    for signal in (qj.disturbances.Constant(1.0), qj.disturbances.Zero(), 2.0 * qj.disturbances.Constant(1.0)):
        assert isinstance(unseen_in_signal(signal, Step(0.0, 1.0, NODES["tsit5"])).amount, float)


class Plant(qj.AbstractPlant):
    """A plant with any drift."""

    f: object
    order = 1

    def drift(self, t, x):
        return self.f(t) * x[0]

    def gain(self, t, x):
        return 1.0


def loop(f):
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(4.0, 3.0, 0.05))
    return qj.ClosedLoop(Plant(f), qj.references.Constant(0.0), qj.disturbances.Zero(), control)


@pytest.mark.slow
def test_what_could_only_be_probed_is_named_in_what_is_printed():
    assert probed_functions(loop(jnp.sin)) == ()
    odd = loop(lambda t: jax.scipy.special.i0e(t))
    assert probed_functions(odd) == ("`drift` of `Plant` (`bessel_i0e`)",)
    assert "Only probed" in str(qj.simulate(odd, [0.5], 1.0))
    assert "Only probed" not in str(qj.simulate(loop(jnp.sin), [0.5], 1.0))


def test_probing_finds_what_is_wider_than_a_thirtieth_of_the_step():
    fn = lambda t: jax.scipy.special.i0e(0.0 * t) * jnp.exp(-(((t - 0.6) / 0.05) ** 2))  # noqa: E731
    assert float(unseen(fn, Step(0.0, 1.0, NODES["tsit5"])).amount) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("value", [jnp.nan, jnp.inf])
def test_a_function_that_is_not_finite_somewhere_is_refused_with_the_place(value):
    with pytest.raises(
        ValueError, match=r"`drift` of `Plant` must be finite, but is (nan|inf) at t = 3\.0.* x = \[0.5\]"
    ):
        qj.simulate(loop(lambda t: jnp.where(t > 3.0, value, 1.0)), [0.5], 5.0)
    study = lambda draw: qj.Scenario(loop(lambda t: jnp.where(t > 3.0, value, 1.0)), [0.5], 5.0)  # noqa: E731
    with pytest.raises(ValueError, match=r"`drift` of `Plant` must be finite"):
        qj.Study(study, bandwidth=0.1)
