"""The claims that a run is judged by: the three of Theorem 1, and the requirements of the study."""

from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Int

from qsmc_jax.base.checks import nearest, require
from qsmc_jax.metrics.record import without_index
from qsmc_jax.metrics.verdict import Verdict

# What Theorem 1 claims, by the names of the claims.
STATEMENTS = {
    "funnel": "|sigma(t)| < rho(t) for all t",
    "reaching": "|sigma(t)| < bandwidth for all t >= t_r",
    "tracking": "|e^(i)(t)| <= bandwidth ||G_i||_1 for all t >= t_s and all i",
}
# What a run does that violates one of them.
_BREACHES = {
    "funnel": ("leaving the funnel", "left the funnel"),
    "reaching": ("leaving the bandwidth", "left the bandwidth"),
    "tracking": ("exceeding an error bound", "exceeded an error bound"),
}
# All claims holding together, as it is called where claims have names.
TOGETHER = "all"

_FUNNEL, _PREFIX = "verdict", "verdict_"
# Of several verdicts the first of these that there is.
GRAVEST = (Verdict.VIOLATED, Verdict.UNDECIDED, Verdict.INADMISSIBLE)


def headline(claims: Iterable[str]) -> str:
    """The claim that a conclusion and stopping rules are about: the funnel's; with requirements, all together.

    Args:
        claims: The claims of a study.
    """
    return TOGETHER if any(map(is_requirement, claims)) else "funnel"


def verdict_column(claim: str) -> str:
    """The column of the verdicts on a claim.

    Args:
        claim: Its name.
    """
    return _FUNNEL if claim == "funnel" else f"{_PREFIX}{claim}"


def margin_column(claim: str) -> str:
    """The column of the margins of a requirement; of a claim of Theorem 1 that of the funnel, or of the channel's.

    Args:
        claim: Its name.
    """
    return f"margin_{claim}" if is_requirement(claim) else f"margin{claim.removeprefix(without_index(claim))}"


def claims_of_channels(channels: int) -> tuple[str, ...]:
    """The claims of Theorem 1 for each of several channels, such as `funnel[0]`; none if there is but one.

    Args:
        channels: How many there are.
    """
    return tuple(f"{claim}[{i}]" for i in range(channels) for claim in STATEMENTS) if channels > 1 else ()


def is_requirement(claim: str) -> bool:
    """Whether a claim is a requirement of the study's, not one of Theorem 1.

    Args:
        claim: Its name.
    """
    return without_index(claim) not in STATEMENTS


def statement_of(claim: str) -> str:
    """What a claim says, in a line.

    Args:
        claim: Its name, or that of all together.
    """
    if claim == TOGETHER:
        return "all claims together"
    statement = without_index(claim)
    if statement not in STATEMENTS:
        return f"requirement {claim} of the study"
    return f"{STATEMENTS[statement]}{_in_channel(claim)}"


def require_no_claim(name: str) -> None:
    """Raises if a column of this name would look like the verdicts on a claim.

    Args:
        name: The name.
    """
    require(not claims_of([name]), f"Argument `name` must not begin with '{_PREFIX}', but is '{name}'. Choose another.")


def require_claim(argument: str, claim: str, claims: Iterable[str]) -> None:
    """Raises unless there is such a claim.

    Args:
        argument: Name of the argument that says it.
        claim: Its name.
        claims: The claims that there are.
    """
    known = tuple(claims)
    listed = f"{nearest(claim, known)} There are: {', '.join(known)}."
    require(claim in known, f"Argument `{argument}` must be the name of a claim, but is `{claim}`.{listed}")


def breaching(claim: str) -> str:
    """Violating a claim, in words.

    Args:
        claim: Its name, or that of all together.
    """
    return "violating a claim" if claim == TOGETHER else _breach(claim, f"violating {claim}", "")[0]


def breached(claim: str) -> str:
    """What a run did that violated a claim, in words.

    Args:
        claim: Its name.
    """
    return _breach(claim, "", f"violated {claim}")[1]


def _breach(claim: str, *otherwise: str) -> tuple[str, ...]:
    """The words for a claim of Theorem 1, with its channel if it is about one; else those given."""
    words = _BREACHES.get(without_index(claim), otherwise)
    return tuple(f"{each}{_in_channel(claim)}" for each in words)


def _in_channel(claim: str) -> str:
    """Which channel a claim is about, in words; empty if it is about all."""
    index = claim.removeprefix(without_index(claim)).strip("[]")
    return f" in channel {index}" if index else ""


def told_of_breaches(row: Mapping[str, Any]) -> str:
    """What a run did that violated any claim but the funnel's, with the margins of requirements; empty if nothing.

    Args:
        row: Its row.
    """
    found = [claim for claim in claims_of(row) if claim != "funnel" and row[verdict_column(claim)] == Verdict.VIOLATED]
    margins = {claim: f" by {-row[margin_column(claim)]:.4g}" if is_requirement(claim) else "" for claim in found}
    return ", ".join(f"{breached(claim)}{margin}" for claim, margin in margins.items())


def claims_of(columns: Iterable[str]) -> tuple[str, ...]:
    """The claims whose verdicts are among some columns.

    Args:
        columns: The columns.
    """
    return tuple(
        "funnel" if column == _FUNNEL else column.removeprefix(_PREFIX)
        for column in columns
        if column == _FUNNEL or column.startswith(_PREFIX)
    )


def gravest(verdicts: Collection[Verdict]) -> Verdict:
    """The gravest of several verdicts; HELD if there are none.

    Args:
        verdicts: The verdicts.
    """
    return next((verdict for verdict in GRAVEST if verdict in verdicts), Verdict.HELD)


def together(verdicts: Int[np.ndarray, "claims rows"]) -> Int[np.ndarray, " rows"]:
    """The verdict on all claims together: the gravest.

    Args:
        verdicts: Those on each.
    """
    cases = [(verdicts == verdict).any(axis=0) for verdict in GRAVEST]
    return np.select(cases, list(map(int, GRAVEST)), int(Verdict.HELD))
