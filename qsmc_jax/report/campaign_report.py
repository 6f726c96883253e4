"""What a campaign ends as: summary, pictures, and one page that can be handed on."""

import base64
import json
import shlex
from collections.abc import Callable, Mapping
from typing import Any

import jinja2

from qsmc_jax.base.atomic import write_whole
from qsmc_jax.base.checks import require
from qsmc_jax.base.json_numbers import restored, to_json
from qsmc_jax.campaign.commands import verify_command
from qsmc_jax.campaign.config import settings_in
from qsmc_jax.campaign.folder import RunFolder
from qsmc_jax.display.plotting import as_png
from qsmc_jax.metrics.claims import is_requirement, told_of_breaches
from qsmc_jax.metrics.standard import USUAL
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.report.sensitivity import Sensitivity
from qsmc_jax.simulation.outcome import Outcome
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.verification.result import Verification

_PICTURES = {
    "verification.png": "The funnel with bands of the first runs and the worst one; how much room the runs leave; when "
    "they come to the bandwidth for good.",
    "sensitivity.png": "Sensitivity of the margin to drawn numbers: Spearman's rank "
    "correlation, and the margin against the strongest three.",
}


def write_summary(folder: RunFolder, result: Verification, provenance: Mapping[str, Any]) -> None:
    """Writes `summary.json`: what was found, before any picture.

    Args:
        folder: The run folder.
        result: What its rows showed.
        provenance: Of the session that came to the end.
    """
    content = to_json({**result.summary(), "conclusion": result.conclusion(), "provenance": provenance})
    write_whole(folder.path / "summary.json", content.encode() + b"\n")


def write_report(folder: RunFolder, result: Verification) -> None:
    """Writes the pictures and `report.html` into a run folder that has a summary.

    Args:
        folder: The run folder.
        result: What its rows showed.
    """
    (folder.path / "figures").mkdir(exist_ok=True)
    _draw(folder, "verification.png", result.plot)
    write_page(folder)


def write_page(folder: RunFolder) -> None:
    """Writes `report.html` from what is in the folder; nothing is solved and no study is run.

    Raises:
        InputError: There is no summary yet.
    """
    summary = folder.summary()
    require(summary is not None, f"Folder `{folder.path}` has no summary yet: give the command of its runs again.")
    summary = restored(summary)
    sensitivity = Sensitivity.of(folder.tables(0, int(summary["runs"])))
    if sensitivity.names:
        (folder.path / "figures").mkdir(exist_ok=True)
        _draw(folder, "sensitivity.png", sensitivity.plot)
    write_whole(folder.path / "report.html", page(folder, summary, sensitivity).encode())


def page(folder: RunFolder, summary: Mapping[str, Any], sensitivity: Sensitivity) -> str:
    """The page: self-contained, with its pictures in it."""
    manifest, place = folder.manifest, str(folder.path)
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("qsmc_jax.report", "templates"), autoescape=True, undefined=jinja2.StrictUndefined
    )
    environment.filters["short"] = _short
    about = (manifest["study_file"], summary["runs"], summary["seed"], summary["confidence"], summary["values"])
    asked = manifest["identity"].get("metrics", USUAL)
    error = summary["numerical_error"]
    changed = {name: change for name, change in error["metrics"].items() if (change["relative"] or 0.0) > 0.0}
    largest = sorted(changed.items(), key=lambda item: -item[1]["relative"])
    return environment.get_template("report.html.j2").render(
        place=place,
        summary=summary,
        claims=[{**claim, "sentence": _sentence(claim, summary)} for claim in _told_claims(summary)],
        worst=[{**row, "finding": _finding(row)} for row in summary["worst"]],
        show=f"qsmc show {shlex.quote(place)} --run",
        pictures=[(_inline(folder, name), text) for name, text in _PICTURES.items() if _is_there(folder, name)],
        sensitivity=sensitivity,
        manifest=manifest,
        sessions=folder.sessions(),
        zip=zip,
        again=shlex.join([*verify_command(*about, settings_in(manifest["identity"]), asked), "--out", "again"]),
        firmer=shlex.join([*verify_command(*about, SolverSettings(**summary["firmer"]), asked), "--out", "firmer"]),
        largest=largest[:5],
    )


def _told_claims(summary: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The claims; with requirements among them, all together too."""
    claims = summary["claims"]
    return [*claims, summary["together"]] if any(is_requirement(each["name"]) for each in claims) else claims


def _sentence(claim: Mapping[str, Any], summary: Mapping[str, Any]) -> str:
    """The finding on one claim, as it can be quoted."""
    admitted = claim["held"] + claim["violated"] + claim["undecided"]
    if not admitted:
        return f"No run was admissible for the claim that {claim['statement']}."
    found = f"In {claim['violated']} of {admitted} admissible independent runs it was violated"
    found += f", {claim['undecided']} could not be decided and count both ways" if claim["undecided"] else ""
    is_anytime = summary["interval"] == "confidence sequence"
    kind = "at all numbers of runs at once (confidence sequence)" if is_anytime else "(Clopper-Pearson)"
    sure = f"with {100 * summary['confidence']:g} % confidence"
    return f"{found}; its probability lies between {claim['low']:.3g} and {claim['high']:.3g} {sure} {kind}."


def _finding(row: Mapping[str, Any]) -> str:
    verdict, outcome = Verdict(row["verdict"]).name, Outcome(row["outcome"]).name
    told = verdict if verdict == "HELD" else f"{verdict}, {outcome} at {_short(row['end_time'])} s"
    return ", ".join(filter(None, (told, told_of_breaches(row))))


def _short(value: Any) -> str:
    """A value as a reader wants it: five digits, containers as JSON."""
    if value is None:
        return "unknown"
    if isinstance(value, float):
        return f"{value:.5g}"
    return value if isinstance(value, str) else json.dumps(value)


def _draw(folder: RunFolder, name: str, draw: Callable[[], Any]) -> None:
    write_whole(folder.path / "figures" / name, as_png(draw, dpi=110))


def _is_there(folder: RunFolder, name: str) -> bool:
    return (folder.path / "figures" / name).is_file()


def _inline(folder: RunFolder, name: str) -> str:
    return "data:image/png;base64," + base64.b64encode((folder.path / "figures" / name).read_bytes()).decode()
