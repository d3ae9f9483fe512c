"""Options of an estimator, from its signature and the docstrings that tell of them."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

_GIVEN = ("prior", "dataset")  # by the adapter, not by the user
_SECTION = re.compile(r"^Parameters\n-+\n(.*?)(?=^[^\n]+\n-+\n|\Z)", re.MULTILINE | re.DOTALL)
_ENTRY = re.compile(r"^(\w[\w, ]*?) *(?::.*)?\n((?:(?:[ ]{4}.*)?\n?)*)", re.MULTILINE)


class Told(NamedTuple):
    """Options that a docstring tells of together.

    Attributes
    ----------
    defaults : dict
        Values by name, as Python writes them; empty for what has to be given.
    text : str
    """

    defaults: dict[str, str]
    text: str


def options_of(maker: Callable[..., Any]) -> list[Told]:
    """Options that a class or a function takes, in the order of its signature.

    Parameters
    ----------
    maker : callable
        With docstrings in NumPy style, its own and those of the classes that it is made from; an
        option that none tells of has no text.
    """
    given = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    try:
        parameters = inspect.signature(maker).parameters
    except (TypeError, ValueError):  # compiled code may not tell
        return []
    defaults = {
        name: "" if each.default is each.empty else repr(each.default)
        for name, each in parameters.items()
        if each.kind not in given and name not in _GIVEN
    }
    texts: dict[tuple[str, ...], str] = {}
    for each in inspect.getmro(maker) if isinstance(maker, type) else (maker,):
        for names, text in _parameters(each.__doc__ or ""):
            new = [name for name in names if name in defaults]
            if new and not any(name in told for told in texts for name in new):
                texts[tuple(new)] = text
    listed, seen = [], set()
    for name in defaults:
        if name not in seen:
            together = next((told for told in texts if name in told), (name,))
            listed.append(Told({n: defaults[n] for n in together}, texts.get(together, "")))
            seen |= set(together)
    return listed


def summary(maker: Any) -> str:
    """The first line of a docstring."""
    return (maker.__doc__ or "").strip().partition("\n")[0]


def _parameters(docstring: str) -> Iterator[tuple[list[str], str]]:
    """Names and text of each entry of the section on parameters."""
    for section in _SECTION.findall(inspect.cleandoc(docstring) + "\n"):
        for names, text in _ENTRY.findall(section):
            yield [name.strip() for name in names.split(",")], " ".join(text.split())
