"""Estimators by name.

Names come from the entry-point group ``ekfslam.estimators``; a package joins by declaring one.
``module:attribute`` works wherever a name does, and options may follow either:
``ekf(association=joint, confirm=3)``. An estimator is an object with
``estimate(dataset) -> Estimate``, or a class or function without arguments that makes one; filters
with ``predict`` and ``observe``, and functions of a dataset, become one (`ekfslam.adapters`).
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import os
import re
import sys
from ast import literal_eval
from collections.abc import Callable
from difflib import get_close_matches
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, Protocol, runtime_checkable

from ekfslam.adapters import FilterEstimator, adapted, is_filter, name_of
from ekfslam.dataset import Dataset
from ekfslam.errors import InputError, UnknownNameError, UnsupportedError, place
from ekfslam.estimates import Estimate

GROUP = "ekfslam.estimators"
ORACLES = "ekfslam.oracles"


@runtime_checkable
class Estimator(Protocol):
    """What every estimator offers."""

    def estimate(self, dataset: Dataset) -> Estimate:
        """Estimate a dataset."""
        ...


@cache  # what is installed is read from a file of every package
def registered() -> dict[str, EntryPoint]:
    """Names of the estimators that are installed, with where they come from."""
    return {point.name: point for point in sorted(entry_points(group=GROUP), key=lambda p: p.name)}


class Call(NamedTuple):
    """A name and the options that follow it, as in ``ekf(association=joint, confirm=3)``.

    Attributes
    ----------
    name : str
    options : dict
        Values by name.
    words : dict of str
        The same as they were written.
    """

    name: str
    options: dict[str, Any]
    words: dict[str, str]

    def __str__(self) -> str:
        inside = ", ".join(f"{key}={word}" for key, word in self.words.items())
        return f"{self.name}({inside})" if inside else self.name


def parse(text: str) -> Call:
    """Read a name with options.

    Parameters
    ----------
    text : str
        ``name`` or ``name(option=value, ...)``. A value is a Python literal, such as ``3``,
        ``(5, 2.5)`` or ``None``; another word, such as ``maximum-likelihood`` or a name with
        options of its own, stands for itself.

    Raises
    ------
    InputError
        For text that does not read so; the message shows where.
    """
    name, bracket, rest = text.strip().partition("(")
    name, rest = name.strip(), rest.rstrip()
    if not bracket:
        return Call(name, {}, {})
    if not rest.endswith(")"):
        raise InputError(f"{text!r} does not end with the bracket that it opens")
    options, words = {}, {}
    for part in split(rest[:-1]):
        key, equals, word = (piece.strip() for piece in part.partition("="))
        if not (equals and _KEY.fullmatch(key)):
            raise InputError(f"{part!r} in {text!r} is no option: write option=value")
        if key in options:
            raise InputError(f"option {key} is given twice in {text!r}")
        options[key], words[key] = _value(word, text), " ".join(word.split())
    return Call(name, options, words)


def split(text: str) -> list[str]:
    """What commas separate, but for those inside brackets and quotes; empty parts are left out.

    Raises
    ------
    InputError
        For a bracket or a quote that is not closed.
    """
    parts, depth, quote = [""], 0, ""
    for letter in text:
        if quote or letter in "'\"":
            quote = "" if letter == quote else quote or letter
        elif letter in "([{":
            depth += 1
        elif letter in ")]}":
            depth -= 1
        if letter == "," and not (depth or quote):
            parts.append("")
        else:
            parts[-1] += letter
        if depth < 0:
            break
    if depth or quote:
        raise InputError(f"brackets or quotes do not match in {text!r}")
    return [part.strip() for part in parts if part.strip()]


_KEY = re.compile(r"[^\W\d]\w*(\.\w+)*")  # with dots: of a scenario's tables
_WORD = re.compile(r"[^\W\d][\w.:-]*(\(.*\))?")


def _value(word: str, text: str) -> Any:
    """A Python literal, or a word that stands for itself."""
    try:
        return literal_eval(word)
    except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
        if not _WORD.fullmatch(word):
            raise InputError(f"cannot read {word!r} in {text!r}; put text in quotes") from None
        return word


def estimator_name(estimator: str | Any) -> str:
    """How an estimator is called in tables: its name and options, `name` attribute or class."""
    if isinstance(estimator, str):
        call = parse(estimator)
        return str(call._replace(name=call.name.rpartition(":")[2]))
    return name_of(estimator)


def resolve(estimator: str | Any, **options: Any) -> Estimator:
    """The estimator of a name, a ``module:attribute``, a class, a function or an object.

    A filter, a class of filters or a function of a dataset is wrapped by `ekfslam.adapters`.

    Parameters
    ----------
    estimator : str or object
        Text may hold options, see `parse`.
    **options
        Passed to the class that the name stands for.

    Raises
    ------
    UnknownNameError
        For a name that nothing carries, or an option that the class does not have; lists close
        ones.
    InputError
        For a module or attribute that cannot be imported, something that is no estimator, or text
        that cannot be read.
    """
    if isinstance(estimator, str):
        call = parse(estimator)
        for twice in sorted(options.keys() & call.options.keys()):
            raise InputError(f"option {twice} is given twice: in {estimator!r} and beside it")
        estimator, options = named(call.name), call.options | options
    if _makes(estimator):
        _check_options(estimator, options)
        wrapped = adapted(estimator, options)
        if wrapped is not None:
            return wrapped
        try:
            estimator = estimator(**options)
        except TypeError as error:
            name = name_of(estimator)
            raise InputError(
                f"cannot make {name}: {error}; a filter has predict and observe, a function takes "
                f"a dataset, and all else are options, as in {name}(option=value)"
            ) from None
    elif options:
        raise InputError(f"options {', '.join(options)} are for a name or a class")
    if isinstance(estimator, Estimator):
        return estimator
    if is_filter(estimator):
        return FilterEstimator(estimator, name_of(estimator))
    raise InputError(
        f"{estimator!r} is no estimator: it has no estimate(dataset), nor both "
        "predict(increment, covariance) and observe(observations)"
    )


def _makes(thing: Any) -> bool:
    """Whether it is called, and not used as it is."""
    if isinstance(thing, type):
        return True
    return callable(thing) and not hasattr(thing, "estimate") and not is_filter(thing)


def _check_options(maker: Callable[..., Any], options: dict[str, Any]) -> None:
    """Refuse options that a class or function does not take; names close ones."""
    try:
        parameters = inspect.signature(maker).parameters.values()
    except (TypeError, ValueError):  # compiled code may not tell
        return
    if any(each.kind is each.VAR_KEYWORD for each in parameters):
        return
    by_name = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    known = [each.name for each in parameters if each.kind in by_name]
    for name in options:
        if not known:
            raise InputError(f"{estimator_name(maker)} takes no options, got {name}")
        if name not in known:
            raise UnknownNameError(f"option of {estimator_name(maker)}", name, known)


def named(name: str) -> Any:
    """The class, function or object that a name without options stands for.

    Raises
    ------
    UnknownNameError, InputError
        As `resolve`.
    """
    known = registered()
    if name in known:
        try:
            return known[name].load()
        except Exception as error:
            raise InputError(f"cannot load estimator {name!r}: {error}") from None
    module_name, _, attribute = name.partition(":")
    stem = module_name.removesuffix(".py")
    if (stem != module_name or not attribute) and Path(f"{stem}.py").is_file():
        right = f"{Path(stem).name}:{attribute or 'MyFilter'}"
        raise InputError(
            f"cannot load estimator {name!r}: write {right}, in the folder of the file"
        )
    if ":" not in name:
        raise UnknownNameError("estimator", name, known)
    try:
        target = _imported(module_name)
        for part in attribute.split("."):
            target = getattr(target, part)
    except (Exception, SystemExit) as error:  # a script may end itself where it is imported
        raise InputError(f"cannot load estimator {name!r}: {_why(error, module_name)}") from None
    return target


_states: dict[str, str] = {}  # of modules when they were imported from here


def _imported(name: str) -> ModuleType:
    """A module as its file is now: a notebook need not start anew after an edit."""
    importlib.invalidate_caches()  # it may have been written a moment ago
    state = _module(name)
    module = importlib.import_module(name)
    if _states.get(name, state) != state:
        module = importlib.reload(module)
    _states[name] = state
    return module


def _why(error: BaseException, module: str) -> str:
    """Why a module or something in it cannot be loaded, and where in it that is."""
    said = str(error)
    if isinstance(error, ModuleNotFoundError) and error.name == module:
        return f"{said}: there is no {module}.py in {os.getcwd()}, nor is it installed"
    if not isinstance(error, ImportError | AttributeError | SyntaxError):
        said = f"{type(error).__name__}: {said}"
    where = place(error, {module.partition(".")[0]})
    if isinstance(error, AttributeError) and not where:  # the name alone is wrong
        there = [each for each in dir(error.obj) if not each.startswith("_")]
        close = get_close_matches(error.name or "", there, cutoff=0.5)
        return f"{said}; did you mean {' or '.join(close)}?" if close else said
    return f"{said} ({where})" if where else said


def origin(estimator: str) -> str:
    """What an estimator comes from, if not from this package, and which state of it.

    Parameters
    ----------
    estimator : str
        A name or ``module:attribute``, as for `resolve`.

    Returns
    -------
    str
        ``package version`` of one that has joined; of ``module:attribute`` the name of the module
        and a digest of its file, or of all files of its package. Empty for all others.
    """
    name = parse(estimator).name
    return _package(name) if name in registered() else _module(name.partition(":")[0])


@cache  # names and versions are read from a file, too
def _package(name: str) -> str:
    package = registered()[name].dist
    if package is None or package.name == "ekfslam":
        return ""
    return f"{package.name} {package.version}"


def _module(name: str) -> str:
    """A module's top-level name and the digest of its files as they are now."""
    top = name.partition(".")[0]
    if os.getcwd() not in sys.path:  # a user's module lives where the command is run
        sys.path.insert(0, os.getcwd())
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        spec = None
    if spec is None or spec.origin is None or not spec.has_location:  # or built in
        return ""
    folders = spec.submodule_search_locations or []
    files = sorted(path for folder in folders for path in Path(folder).rglob("*.py"))
    digest = hashlib.sha256()
    for path in files or [Path(spec.origin)]:
        digest.update(path.read_bytes())
    return f"{top} {digest.hexdigest()[:8]}"


def linear_oracle() -> Callable[..., Any]:
    """The solver of a filter's own linear models, ``solve(prior, linearizations)``.

    Raises
    ------
    UnsupportedError
        If no package offers one.
    """
    for point in entry_points(group=ORACLES, name="linear"):
        return point.load()
    raise UnsupportedError("no package offers a linear oracle; reinstall ekfslam")
