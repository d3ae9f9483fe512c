"""Rows of the table of ratios: ours beside another, and what the ratio is held against."""

from __future__ import annotations

from typing import Any


def at_least(what: str, ours: float, other: float, unit: str, bound: float) -> list[Any]:
    """A row whose ratio other / ours must reach a bound."""
    ratio = other / ours
    return [what, ours, other, unit, ratio, f">= {bound:g}", ratio >= bound]


def at_most(what: str, ours: float, other: float, unit: str, bound: float) -> list[Any]:
    """A row whose ratio ours / other must stay below a bound."""
    ratio = ours / other
    return [what, ours, other, unit, ratio, f"<= {bound:g}", ratio <= bound]
