"""Campaign files read and checked; `ekfslam.experiments.campaign` describes the format."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ekfslam.errors import EkfslamError, FileFormatError, InputError, UnknownNameError
from ekfslam.experiments.campaign import COMPARED, Campaign, Pairing, Variant
from ekfslam.experiments.cells import Metrics
from ekfslam.experiments.rows import COMPARABLE
from ekfslam.registry import estimator_name, resolve
from ekfslam.simulation import load_scenario, scenario_hash

HASH_DIGITS = 16
MOST = 1_000_000  # seeds: more would be a slip, and fill the memory before anything is said
LARGEST = 2**63 - 1  # that a column of whole numbers holds

T = TypeVar("T")


def load_campaign(
    source: str | Path | Mapping[str, Any] | Campaign, seeds: int | None = None
) -> Campaign:
    """Read a campaign and check all of it.

    Parameters
    ----------
    source : path, mapping or Campaign
        A TOML file, or the same keys as a mapping; paths in that are relative to the working
        folder.
    seeds : int, optional
        How many, instead of what the campaign says, from its first one on.

    Raises
    ------
    FileFormatError
        If the file is missing or no TOML.
    InputError
        For anything in it that makes no sense; the message names the file and the key.
    """
    if isinstance(source, Campaign):
        campaign = source
    elif isinstance(source, Mapping):
        campaign = _build(dict(source), "campaign", "campaign", Path())
    else:
        path = Path(source)
        try:
            text = path.read_text(encoding="utf-8")
            document = tomllib.loads(text)
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise FileFormatError(f"{path}: {error}") from None
        except OSError as error:
            reason = "no such file" if isinstance(error, FileNotFoundError) else error.strerror
            raise FileFormatError(f"{path}: {reason}") from None
        campaign = replace(_build(document, path.stem, str(path), path.parent), text=text)
    if seeds is None:
        return campaign
    return replace(campaign, seeds=_so_many(campaign.seeds, seeds))


def _so_many(seeds: tuple[int, ...], count: int) -> tuple[int, ...]:
    count = _whole(count, "seeds", least=1)
    if seeds == tuple(range(seeds[0], seeds[0] + len(seeds))):
        return _in_a_row(seeds[0], count, "seeds")
    if count > len(seeds):
        raise InputError(f"the campaign lists {len(seeds)} seeds, {count} are asked for")
    return seeds[:count]


# From a document to a campaign -------------------------------------------------------------------

_KEYS = ("name", "description", "seeds", "estimators", "scenarios", "metrics", "compare")
_OF_ESTIMATOR = ("name", "seeds")
_OF_SCENARIO = ("name", "label", "set", "sweep")
_OF_METRICS = ("skip", "steps", "reference", "diverged_above")
_OF_COMPARE = ("baseline", "pairs", "metrics")


def _build(document: dict[str, Any], name: str, where: str, folder: Path) -> Campaign:
    _check_keys(document, _KEYS, where)
    for key in ("seeds", "estimators", "scenarios"):
        if key not in document:
            raise InputError(f"{where}: missing key {key!r}")
    estimators, few = _estimators(document["estimators"], f"{where}: estimators")
    variants = _variants(document["scenarios"], where, folder)
    shortest = min(len(variant.scenario.times) for variant in variants)
    return Campaign(
        name=_text(document.get("name", name), f"{where}: name"),
        description=_text(document.get("description", ""), f"{where}: description", empty=True),
        variants=variants,
        seeds=_seeds(document["seeds"], f"{where}: seeds"),
        estimators=estimators,
        few_seeds=few,
        metrics=_metrics(_table(document, "metrics", where), f"{where}: [metrics]", shortest),
        pairing=_pairing(_table(document, "compare", where), f"{where}: [compare]", estimators),
    )


def _check_keys(table: Mapping[str, Any], known: Collection[str], where: str) -> None:
    for key in table:
        if key not in known:
            raise InputError(f"{where}: {UnknownNameError('key', str(key), known)}")


def _table(document: Mapping[str, Any], key: str, where: str) -> dict[str, Any]:
    table = document.get(key, {})
    if not isinstance(table, Mapping):
        raise InputError(f"{where}: [{key}] must be a table, got {table!r}")
    return dict(table)


def _text(value: Any, where: str, empty: bool = False) -> str:
    if not isinstance(value, str) or not (value.strip() or empty):
        raise InputError(f"{where} must be text, got {value!r}")
    return value


def _whole(value: Any, where: str, least: int = 0) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise InputError(f"{where} must be a whole number from {least} on, got {value!r}")
    return int(value)


def _list(value: Any, where: str, of: str) -> list[Any]:
    if isinstance(value, str | Mapping) or not isinstance(value, Sequence) or not value:
        raise InputError(f"{where} must be a list of {of}, got {value!r}")
    return list(value)


def _different(values: Sequence[Any], where: str) -> None:
    for value in values:
        if values.count(value) > 1:
            raise InputError(f"{where}: {value!r} is there twice")


def _told(where: str, read: Callable[..., T], *arguments: Any, **named: Any) -> T:
    """What a function gives; its error says where in the file the reason is."""
    try:
        return read(*arguments, **named)
    except EkfslamError as error:
        raise InputError(f"{where}: {error}") from None


def _seeds(value: Any, where: str) -> tuple[int, ...]:
    if isinstance(value, Mapping):
        _check_keys(value, ("first", "count"), where)
        if "count" not in value:
            raise InputError(f"{where}: missing key 'count'")
        first = _whole(value.get("first", 0), f"{where}: first")
        return _in_a_row(first, _whole(value["count"], f"{where}: count", least=1), where)
    if not isinstance(value, list | tuple):
        return _in_a_row(0, _whole(value, where, least=1), where)
    seeds = tuple(_whole(seed, where) for seed in _list(value, where, "seeds"))
    _different(seeds, where)
    if max(seeds) > LARGEST:
        raise InputError(f"{where}: {max(seeds)} is too large, a seed is at most {LARGEST}")
    return seeds


def _in_a_row(first: int, count: int, where: str) -> tuple[int, ...]:
    if count > MOST:
        raise InputError(f"{where}: {count} are too many, a campaign has at most {MOST} seeds")
    if first + count - 1 > LARGEST:
        raise InputError(f"{where}: {first} is too large, a seed is at most {LARGEST}")
    return tuple(range(first, first + count))


def _estimators(value: Any, where: str) -> tuple[dict[str, str], dict[str, int]]:
    """Texts of the estimators by name, and how many seeds those have that do not run on all."""
    texts, names, few = [], [], {}
    for each in _list(value, where, "names"):
        entry = each if isinstance(each, Mapping) else {"name": each}
        _check_keys(entry, _OF_ESTIMATOR, where)
        texts.append(_text(entry.get("name"), f"{where}: name" if entry is each else where))
        names.append(_estimator(texts[-1], where))
        if "seeds" in entry:
            few[names[-1]] = _whole(entry["seeds"], f"{where}: seeds of {texts[-1]!r}", least=1)
    _different(names, where)
    return dict(zip(names, texts, strict=True)), few


def _estimator(text: str, where: str) -> str:
    """What an estimator is called, which can be made."""
    _told(where, resolve, text)
    return estimator_name(text)


def _variants(value: Any, where: str, folder: Path) -> tuple[Variant, ...]:
    variants = []
    for number, entry in enumerate(_list(value, f"{where}: [[scenarios]]", "tables"), start=1):
        here = f"{where}: [[scenarios]] {number}"
        if not isinstance(entry, Mapping):
            raise InputError(f"{here} must be a table, got {entry!r}")
        variants += _variants_of(entry, here, folder)
    labels = [variant.label for variant in variants]
    for label in labels:
        if labels.count(label) > 1:
            raise InputError(f"{where}: two scenarios are called {label!r}; give one a label")
    by_digest: dict[str, str] = {}
    for variant in variants:
        other = by_digest.setdefault(variant.digest, variant.label)
        if other != variant.label:
            raise InputError(f"{where}: {other!r} and {variant.label!r} are the same problem")
    return tuple(variants)


def _variants_of(entry: Mapping[str, Any], where: str, folder: Path) -> list[Variant]:
    _check_keys(entry, _OF_SCENARIO, where)
    if "name" not in entry:
        raise InputError(f"{where}: missing key 'name'")
    name = _text(entry["name"], f"{where}: name")
    label = _text(entry.get("label", Path(name).stem), f"{where}: label")
    source = str(folder / name) if name.endswith(".toml") else name
    fixed = _by_dotted_key(_table(entry, "set", where))
    lists = {
        key: _list(values, f"{where}: [sweep] {key}", "values")
        for key, values in _by_dotted_key(_table(entry, "sweep", where)).items()
    }
    for key, several in lists.items():
        _different(several, f"{where}: [sweep] {key}")
        if key in fixed:
            raise InputError(f"{where}: {key} is both set and swept")
    variants = []
    for values in product(*lists.values()):
        swept = dict(zip(lists, values, strict=True))
        scenario = _told(where, load_scenario, source, changes=fixed | swept)
        words = ", ".join(f"{key}={_written(value)}" for key, value in swept.items())
        digest = scenario_hash(scenario)[:HASH_DIGITS]
        title = f"{label}({words})" if words else label
        variants.append(Variant(title, name, swept, scenario, digest))
    return variants


def _by_dotted_key(table: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Values inside tables by dotted key: TOML reads ``a.b = 1`` as a table in a table."""
    values: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, Mapping):
            values |= _by_dotted_key(value, f"{before}{key}.")
        else:
            values[f"{before}{key}"] = value
    return values


def _written(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_written, value))}]"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _metrics(table: Mapping[str, Any], where: str, poses: int) -> Metrics:
    _check_keys(table, _OF_METRICS, where)
    skip = _whole(table.get("skip", 0), f"{where}: skip")
    if skip >= poses:
        raise InputError(f"{where}: skip = {skip} leaves nothing of {poses} poses")
    every, steps = _kept(table.get("steps", "all"), f"{where}: steps", poses)
    reference = table.get("reference")
    if reference is not None:
        _estimator(_text(reference, f"{where}: reference"), f"{where}: reference")
    bound = table.get("diverged_above", Metrics.diverged_above)
    if isinstance(bound, bool) or not isinstance(bound, int | float) or not bound > 0:
        raise InputError(f"{where}: diverged_above must be a positive number, got {bound!r}")
    return Metrics(skip, every, steps, reference, float(bound))


def _kept(value: Any, where: str, poses: int) -> tuple[int, tuple[int, ...] | None]:
    """Which steps are kept: every so many, or those listed."""
    if value == "all":
        return 1, None
    if isinstance(value, Mapping):
        _check_keys(value, ("every",), where)
        if "every" not in value:
            raise InputError(f"{where}: missing key 'every'")
        return _whole(value["every"], f"{where}: every", least=1), None
    if not isinstance(value, list | tuple):
        raise InputError(f"{where} must be 'all', {{ every = n }} or a list, got {value!r}")
    steps = tuple(sorted(_whole(step, where) for step in _list(value, where, "steps")))
    _different(steps, where)
    if steps[-1] >= poses:
        raise InputError(f"{where}: there is no step {steps[-1]}: a scenario has {poses} poses")
    return 1, steps


def _pairing(table: Mapping[str, Any], where: str, estimators: Collection[str]) -> Pairing:
    _check_keys(table, _OF_COMPARE, where)
    pairs = []
    if "baseline" in table:
        baseline = _one_of(table["baseline"], estimators, "estimator", f"{where}: baseline")
        pairs += [(name, baseline) for name in estimators if name != baseline]
    for pair in _list(table["pairs"], f"{where}: pairs", "pairs") if "pairs" in table else ():
        names = _list(pair, f"{where}: pairs", "pairs of estimators")
        if len(names) != 2 or names[0] == names[1]:
            raise InputError(f"{where}: pairs must be pairs of estimators, got {pair!r}")
        a, b = (_one_of(name, estimators, "estimator", f"{where}: pairs") for name in names)
        pairs.append((a, b))
    listed = _list(table.get("metrics", list(COMPARED)), f"{where}: metrics", "columns")
    metrics = tuple(_one_of(name, COMPARABLE, "column", f"{where}: metrics") for name in listed)
    _different(metrics, f"{where}: metrics")
    # The same two the other way round would count as one more comparison.
    once: dict[frozenset[str], tuple[str, str]] = {}
    for a, b in pairs:
        once.setdefault(frozenset((a, b)), (a, b))
    return Pairing(tuple(once.values()), metrics)


def _one_of(value: Any, known: Collection[str], what: str, where: str) -> str:
    name = _text(value, where)
    name = estimator_name(name) if name not in known and "(" in name else name
    if name not in known:
        raise InputError(f"{where}: {UnknownNameError(what, name, known)}")
    return name
