"""Random numbers of noise and jitter: nobody shares them with anybody, whatever the seeds."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import qsmc_jax as qj
from qsmc_jax.implementation.rng import Consumer, counter_key

SAMPLES = 4000
# Of independent numbers, the correlation over so many is normal with this deviation. Some 100 pairs are compared: one
# beyond five deviations turns up once in 17 000 trials.
SIGMA = 1.0 / np.sqrt(SAMPLES)
PAIRS = list(itertools.combinations([0.0, 0.25, 0.5, np.nextafter(0.5, 1.0)], 2))
SEEDS = {"default": None, "zero": 0.0, "half": 0.5, "drawn": 0.7314159265358979, "next to zero": 5e-324}


def seeded(make, seed):
    return make() if seed is None else make(seed)


def consumers(seed):
    """The numbers of every consumer by its name, over the samples of one run; noises on two states."""
    seeded_with = {} if seed is None else {"seed": seed}
    jitter = qj.Jitter(0.5, **seeded_with)
    noises = {
        "white": qj.noises.White([1.0, 1.0], **seeded_with),
        "uniform": qj.noises.Uniform([1.0, 1.0], **seeded_with),
    }
    ks = jnp.arange(float(SAMPLES))
    table = {"jitter": jax.vmap(jitter)(ks)}
    for name, noise in noises.items():
        first, second = jax.vmap(lambda k, noise=noise: noise(0.0, k))(ks)
        table |= {f"{name}[0]": first, f"{name}[1]": second}
    return {name: np.asarray(values) for name, values in table.items()}


def draws(seed):
    """The coordinates that the runs of a study get."""
    points = qj.Random().points(seed, range(SAMPLES), 2)
    return {f"draw[{i}]": points[:, i] for i in range(2)}


def worst(table):
    """The largest correlation of two columns, and of each with itself one sample later, and between whom."""
    pairs = [(a, b, table[a], table[b]) for a, b in itertools.combinations(table, 2)]
    pairs += [(name, "one later", values[1:], values[:-1]) for name, values in table.items()]
    return max((abs(np.corrcoef(x, y)[0, 1]), a, b) for a, b, x, y in pairs)


@pytest.mark.parametrize("seed", SEEDS.values(), ids=SEEDS)
def test_consumers_of_one_seed_share_nothing(seed):
    found = worst(consumers(seed))
    assert found[0] < 5.0 * SIGMA, found


@pytest.mark.parametrize("study_seed", [0, 1, 2**31, 0x3FE00000 << 32])
@pytest.mark.parametrize("seed", [0.0, 0.5])
def test_consumers_share_nothing_with_the_draws_of_a_study(seed, study_seed):
    """The seeds include those whose bits are the same: of 0.0 and 0, of 0.5 and 0x3FE00000 00000000."""
    found = worst(consumers(seed) | draws(study_seed))
    assert found[0] < 5.0 * SIGMA, found


@pytest.mark.parametrize(("one", "other"), PAIRS)
def test_other_seeds_are_other_numbers(one, other):
    first = {f"{name} of {one}": values for name, values in consumers(one).items()}
    second = {f"{name} of {other}": values for name, values in consumers(other).items()}
    found = worst(first | second)
    assert found[0] < 5.0 * SIGMA, found


def test_every_key_is_another():
    """Also where the counters of two consumers come nearest: at the last sample of one and the first of the next."""
    seeds, ks = [0.0, 0.5, 0.75, np.nextafter(1.0, 0.0)], [0.0, 1.0, 2.0**29 - 1.0]
    keys = {tuple(jax.random.key_data(counter_key(c, s, k)).tolist()) for c in Consumer for s in seeds for k in ks}
    assert len(keys) == len(Consumer) * len(seeds) * len(ks)
    assert max(Consumer) < 8
