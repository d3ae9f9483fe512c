"""The page as a file: everything in it, nothing loaded."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from ekfslam.errors import InputError
from ekfslam.report import campaign, comparison
from ekfslam.report.drawings import Ink, of_campaign, of_comparison
from ekfslam.report.folder import CampaignFolder, ComparisonFolder, read_results
from ekfslam.report.maps import maps_of
from ekfslam.report.words import counted
from ekfslam.storage import atomic_write

FILE = "report.html"


def write_report(folder: str | Path, out: str | Path | None = None) -> Path:
    """Write one self-contained HTML page of a comparison or a campaign.

    It holds what ran, the findings in words, maps to step through, tables that sort, figures,
    configuration and versions, and loads nothing. Only the folder is read; no estimator runs.

    Parameters
    ----------
    folder : path
        What ``--out`` of ``ekfslam compare`` or ``ekfslam campaign`` named; a campaign may be
        unfinished.
    out : path, optional
        The page; ``report.html`` in the folder by default.

    Returns
    -------
    Path
        The page. It appears whole or not at all.

    Raises
    ------
    FileFormatError
        If the folder holds no results, or a file of it is damaged; names the file, and the line
        where it has lines.
    InputError
        If the page cannot be written.
    """
    path = Path(folder) / FILE if out is None else Path(out)
    results = read_results(folder)
    if path.is_dir() or not path.parent.is_dir():
        raise InputError(f"cannot write {path}: --out is a file in a folder that exists")
    page = render(results)
    with atomic_write(path) as stream:
        stream.write(page.encode("utf-8"))
    return path


def render(results: ComparisonFolder | CampaignFolder) -> str:
    """The page as text."""
    ink = Ink()
    if isinstance(results, ComparisonFolder):
        content = _of_comparison(results, ink)
    else:
        content = _of_campaign(results, ink)
    for code in (each["color"] for m in content["maps"] for each in m.data["tracks"]):
        ink.color(code)
    content["kept"] = _in_lines(results.config)
    content["versions"] = _versions(results.config)
    script = _text("page.js")
    digest = hashlib.sha256(script.encode()).digest()
    # Autoescaping is on: names and messages come from files that somebody else may have written.
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    return environment.from_string(_text("page.html")).render(
        **content,
        style=Markup(_text("page.css") + ink.css),
        script=Markup(script),
        script_hash=base64.b64encode(digest).decode(),
        svg=Markup,
    )


def _of_comparison(results: ComparisonFolder, ink: Ink) -> dict[str, Any]:
    datasets, config = list(results.summary["dataset"].unique()), results.config
    lacking = [f"The table {name} is not kept in the folder." for name in results.missing]
    if "trajectories" in results.missing:
        lacking.append("Without trajectories there are neither maps nor figures.")
    if results.every > 1:
        lacking.append(
            f"Of tables of steps every {results.every}th step is kept; figures are of those."
        )
    if config.get("ids_withheld"):
        lacking.append("Who was seen was withheld from the estimators.")
    aligned = config.get("alignment", "none")
    return {
        "kind": "Comparison",
        "title": ", ".join(datasets),
        "lead": f"{counted(len(config['estimators']), 'estimator')} on "
        f"{counted(len(datasets), 'dataset')}, side by side. Alignment before errors: {aligned}.",
        "remarks": lacking,
        "ran": comparison.what_ran(results),
        "findings": comparison.findings(results),
        "maps": maps_of(results),
        "tables": comparison.overview(results),
        "everything": comparison.everything(results),
        "drawings": of_comparison(results, ink),
    }


def _of_campaign(results: CampaignFolder, ink: Ink) -> dict[str, Any]:
    config, remarks = results.config, []
    if results.cells is None:
        remarks.append("Statistics are those of the CSV files: the runs themselves are not here.")
    elif results.cells[0] < results.cells[1]:
        done, cells = results.cells
        remarks.append(f"Unfinished: {done} of {cells} cells are done, and this is what they say.")
    remarks.append("A campaign keeps no poses, so that there is no map.")
    scenarios = counted(len(config["scenarios"]), "scenario")
    return {
        "kind": "Campaign",
        "title": str(config["campaign"]),
        "lead": f"{counted(len(config['estimators']), 'estimator')} on {scenarios} and "
        f"{counted(len(config['seeds']), 'seed')}.",
        "remarks": remarks,
        "ran": campaign.what_ran(results),
        "findings": campaign.findings(results),
        "maps": [],
        "tables": campaign.overview(results),
        "everything": campaign.everything(results),
        "drawings": of_campaign(results, ink),
    }


def _in_lines(config: Mapping[str, Any]) -> str:
    """The configuration as JSON, lists of numbers on one line: two hundred seeds fill pages."""
    text = json.dumps(dict(config), indent=2, ensure_ascii=False)
    numbers = r"\[\n\s*[-+.\deE]+(?:,\n\s*[-+.\deE]+)*\n\s*\]"  # a string holds no line break
    return re.sub(numbers, lambda found: json.dumps(json.loads(found[0])), text)


def _versions(config: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [(str(name), str(value)) for name, value in config.get("versions", {}).items()]


def _text(name: str) -> str:
    return files("ekfslam.report").joinpath(name).read_text(encoding="utf-8")
