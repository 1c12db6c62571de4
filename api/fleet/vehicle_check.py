"""The check whether an operator's own vehicles are fit to be flown by this service: on the ground, and moving nothing.

Each vehicle is heard, waited for and audited, and is sent a small mission, a geofence and a rally point, which are read
back. Then what was on board before is put back and read back too. Nothing is armed.
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
"""Wall seconds after the first heartbeat in which other vehicles are heard: heartbeats come at 1 Hz."""
LOOK_S = 0.1

ReportProgress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class CheckConfig:
    """What to check.

    urls: endpoints of the link, the preferred one first. system_ids: the vehicles to check; if empty, all that are
    heard within `wait_s` wall seconds.
    """

    urls: tuple[str, ...]
    system_ids: tuple[int, ...] = ()
    wait_s: float = 15.0
    signing_key_file: Path | None = None


class NobodyHeard(BridgeError):  # noqa: N818 (as its siblings in the bridge)
    """No autopilot was heard on the link."""


class FindingView(BaseModel):
    """One row of the audit; `level` is blocker or warning."""

    level: Level
    name: str
    found: str
    should: str
    why: str


class TransferView(BaseModel):
    """How the transfer of one kind of items to a vehicle went.

    `seconds`: wall time of the upload and of reading it back.

    `changed`: the fields that the vehicle stores with another value than was sent, even where its autopilot is known to
    do so. `restored`: whether what was on board before is there again, read back and equal; None if nothing was
    written.
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
    """The check of one vehicle. `missing`: the facts that it had not reported in time."""

    system_id: int
    autopilot: str | None
    missing: list[str] = []
    findings: list[FindingView] = []
    transfers: list[TransferView] = []

    @property
    def ready(self) -> bool:
        """Return whether nothing was found that keeps the vehicle from being flown."""
        blocked = any(finding.level is Level.BLOCKER for finding in self.findings)
        return not blocked and all(transfer.verified and transfer.restored is True for transfer in self.transfers)


class CheckReport(BaseModel):
    """The checks of all vehicles."""

    ready: bool
    urls: list[str]
    vehicles: list[VehicleReport]


async def check(config: CheckConfig, report_progress: ReportProgress = lambda _words: None) -> CheckReport:
    """Check all vehicles behind the links.

    report_progress: called with a few words about each step. Raises ConnectionFailed, VehiclesMissing for a system id
    that does not answer, NobodyHeard.
    """
    signing = None if config.signing_key_file is None else Signing.from_file(config.signing_key_file)
    async with FleetLink(clock=FleetClock(), monitor=HeartbeatMonitor(), options=LinkOptions(signing=signing)) as link:
        for url in config.urls:
            await link.connect(url)
        report_progress("waiting for heartbeats")
        systems = await _heard(link, config)
        reports = [await _Check(link, system_id, report_progress).run() for system_id in systems]
    return CheckReport(ready=all(report.ready for report in reports), urls=list(config.urls), vehicles=reports)


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
        raise NobodyHeard(f"no heartbeat of an autopilot was heard on {where} within {config.wait_s:g} s") from None
    await asyncio.sleep(MORE_WITHIN_S)
    return sorted(link.heard_systems)


class _Check:
    """The check of one vehicle."""

    def __init__(self, link: FleetLink, system_id: int, report_progress: ReportProgress) -> None:
        self._link, self._system = link, system_id
        self._report_progress = report_progress

    async def run(self) -> VehicleReport:
        """Audit the vehicle, and try what is put on board of one."""
        state = self._link.vehicle(self._system).state
        report = VehicleReport(system_id=self._system, autopilot=state.autopilot)
        if state.autopilot is None:
            unknown = unknown_autopilot(state.mav_autopilot)
            report.findings = [_blocker("autopilot", unknown.autopilot, KNOWN, "missions are compiled for these only")]
            return report
        self._progress("asking for its parameters")
        await self._link.prepare([self._system])
        report.missing = list((await self._link.wait_for_facts([self._system], self._waits))[self._system])
        plan = self._plan()
        mission = compile_mission(
            plan, UAV, autopilot=state.autopilot, model=self._link.model(self._system)
        )  # around its position if that is known: the audit needs only the length
        findings = audit(*self._link.facts(self._system, plan, UAV, items=len(mission.items)))
        report.findings = [_view(finding) for finding in findings]
        if state.armed:
            why = "an armed vehicle is left alone: disarm it, and check again"
            report.findings.insert(0, _blocker("armed", "armed", "disarmed", why))
        elif state.place_deg is not None:
            trial_items = {
                MissionType.MISSION: mission.items,
                MissionType.FENCE: fence_items(plan.scenario),
                MissionType.RALLY: rally_items(plan.scenario, [(0.0, 0.0)], ALTITUDE_M),
            }
            report.transfers = [await self._transfer(kind, items) for kind, items in trial_items.items()]
        return report

    def _progress(self, words: str) -> None:
        self._report_progress(f"system {self._system}: {words}")

    def _waits(self, _system: int, missing: tuple[str, ...]) -> None:
        self._progress(f"waiting for its {', '.join(missing)}")

    def _plan(self) -> Plan:
        state = self._link.vehicle(self._system).state
        lat_deg, lon_deg = state.place_deg or state.home_deg or (0.0, 0.0)
        return trial_plan(Origin(lat_deg=lat_deg, lon_deg=lon_deg), {UAV: SQUARE})

    async def _transfer(self, kind: MissionType, items: Sequence[MissionItem]) -> TransferView:
        """Upload items of one kind, read how they are stored, and put back what was there before."""
        name = kind.name.lower()
        view = TransferView(kind=name, items=len(items))
        self._progress(f"reading the {name} it has")
        before = (await self._link.read([self._system], kind))[self._system]
        if before.error is not None:
            return view.model_copy(
                update={"error": f"what is on board cannot be read, so nothing is uploaded: {before.error}"}
            )
        self._progress(f"uploading a {name}")
        result = await self._upload(kind, items)
        stored = (await self._link.read([self._system], kind))[self._system]
        self._progress(f"restoring its {name}")
        restore_error = await self._restored(kind, before.items)
        errors = [result.error, stored.error, None if restore_error is None else f"not restored: {restore_error}"]
        return view.model_copy(
            update={
                "verified": result.verified,
                "seconds": round(result.seconds, 3),
                "changed": changed_fields(items, stored.items) if stored.ok else [],
                "items_before": len(before.items),
                "restored": restore_error is None,
                "error": "; ".join(error for error in errors if error) or None,
            }
        )

    async def _upload(self, kind: MissionType, items: Sequence[MissionItem]) -> UploadResult:
        return (await self._link.upload_fence({self._system: items}, mission_type=kind))[self._system]

    async def _restored(self, kind: MissionType, before: tuple[MissionItem, ...]) -> str | None:
        """Put these items back; return what went wrong, or None.

        The home that ArduPilot keeps as item 0 is no mission.
        """
        result = await self._upload(kind, before)
        if result.error is None or kind is not MissionType.MISSION or len(before) > 1:
            return result.error
        read_back = (await self._link.read([self._system], kind))[self._system]
        return read_back.error if read_back.error is not None or len(read_back.items) > 1 else None


def changed_fields(sent: Sequence[MissionItem], stored: Sequence[MissionItem]) -> list[str]:
    """List what is stored with another value than was sent, by command and field.

    Differences by float32 rounding, and of the field `current`, are left out.
    """
    if len(sent) != len(stored):
        return [f"{len(sent)} items sent, {len(stored)} stored"]
    items_by_change: dict[str, list[int]] = {}
    for sent_item, stored_item in zip(sent, stored, strict=True):
        for name, value in asdict(sent_item).items():
            stored_value = getattr(stored_item, name)
            if name != "current" and not _same(value, stored_value):
                change = f"command {sent_item.command} {name}: {value:g} sent, {stored_value:g} stored"
                items_by_change.setdefault(change, []).append(sent_item.seq)
    return [
        f"{change} (item{'s' if len(items) > 1 else ''} {_first_three(items)})"
        for change, items in items_by_change.items()
    ]


def _same(sent: float, stored: float) -> bool:
    return abs(sent - stored) <= 1e-6 * max(1.0, abs(sent)) or (sent != sent and stored != stored)


def _first_three(items: Iterable[int]) -> str:
    listed = list(items)
    return ", ".join(map(str, listed[:3])) + (", ..." if len(listed) > 3 else "")


def _blocker(name: str, found: str, should: str, why: str) -> FindingView:
    return FindingView(level=Level.BLOCKER, name=name, found=found, should=should, why=why)


def _view(finding: Finding) -> FindingView:
    return FindingView(**{name: value for name, value in asdict(finding).items() if name in FindingView.model_fields})
