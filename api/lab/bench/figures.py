"""The file of the planner benchmark's figures: `parts`, by name (`quality 10x100x50 sum`).

A part has `figures` (or `skipped`, why there are none), the `effort` that it was measured with, the `seconds` that it
took, of them `cpu_s` of processor time, when (`at`, UTC) and on what `machine`. Nothing that follows from other figures
is kept: reports work it out.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAlias

Row: TypeAlias = dict[str, Any]


def load(file: Path | None) -> Row:
    """Return the figures in a file, or none yet. Raises ValueError for a file that holds something else."""
    if file is None or not file.exists():
        return {"parts": {}}
    return parsed(file.read_text(encoding="utf-8"), str(file))


def parsed(text: str, name: str) -> Row:
    """Return the figures that a file called `name` holds. Raises ValueError for anything else."""
    try:
        figures: Any = json.loads(text)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error
    if not isinstance(figures, dict) or not isinstance(figures.get("parts"), dict):
        raise ValueError(f"{name}: holds no figures of the planner's benchmark; run `skyfolio bench planner` anew")
    return figures


def save(figures: Row, file: Path) -> None:
    """Replace the file, whole or not at all."""
    written = file.with_suffix(f".{os.getpid()}.new")
    written.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    written.replace(file)


def parts_of(figures: Row, section: str) -> Iterator[tuple[str, str, Row]]:
    """Yield size, kind and part of one section, small fleets first."""
    named = [(*name.split(" "), part) for name, part in figures["parts"].items()]
    found = [(size, kind, part) for of, size, kind, part in named if of == section]
    yield from sorted(found, key=lambda one: int(one[0].split("x")[0]))


def figures_of(figures: Row, section: str, size: str, kind: str) -> Row | None:
    """Return the figures of one part, or None where there are none."""
    found: Row | None = figures["parts"].get(f"{section} {size} {kind}", {}).get("figures")
    return found


def measured(figures: Row, section: str) -> Iterator[tuple[str, str, Row]]:
    """Yield size, kind and figures of the parts of one section that have some."""
    return ((size, kind, part["figures"]) for size, kind, part in parts_of(figures, section) if "figures" in part)
