"""Lines of text as tables: in Markdown for pages, on a terminal for commands; and what pages say of their figures."""

from __future__ import annotations

from rich.table import Table

from skyfolio.api.lab.bench.figures import Row

Lines = list[list[str]]
"""The header first."""


def grid(lines: Lines) -> str:
    """Return lines as a Markdown table, or say that there are none."""
    if len(lines) == 1:
        return "Not measured yet."
    header, *rows = ["| " + " | ".join(line) + " |" for line in lines]
    return "\n".join([header, "|" + "---|" * len(lines[0]), *rows])


def on_terminal(title: str, lines: Lines) -> Table:
    """Return lines as a table for a terminal."""
    header, *rows = lines
    shown = Table(*header, title=title)
    for row in rows:
        shown.add_row(*row)
    return shown


def target_lines(targets: list[Row]) -> Lines:
    """Return targets, what was measured, and whether they are met."""
    lines = [["what", "measured", "asked", "met"]]
    for one in targets:
        asked = f"<= {one['at_most']:g}" if "at_most" in one else f">= {one['at_least']:g}"
        found = "-" if one["measured"] is None else f"{one['measured']:.4g}"
        unknown = "not measured" if one["measured"] is None else "not searched"
        lines.append([one["what"], found, asked, {None: unknown, True: "yes", False: "**no**"}[one["met"]]])
    return lines


def provenance(figures: Row, sections: tuple[str, ...]) -> str:
    """Return on what these sections were measured, when, how busy it was, and which parts are missing and why."""
    parts = {name: part for name, part in figures["parts"].items() if name.split(" ")[0] in sections}
    if not parts:
        return "Nothing has been measured yet. Written by `skyfolio bench report`; do not edit."
    machines = dict.fromkeys(
        f"{on['cpu']}, one core of {on['cores']}, {on['memory_gb']} GB, {on['platform']}, Python {on['python']}"
        for on in (part["machine"] for part in parts.values())
    )
    loads = [part["machine"]["load"] for part in parts.values()]
    first, last = (choose(part["at"] for part in parts.values()) for choose in (min, max))
    efforts = ", ".join(f"`{one}`" for one in dict.fromkeys(part["effort"] for part in parts.values()))
    missing = "; ".join(f"{name}: {part['skipped']}" for name, part in parts.items() if "skipped" in part)
    return (
        f"Measured by `skyfolio bench planner` (effort {efforts}) from {first} to {last} UTC on {'; '.join(machines)}; "
        f"load average {min(loads):.1f} to {max(loads):.1f}, with two parts of this benchmark at a time. "
        f"Written by `skyfolio bench report`; do not edit." + (f" Without figures: {missing}." if missing else "")
    )
