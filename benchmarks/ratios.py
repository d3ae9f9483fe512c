"""Rows of the table of ratios: ours beside another, and what the ratio is held against."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

COLUMNS = ["part", "what", "ours", "other", "unit", "ratio", "bound", "holds"]


def at_least(what: str, ours: float, other: float, unit: str, bound: float) -> list[Any]:
    """A row whose ratio other / ours must reach a bound."""
    ratio = other / ours
    return [what, ours, other, unit, ratio, f">= {bound:g}", ratio >= bound]


def at_most(what: str, ours: float, other: float, unit: str, bound: float) -> list[Any]:
    """A row whose ratio ours / other must stay below a bound."""
    ratio = ours / other
    return [what, ours, other, unit, ratio, f"<= {bound:g}", ratio <= bound]


def alone(what: str, value: float, unit: str, bound: float = np.inf) -> list[Any]:
    """A row of one number, which may have to stay below a bound."""
    held = [f"<= {bound:g} {unit}", value <= bound] if np.isfinite(bound) else ["", ""]
    return [what, value, np.nan, unit, np.nan, *held]


def renewed(table: pd.DataFrame, part: str, rows: pd.DataFrame) -> pd.DataFrame:
    """The table with the rows of a part replaced where they stood; at the end if it had none."""
    if not (table["part"] == part).any():
        return rows if table.empty else pd.concat([table, rows], ignore_index=True)
    first = int((table["part"] == part).to_numpy().argmax())
    others = (table["part"] != part).to_numpy()
    before, after = others.copy(), others.copy()
    before[first:], after[:first] = False, False
    pieces = [piece for piece in (table[before], rows, table[after]) if not piece.empty]
    return pd.concat(pieces, ignore_index=True)
