"""Small pieces of Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from textwrap import fill
from typing import Any


def text(paragraph: str) -> str:
    """One paragraph, filled."""
    return fill(" ".join(paragraph.split()), width=118, break_long_words=False, break_on_hyphens=False)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table; bars in cells are escaped."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def means(rows: Iterable[dict[str, Any]], unit: str) -> str:
    """Return a table of names, means and spreads."""
    return table(("", unit), [(row["name"], f"{row['mean']:.2f} ± {row['spread']:.2f}") for row in rows])


def figure(value: float) -> str:
    """Return a number with as many digits as a reader wants."""
    return f"{value:.3f}" if abs(value) < 2 else f"{value:.2f}" if abs(value) < 100 else f"{value:.1f}"


def names(those: Sequence[str]) -> str:
    """In code spans, joined."""
    return " and ".join(f"`{name}`" for name in those)
