"""Campaigns run: what is left of one is worked on and kept as it finishes."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from ekfslam.errors import InputError
from ekfslam.estimates import FAILED
from ekfslam.experiments.attempts import Watch
from ekfslam.experiments.campaign import Campaign
from ekfslam.experiments.cells import versions_in_words
from ekfslam.experiments.cluster import run_units
from ekfslam.experiments.files import CAMPAIGN, check_folder, versions, write_together
from ekfslam.experiments.reading import load_campaign
from ekfslam.experiments.results import CampaignResults, read_campaign
from ekfslam.experiments.store import FILE, SUPERSEDED, Identity, Store, identity, unit_name
from ekfslam.registry import origin

Tell = Callable[[str], None]

logger = logging.getLogger(__name__)


def run_campaign(
    source: str | Path | Mapping[str, Any] | Campaign,
    out: str | Path,
    workers: int = 1,
    scheduler: str | None = None,
    seeds: int | None = None,
    retry_failed: bool = False,
    watch: Watch | None = None,
    tell: Tell | None = None,
) -> CampaignResults:
    """Run a campaign, or what is left of it.

    Cells that are in the folder already are not run again: a campaign that was stopped, however
    abruptly, goes on where it was, and seeds, estimators and scenarios that are added to a finished
    one run alone. Where a scenario or the way that runs are judged has changed since, the cells are
    set aside and run again.

    Parameters
    ----------
    source : path, mapping or Campaign
        As for `load_campaign`.
    out : path
        Folder of the results, which belongs to this campaign; made if needed.
    workers : int
        Processes; 1 is this process. The results do not depend on them. A script that asks for
        several must guard what it runs with ``if __name__ == "__main__":``.
    scheduler : str, optional
        Address of a Dask cluster to run on instead, such as ``tcp://10.0.0.1:8786``.
    seeds : int, optional
        How many, instead of what the campaign says.
    retry_failed : bool
        Whether to run failed cells again, with those of the same draw.
    watch : callable, optional
        Told of progress: (scenario, seed, cells done, cells to do).
    tell : callable, optional
        Told in words what is there already, and what of it cannot stay; logged by default.

    Returns
    -------
    CampaignResults

    Raises
    ------
    UnknownNameError, InputError, FileFormatError
        For a campaign that makes no sense, before anything runs; for a folder that cannot be
        written to or that another campaign is at work in, a disk that is full, and a cluster that
        is not there. Whatever was done by then stays.
    """
    campaign = load_campaign(source, seeds)
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise InputError(f"workers must be a whole number from 1 on, got {workers!r}")
    if scheduler is not None and workers != 1:
        raise InputError("workers are those of the cluster: give either workers or a scheduler")
    check_folder(out, CAMPAIGN)
    store = Store(out)
    with store.opened():
        done = _settled(campaign, store, retry_failed, tell or logger.info)
        write_together(out, lambda place: _describe(campaign, place))
        units = campaign.units(done)
        total, count = sum(len(unit.estimators) for unit in units), 0
        if watch is not None:
            watch(campaign.name, "", count, total)
        for unit, files in run_units(units, workers, scheduler):
            try:
                store.add(unit_name(unit), files)
            except InputError as error:
                raise InputError(f"{error}; what was done stays, run it again to go on") from None
            count += len(unit.estimators)
            if watch is not None:
                watch(unit.label, f"seed {unit.seed}", count, total)
    return read_campaign(out)


def _describe(campaign: Campaign, folder: Path) -> None:
    config = campaign.config() | {"versions": versions()}
    (folder / "config.json").write_text(json.dumps(config, indent=2) + "\n")
    if campaign.text:
        (folder / "campaign.toml").write_text(campaign.text, encoding="utf-8")


# What is there already ---------------------------------------------------------------------------


def _settled(
    campaign: Campaign, store: Store, retry_failed: bool, tell: Tell
) -> dict[tuple[str, int], set[str]]:
    """Estimators that are done for each digest and seed, after setting aside what cannot stay."""
    found = store.read("runs", store.names(), [FILE, "scenario", "estimator", "status", "versions"])
    cells = found.drop_duplicates([FILE, "estimator"])
    said = [identity(name) for name in cells[FILE]]
    cells = cells.join(pd.DataFrame(said, index=cells.index, columns=list(Identity._fields)))
    cells = _current(campaign, cells, store, tell)
    runs = {(name, seed) for name in campaign.estimators for seed in campaign.seeds_of(name)}
    wanted = pd.Series(
        [cell in runs for cell in zip(cells["estimator"], cells["seed"], strict=True)],
        index=cells.index,
        dtype=bool,
    )
    wanted &= cells["digest"].isin([variant.digest for variant in campaign.variants])
    edited = wanted & _edited(campaign, cells)
    if edited.any():
        again = cells[FILE].isin(cells[FILE][edited])
        store.set_aside(cells[FILE][again].unique())
        names = ", ".join(cells["estimator"][edited].unique())
        place = store.folder / SUPERSEDED
        tell(f"the module of {names} has changed: {again.sum()} cells are set aside in {place}")
        cells, wanted = cells[~again], wanted[~again]
    broken = wanted & (cells["status"] == FAILED)
    if retry_failed and broken.any():
        again = cells[FILE].isin(cells[FILE][broken])
        store.set_aside(cells[FILE][again].unique())
        cells, wanted = cells[~again], wanted[~again]
    elif broken.any():
        tell(f"{broken.sum()} cells failed before and are not run again, unless retried")
    if wanted.any():
        tell(f"{wanted.sum()} of {campaign.cells} cells are there already")
    now = {*versions_in_words().split(", "), *map(origin, campaign.estimators.values())}
    for other, count in cells["versions"][wanted].value_counts().items():
        if differing := [word for word in str(other).split(", ") if word not in now]:
            tell(f"{count} of them stay from other versions: {', '.join(differing)}")
    by_draw = cells.groupby(["digest", "seed"])["estimator"]
    return {key: set(names) for key, names in by_draw}  # type: ignore[misc]


def _current(campaign: Campaign, cells: pd.DataFrame, store: Store, tell: Tell) -> pd.DataFrame:
    """Cells that state what the campaign states; those of the same label that do not go."""
    digest_of = {variant.label: variant.digest for variant in campaign.variants}
    known = cells["digest"].isin(digest_of.values())
    changed = cells["scenario"].isin(digest_of) & ~known
    judged_otherwise = known & (cells["metrics"] != campaign.metrics.digest)
    gone = changed | judged_otherwise
    place = store.folder / SUPERSEDED
    for label, count in cells["scenario"][changed].value_counts(sort=False).items():
        tell(f"{label} has changed: {count} cells of before are set aside in {place}")
    if judged_otherwise.any():
        count = judged_otherwise.sum()
        tell(f"runs are judged otherwise than before: {count} cells are set aside in {place}")
    store.set_aside(cells[FILE][gone].unique())
    return cells[~gone]


def _edited(campaign: Campaign, cells: pd.DataFrame) -> pd.Series:
    """Cells of estimators whose modules, of the user's own, are not what they were."""
    origins = {name: origin(text) for name, text in campaign.estimators.items() if ":" in text}
    pairs = zip(cells["estimator"], cells["versions"], strict=True)
    changed = [origins.get(name, "") not in ["", *said.split(", ")] for name, said in pairs]
    return pd.Series(changed, index=cells.index, dtype=bool)
