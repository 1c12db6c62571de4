"""The conditions a UAV can be in, when each counts, and how a change is reported. Pure values, used by `classifier`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from enum import StrEnum
from math import isfinite

from skyfolio.mavlink_bridge.heartbeat import LinkEvent


class Condition(StrEnum):
    """The state of one UAV, gravest first."""

    CRASHED = "crashed"
    LANDED = "landed"
    DISARMED = "disarmed_in_air"
    """It reports to be disarmed, was high when it was last known to be armed, and is not seen to come down."""
    REBOOTED = "rebooted"
    AUTOPILOT_SILENT = "autopilot_silent"
    """Nothing is received from component 1, but another component of the system is heard: the link works."""
    LINK_LOST = "link_lost"
    HUMAN = "human_took_over"
    FAILSAFE = "in_failsafe"
    BACK = "back"
    """Heard again after a loss, and not yet for long enough to count on."""
    STALE = "stale"
    LOW_BATTERY = "low_battery"
    LIVE = "live"

    @property
    def serves(self) -> bool:
        """Return whether a plan may count on this UAV."""
        return self in (Condition.LIVE, Condition.STALE, Condition.LOW_BATTERY, Condition.BACK)

    @property
    def is_of_link(self) -> bool:
        """Return whether it only says how well the vehicle is heard."""
        return self in (
            Condition.LIVE,
            Condition.STALE,
            Condition.BACK,
            Condition.LINK_LOST,
            Condition.AUTOPILOT_SILENT,
        )

    @property
    def in_the_air(self) -> bool:
        """Return whether it may still be flying where its last mission takes it."""
        return self not in (Condition.CRASHED, Condition.LANDED)


@dataclass(frozen=True, kw_only=True)
class Timing:
    """When something counts, in fleet seconds; see `Condition`.

    lost_after_s is a little more than five heartbeats of a 1 Hz stream: only five lost in a row look like a loss.
    low_battery, full_again: share of charge (0..1) at which the battery counts as low, and as no longer low. proof_s:
    the time in which a UAV that rebooted in the air may report that it flies its mission on. crash_descent_mps: sinking
    faster than this for crash_after_s, other than in a landing, is falling. crash_height_m: a UAV that was higher than
    this above home when it was disarmed did not land. withdrawn_after_s: a UAV that was judged crashed and then
    evidently flies for so long has not crashed.
    """

    stale_after_s: float = 3.0
    lost_after_s: float = 5.5
    recovered_after_s: float = 2.0
    other_component_s: float = 2.5
    takeover_after_s: float = 1.0
    failsafe_after_s: float = 0.5
    clear_after_s: float = 3.0
    landed_after_s: float = 1.0
    rebooted_for_s: float = 10.0
    proof_s: float = 2.5
    low_battery: float = 0.2
    full_again: float = 0.25
    battery_after_s: float = 3.0
    crash_descent_mps: float = 6.0
    crash_height_m: float = 2.0
    crash_after_s: float = 0.5
    withdrawn_after_s: float = 3.0
    expected_for_s: float = 3.0

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not (isfinite(value) and value > 0):
                raise ValueError(f"{name}: {value} must be a finite number above 0")
        if not self.stale_after_s < self.lost_after_s:
            raise ValueError(f"lost_after_s: {self.lost_after_s} must be above stale_after_s {self.stale_after_s}")
        if not self.low_battery < self.full_again <= 1:
            raise ValueError(f"full_again: {self.full_again} must lie in ({self.low_battery}, 1]")


@dataclass(frozen=True, kw_only=True)
class Change:
    """A change of condition at `at_s`; `cause` says what was seen, with numbers.

    flies_on: it rebooted in the air, and has reported since that it flies the same mission on.
    """

    system_id: int
    before: Condition
    after: Condition
    cause: str
    at_s: float
    flies_on: bool = False


@dataclass(frozen=True, kw_only=True)
class VehicleChange:
    """What one look found changed about one vehicle: its link, step by step, and its condition.

    A vehicle that falls silent changes both; it is reported once. condition: None if only the link changed, as that of
    a vehicle that has crashed before.
    """

    system_id: int
    link: tuple[LinkEvent, ...] = ()
    condition: Change | None = None

    @property
    def is_of_link_only(self) -> bool:
        """Return whether the new condition says nothing more than the changes of the link do."""
        change = self.condition
        return change is None or (bool(self.link) and change.before.is_of_link and change.after.is_of_link)


def changes_by_vehicle(links: Iterable[LinkEvent], conditions: Iterable[Change]) -> list[VehicleChange]:
    """Return one change for each vehicle that one look found changed, in the order in which they were found."""
    steps: dict[int, list[LinkEvent]] = {}
    for event in links:
        steps.setdefault(event.system_id, []).append(event)
    new = {change.system_id: change for change in conditions}
    return [
        VehicleChange(system_id=system_id, link=tuple(steps.get(system_id, ())), condition=new.get(system_id))
        for system_id in dict.fromkeys((*steps, *new))
    ]


class Lasting:
    """Something that becomes true once it was so for `on_s`, and false once it was not for `off_s`."""

    def __init__(self, on_s: float, off_s: float) -> None:
        self.on = False
        self._on_s, self._off_s = on_s, off_s
        self._raw = False
        self._since_s: float | None = None

    def update(self, raw: bool | None, now_s: float) -> bool:
        """Take in what is seen now (None: the same as before), and return what counts."""
        if raw is not None and raw != self._raw:
            self._raw, self._since_s = raw, now_s
        if self._since_s is not None and self._raw != self.on:
            needed = self._on_s if self._raw else self._off_s
            self.on = self._raw if now_s - self._since_s >= needed else self.on
        return self.on
