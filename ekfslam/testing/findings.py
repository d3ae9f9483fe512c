"""What an assertion found, in words: the first line says it, the tables show it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import pandas as pd

WORST = 5
"""Seeds that a message shows."""


@dataclass(frozen=True, eq=False)
class Finding:
    """What an assertion found.

    Attributes
    ----------
    headline : str
        In one line: what, by how much, of how many runs, at which false-alarm rate.
    claims : DataFrame
        A row for each claim with its numbers; ``holds`` is false where the data contradict it.
    seeds : DataFrame
        A row for each claim and seed: ``scenario``, ``what``, ``seed``, ``now``, and where there
        is a reference ``stored``. The worst come first.
    """

    headline: str
    claims: pd.DataFrame
    seeds: pd.DataFrame

    @property
    def holds(self) -> bool:
        """Whether the data contradict none of the claims."""
        return bool(self.claims["holds"].all())

    def __str__(self) -> str:
        parts = [self.headline, "", in_text(self.claims)]
        broken = self.claims[~self.claims["holds"]]
        for scenario, what in zip(broken["scenario"], broken["what"], strict=True):
            rows = self.seeds[(self.seeds["scenario"] == scenario) & (self.seeds["what"] == what)]
            title = f"worst of {len(rows)} seeds, {what} on {scenario}:"
            parts += ["", title, in_text(rows.drop(columns=["scenario", "what"]).head(WORST))]
        return "\n".join(parts)


def in_text(table: pd.DataFrame) -> str:
    """A table in lines of text, three digits to a number, indented."""
    shown = table.assign(
        **{
            name: [short(value) for value in table[name]]
            for name in table.columns
            if table[name].dtype == float
        }
    )
    lines = shown.to_string(index=False).splitlines()
    return "\n".join(f"  {line.rstrip()}" for line in lines)


def short(value: float) -> str:
    """Three digits, or nothing."""
    return "" if value != value else f"{value:.3g}"


def percent(value: float, sign: bool = False) -> str:
    """A share in percent, as in 1 % or +11.7 %."""
    return f"{100 * value:{'+' if sign else ''}.3g} %"


def options(words: Mapping[str, object]) -> str:
    """Keywords as they are written in a call, those that are None left out."""
    return ", ".join(f"{key}={value!r}" for key, value in words.items() if value is not None)
