"""The ground crew: it gives a vehicle that has come back to its pad a charged battery, by switching it off and on.

A pad is where a vehicle was put down at the beginning. The crew touches no vehicle in the first seconds after it has
disarmed; then the crew switches it off, changes the pack, and switches it on again, so that its autopilot boots
as after any power on: another boot clock, no position and no home for a while, charge counted from 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

from skyfolio.sim.knobs import LONGEST_S, check_duration, check_number, check_whole
from skyfolio.sim.packs import Pack, Packs, packs_of
from skyfolio.sim.station import Vehicle

LOOK_S = 0.5
"""Fleet seconds between two looks of the crew at its pads."""
HANDS_OFF_S = 5.0
"""The crew touches no vehicle in the first seconds after it was seen to be disarmed."""
MOST_MEMBERS = 100
FARTHEST_M = 1000.0


@dataclass(frozen=True, kw_only=True, slots=True)
class GroundCrew:
    """Who changes batteries, and of what.

    members: how many vehicles they work on at a time, first come, first served. turnaround_s: seconds from the moment
    they turn to a vehicle, at once if one of them is free, until it is switched on again; off_s: the last seconds of
    these, in which it is off.
    radius_m: a vehicle further from its pad is left alone. swap_below: the charge (0-1) below which a vehicle gets
    another pack even if it has not flown. packs: those of each pad. ValueError names a field that is out of range.
    """

    members: int = 1
    turnaround_s: float = 90.0
    off_s: float = 20.0
    radius_m: float = 3.0
    swap_below: float = 0.8
    packs: Packs = field(default_factory=Packs)

    def __post_init__(self) -> None:
        check_whole("members", self.members, 1, MOST_MEMBERS)
        check_duration("off_s", self.off_s)
        check_number("turnaround_s", self.turnaround_s, self.off_s + HANDS_OFF_S, LONGEST_S)
        check_number("radius_m", self.radius_m, 0.1, FARTHEST_M)
        check_number("swap_below", self.swap_below, 0.0, 1.0)


class Pad:
    """One vehicle's pad: its packs, and what is being done there."""

    def __init__(self, vehicle: Vehicle, packs: list[Pack]) -> None:
        self.vehicle = vehicle
        self.on_board, *self.stored = packs
        self.on_board.put_in(vehicle.autopilot.battery)
        vehicle.pack_id = self.on_board.pack_id
        self.has_flown = False
        self.waits_since_s: float | None = None
        """When the vehicle was first seen to be due; None while it is not."""
        self.done_s: float | None = None
        """When it will be switched on again; None while the crew does not work on it."""
        self.reported: str | None = None
        """The kind of the event that was written last about why it waits."""

    @property
    def stands(self) -> bool:
        """Whether the vehicle is disarmed, on the ground, and whole."""
        vehicle = self.vehicle
        return vehicle.alive and not vehicle.armed and vehicle.autopilot.body.on_ground

    @property
    def off_pad_m(self) -> float:
        """How far the vehicle is from the middle of its pad, metres."""
        return self.vehicle.autopilot.body.distance_to(0.0, 0.0)

    def charged(self, now_s: float) -> Pack | None:
        """Return the full pack with the fewest cycles; None while all are charging."""
        full = [pack for pack in self.stored if pack.full_in_s(now_s) == 0.0]
        return min(full, key=lambda pack: (pack.cycles, pack.pack_id), default=None)


class CrewAtWork:
    """One crew and all its pads. emit: called with system id, kind and detail of what happens (`sim.truth.Event`)."""

    def __init__(
        self,
        crew: GroundCrew,
        vehicles: Iterable[Vehicle],
        *,
        seed: int,
        emit: Callable[[int, str, dict[str, Any]], None],
    ) -> None:
        self.crew = crew
        self.pads = {v.system_id: Pad(v, packs_of(v.system_id, crew.packs, seed)) for v in vehicles}
        self._emit = emit
        self._next_s = 0.0

    def step(self, now_s: float) -> None:
        """Do what is to be done by fleet second `now_s`."""
        if now_s < self._next_s - 1e-9:
            return
        self._next_s = now_s + LOOK_S
        for pad in self.pads.values():
            if pad.done_s is None:
                self._look(pad, now_s)
            else:
                self._go_on(pad, pad.done_s, now_s)
        waiting = [
            (pad.waits_since_s, number, pad) for number, pad in self.pads.items() if pad.waits_since_s is not None
        ]
        for _, _, pad in sorted(waiting, key=lambda entry: entry[:2]):
            self._turn_to(pad, now_s)

    def _look(self, pad: Pad, now_s: float) -> None:
        """See whether a vehicle is due, and since when."""
        vehicle = pad.vehicle
        if not vehicle.autopilot.body.on_ground:
            pad.has_flown = True
        due = pad.stands and vehicle.running
        due = due and (pad.has_flown or vehicle.autopilot.battery.share < self.crew.swap_below)
        if due and pad.off_pad_m > self.crew.radius_m:
            self._report(pad, "off_pad", {"distance_m": round(pad.off_pad_m, 2)})
            due = False
        if not due:
            pad.waits_since_s = None
        elif pad.waits_since_s is None:
            pad.waits_since_s = now_s
        if not pad.stands:
            pad.reported = None

    def _turn_to(self, pad: Pad, now_s: float) -> None:
        """Begin to work on a vehicle, if somebody is free, and a pack is charged."""
        busy = sum(other.done_s is not None for other in self.pads.values())
        if busy >= self.crew.members:
            self._report(pad, "swap_waits", {"because": "the crew is busy"})
        elif pad.charged(now_s) is None:
            full_in_s = min(pack.full_in_s(now_s) for pack in pad.stored)
            self._report(pad, "swap_waits", {"because": "no pack is charged", "full_in_s": round(full_in_s, 1)})
        else:
            pad.done_s, pad.waits_since_s, pad.reported = now_s + self.crew.turnaround_s, None, None
            self._tell(pad, "swap_begun", {"done_s": round(pad.done_s, 3)})

    def _go_on(self, pad: Pad, done_s: float, now_s: float) -> None:
        vehicle = pad.vehicle
        if not pad.stands:
            pad.done_s = None
            self._tell(pad, "swap_abandoned", {"because": "armed" if vehicle.alive else "broken"})
        elif not vehicle.is_off and now_s >= done_s - self.crew.off_s - 1e-9:
            vehicle.switch_off()
        elif now_s >= done_s - 1e-9:
            self._swap(pad, now_s)
            pad.done_s, pad.has_flown = None, False
            vehicle.switch_on()

    def _swap(self, pad: Pad, now_s: float) -> None:
        charged = pad.charged(now_s)
        assert charged is not None, "a pack that is full stays full"  # noqa: S101
        battery, removed = pad.vehicle.autopilot.battery, pad.on_board
        removed.take_out(battery, now_s)
        charged.put_in(battery)
        pad.stored = [*(pack for pack in pad.stored if pack is not charged), removed]
        pad.on_board, pad.vehicle.pack_id = charged, charged.pack_id
        detail = {
            "pack": charged.pack_id,
            "cycles": round(charged.cycles, 2),
            "health": round(charged.health, 4),
            "resistance_ohm": round(charged.resistance_ohm, 5),
            "removed": removed.pack_id,
            "removed_share": round(removed.share, 4),
        }
        self._tell(pad, "swapped", detail)

    def _report(self, pad: Pad, kind: str, detail: dict[str, Any]) -> None:
        """Tell once why a vehicle waits, until it stands no more or the reason is another."""
        reason = f"{kind} {detail.get('because')}"
        if pad.reported != reason:
            pad.reported = reason
            self._tell(pad, kind, detail)

    def _tell(self, pad: Pad, kind: str, detail: dict[str, Any]) -> None:
        self._emit(pad.vehicle.system_id, kind, detail)
