"""Laws whose memory follows a differential equation, so that they run in continuous time too."""

import abc
from typing import Any

import jax

from qsmc_jax.base.checks import require
from qsmc_jax.base.types import RealScalarLike, Scalars, State
from qsmc_jax.control.control import AbstractControl, Sample
from qsmc_jax.tracing.traceable import described, is_number, once_per_structure, trace


class AbstractDynamicControl(AbstractControl):
    r"""A controller with states of its own, $\dot m = \phi(t, m, \dots)$: an integral, a filter, an observer.

    In the ideal loop these follow the plant's in `x`; a start `x0` is the plant's alone. There a `Sample` has exact
    errors and period 0, and of what `command` returns the memory is of no account. In a loop with an `Implementation`
    it is as for any law: `first_memory`, and what `command` keeps.

    Examples:
        A linear law with an integral of the error, which leaves none under a constant load:

        >>> from typing import ClassVar
        >>> import jax.numpy as jnp
        >>> import qsmc_jax as qj
        >>> class Integral(qj.AbstractDynamicControl):
        ...     surface: qj.SlidingSurface
        ...     funnel: qj.AbstractFunnel
        ...     gain_sign: float = 1.0
        ...     positive: ClassVar[tuple[str, ...]] = ()
        ...     def first_memory(self):
        ...         return (jnp.zeros(()),)
        ...     def command(self, sample, memory):
        ...         kept = memory[0] + sample.period * sample.errors[0]
        ...         return -5.0 * sample.errors[0] - 10.0 * memory[0], (kept,)
        ...     def memory_at_start(self, sample):
        ...         return (0.0,)
        ...     def memory_rates(self, sample, memory):
        ...         return (sample.errors[0],)
        >>> class Motor(qj.AbstractPlant):
        ...     order = 1
        ...     def drift(self, t, x):
        ...         return 2.0 - x[0]
        ...     def gain(self, t, x):
        ...         return 1.0
        >>> law = Integral(qj.SlidingSurface([]), qj.Funnel(rho0=4.0, mu=1.0, rho_inf=0.5))
        >>> loop = qj.ClosedLoop(Motor(), qj.references.Constant(1.0), qj.disturbances.Zero(), law)
        >>> run = qj.simulate(loop, [0.0], t1=8.0)
        >>> run.verdict.name, run.x[-1].round(3).tolist()  # the speed, and the integral
        ('HELD', [1.0, 0.1])
    """

    @abc.abstractmethod
    def memory_at_start(self, sample: Sample) -> Scalars:
        """The memory at time 0 of the ideal loop, as many scalars as `first_memory` has.

        Args:
            sample: What it is given then.
        """

    @abc.abstractmethod
    def memory_rates(self, sample: Sample, memory: Scalars) -> Scalars:
        """The rates of the memory in the ideal loop, as many scalars; smooth functions of the sample and the memory.

        Args:
            sample: What it is given.
            memory: The memory.
        """


def is_continuous(law: AbstractControl) -> bool:
    """Whether a law runs in continuous time: a smooth one without memory, or with one that has rates.

    Args:
        law: The law.
    """
    return law.has_derivative and _has_rates(law)


def _has_rates(law: AbstractControl) -> bool:
    """Whether what a law keeps, and the laws that it is made of, has rates."""
    is_known = isinstance(law, AbstractDynamicControl) or len(law.first_memory()) == 0
    return is_known and all(map(_has_rates, law.inner_laws))


@once_per_structure
def require_memory(law: AbstractControl) -> None:
    """Raises unless start and rates of a law's memory are as many numbers as its `first_memory`."""
    number = jax.ShapeDtypeStruct((), float)
    order, count = law.surface.order, len(law.first_memory())

    def start(law: AbstractControl, t: Any, sigma: Any, desired: Scalars, errors: Scalars, memory: Scalars) -> Scalars:
        return tuple(memory_at_start(law, law.exact_sample(t, errors, desired, sigma)))

    def rates(law: AbstractControl, t: Any, sigma: Any, desired: Scalars, errors: Scalars, memory: Scalars) -> Scalars:
        return tuple(memory_rates(law, law.exact_sample(t, errors, desired, sigma), memory))

    given = number, number, (number,) * (order + 1), (number,) * order, (number,) * count
    for method, call in {"memory_at_start": start, "memory_rates": rates}.items():
        name = f"`{method}` of `{type(law).__name__}`"
        _, result = trace(name, "a sample, and a memory", law, call, *given)
        require(
            len(result) == count and all(map(is_number, result)),
            f"{name} must return {count} numbers, as `first_memory` does, but returns {described(result)}.",
        )


def memory_at_start(law: AbstractControl, sample: Sample) -> Scalars:
    """The memory of any law at time 0 of the ideal loop; none if it has none.

    Args:
        law: The law.
        sample: What it is given then.
    """
    return law.memory_at_start(sample) if isinstance(law, AbstractDynamicControl) else ()


def memory_rates(law: AbstractControl, sample: Sample, memory: Scalars) -> Scalars:
    """The rates of the memory of any law in the ideal loop; none if it has none.

    Args:
        law: The law.
        sample: What it is given.
        memory: The memory.
    """
    return law.memory_rates(sample, memory) if isinstance(law, AbstractDynamicControl) else ()


def exact_command(
    law: AbstractControl, t: RealScalarLike, errors: State, desired: State, deviation: RealScalarLike, memory: State
) -> RealScalarLike:
    """What any law makes of exact errors.

    Args:
        law: The law.
        t: Time [s].
        errors: Errors, n scalars.
        desired: Desired output and its first n derivatives.
        deviation: The sliding variable, from the funnel's centre.
        memory: What the law keeps.
    """
    sigma = deviation + law.funnel.centre(t)
    return law.command(law.exact_sample(t, tuple(errors), tuple(desired), sigma), tuple(memory))[0]
