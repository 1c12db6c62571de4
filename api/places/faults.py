"""What is wrong with files that were given, by file, row, column and rule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from skyfolio.api.common.errors import InvalidError

SHOWN = 20
"""Faults that are shown at once; a file with a wrong separator has one in every row."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Fault:
    """One broken rule. row: `row 7`, `feature 3`, as people count them; empty if it is about the whole file."""

    file: str
    message: str
    rule: str
    row: str = ""
    column: str = ""

    @property
    def where(self) -> str:
        """Return file, row and column as far as they are known."""
        return ": ".join(part for part in (self.file, self.row, self.column) if part)

    def __str__(self) -> str:
        """Return the fault as one line."""
        return f"{self.where}: {self.message}"

    def as_row(self) -> dict[str, str]:
        """Return the fault as a row of a problem document."""
        known = {"file": self.file, "row": self.row, "column": self.column}
        told = {"field": self.where, "rule": self.rule, "message": self.message}
        return {**told, **{name: value for name, value in known.items() if value}}


class FaultyFilesError(InvalidError):
    """Files that cannot be imported. `rows`: each fault as a row of a problem document."""

    def __init__(self, faults: Sequence[Fault]) -> None:
        shown = [str(fault) for fault in faults[:SHOWN]]
        more = len(faults) - len(shown)
        super().__init__("\n".join([*shown, *([f"files: {more} more rows have faults"] if more else [])]))
        self.faults = tuple(faults)
        self.rows = [fault.as_row() for fault in faults[:SHOWN]]
