"""Is an operator's own vehicle fit to be flown by this service? Asked on the ground; nothing is armed or moved.

Each vehicle is heard, waited for, audited, and given a small mission, a geofence and a rally point, which are read
back; then what was on board before is put back, and proven too.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from pydantic import BaseModel

from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.fleet.trial_mission import ALTITUDE_M, SQUARE, trial_plan
from skyfolio.mavlink_bridge import (
    BridgeError,
    FleetLink,
    HeartbeatMonitor,
    LinkOptions,
    MissionItem,
    Signing,
    compile_mission,
)
from skyfolio.mavlink_bridge.fence import fence_items, rally_items
from skyfolio.mavlink_bridge.findings import Finding, Level
from skyfolio.mavlink_bridge.listening import ANYBODY
from skyfolio.mavlink_bridge.mission_messages import MissionType
from skyfolio.mavlink_bridge.preflight import audit
from skyfolio.mavlink_bridge.profiles import KNOWN, unknown_autopilot
from skyfolio.mavlink_bridge.results import UploadResult
from skyfolio.planner import Origin, Plan

UAV = "trial"
MORE_WITHIN_S = 1.5
"""Wall seconds after the first heartbeat in which others are heard: it comes at 1 Hz."""
LOOK_S = 0.1

Say = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class CheckConfig:
    """urls: links, the preferred first. system_ids: whom to check; none: who is heard within `wait_s` wall seconds."""

    urls: tuple[str, ...]
    system_ids: tuple[int, ...] = ()
    wait_s: float = 15.0
    signing_key_file: Path | None = None


class NobodyHeard(BridgeError):  # noqa: N818 (as its siblings in the bridge)
    """No autopilot answers on the links."""


class FindingView(BaseModel):
    """One row of the audit; `level` is blocker or warning."""

    level: Level
    name: str
    found: str
    should: str
    why: str


class TransferView(BaseModel):
    """What came of putting one kind of items on board. `seconds`: wall time of the upload and its proof.

    `changed`: what the vehicle stores otherwise than it was sent, field by field, also where that is known to be its
    way. `restored`: whether what was there before is there again, read back and equal; None: nothing was written.
    """

    kind: str
    items: int
    verified: bool = False
    seconds: float = 0.0
    changed: list[str] = []
    items_before: int | None = None
    restored: bool | None = None
    error: str | None = None


class VehicleReport(BaseModel):
    """One vehicle. `missing`: what it had not told when the time was over."""

    system_id: int
    autopilot: str | None
    missing: list[str] = []
    findings: list[FindingView] = []
    transfers: list[TransferView] = []

    @property
    def ready(self) -> bool:
        """Whether nothing was found that keeps it from being flown."""
        blocked = any(one.level is Level.BLOCKER for one in self.findings)
        return not blocked and all(one.verified and one.restored is True for one in self.transfers)


class CheckReport(BaseModel):
    """The whole check."""

    ready: bool
    urls: list[str]
    vehicles: list[VehicleReport]


async def check(config: CheckConfig, say: Say = lambda _words: None) -> CheckReport:
    """Check all vehicles behind the links; `say` is told what is being done.

    Raises ConnectionFailed, VehiclesMissing for a system id that does not answer, NobodyHeard.
    """
    signing = None if config.signing_key_file is None else Signing.from_file(config.signing_key_file)
    async with FleetLink(clock=FleetClock(), monitor=HeartbeatMonitor(), options=LinkOptions(signing=signing)) as link:
        for url in config.urls:
            await link.connect(url)
        say("waiting for heartbeats")
        systems = await _heard(link, config)
        reports = [await _Check(link, system_id, say).run() for system_id in systems]
    return CheckReport(ready=all(one.ready for one in reports), urls=list(config.urls), vehicles=reports)


async def _heard(link: FleetLink, config: CheckConfig) -> list[int]:
    if config.system_ids:
        await link.wait_for(config.system_ids, timeout_s=config.wait_s)
        return list(config.system_ids)
    link.expect(ANYBODY)
    try:
        async with asyncio.timeout(config.wait_s):
            while not link.heard_systems:  # noqa: ASYNC110
                await asyncio.sleep(LOOK_S)
    except TimeoutError:
        where = ", ".join(config.urls)
        raise NobodyHeard(f"no autopilot's heartbeat was heard on {where} within {config.wait_s:g} s") from None
    await asyncio.sleep(MORE_WITHIN_S)
    return sorted(link.heard_systems)


class _Check:
    """The check of one vehicle."""

    def __init__(self, link: FleetLink, system_id: int, say: Say) -> None:
        self._link, self._system = link, system_id
        self._tell = say

    async def run(self) -> VehicleReport:
        """Audit it, and try what is put on board of it."""
        state = self._link.vehicle(self._system).state
        report = VehicleReport(system_id=self._system, autopilot=state.autopilot)
        if state.autopilot is None:
            unknown = unknown_autopilot(state.mav_autopilot)
            report.findings = [_blocker("autopilot", unknown.autopilot, KNOWN, "missions are compiled for these only")]
            return report
        self._say("asking for its parameters")
        await self._link.prepare([self._system])
        report.missing = list((await self._link.wait_for_facts([self._system], self._waits))[self._system])
        plan = self._plan()
        mission = compile_mission(
            plan, UAV, autopilot=state.autopilot, model=self._link.model(self._system)
        )  # around its place, or somewhere: the audit needs its length only
        found = audit(*self._link.facts(self._system, plan, UAV, items=len(mission.items)))
        report.findings = [_view(one) for one in found]
        if state.armed:
            why = "what it flies is left alone: disarm it, and check again"
            report.findings.insert(0, _blocker("armed", "armed", "disarmed", why))
        elif state.place_deg is not None:
            wanted = {
                MissionType.MISSION: mission.items,
                MissionType.FENCE: fence_items(plan.scenario),
                MissionType.RALLY: rally_items(plan.scenario, [(0.0, 0.0)], ALTITUDE_M),
            }
            report.transfers = [await self._transfer(kind, items) for kind, items in wanted.items()]
        return report

    def _say(self, words: str) -> None:
        self._tell(f"system {self._system}: {words}")

    def _waits(self, _system: int, missing: tuple[str, ...]) -> None:
        self._say(f"waiting for its {', '.join(missing)}")

    def _plan(self) -> Plan:
        state = self._link.vehicle(self._system).state
        lat_deg, lon_deg = state.place_deg or state.home_deg or (0.0, 0.0)
        return trial_plan(Origin(lat_deg=lat_deg, lon_deg=lon_deg), {UAV: SQUARE})

    async def _transfer(self, kind: MissionType, items: Sequence[MissionItem]) -> TransferView:
        """Put items on board, look how they are stored, and put back what was there."""
        name = kind.name.lower()
        view = TransferView(kind=name, items=len(items))
        self._say(f"reading the {name} it has")
        before = (await self._link.read([self._system], kind))[self._system]
        if before.error is not None:
            return view.model_copy(update={"error": f"what is on board cannot be read, so it is kept: {before.error}"})
        self._say(f"uploading a {name}")
        result = await self._upload(kind, items)
        stored = (await self._link.read([self._system], kind))[self._system]
        self._say(f"restoring its {name}")
        back = await self._restored(kind, before.items)
        errors = [result.error, stored.error, None if back is None else f"not restored: {back}"]
        return view.model_copy(
            update={
                "verified": result.verified,
                "seconds": round(result.seconds, 3),
                "changed": changed_fields(items, stored.items) if stored.ok else [],
                "items_before": len(before.items),
                "restored": back is None,
                "error": "; ".join(error for error in errors if error) or None,
            }
        )

    async def _upload(self, kind: MissionType, items: Sequence[MissionItem]) -> UploadResult:
        return (await self._link.upload_fence({self._system: items}, mission_type=kind))[self._system]

    async def _restored(self, kind: MissionType, before: tuple[MissionItem, ...]) -> str | None:
        """Put these back; what went wrong. The home that ArduPilot keeps as item 0 is no mission."""
        result = await self._upload(kind, before)
        if result.error is None or kind is not MissionType.MISSION or len(before) > 1:
            return result.error
        now = (await self._link.read([self._system], kind))[self._system]
        return now.error if now.error is not None or len(now.items) > 1 else None


def changed_fields(sent: Sequence[MissionItem], stored: Sequence[MissionItem]) -> list[str]:
    """What is stored otherwise than it was sent, by command and field; float32 rounding and `current` apart."""
    if len(sent) != len(stored):
        return [f"{len(sent)} items sent, {len(stored)} stored"]
    seen: dict[str, list[int]] = {}
    for one, other in zip(sent, stored, strict=True):
        for name, value in asdict(one).items():
            found = getattr(other, name)
            if name != "current" and not _same(value, found):
                words = f"command {one.command} {name}: {value:g} sent, {found:g} stored"
                seen.setdefault(words, []).append(one.seq)
    return [f"{words} (item{'s' if len(at) > 1 else ''} {_some(at)})" for words, at in seen.items()]


def _same(sent: float, stored: float) -> bool:
    return abs(sent - stored) <= 1e-6 * max(1.0, abs(sent)) or (sent != sent and stored != stored)


def _some(items: Iterable[int]) -> str:
    listed = list(items)
    return ", ".join(map(str, listed[:3])) + (", ..." if len(listed) > 3 else "")


def _blocker(name: str, found: str, should: str, why: str) -> FindingView:
    return FindingView(level=Level.BLOCKER, name=name, found=found, should=should, why=why)


def _view(finding: Finding) -> FindingView:
    return FindingView(**{name: value for name, value in asdict(finding).items() if name in FindingView.model_fields})
