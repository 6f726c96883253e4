"""The result of `certify`: a verdict, what is certain, and the proof itself."""

import dataclasses
import decimal
import io
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from qsmc_jax.base.atomic import write_whole
from qsmc_jax.base.checks import require
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.json_numbers import to_json
from qsmc_jax.display.result import AbstractResult
from qsmc_jax.proof.arithmetic import Arithmetic
from qsmc_jax.proof.checker import PROOF, PROVED, TUBES, Certificate, Tube, certificate_of, leaves_of, slab_of
from qsmc_jax.proof.field import frame_of, inside
from qsmc_jax.proof.plots import plot_proof

_COLUMNS = ("sigma_min", "sigma_max", "rho", "u_min", "u_max")
# Rows of a table of a tube, about.
_ROWS = 512


@dataclasses.dataclass(frozen=True, repr=False)
class Proof(AbstractResult):
    """What `certify` found: bounds that are certain, or why there are none.

    Attributes:
        content: What is claimed of what, as the file `proof.json` has it.
        arrays: Knots of the tubes, as the file `tubes.npz` has them; empty if nothing is proved.

    Examples:
        A second pendulum of the same kind may be up to a half heavier, or lighter, at any time:

        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     plant = qj.plants.InvertedPendulum(mass=draw.uniform("mass", 0.005, 0.015))
        ...     law = qj.paper.example1().control
        ...     loop = qj.ClosedLoop(plant, qj.references.Constant(0.0), qj.disturbances.Constant(0.5), law)
        ...     return qj.Scenario(loop, x0=[0.5, 0.5], t1=10.0)
        >>> proof = qj.certify(qj.Study(scenario, bandwidth=0.1), boxes=1)
        >>> proof.verdict, proof.peak_ratio < 1.0, proof.least_gain > 0.0
        ('PROVED', True, True)
    """

    content: Mapping[str, Any]
    arrays: Mapping[str, np.ndarray]

    @property
    def verdict(self) -> str:
        """`"PROVED"`, or `"NOT_PROVED"`, which says nothing against the loop."""
        return self.content["verdict"]

    @property
    def is_proved(self) -> bool:
        """Whether the bounds are certain."""
        return self.verdict == PROVED

    @property
    def reason(self) -> str:
        """Why nothing is proved; empty if it is."""
        return self.content["reason"]

    @property
    def peak_u(self) -> float:
        """What |u| never exceeds, in units of the input; infinite if nothing is proved."""
        return self._claim("peak_u", math.inf)

    @property
    def peak_ratio(self) -> float:
        """What |sigma - m| / rho never exceeds, below 1; infinite if nothing is proved."""
        return self._claim("peak_ratio", math.inf)

    @property
    def peak_errors(self) -> tuple[float, ...]:
        """What |e^(i)| never exceeds, n numbers in units of the output per second to the power i."""
        return tuple(map(float.fromhex, self.content["claims"]["peak_errors"])) if self.is_proved else ()

    @property
    def least_gain(self) -> float:
        """What |g| is never below, as far as runs go; 0 if nothing is proved."""
        return self._claim("least_gain", 0.0)

    @property
    def until(self) -> float:
        """Until when all this holds [s], from 0 on; infinite for ever."""
        return self._claim("until", 0.0)

    @property
    def disturbance_bound(self) -> float:
        """The bound of |d|, whatever is drawn, within which all this holds; NaN if nothing is proved."""
        if not self.is_proved:
            return math.nan
        loop = self.content["loop"]
        return float.fromhex(loop["program"][loop["places"]["bound"]][1])

    @property
    def constant(self) -> tuple[str, ...]:
        """Numbers that are constant along each run of which this holds; others of the plant may vary in time."""
        if not self.is_proved:
            return ()
        loop, tree = self.content["loop"], self.content["tree"]
        told = {*loop["constant"], *(loop["names"][cut[0]] for cut in tree if cut)}
        return tuple(name for name in self._acting() if name in told)

    @property
    def boxes(self) -> int:
        """How many boxes of starts and parameters are told apart."""
        return len(self.arrays["leaves_z"]) if self.is_proved else 0

    @property
    def certificate(self) -> Certificate:
        """What the checker is given; only of what is proved."""
        require(self.is_proved, f"Nothing is proved: {self.reason}")
        return certificate_of(self.content, self.arrays)

    def _claim(self, name: str, otherwise: float) -> float:
        return float.fromhex(self.content["claims"][name]) if self.is_proved else otherwise

    def save(self, folder: str | Path) -> None:
        """Writes the proof into a new folder, which `qsmc check` checks.

        Args:
            folder: The folder.

        Raises:
            InputError: It exists, or can't be made.
        """
        folder = Path(folder)
        try:
            folder.mkdir(parents=True)
        except OSError as error:
            raise InputError(f"Argument `folder` must be new, but `{folder}` can't be made: {error}.") from None
        for name, content in self.files().items():
            write_whole(folder / name, content)

    def files(self) -> dict[str, bytes]:
        """The files of a proof, by name."""
        found = {PROOF: (to_json(self.content) + "\n").encode()}
        if self.arrays:
            file = io.BytesIO()
            np.savez_compressed(file, **dict(self.arrays))
            found[TUBES] = file.getvalue()
        return found

    def table(self) -> dict[str, Any]:
        """The tube of all runs: bounds of sliding variable, funnel and input, a row a slab, from `t` to `until`."""
        if not self.is_proved:
            return {name: np.zeros(0) for name in ("t", "until", *_COLUMNS)}
        certificate = self.certificate
        boxes = np.stack(list(leaves_of(certificate.domain, certificate.tree)))
        parts = [(certificate.leaves, boxes), (certificate.trunk, certificate.domain[None])]
        rows = [_rows(certificate, *part) for part in parts]
        return {name: np.concatenate([part[name] for part in rows]) for name in rows[0]}

    def summary(self) -> dict[str, Any]:
        """Everything as plain numbers and texts, ready for JSON."""
        return {
            "verdict": self.verdict,
            "reason": self.reason,
            "conclusion": self.conclusion(),
            "peak_u": self.peak_u,
            "peak_ratio": self.peak_ratio,
            "peak_errors": list(self.peak_errors),
            "least_gain": self.least_gain,
            "until": self.until,
            "boxes": self.boxes,
            "uncertain": self._uncertain(),
            "constant": list(self.constant),
            "values": dict(self.content["values"]),
        }

    def conclusion(self) -> str:
        """What is claimed, in a sentence that can be quoted."""
        if not self.is_proved:
            return f"NOT_PROVED: {self.reason} This says nothing against the loop."
        until = "for ever" if math.isinf(self.until) else f"up to t = {self.until:g} s"
        return (
            f"PROVED: every run stays in its funnel {until}, with |sigma| / rho <= {_up(self.peak_ratio)} and |u| <= "
            f"{_up(self.peak_u)}, for all numbers in the box{self._varying()}, and every measurable |d| <= "
            f"{self.disturbance_bound:g}."
        )

    def _acting(self) -> list[str]:
        """Uncertain numbers that count along a run, not only at its start."""
        loop = self.content["loop"]
        return [name for name in loop["names"] if ["input", name] in loop["program"]]

    def _varying(self) -> str:
        """Which numbers may vary along a run, in words."""
        if len(self.constant) == len(self._acting()):
            return ", each constant along a run" if self.constant else ""
        return ", constant or not" + (f" (constant: {', '.join(self.constant)})" if self.constant else "")

    def _uncertain(self) -> dict[str, list[float]]:
        if not self.is_proved:
            return {}
        ends = [[float.fromhex(end) for end in ends] for ends in self.content["domain"]]
        return dict(zip(self.content["loop"]["names"], ends, strict=True))

    def plot(self, ax: Any = None) -> Any:
        """The tubes of sliding variable and input that hold all runs, and the funnel.

        Args:
            ax: Two matplotlib `Axes` to draw in; None for a new figure.

        Returns:
            The axes.
        """
        return plot_proof(self, ax)

    def __str__(self) -> str:
        if not self.is_proved:
            return self.conclusion()
        rows = [self.conclusion()]
        rows += [f"  {name:14} in [{low:g}, {high:g}]" for name, (low, high) in self._uncertain().items()]
        rows += [f"  {name:14} = {value}, as given" for name, value in self.content["values"].items()]
        rows += [f"  |e^({i})|         <= {_up(each)}" for i, each in enumerate(self.peak_errors)]
        return "\n".join([*rows, f"  |g|            >= {_down(self.least_gain)}", f"  boxes          {self.boxes}"])


def _up(bound: float) -> str:
    """An upper bound with six digits, rounded up."""
    return _digits(bound, decimal.ROUND_CEILING)


def _down(bound: float) -> str:
    """A lower bound with six digits, rounded down."""
    return _digits(bound, decimal.ROUND_FLOOR)


def _digits(bound: float, rounding: str) -> str:
    with decimal.localcontext(prec=6, rounding=rounding):
        return f"{+decimal.Decimal(bound):g}"


def _rows(certificate: Certificate, tube: Tube, boxes: np.ndarray) -> dict[str, np.ndarray]:
    """What some tubes hold together, on knots that are few enough to look at."""
    ar, loop = Arithmetic(), certificate.loop
    frame = frame_of(ar, certificate.frame, certificate.modes, loop.c)
    knots = tube.times[0]
    grid = np.unique(np.append(knots[:: max(1, len(knots) // _ROWS)], knots[-1]))
    ends = np.full((len(_COLUMNS), len(grid) - 1), -np.inf)
    for i in range(len(boxes)):
        part, shape = tube.of(slice(i, i + 1)), (tube.times.shape[1] - 1,)
        with np.errstate(all="ignore"):
            found = inside(ar, loop, frame, slab_of(ar, loop, frame, part, boxes[i : i + 1]))
        sigma, rho, u = (found[name] for name in ("sigma", "rho", "u"))
        bounds = [np.broadcast_to(np.ravel(each), shape) for each in (-sigma.lo, sigma.hi, rho.hi, -u.lo, u.hi)]
        first, last = np.searchsorted(part.times[0], grid[:-1], "right") - 1, np.searchsorted(part.times[0], grid[1:])
        places = np.stack([first, last], -1).ravel()  # of the slabs that meet a row: from the first up to the last
        largest = [np.maximum.reduceat(np.append(each, -np.inf), places)[::2] for each in bounds]
        ends = np.maximum(ends, largest)
    signs = {"sigma_min": -1.0, "u_min": -1.0}
    columns = {name: signs.get(name, 1.0) * each for name, each in zip(_COLUMNS, ends, strict=True)}
    return {"t": grid[:-1], "until": grid[1:], **columns}
