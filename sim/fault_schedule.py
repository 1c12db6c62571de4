"""Faults that are to happen at a fleet time or a slot, and how they are written on a command line."""

import re
from typing import Any

from skyfolio.sim.faults import FAULTS, Fault, fault_from
from skyfolio.sim.slots import SlotGrid

_TEXT = re.compile(
    r"(?P<kind>[a-z_-]+):(?P<system_id>\d+)(@(?:slot=(?P<slot>\d+)|(?P<at>\d+(?:\.\d+)?)))?(,(?P<knobs>.+))?"
)


class Schedule:
    """Holds faults until they are due; those for a slot wait until there is a `grid`."""

    def __init__(self) -> None:
        self.grid: SlotGrid | None = None
        self._entries: list[tuple[float | None, int, Fault]] = []

    def add(self, fault: Fault, *, at_s: float | None, at_slot: int | None) -> None:
        """Add a fault for a moment of fleet time (seconds) or for a slot."""
        self._entries.append((at_s, at_slot or 0, fault))

    def due(self, now_s: float) -> list[Fault]:
        """Return the faults due by fleet time `now_s`, and forget them."""
        due = [entry for entry in self._entries if self._time_of(entry) <= now_s + 1e-9]
        for entry in due:
            self._entries.remove(entry)
        return [fault for _, _, fault in due]

    def _time_of(self, entry: tuple[float | None, int, Fault]) -> float:
        at_s, slot, _ = entry
        if at_s is not None:
            return at_s
        return float("inf") if self.grid is None else self.grid.begins_s(slot)


def parse_fault(text: str) -> tuple[Fault, float | None, int | None]:
    """Return a fault, its time and its slot, from `KIND:VEHICLE[@SECONDS|@slot=N][,KNOB=VALUE...]`.

    Words of a kind are joined by `-` or `_`. Knobs of a link's directions are written `up.loss=0.2`.
    ValueError names the part that cannot be read.
    """
    match = _TEXT.fullmatch(text)
    if match is None:
        raise ValueError(
            f"{text!r} must look like KIND:VEHICLE[@SECONDS|@slot=N][,KNOB=VALUE...], KIND of {', '.join(FAULTS)}"
        )
    data: dict[str, Any] = {"kind": match["kind"].replace("-", "_"), "system_id": int(match["system_id"])}
    for knob in match["knobs"].split(",") if match["knobs"] else []:
        name, equals, value = knob.partition("=")
        if not equals:
            raise ValueError(f"{knob!r} must look like KNOB=VALUE")
        group, dot, inner = name.partition(".")
        if dot:
            data.setdefault(group, {})[inner] = value_of(value)
        else:
            data[name] = value_of(value)
    return (
        fault_from(data),
        None if match["at"] is None else float(match["at"]),
        None if match["slot"] is None else int(match["slot"]),
    )


def value_of(text: str) -> Any:
    """Return what a knob's value means: yes or no, a whole number, a number, or a word."""
    if text in ("true", "yes", "false", "no"):
        return text in ("true", "yes")
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
