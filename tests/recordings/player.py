"""Plays a recorded flight to the bridge's own classifier, in virtual time: what the service would have concluded."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from math import inf

from skyfolio.mavlink_bridge.autopilots import FlightMode
from skyfolio.mavlink_bridge.classifier import Classifier
from skyfolio.mavlink_bridge.conditions import Change, Condition, Timing
from skyfolio.mavlink_bridge.telemetry import MESSAGES, TelemetryState
from tests.recordings.reading import Recorded, messages, vehicles

POLL_S = 0.05
"""How often the service looks."""
CONFIRM_S = 3.0
"""How long it waits to see a mode that it has commanded."""
SET_MODE, TAKE_OFF = 176, 22


@dataclass
class Played:
    """What was concluded of each vehicle."""

    changes: dict[int, list[Change]] = field(default_factory=lambda: defaultdict(list))
    warnings: dict[int, list[tuple[float, str]]] = field(default_factory=lambda: defaultdict(list))
    states: dict[int, TelemetryState] = field(default_factory=dict)

    def conditions(self, system_id: int) -> list[Condition]:
        """What it went through, without its first LIVE."""
        return [change.after for change in self.changes[system_id]]

    def losses(self, system_id: int) -> list[Change]:
        """Changes to what no plan may count on, in order."""
        return [change for change in self.changes[system_id] if not change.after.serves]


class Player:
    """Tells a classifier what was heard, and announces what the service ordered as the service does."""

    def __init__(self, name: str, timing: Timing, began_s: float) -> None:
        self.classifier = Classifier(timing)
        self.played = Played(states={system_id: TelemetryState(system_id) for system_id in vehicles(name)})
        self._ordered: dict[int, tuple[FlightMode, float]] = {}
        for system_id in self.played.states:
            self.classifier.watch(system_id, began_s)

    def tell(self, heard: Recorded) -> None:
        """One message of the recording."""
        if heard.from_service:
            if heard.name == "COMMAND_LONG":
                self._command(heard)
        elif heard.system_id in self.played.states:
            if heard.name in MESSAGES and heard.component_id == 1:
                self.played.states[heard.system_id].fold(heard.name, heard.fields, heard.at_s)
            self.classifier.hear(heard.system_id, heard.component_id, heard.name, heard.fields, heard.at_s)
            self._seen(heard)

    def look(self, now_s: float) -> None:
        """What the service does every POLL_S."""
        for change in self.classifier.poll(now_s):
            self.played.changes[change.system_id].append(change)
        for system_id in self.played.states:
            said, told = self.classifier.warning(system_id), self.played.warnings[system_id]
            if said is not None and (not told or told[-1][1] != said):
                told.append((now_s, said))

    def _command(self, heard: Recorded) -> None:
        system_id, fields = int(heard.fields["target_system"]), heard.fields
        profile = self.played.states[system_id].profile
        if fields["command"] == TAKE_OFF:
            mode = FlightMode.TAKEOFF
        elif fields["command"] == SET_MODE:
            numbers = int(fields["param2"]), int(fields["param3"])
            assert profile is not None
            mode = next(mode for mode, sent in profile.mode_numbers.items() if sent == numbers)
        else:
            return
        self._ordered[system_id] = (mode, heard.at_s)
        self.classifier.expect(system_id, frozenset({mode}), heard.at_s, inf)

    def _seen(self, heard: Recorded) -> None:
        """A command ends when what it ordered is seen, or is not seen in time."""
        mode, since_s = self._ordered.get(heard.system_id, (None, 0.0))
        if mode is not None and (heard.at_s - since_s >= CONFIRM_S or self.played.states[heard.system_id].mode is mode):
            del self._ordered[heard.system_id]
            self.classifier.expect(heard.system_id, frozenset({mode}), heard.at_s)


def play(name: str, timing: Timing | None = None, *, from_s: float = 0.0) -> Played:
    """Play a recording from some second of it on, as a service hears it that is started then."""
    player, looked_s = Player(name, timing or Timing(lost_after_s=5.0), from_s), from_s
    for heard in messages(name):
        at_s = heard.at_s
        if at_s < from_s:
            continue
        while looked_s + POLL_S <= at_s:
            looked_s += POLL_S
            player.look(looked_s)
        player.tell(heard)
    return player.played
