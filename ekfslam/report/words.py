"""How numbers and names are written on the page."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import pandas as pd


def known(value: Any) -> bool:
    """Whether a cell holds anything."""
    return value is not None and not pd.isna(value)


def digits(value: Any) -> str:
    """A number to three digits, or whole; empty if it is not known."""
    if not known(value):
        return ""
    number = float(value)
    if not math.isfinite(number):
        return str(number)
    if number == int(number) and abs(number) < 1e6:
        return f"{int(number)}"
    if abs(number) < 1000 or abs(number) >= 1e6:
        return f"{number:.3g}"
    return f"{number:.0f}"


def rounded(value: float, figures: int) -> str:
    """A number to so many significant figures, with a power of ten from a million on alone."""
    return f"{float(f'{value:.{figures}g}'):g}"


def plus_minus(value: Any, error: Any) -> str:
    """A number with its error, as far as they are known."""
    if not known(value):
        return ""
    return digits(value) + (f" ± {rounded(float(error), 2)}" if known(error) else "")


def interval(low: float, high: float, figures: int = 3) -> str:
    """An interval in brackets, to so many significant figures."""
    return f"[{rounded(low, figures)}, {rounded(high, figures)}]"


def percent(share: float) -> str:
    """A share as a percentage."""
    return f"{100 * share:.3g} %"


def listed(words: Iterable[str]) -> str:
    """Words with commas and a last "and"."""
    *others, last = words
    return f"{', '.join(others)} and {last}" if others else last


def counted(number: int, word: str) -> str:
    """So many of something: the plural but for one."""
    return f"{number} {word}" if number == 1 else f"{number} {word}s"


def seeds_in_words(seeds: Sequence[int]) -> str:
    """Seeds as ranges: 0 to 4, 7."""
    ordered = sorted(seeds)
    parts, start = [], 0
    for place in range(1, len(ordered) + 1):
        if place == len(ordered) or ordered[place] != ordered[place - 1] + 1:
            first, last = ordered[start], ordered[place - 1]
            parts.append(f"{first}" if first == last else f"{first} to {last}")
            start = place
    return ", ".join(parts)
