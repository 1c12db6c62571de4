"""What real autopilots answered to recorded commands, the simulated ones answer too.

Each vehicle of each recorded flight is flown again in virtual time: it has the parameters that were read, and is sent
what the service sent, when the service did. What happened to it beside that, by another station or a fault, happens
again. Then both have given the same results, gone through the same modes, and stood or flown in the same order.
"""

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from itertools import groupby
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.autopilot import Autopilot
from skyfolio.sim.modes import Mode
from skyfolio.sim.specs import VehicleSpec
from skyfolio.sim.wire import Decoder
from tests.recordings.reading import NAMES, SERVICE, Recorded, messages, vehicles

STEP_S = 0.05
AFTER_S = 150.0
"""A simulated flight may take this much longer than the recorded one."""
Happening = Callable[[Autopilot], object]


def change_to(mode: Mode) -> Happening:
    """Another ground station, or a pilot, takes over."""
    return lambda autopilot: autopilot.set_mode(mode)


def drain(autopilot: Autopilot) -> None:
    autopilot.component_failures.set_battery(0.04)


HAPPENED: dict[tuple[str, int], list[tuple[float, Happening]]] = {
    ("ccc-human-stop", 1): [(55.1, change_to(Mode.HOLD))],
    ("ccc-rtl-batt", 1): [(53.0, change_to(Mode.RTL))],
    ("ppp-crawl2", 1): [(53.4, change_to(Mode.RTL))],
    ("ppp-crawl2", 2): [(54.0, change_to(Mode.RTL))],
    ("ppp-crawl2", 3): [(54.5, change_to(Mode.RTL))],
    ("ppp-gps-motor", 1): [(59.2, lambda autopilot: autopilot.component_failures.lose_satellites())],
    ("ppp-human-stop", 1): [(56.57, change_to(Mode.HOLD))],
    ("ppp-rtl-batt", 1): [(56.0, change_to(Mode.RTL))],
    ("ppp-rtl-batt", 2): [(89.4, drain)],
}
"""What is in the README of the recordings and not in what the service sent, seconds into the recording."""

STOPPED_S = {("ccc-human-stop", 2): (90.05, 98.2), ("ppp-human-stop", 2): (91.4, 99.4)}
"""When a vehicle stood still as a process: it reads what it was sent once it goes on."""
DOWN_S = {("ccc-reboot", 2): (52.4, 55.6), ("ccc-reboot", 3): (82.4, 85.8)}
"""When a vehicle was off: what it was sent then is lost."""
JUDGED_UNTIL_S = {
    ("ccc-human-stop", 1): 75.0,
    ("ccc-human-stop", 2): 112.0,
    ("ppp-gps-motor", 3): 125.0,
    ("ppp-human-stop", 2): 160.0,
}
"""The first sank in LOITER because its sticks lay at the bottom; the simulator's are centred. The simulation of the
others is seconds ahead at the end of its mission, and lands where the real one was still sent something."""
STALLED = ("ccp-kill-p",)
"""The machine that recorded this one stood still for seconds: answers and words are missing in it."""
PASSING = re.compile(r"Mission|Reached|EKF3|AHRS|GPS 1|Field|SIM |PreArm|Geofence|RTL: start|\)")
"""Words that depend on the way flown, or on a machine; sim.boot, the runners and the failsafes have tests of theirs."""
STANDBY, ARMED, AUTO = 3, 128, 3
SERVICES_OWN = {0, dialect.MAV_CMD_INJECT_FAILURE}
"""Orders a PX4 only passed on."""


class Flight:
    """One vehicle's side of a conversation, real or simulated."""

    def __init__(self) -> None:
        self.results: list[tuple[int, int]] = []
        self.mission_answers: list[tuple[int, int]] = []
        self.beats: list[tuple[int, int, int]] = []
        self.landed: list[int] = []
        self.words: list[tuple[int, str]] = []
        self.orders: list[int] = []

    def take(self, name: str, get: Callable[[str], Any]) -> None:
        """Take a message of the vehicle; `get` reads its fields."""
        if name == "COMMAND_ACK":
            if get("target_system") == SERVICE:
                self.results.append((get("command"), get("result")))
        elif name == "MISSION_ACK":
            self.mission_answers.append((get("mission_type"), get("type")))
        elif name == "HEARTBEAT":
            self.beats.append((get("base_mode"), get("custom_mode"), get("system_status")))
        elif name == "EXTENDED_SYS_STATE":
            self.landed.append(get("landed_state"))
        elif name == "STATUSTEXT":
            self.words.append((get("severity"), get("text")))
        elif name == "COMMAND_LONG":
            self.orders.append(get("command"))


def changes(values: Iterable[Any]) -> list[Any]:
    """Return values without those that repeat the one before."""
    return [value for value, _ in groupby(values)]


def recorded_flight(name: str, system_id: int, *, until_s: float) -> Flight:
    flight = Flight()
    for message in messages(name):
        if message.system_id == system_id and message.component_id == 1 and message.at_s <= until_s:
            flight.take(message.name, message.fields.__getitem__)
    return flight


def sent_to(name: str, system_id: int) -> list[Recorded]:
    """Return what the service sent to a vehicle and to everybody."""
    return [m for m in messages(name) if m.system_id == SERVICE and m.fields.get("target_system", 0) in (0, system_id)]


def standing(name: str, system_id: int) -> Autopilot:
    """Return a simulated vehicle where the recorded one stood, with its parameters as far as they were read."""
    recorded = [m for m in messages(name) if m.system_id == system_id]
    home = next(m.fields for m in recorded if m.name == "HOME_POSITION")
    flavour = "px4" if next(m for m in recorded if m.name == "HEARTBEAT").fields["autopilot"] == 12 else "ardupilot"
    place = (home["latitude"] / 1e7, home["longitude"] / 1e7, home["altitude"] / 1e3)
    autopilot = Autopilot(
        VehicleSpec(system_id, *place, autopilot=flavour),
        protocol_clock=lambda: autopilot.now_s,
        on_event=lambda _kind, _detail: None,
    )
    for message in recorded:
        if message.name == "PARAM_VALUE" and message.fields["param_id"] in autopilot.parameters:
            set_parameter(autopilot, message.fields)
    return autopilot


def set_parameter(autopilot: Autopilot, fields: dict[str, Any]) -> None:
    station = dialect.MAVLink(None, srcSystem=SERVICE, srcComponent=190)
    values = (autopilot.spec.system_id, 1, fields["param_id"].encode(), fields["param_value"], fields["param_type"])
    (message,) = Decoder().decode(bytes(dialect.MAVLink_param_set_message(*values).pack(station)))
    autopilot.handle(message)


def ends_s(name: str, system_id: int) -> float:
    """Return when the vehicle sent its last message."""
    return max(m.at_s for m in messages(name) if m.system_id == system_id)


def simulated_flight(name: str, system_id: int, *, goes_on: bool) -> Flight:
    """Fly it; `goes_on`: beyond the recording, and the service's HEARTBEAT with it."""
    autopilot, flight, decoder = standing(name, system_id), Flight(), Decoder()
    waiting = sent_to(name, system_id)
    happening = list(HAPPENED.get((name, system_id), []))
    until_s = JUDGED_UNTIL_S.get((name, system_id), ends_s(name, system_id) + 0.2)
    if goes_on:
        beat = next(m for m in waiting if m.name == "HEARTBEAT")
        waiting += [replace(beat, at_s=waiting[-1].at_s + n) for n in range(1, round(AFTER_S))]
        until_s += AFTER_S
    off, stopped = DOWN_S.get((name, system_id)), STOPPED_S.get((name, system_id))
    if off is not None:
        waiting = [m for m in waiting if not off[0] <= m.at_s < off[1]]
    while autopilot.now_s < until_s:
        if off is not None and autopilot.now_s >= off[0]:
            autopilot.shut_down()
            autopilot.boot(off[1])
            off = None
        if stopped is not None and autopilot.now_s >= stopped[0]:
            frozen_s, stopped = stopped[1] - stopped[0], None
            autopilot.clock.now_s += frozen_s
            autopilot.thaw(frozen_s, frozen_s)
        while waiting and waiting[0].at_s <= autopilot.now_s:
            for message in decoder.decode(waiting.pop(0).frame):
                listen(flight, autopilot.handle(message))
                listen(flight, autopilot.due())
        while happening and happening[0][0] <= autopilot.now_s:
            happening.pop(0)[1](autopilot)
        autopilot.step(autopilot.now_s + STEP_S, STEP_S)
        listen(flight, autopilot.due())
    return flight


def listen(flight: Flight, messages_sent: Iterable[Any]) -> None:
    for message in messages_sent:
        flight.take(message.get_type(), partial(getattr, message))


def path(beats: list[tuple[int, int, int]]) -> list[tuple[int, int, int]]:
    """Return the changes of HEARTBEATs, without what two flights of the same autopilot differ in.

    An ArduCopter that has landed disarms before or after its next HEARTBEAT, and controls a position or not in AUTO on
    the ground; a PX4 that has landed may need a moment until it could be armed again.
    """
    flown = False
    kept = []
    for base, custom, status in beats:
        flown = flown or (bool(base & ARMED) and status != STANDBY)
        if base & ARMED and status == STANDBY and flown:
            continue
        if not base & ARMED and flown and status in (0, STANDBY):
            kept.append((base | 8 if custom == AUTO else base, custom, STANDBY))
        else:
            kept.append((base, custom, status))
    return changes(kept)


def same_as_far_as_heard(real: list[Any], simulated: list[Any]) -> bool:
    """Whether one goes on where the other ended, by one change at most."""
    shorter = min(len(real), len(simulated))
    return real[:shorter] == simulated[:shorter] and max(len(real), len(simulated)) - shorter <= 1


@pytest.mark.parametrize(("name", "system_id"), [(n, v) for n in NAMES if "svckill" not in n for v in vehicles(n)])
def test_a_simulated_vehicle_answers_and_flies_as_the_recorded_one_did(name: str, system_id: int) -> None:
    real = recorded_flight(name, system_id, until_s=JUDGED_UNTIL_S.get((name, system_id), math.inf))
    landed = not real.beats[-1][0] & ARMED
    simulated = simulated_flight(name, system_id, goes_on=landed and "reboot" not in name)
    if name in STALLED:
        assert set(simulated.results) == set(real.results)
        assert set(simulated.mission_answers) == set(real.mission_answers)
    else:
        assert Counter(simulated.results) == Counter(real.results)
        assert simulated.mission_answers == real.mission_answers
        assert words(simulated) == words(real)
    assert same_as_far_as_heard(path(real.beats), path(simulated.beats))
    assert same_as_far_as_heard(changes(real.landed), changes(simulated.landed))
    assert set(real.orders) - SERVICES_OWN <= set(simulated.orders)


def words(flight: Flight) -> set[tuple[int, str]]:
    return {text for text in flight.words if not PASSING.match(text[1])}
