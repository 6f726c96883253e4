"""Batched simulation and verification of quasi-sliding-mode control loops, in JAX.

See `simulate` for one run, `Study` and `monte_carlo` for many, `verify` for a verdict with its confidence,
`tune` for gains.
"""

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from qsmc_jax import campaign as campaign
    from qsmc_jax import paper as paper
    from qsmc_jax.base.errors import InputError as InputError
    from qsmc_jax.control import controllers as controllers
    from qsmc_jax.control import funnels as funnels
    from qsmc_jax.control import thresholds as thresholds
    from qsmc_jax.control.control import AbstractControl as AbstractControl
    from qsmc_jax.control.control import Sample as Sample
    from qsmc_jax.control.dynamic_control import AbstractDynamicControl as AbstractDynamicControl
    from qsmc_jax.control.funnel import AbstractFunnel as AbstractFunnel
    from qsmc_jax.control.funnel import Funnel as Funnel
    from qsmc_jax.control.law import QuasiSlidingControl as QuasiSlidingControl
    from qsmc_jax.control.surface import SlidingSurface as SlidingSurface
    from qsmc_jax.falsification.falsify import falsify as falsify
    from qsmc_jax.falsification.result import Falsification as Falsification
    from qsmc_jax.implementation import actuators as actuators
    from qsmc_jax.implementation import noises as noises
    from qsmc_jax.implementation.implementation import GainFault as GainFault
    from qsmc_jax.implementation.implementation import Implementation as Implementation
    from qsmc_jax.implementation.implementation import Jitter as Jitter
    from qsmc_jax.implementation.implementation import random_jitter as random_jitter
    from qsmc_jax.loop import ClosedLoop as ClosedLoop
    from qsmc_jax.metrics.requirements import Requirement as Requirement
    from qsmc_jax.metrics.requirements import always as always
    from qsmc_jax.metrics.requirements import eventually as eventually
    from qsmc_jax.metrics.standard import Metrics as Metrics
    from qsmc_jax.metrics.verdict import Verdict as Verdict
    from qsmc_jax.model import disturbances as disturbances
    from qsmc_jax.model import plants as plants
    from qsmc_jax.model import references as references
    from qsmc_jax.model import smoothed as smoothed
    from qsmc_jax.model.disturbances import AbstractDisturbance as AbstractDisturbance
    from qsmc_jax.model.plants import AbstractPlant as AbstractPlant
    from qsmc_jax.model.recording import Recording as Recording
    from qsmc_jax.model.reference_model import AbstractReferenceModel as AbstractReferenceModel
    from qsmc_jax.model.references import AbstractReference as AbstractReference
    from qsmc_jax.model.state_space import AbstractStateSpace as AbstractStateSpace
    from qsmc_jax.multivariable import MultivariableLoop as MultivariableLoop
    from qsmc_jax.proof.certify import certify as certify
    from qsmc_jax.proof.residual import ResidualBound as ResidualBound
    from qsmc_jax.proof.residual import residual_bound as residual_bound
    from qsmc_jax.proof.result import Proof as Proof
    from qsmc_jax.report.card import Card as Card
    from qsmc_jax.report.card import card as card
    from qsmc_jax.report.saved import load as load
    from qsmc_jax.report.saved import save as save
    from qsmc_jax.robustness.comparison import Comparison as Comparison
    from qsmc_jax.robustness.comparison import compare as compare
    from qsmc_jax.robustness.critical import critical_value as critical_value
    from qsmc_jax.robustness.critical_result import CriticalValue as CriticalValue
    from qsmc_jax.robustness.limits import Threshold as Threshold
    from qsmc_jax.robustness.map import RobustnessMap as RobustnessMap
    from qsmc_jax.robustness.map import robustness_map as robustness_map
    from qsmc_jax.simulation.outcome import Outcome as Outcome
    from qsmc_jax.simulation.settings import SolverSettings as SolverSettings
    from qsmc_jax.simulation.settings import tight as tight
    from qsmc_jax.simulation.trajectory import Trajectory as Trajectory
    from qsmc_jax.simulation.trajectory import simulate as simulate
    from qsmc_jax.statistics.anytime import confidence_sequence as confidence_sequence
    from qsmc_jax.statistics.bands import Band as Band
    from qsmc_jax.statistics.intervals import runs_needed as runs_needed
    from qsmc_jax.statistics.shift import Shift as Shift
    from qsmc_jax.study.cases import table_of as table_of
    from qsmc_jax.study.draw import Draw as Draw
    from qsmc_jax.study.monte_carlo import monte_carlo as monte_carlo
    from qsmc_jax.study.monte_carlo import stream as stream
    from qsmc_jax.study.runs import Runs as Runs
    from qsmc_jax.study.sampling import LatinHypercube as LatinHypercube
    from qsmc_jax.study.sampling import Random as Random
    from qsmc_jax.study.sampling import Sobol as Sobol
    from qsmc_jax.study.sampling import Table as Table
    from qsmc_jax.study.signals import SignalBatch as SignalBatch
    from qsmc_jax.study.signals import signals as signals
    from qsmc_jax.study.study import Scenario as Scenario
    from qsmc_jax.study.study import Study as Study
    from qsmc_jax.tuning import objectives as objectives
    from qsmc_jax.tuning.certificate import Certificate as Certificate
    from qsmc_jax.tuning.landscape import Landscape as Landscape
    from qsmc_jax.tuning.landscape import landscape as landscape
    from qsmc_jax.tuning.result import Tuning as Tuning
    from qsmc_jax.tuning.tune import tune as tune
    from qsmc_jax.verification import stopping as stopping
    from qsmc_jax.verification.result import Verification as Verification
    from qsmc_jax.verification.verify import verify as verify

# Names are loaded on first use, so that `qsmc --help` need not wait for JAX. A test holds this table against the
# imports above.
_HOMES = {
    "InputError": "qsmc_jax.base.errors",
    "AbstractFunnel": "qsmc_jax.control.funnel",
    "Funnel": "qsmc_jax.control.funnel",
    "QuasiSlidingControl": "qsmc_jax.control.law",
    "AbstractControl": "qsmc_jax.control.control",
    "AbstractDynamicControl": "qsmc_jax.control.dynamic_control",
    "Sample": "qsmc_jax.control.control",
    "SlidingSurface": "qsmc_jax.control.surface",
    "GainFault": "qsmc_jax.implementation.implementation",
    "Implementation": "qsmc_jax.implementation.implementation",
    "Jitter": "qsmc_jax.implementation.implementation",
    "random_jitter": "qsmc_jax.implementation.implementation",
    "ClosedLoop": "qsmc_jax.loop",
    "MultivariableLoop": "qsmc_jax.multivariable",
    "AbstractDisturbance": "qsmc_jax.model.disturbances",
    "AbstractPlant": "qsmc_jax.model.plants",
    "AbstractStateSpace": "qsmc_jax.model.state_space",
    "Recording": "qsmc_jax.model.recording",
    "AbstractReference": "qsmc_jax.model.references",
    "AbstractReferenceModel": "qsmc_jax.model.reference_model",
    "Metrics": "qsmc_jax.metrics.standard",
    "always": "qsmc_jax.metrics.requirements",
    "eventually": "qsmc_jax.metrics.requirements",
    "Requirement": "qsmc_jax.metrics.requirements",
    "certify": "qsmc_jax.proof.certify",
    "Proof": "qsmc_jax.proof.result",
    "ResidualBound": "qsmc_jax.proof.residual",
    "residual_bound": "qsmc_jax.proof.residual",
    "Card": "qsmc_jax.report.card",
    "card": "qsmc_jax.report.card",
    "load": "qsmc_jax.report.saved",
    "save": "qsmc_jax.report.saved",
    "Outcome": "qsmc_jax.simulation.outcome",
    "Verdict": "qsmc_jax.metrics.verdict",
    "SolverSettings": "qsmc_jax.simulation.settings",
    "tight": "qsmc_jax.simulation.settings",
    "Trajectory": "qsmc_jax.simulation.trajectory",
    "simulate": "qsmc_jax.simulation.trajectory",
    "table_of": "qsmc_jax.study.cases",
    "Draw": "qsmc_jax.study.draw",
    "monte_carlo": "qsmc_jax.study.monte_carlo",
    "stream": "qsmc_jax.study.monte_carlo",
    "Runs": "qsmc_jax.study.runs",
    "SignalBatch": "qsmc_jax.study.signals",
    "signals": "qsmc_jax.study.signals",
    "LatinHypercube": "qsmc_jax.study.sampling",
    "Random": "qsmc_jax.study.sampling",
    "Sobol": "qsmc_jax.study.sampling",
    "Table": "qsmc_jax.study.sampling",
    "Scenario": "qsmc_jax.study.study",
    "Study": "qsmc_jax.study.study",
    "Comparison": "qsmc_jax.robustness.comparison",
    "compare": "qsmc_jax.robustness.comparison",
    "Certificate": "qsmc_jax.tuning.certificate",
    "Landscape": "qsmc_jax.tuning.landscape",
    "landscape": "qsmc_jax.tuning.landscape",
    "Tuning": "qsmc_jax.tuning.result",
    "tune": "qsmc_jax.tuning.tune",
    "CriticalValue": "qsmc_jax.robustness.critical_result",
    "critical_value": "qsmc_jax.robustness.critical",
    "RobustnessMap": "qsmc_jax.robustness.map",
    "Threshold": "qsmc_jax.robustness.limits",
    "robustness_map": "qsmc_jax.robustness.map",
    "Falsification": "qsmc_jax.falsification.result",
    "falsify": "qsmc_jax.falsification.falsify",
    "confidence_sequence": "qsmc_jax.statistics.anytime",
    "Band": "qsmc_jax.statistics.bands",
    "Shift": "qsmc_jax.statistics.shift",
    "runs_needed": "qsmc_jax.statistics.intervals",
    "Verification": "qsmc_jax.verification.result",
    "verify": "qsmc_jax.verification.verify",
}
_NAMESPACES = {
    "actuators": "qsmc_jax.implementation.actuators",
    "campaign": "qsmc_jax.campaign",
    "controllers": "qsmc_jax.control.controllers",
    "disturbances": "qsmc_jax.model.disturbances",
    "funnels": "qsmc_jax.control.funnels",
    "metrics": "qsmc_jax.metrics",
    "noises": "qsmc_jax.implementation.noises",
    "objectives": "qsmc_jax.tuning.objectives",
    "paper": "qsmc_jax.paper",
    "plants": "qsmc_jax.model.plants",
    "references": "qsmc_jax.model.references",
    "smoothed": "qsmc_jax.model.smoothed",
    "stopping": "qsmc_jax.verification.stopping",
    "thresholds": "qsmc_jax.control.thresholds",
}

__all__ = sorted(["__version__", *_HOMES, *_NAMESPACES])  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _NAMESPACES:
        value = importlib.import_module(_NAMESPACES[name])
    elif name in _HOMES:
        value = getattr(importlib.import_module(_HOMES[name]), name)
    else:
        hint = importlib.import_module("qsmc_jax.base.checks").nearest(name, __all__)
        raise AttributeError(f"Module `qsmc_jax` has no attribute `{name}`.{hint}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
