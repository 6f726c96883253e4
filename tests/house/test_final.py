"""Abstract or final: a concrete class of the package can't be subclassed, and is told what to do instead."""

import importlib
import inspect
import pkgutil
import types

import pytest

import qsmc_jax as qj
from qsmc_jax.base.module import AbstractModule

MODULES = [importlib.import_module(info.name) for info in pkgutil.walk_packages(qj.__path__, "qsmc_jax.")]
CLASSES = {
    f"{kind.__module__}.{kind.__qualname__}": kind
    for module in MODULES
    for kind in vars(module).values()
    if inspect.isclass(kind) and issubclass(kind, AbstractModule) and kind.__module__.startswith("qsmc_jax.")
}
ABSTRACT = {name: kind for name, kind in CLASSES.items() if "Abstract" in kind.__name__}
FINAL = {name: kind for name, kind in CLASSES.items() if name not in ABSTRACT}

# Of each family that has an interface: what to derive from instead.
INTERFACES = {
    qj.QuasiSlidingControl: "`AbstractControl` of `qsmc_jax.control.control`",
    qj.controllers.Sign: "`AbstractControl` of `qsmc_jax.control.control`",
    qj.plants.InvertedPendulum: "`AbstractPlant` of `qsmc_jax.model.plants`",
    qj.references.Smooth: "`AbstractReference` of `qsmc_jax.model.references`",
    qj.disturbances.Sine: "`AbstractDisturbance` of `qsmc_jax.model.disturbances.disturbance`",
    qj.noises.White: "`AbstractNoise` of `qsmc_jax.implementation.noises`",
    qj.actuators.FirstOrderLag: "`AbstractMonotoneActuator` of `qsmc_jax.implementation.actuators.actuator`",
    qj.Random: "`AbstractSampling` of `qsmc_jax.study.sampling`",
}


def derived(*bases):
    return types.new_class("Mine", bases)


@pytest.mark.parametrize("kind", FINAL.values(), ids=FINAL)
def test_a_concrete_class_is_final(kind):
    with pytest.raises(TypeError, match=f"Class `Mine` must not be derived from `{kind.__name__}`, which is final. "):
        derived(kind)


@pytest.mark.parametrize("kind", ABSTRACT.values(), ids=ABSTRACT)
def test_an_interface_may_be_derived_from(kind):
    assert issubclass(derived(kind), kind)


def test_there_are_both():
    assert qj.Funnel in FINAL.values()
    assert qj.AbstractPlant in ABSTRACT.values()
    assert len(FINAL) > 40


@pytest.mark.parametrize(("kind", "interface"), INTERFACES.items(), ids=[kind.__name__ for kind in INTERFACES])
def test_the_interface_is_named(kind, interface):
    with pytest.raises(TypeError) as refusal:
        derived(kind)
    message = str(refusal.value)
    assert f"Derive it from {interface}, and keep a `{kind.__name__}` in a field if need be." in message
    name, module = interface.replace("`", "").split(" of ")
    assert issubclass(kind, getattr(importlib.import_module(module), name))


def test_what_is_possible_is_said_where_there_is_no_interface_yet():
    with pytest.raises(
        TypeError, match=r"final\. Derive it from `AbstractFunnel` .*`qj.funnels.Smooth\(fn\)` takes any"
    ):
        derived(qj.Funnel)
    with pytest.raises(TypeError, match=r"final\. Keep a `Jitter` in a field instead"):
        derived(qj.Jitter)
    with pytest.raises(TypeError, match=r"A law of your own is an `AbstractControl`"):
        derived(qj.QuasiSlidingControl)


def test_a_final_class_is_found_among_several():
    with pytest.raises(TypeError, match="from `Zero`"):
        derived(qj.AbstractPlant, qj.disturbances.Zero)


def test_plants_of_users_may_be_derived_from_one_another():
    class Unit(qj.AbstractPlant):
        order = 1

        def drift(self, t, x):
            return 0.0 * x[0]

        def gain(self, t, x):
            return 1.0

    class Second(Unit):
        order = 2

    assert Second().order == 2
    assert Second().gain(0.0, (0.0, 0.0)) == 1.0
