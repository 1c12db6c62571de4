"""Who is still alive: a pure state machine over heartbeats of autopilots (component 1), with its own time-outs.

A companion computer that still sends proves nothing about its autopilot, so only component 1 counts. The machine has no
clock: every call carries the time, in fleet seconds. How often it is polled does not change which states it goes
through.

    LIVE -- silent for stale_after_s --> STALE -- silent for lost_after_s --> LOST
    LOST -- heard for recovered_after_s --> STALE -- heard for another recovered_after_s --> LIVE

"Heard for" counts from the first heartbeat after a silence to the latest one; a pause of stale_after_s restarts it.

Silence counts only while this process listens. A pause of its own (`missed`: a stopped process, a moved machine, a
blocked loop) is left out, so that no vehicle is lost because of what was not received; but of many pauses together no
more than the longest of them, or lost_after_s, so that a loss is found however often the process pauses.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from math import isfinite

from skyfolio.mavlink_bridge.boot_clock import has_restarted

AUTOPILOT = 1
"""MAV_COMP_ID_AUTOPILOT1."""

_LISTENED = 0.1
"""The share of lost_after_s for which the process must have listened before a silence is one."""


class LinkState(StrEnum):
    """What the heartbeats of one vehicle show."""

    LIVE = "live"
    STALE = "stale"
    LOST = "lost"


@dataclass(frozen=True, kw_only=True)
class LinkEvent:
    """A change of state. `silent_for_s` is the time since the last heartbeat when the change was noticed, at `at_s`."""

    system_id: int
    before: LinkState
    after: LinkState
    silent_for_s: float
    at_s: float


@dataclass(slots=True)
class _Watched:
    now_s: float
    last_s: float
    first_s: float | None = None
    """The first heartbeat of the current run; None before any, and after a silence."""
    state: LinkState = LinkState.LIVE
    missed_s: float = 0.0
    """The time since it was last heard in which the process did not listen."""
    longest_missed_s: float = 0.0
    boot_ms: int | None = None
    boot_at_s: float = 0.0
    reboots: int = 0
    pending: list[LinkEvent] = field(default_factory=list)


class HeartbeatMonitor:
    """Keeps the link states of the watched vehicles. Times are fleet seconds, never wall time."""

    def __init__(
        self, *, stale_after_s: float = 3.0, lost_after_s: float = 5.0, recovered_after_s: float = 2.0
    ) -> None:
        for name, value in (("stale_after_s", stale_after_s), ("recovered_after_s", recovered_after_s)):
            if not (isfinite(value) and value > 0):
                raise ValueError(f"{name}: {value} must be a finite number of seconds above 0")
        if not (isfinite(lost_after_s) and lost_after_s > stale_after_s):
            raise ValueError(f"lost_after_s: {lost_after_s} must be above stale_after_s {stale_after_s}")
        self.stale_after_s = stale_after_s
        self.lost_after_s = lost_after_s
        self.recovered_after_s = recovered_after_s
        self._vehicles: dict[int, _Watched] = {}

    @property
    def watched(self) -> frozenset[int]:
        """Return the system ids that are watched."""
        return frozenset(self._vehicles)

    def watch(self, system_id: int, now_s: float) -> None:
        """Expect heartbeats from now on; it is live until proven silent. Watching twice changes nothing."""
        self._vehicles.setdefault(system_id, _Watched(now_s=now_s, last_s=now_s))

    def unwatch(self, system_id: int) -> None:
        """Stop expecting heartbeats and reporting changes."""
        self._vehicles.pop(system_id, None)

    def state(self, system_id: int) -> LinkState:
        """Return the state as of the latest call. Raises KeyError if it is not watched."""
        return self._vehicles[system_id].state

    def is_up(self, system_id: int) -> bool:
        """Return whether it is watched, and its link was not lost as of the latest call."""
        vehicle = self._vehicles.get(system_id)
        return vehicle is not None and vehicle.state is not LinkState.LOST

    def silent_for_s(self, system_id: int, now_s: float) -> float:
        """Return the seconds since the last heartbeat (or since `watch`). Raises KeyError if it is not watched."""
        return max(0.0, now_s - self._vehicles[system_id].last_s)

    def reboots(self, system_id: int) -> int:
        """Return how often the autopilot restarted, by its boot clock. Raises KeyError if it is not watched."""
        return self._vehicles[system_id].reboots

    def heard(self, system_id: int, component_id: int, now_s: float, boot_ms: int | None = None) -> None:
        """Take in a HEARTBEAT. Other components and vehicles that are not watched are ignored.

        boot_ms: the latest `time_boot_ms` this autopilot sent, milliseconds since it started.
        """
        vehicle = self._vehicles.get(system_id)
        if vehicle is None or component_id != AUTOPILOT:
            return
        self._silence(system_id, vehicle, now_s)
        if vehicle.first_s is None:
            vehicle.first_s = vehicle.now_s
        vehicle.last_s = vehicle.now_s
        vehicle.missed_s = vehicle.longest_missed_s = 0.0
        self._recover(system_id, vehicle)
        if boot_ms is not None:
            self._check_boot(vehicle, boot_ms)

    def missed(self, now_s: float, for_s: float) -> None:
        """Take in that the process has not listened for the last `for_s` seconds: what was sent may be lost.

        Call it before `poll`, which would take the pause for the vehicles' silence.
        """
        for vehicle in self._vehicles.values():
            pause_s = min(for_s, max(0.0, now_s - vehicle.last_s))
            vehicle.missed_s += pause_s
            vehicle.longest_missed_s = max(vehicle.longest_missed_s, pause_s)

    def poll(self, now_s: float) -> list[LinkEvent]:
        """Return everything that changed since the latest poll, each vehicle's changes in order."""
        events: list[LinkEvent] = []
        for system_id, vehicle in self._vehicles.items():
            self._silence(system_id, vehicle, now_s)
            events += vehicle.pending
            vehicle.pending.clear()
        return events

    def _silence(self, system_id: int, vehicle: _Watched, now_s: float) -> None:
        """Let time pass without a heartbeat; a clock that runs backwards counts as stopped."""
        vehicle.now_s = max(vehicle.now_s, now_s)
        silent_s = self._counted_s(vehicle)
        if silent_s >= self.stale_after_s:
            vehicle.first_s = None
            if vehicle.state is LinkState.LIVE:
                self._change(system_id, vehicle, LinkState.STALE)
        if silent_s >= self.lost_after_s and vehicle.state is LinkState.STALE:
            self._change(system_id, vehicle, LinkState.LOST)

    def _counted_s(self, vehicle: _Watched) -> float:
        """Return its silence in seconds, less the pauses of this process."""
        silent_s = vehicle.now_s - vehicle.last_s
        if vehicle.missed_s == 0.0:
            return silent_s
        if silent_s - vehicle.missed_s < _LISTENED * self.lost_after_s:
            return 0.0
        return silent_s - min(vehicle.missed_s, max(vehicle.longest_missed_s, self.lost_after_s))

    def _recover(self, system_id: int, vehicle: _Watched) -> None:
        """Climb one state each time the run of heartbeats has held for `recovered_after_s`."""
        if vehicle.state is LinkState.LIVE or vehicle.first_s is None:
            return
        if vehicle.last_s - vehicle.first_s >= self.recovered_after_s:
            vehicle.first_s = vehicle.last_s
            self._change(system_id, vehicle, LinkState.STALE if vehicle.state is LinkState.LOST else LinkState.LIVE)

    def _change(self, system_id: int, vehicle: _Watched, after: LinkState) -> None:
        vehicle.pending.append(
            LinkEvent(
                system_id=system_id,
                before=vehicle.state,
                after=after,
                silent_for_s=vehicle.now_s - vehicle.last_s,
                at_s=vehicle.now_s,
            )
        )
        vehicle.state = after

    def _check_boot(self, vehicle: _Watched, boot_ms: int) -> None:
        """Count a restart.

        The same value again proves nothing: HEARTBEATs carry none, and a vehicle that has restarted sends them long
        before its first position.
        """
        if boot_ms == vehicle.boot_ms:
            return
        last, heard_s = vehicle.boot_ms, vehicle.now_s - vehicle.boot_at_s
        vehicle.boot_ms, vehicle.boot_at_s = boot_ms, vehicle.now_s
        if last is not None and has_restarted(last, boot_ms, heard_s):
            vehicle.reboots += 1
