"""What lies in a folder of results: a comparison's or a campaign's configuration and tables."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from ekfslam.errors import FileFormatError
from ekfslam.evaluation import tables
from ekfslam.evaluation.monte_carlo import STATISTICS
from ekfslam.evaluation.over_time import OVER_TIME
from ekfslam.evaluation.paired import PAIRS
from ekfslam.experiments.results import read_campaign
from ekfslam.experiments.rows import SCHEMAS as CAMPAIGN
from ekfslam.experiments.store import Store

Schema = Mapping[str, str]


@dataclass(frozen=True, eq=False)
class ComparisonFolder:
    """What is kept of a comparison.

    Attributes
    ----------
    folder : Path
    config : dict
    summary, trajectories, landmarks, innovations : DataFrame
        Without rows where the table is not kept.
    missing : tuple of str
        Names of the tables that are not kept.
    """

    folder: Path
    config: Mapping[str, Any]
    summary: pd.DataFrame
    trajectories: pd.DataFrame
    landmarks: pd.DataFrame
    innovations: pd.DataFrame
    missing: tuple[str, ...]

    @property
    def every(self) -> int:
        """Of the tables with rows for each step, every so many steps are kept."""
        return int(self.config.get("files_every", 1))


@dataclass(frozen=True, eq=False)
class CampaignFolder:
    """What is kept of a campaign, finished or not.

    Attributes
    ----------
    folder : Path
    config : dict
    summary, pairs, over_time, runs, timings : DataFrame
        The last two without rows where neither the Parquet datasets nor their CSVs are here.
    cells : (int, int) or None
        How many are done and how many there are in all; None if that cannot be told.
    """

    folder: Path
    config: Mapping[str, Any]
    summary: pd.DataFrame
    pairs: pd.DataFrame
    over_time: pd.DataFrame
    runs: pd.DataFrame
    timings: pd.DataFrame
    cells: tuple[int, int] | None


def read_results(folder: str | Path) -> ComparisonFolder | CampaignFolder:
    """Read a folder that ``ekfslam compare --out`` or ``ekfslam campaign --out`` wrote.

    Parameters
    ----------
    folder : path

    Raises
    ------
    FileFormatError
        If it is no such folder, or a file of it is damaged or of another version.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileFormatError(f"{folder}: there is no such folder; give one that --out named")
    config = _read_config(folder / "config.json")
    if _of_campaign(config):
        return _read_campaign(folder)
    if _of_comparison(config):
        return _read_comparison(folder, config)
    raise FileFormatError(
        f"{folder / 'config.json'}: neither of a comparison nor of a campaign, or damaged; "
        "give a folder that ekfslam compare or ekfslam campaign wrote"
    )


def _of_comparison(config: Mapping[str, Any]) -> bool:
    parts = [config.get(key) for key in ("datasets", "estimators")]
    return all(
        isinstance(part, dict) and all(isinstance(each, dict) for each in part.values())
        for part in parts
    )


def _of_campaign(config: Mapping[str, Any]) -> bool:
    """Whether everything is there that the page tells of a campaign."""
    kinds = {"scenarios": list, "seeds": list, "estimators": dict, "metrics": dict, "compare": dict}
    if "campaign" not in config or any(
        not isinstance(config.get(key), kind) for key, kind in kinds.items()
    ):
        return False
    scenarios = ("label", "name", "swept", "hash")
    return (
        all(isinstance(each, dict) and each.keys() >= {*scenarios} for each in config["scenarios"])
        and all(isinstance(seed, int) for seed in config["seeds"])
        and config["metrics"].keys() >= {"skip", "diverged_above", "digest"}
    )


def _read_config(path: Path) -> dict[str, Any]:
    try:
        config = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileFormatError(
            f"{path.parent}: no results are kept here, there is no {path.name}; "
            "give a folder that ekfslam compare or ekfslam campaign wrote"
        ) from None
    except json.JSONDecodeError as error:
        raise FileFormatError(f"{path}, line {error.lineno}: damaged ({error.msg})") from None
    except (OSError, ValueError) as error:
        raise FileFormatError(f"{path}: cannot be read ({error})") from None
    if not isinstance(config, dict):
        raise FileFormatError(f"{path}, line 1: damaged, not a configuration")
    return config


def _read_comparison(folder: Path, config: dict[str, Any]) -> ComparisonFolder:
    others = ("trajectories", "landmarks", "innovations")
    return ComparisonFolder(
        folder,
        config,
        summary=_needed(folder, "summary", tables.SCHEMAS["summary"]),
        missing=tuple(name for name in others if not _forms(folder, name)),
        **{name: _optional(folder, name, tables.SCHEMAS[name]) for name in others},
    )


def _read_campaign(folder: Path) -> CampaignFolder:
    kept = read_campaign(folder)
    if Store(folder).names():
        return CampaignFolder(
            folder,
            kept.config,
            summary=kept.summary,
            pairs=kept.pairs,
            over_time=kept.nees_over_time,
            runs=kept.runs,
            timings=kept.timings,
            cells=kept.cells,
        )
    summary = _needed(folder, "summary", STATISTICS)
    for column, named in (
        ("estimator", set(kept.config["estimators"])),
        ("scenario", {scenario["label"] for scenario in kept.config["scenarios"]}),
    ):
        strangers = sorted(set(summary[column].astype(str)) - named)
        if strangers:
            raise FileFormatError(
                f"{folder / 'summary.csv'}: {column} {strangers[0]} is not in config.json; they "
                "belong to different campaigns"
            )
    return CampaignFolder(
        folder,
        kept.config,
        summary=summary,
        pairs=_needed(folder, "pairs", PAIRS),
        over_time=_needed(folder, "nees_over_time", OVER_TIME),
        runs=_optional(folder, "runs", CAMPAIGN["runs"]),
        timings=_optional(folder, "timings", CAMPAIGN["timings"]),
        cells=None,
    )


# Tables ------------------------------------------------------------------------------------------


def _needed(folder: Path, name: str, schema: Schema) -> pd.DataFrame:
    table = _table(folder, name, schema)
    if table is None:
        raise FileFormatError(
            f"{folder}: there is no {name}.csv; run the experiment with --out again"
        )
    return table


def _optional(folder: Path, name: str, schema: Schema) -> pd.DataFrame:
    """A table, without rows if it is not here."""
    table = _table(folder, name, schema)
    return pd.DataFrame(columns=list(schema)).astype(dict(schema)) if table is None else table


def _forms(folder: Path, name: str) -> list[Path]:
    return [path for form in ("csv", "parquet") if (path := folder / f"{name}.{form}").exists()]


def _table(folder: Path, name: str, schema: Schema) -> pd.DataFrame | None:
    """A table in the form that is there, the newer one of two; None if there is none."""
    forms = _forms(folder, name)
    if not forms:
        return None
    path = max(forms, key=lambda form: form.stat().st_mtime)
    return _read_csv(path, schema) if path.suffix == ".csv" else _read_parquet(path, schema)


def _read_parquet(path: Path, schema: Schema) -> pd.DataFrame:
    try:
        table = pd.read_parquet(path)
        _check_columns(path, table, schema)
        return table[list(schema)].astype(dict(schema))
    except (OSError, ValueError, TypeError) as error:  # pyarrow's own errors are of these
        text = " ".join(str(error).split())
        raise FileFormatError(f"{path}: damaged ({text})") from None


def _read_csv(path: Path, schema: Schema) -> pd.DataFrame:
    """Through text, so that a damaged number is told with its line."""
    _check_end(path)
    try:
        text = pd.read_csv(path, dtype="string", keep_default_na=False, na_values=[""])
    except (OSError, ValueError) as error:  # the parser's own words name the line
        words = " ".join(str(error).split())
        raise FileFormatError(f"{path}: damaged ({words})") from None
    _check_columns(path, text, schema)
    columns = {}
    for name, dtype in schema.items():
        try:
            columns[name] = text[name].astype(dtype)  # type: ignore[call-overload]
        except (ValueError, TypeError):
            raise FileFormatError(_fault(path, text, name, dtype)) from None
    return pd.DataFrame(columns)


def _check_end(path: Path) -> None:
    """A file that was cut short ends in the middle of a line."""
    content = path.read_bytes()
    if content and not content.endswith(b"\n"):
        raise FileFormatError(
            f"{path}, line {content.count(bytes([10])) + 1}: the file ends in the middle of a line"
        )


def _check_columns(path: Path, table: pd.DataFrame, schema: Schema) -> None:
    missing = [name for name in schema if name not in table.columns]
    if missing:
        raise FileFormatError(
            f"{path}, line 1: there is no column {missing[0]}; damaged, or of an older version: "
            "run the experiment again"
        )


def _fault(path: Path, text: pd.DataFrame, name: str, dtype: str) -> str:
    """Where the first value is that is none of its column."""
    for row, value in enumerate(text[name]):
        try:
            pd.Series([value], dtype="string").astype(dtype)  # type: ignore[call-overload]
        except (ValueError, TypeError):
            # A message may go over several lines of the file.
            above = text.iloc[:row].apply(lambda column: column.str.count("\n").sum()).sum()
            return f"{path}, line {row + 2 + int(above)}: {name} cannot be {value!r}"
    return f"{path}: {name} is not all {dtype}"
