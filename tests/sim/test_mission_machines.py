"""The mission protocol of both flavours under any order of messages: wrong seq, wrong target, foreign ground stations.

PX4's invariant: what lies on board is always a whole plan that somebody sent and that was acknowledged. ArduPilot's:
what lies on board is what was written last, item by item, after a truncation at MISSION_COUNT: a hybrid after a broken
upload, exactly as on the real one. Neither crashes, hangs in a transfer, or keeps anything of strangers.
"""

from typing import Any

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.ardupilot_missions import ArdupilotMissions
from skyfolio.sim.autopilot import Autopilot
from skyfolio.sim.mission_protocol import TYPES
from skyfolio.sim.missions import Mission, MissionItem
from skyfolio.sim.px4_missions import Px4Missions
from skyfolio.sim.specs import VehicleSpec
from skyfolio.sim.wire import Decoder, Encoder

Who = tuple[int, int]
stations = st.sampled_from([(245, 190), (99, 190), (245, 191)])
targets = st.sampled_from([(1, 1), (1, 1), (1, 1), (1, 0), (0, 0), (2, 1), (1, 191)])
seqs, variants = st.integers(0, 4), st.integers(0, 3)
MISSION, FENCE, RALLY = TYPES
COMMAND_OF = {MISSION: 16, FENCE: 5003, RALLY: 5100}
types = st.sampled_from([MISSION, MISSION, MISSION, FENCE, RALLY])
LONGEST_S = 8.0
MAX_ITEM_SEQ = 5


class Machine(RuleBasedStateMachine):
    """Sends frames to a whole autopilot and packs every answer, as a link would."""

    flavour = "px4"

    def __init__(self) -> None:
        super().__init__()
        self.wall_s = 0.0
        self.accepted: dict[int, list[tuple[Any, ...]]] = {kind: [()] for kind in TYPES}
        self.autopilot = Autopilot(
            VehicleSpec(1, 47.0, 8.5, autopilot=self.flavour),
            protocol_clock=lambda: self.wall_s,
            on_event=self._happened,
        )
        self.encoder = Encoder(1)

    def _happened(self, kind: str, detail: dict[str, Any]) -> None:
        kinds = {"mission_accepted": MISSION, "fence_accepted": FENCE, "rally_accepted": RALLY}
        if kind in kinds:
            self.accepted[kinds[kind]].append(detail["items"])

    def send(self, who: Who, name: str, *values: Any) -> list[Any]:
        mav = dialect.MAVLink(None, srcSystem=who[0], srcComponent=who[1])
        (message,) = Decoder().decode(bytes(getattr(dialect, f"MAVLink_{name}_message")(*values).pack(mav)))
        answers = self.autopilot.handle(message)
        for answer in answers:
            self.encoder.encode(answer)
        for answer in answers:
            if hasattr(answer, "target_system"):
                assert (answer.target_system, answer.target_component) == who
        return answers

    def fields(self, kind: int, seq: int, variant: int, command: int) -> tuple[Any, ...]:
        return (seq, 3, command, 0, 1, 5.0, 0.0, 0.0, 0.0, 470_000_000 + variant, 85_000_000 + seq, 20.0, kind)

    @rule(who=stations, to=targets, seq=seqs, kind=types)
    def read(self, who: Who, to: Who, seq: int, kind: int) -> None:
        self.send(who, "mission_request_list", *to, kind)
        for answer in self.send(who, "mission_request_int", *to, seq, kind):
            if answer.get_type() == "MISSION_ITEM_INT" and not (kind == MISSION and seq == 0):
                held = self.autopilot.missions.plan(kind).items[seq]
                assert (answer.x, answer.y, answer.seq) == (held.x, held.y, held.seq)

    @rule(who=stations, to=targets, seq=st.integers(0, MAX_ITEM_SEQ))
    def set_current(self, who: Who, to: Who, seq: int) -> None:
        self.send(who, "mission_set_current", *to, seq)

    @rule(seconds=st.sampled_from([0.1, 0.3, 1.1, LONGEST_S + 1.0]))
    def wait(self, seconds: float) -> None:
        self.wall_s += seconds
        for message in self.autopilot.due():
            self.encoder.encode(message)
        if seconds > LONGEST_S:
            assert not self.autopilot.missions.busy, "no transfer hangs"

    @rule()
    def fly(self) -> None:
        self.autopilot.step(self.autopilot.now_s + 0.05, 0.05)

    @invariant()
    def every_plan_is_numbered_from_zero_without_gaps(self) -> None:
        for kind in TYPES:
            items = self.autopilot.missions.plan(kind).items
            assert [item.seq for item in items] == list(range(len(items)))

    @invariant()
    def nothing_piles_up(self) -> None:
        assert len(self.autopilot._outbox) < 100


class Px4Machine(Machine):
    """Always a whole accepted plan."""

    def __init__(self) -> None:
        super().__init__()
        self.promised: dict[int, tuple[Who, int]] = {}
        self.sent: dict[int, list[tuple[Who, int, int]]] = {kind: [] for kind in TYPES}

    @rule(who=stations, to=targets, number=seqs, kind=types)
    def count(self, who: Who, to: Who, number: int, kind: int) -> None:
        answers = self.send(who, "mission_count", *to, number, kind)
        if [answer.get_type() for answer in answers] == ["MISSION_REQUEST_INT"]:
            self.promised[kind], self.sent[kind] = (who, number), []

    @rule(who=stations, to=targets, seq=seqs, variant=variants, kind=types, wrong=st.booleans())
    def item(self, who: Who, to: Who, seq: int, variant: int, kind: int, wrong: bool) -> None:
        fields = self.fields(kind, seq, variant, 82 if wrong and seq == 3 else COMMAND_OF[kind])
        self.sent[kind].append((who, seq, fields[9]))
        known = len(self.accepted[kind])
        answers = self.send(who, "mission_item_int", *to, *fields)
        if len(self.accepted[kind]) > known:
            assert [a.type for a in answers if a.get_type() == "MISSION_ACK"] == [dialect.MAV_MISSION_ACCEPTED]
            plan = self.accepted[kind][-1]
            assert self.promised[kind] == (who, len(plan))
            assert {(who, item.seq, item.x) for item in plan} <= set(self.sent[kind])

    @rule(who=stations, variant=variants, kind=types)
    def next_item(self, who: Who, variant: int, kind: int) -> None:
        missions = self.autopilot.missions
        assert isinstance(missions, Px4Missions)
        self.item(who, (1, 1), len(getattr(missions._transfer, "staged", [])), variant, kind, False)

    @rule(who=stations, to=targets, result=st.sampled_from([0, 1, 15]), kind=types)
    def acknowledge(self, who: Who, to: Who, result: int, kind: int) -> None:
        assert self.send(who, "mission_ack", *to, result, kind) == []

    @rule(who=stations, to=targets, kind=st.sampled_from([MISSION, FENCE, RALLY, 255]))
    def clear(self, who: Who, to: Who, kind: int) -> None:
        self.send(who, "mission_clear_all", *to, kind)

    @invariant()
    def what_lies_on_board_was_accepted_whole(self) -> None:
        for kind in TYPES:
            assert self.autopilot.missions.plan(kind) == Mission(self.accepted[kind][-1])


class ArdupilotMachine(Machine):
    """What was written last, item by item; `model` keeps that and which station may write next on its own."""

    flavour = "ardupilot"

    def __init__(self) -> None:
        super().__init__()
        self.model: dict[int, list[int]] = {kind: [] for kind in TYPES}
        self.staged: list[int] = []
        self.writer: dict[int, tuple[Who, int, int]] = {}

    @initialize(number=st.integers(0, 4))
    def a_mission_is_on_board(self, number: int) -> None:
        self.count((245, 190), (1, 1), number, MISSION)
        for seq in range(number):
            self.item((245, 190), (1, 1), seq, 0, MISSION, False)

    @rule(who=stations, to=targets, number=seqs, kind=types)
    def count(self, who: Who, to: Who, number: int, kind: int) -> None:
        answers = self.send(who, "mission_count", *to, number, kind)
        if not ours(to):
            assert answers == []
            return
        if kind in self.writer and self.writer[kind][0] != who:
            assert answers[0].type == dialect.MAV_MISSION_DENIED
            return
        self.writer.pop(kind, None)
        if kind != FENCE or number == 0:
            del self.model[kind][number:]
        self.staged = [] if kind == FENCE else self.staged
        if number:
            self.writer[kind] = (who, 0, number)
            assert answers[0].get_type() == "MISSION_REQUEST"

    @rule(who=stations, to=targets, seq=seqs, variant=variants, kind=types, wrong=st.booleans())
    def item(self, who: Who, to: Who, seq: int, variant: int, kind: int, wrong: bool) -> None:
        refused = wrong and seq == 3
        fields = self.fields(kind, seq, variant, 2000 if refused else COMMAND_OF[kind])
        answers = self.send(who, "mission_item_int", *to, *fields)
        if not ours(to):
            assert answers == []
            return
        writer, due, number = self.writer.get(kind, ((0, 0), -1, 0))
        if (writer, due) != (who, seq):
            assert answers[-1].type in (
                dialect.MAV_MISSION_ERROR,
                dialect.MAV_MISSION_INVALID_SEQUENCE,
                dialect.MAV_MISSION_DENIED,
            )
        elif refused:
            del self.writer[kind]
            assert answers[-1].type == dialect.MAV_MISSION_UNSUPPORTED
        else:
            self._written(kind, seq, fields[9], number)

    def _written(self, kind: int, seq: int, x: int, number: int) -> None:
        into = self.staged if kind == FENCE else self.model[kind]
        into[seq : seq + 1] = [x]
        self.writer[kind] = (self.writer[kind][0], seq + 1, number)
        if seq + 1 == number:
            del self.writer[kind]
            if kind == FENCE:
                self.model[kind] = list(self.staged)

    @rule(variant=variants, kind=types)
    def next_item(self, variant: int, kind: int) -> None:
        if kind in self.writer:
            who, due, _ = self.writer[kind]
            self.item(who, (1, 1), due, variant, kind, False)

    @rule(who=stations, to=targets, kind=types)
    def acknowledgements_change_nothing(self, who: Who, to: Who, kind: int) -> None:
        busy = self.autopilot.missions.busy
        assert self.send(who, "mission_ack", *to, dialect.MAV_MISSION_OPERATION_CANCELLED, kind) == []
        assert self.autopilot.missions.busy == busy

    @rule(who=stations, to=targets, kind=types)
    def clear(self, who: Who, to: Who, kind: int) -> None:
        answers = self.send(who, "mission_clear_all", *to, kind)
        if answers and answers[0].type == dialect.MAV_MISSION_ACCEPTED:
            assert kind not in self.writer
            self.model[kind] = []

    @invariant()
    def what_lies_on_board_is_what_was_written_last(self) -> None:
        missions = self.autopilot.missions
        assert isinstance(missions, ArdupilotMissions)
        if not missions.busy:
            self.writer.clear()
        self.writer = {kind: state for kind, state in self.writer.items() if kind in missions._uploads}
        for kind in TYPES:
            assert [item.x for item in missions.plan(kind).items] == self.model[kind]

    @invariant()
    def only_home_stands_in_for_what_was_sent(self) -> None:
        home: MissionItem = self.autopilot.plans.home_item()
        assert (home.seq, home.command) == (0, 16)


def ours(to: Who) -> bool:
    return to[0] in (0, 1) and to[1] in (0, 1)


ECONOMICAL = settings(deadline=None, max_examples=60, stateful_step_count=40)
TestPx4 = Px4Machine.TestCase
TestPx4.settings = ECONOMICAL
TestArdupilot = ArdupilotMachine.TestCase
TestArdupilot.settings = ECONOMICAL
