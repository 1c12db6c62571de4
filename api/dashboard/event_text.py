"""Describes events to the operator. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from skyfolio.api.dashboard.changes import disruption_words
from skyfolio.api.dashboard.radio_text import RADIO_DESCRIPTIONS
from skyfolio.api.dashboard.views import ServiceEvent

Data = Mapping[str, Any]
SKIP = {"operation_id", "plan_id"}


def describe(event: ServiceEvent) -> tuple[str, str]:
    """Return (text, level). The level is ok, warn, alarm or empty; an empty text means that the event is not shown."""
    known = DESCRIPTIONS.get(event.kind)
    if known is not None:
        return known(event.data)
    rest = ", ".join(f"{name} {value}" for name, value in event.data.items() if name not in SKIP and value is not None)
    return f"{event.kind.replace('_', ' ')} {rest}".strip(), ""


def _operation(data: Data) -> tuple[str, str]:
    state, error = str(data.get("state")), data.get("error")
    if state == "link_lost":
        return "no vehicle is heard: our own link is lost, and the vehicles fly on with the missions on board", "alarm"
    ends = ", ".join(f"{uav} {str(end).replace('_', ' ')}" for uav, end in (data.get("ends") or {}).items())
    text = f"operation {state.replace('_', ' ')}" + (f": {error}" if error else f": {ends}" if ends else "")
    levels = {"failed": "alarm", "aborted": "warn", "completed_partly": "alarm", "completed": "ok"}
    return text, levels.get(state, "")


def _link(data: Data) -> tuple[str, str]:
    after = str(data.get("after"))
    text = f"{data.get('uav_id')} link {data.get('before')} → {after}"
    if after != "live":
        text += f", silent for {data.get('silent_for_s', 0):.1f} s"
    return text, {"lost": "alarm", "stale": "warn", "live": "ok"}.get(after, "")


def _lost(data: Data) -> tuple[str, str]:
    cause = data.get("cause", "heartbeat_lost")
    if cause == "ordered":
        return f"{data.get('uav_id')} left its operation: {data.get('detail')}", "warn"
    if cause != "heartbeat_lost":
        return f"{data.get('uav_id')} declared LOST: {cause.replace('_', ' ')} ({data.get('detail')})", "alarm"
    return f"{data.get('uav_id')} declared LOST after {data.get('silent_for_s', 0):.1f} s of silence", "alarm"


def _geofence(data: Data) -> tuple[str, str]:
    if data.get("error"):
        return f"{data.get('uav_id')} flies without a geofence: {data.get('error')}", "warn"
    return f"{data.get('uav_id')} has accepted the plan's area as its geofence", "ok"


def _rally_point(data: Data) -> tuple[str, str]:
    if data.get("error"):
        return f"{data.get('uav_id')} flies without a rally point: {data.get('error')}", "warn"
    return f"{data.get('uav_id')} has accepted its present position as its rally point", "ok"


def _telemetry_log(data: Data) -> tuple[str, str]:
    return f"the telemetry log cannot be written: {data.get('error')}", "warn"


def _order(data: Data) -> tuple[str, str]:
    results = data.get("vehicles") or []
    obedient = [str(result.get("uav_id")) for result in results if result.get("outcome") == "ok"]
    others = [f"{result.get('uav_id')}: {result.get('reason')}" for result in results if result.get("outcome") != "ok"]
    text = f"ordered to {data.get('action')}: {', '.join(obedient) or 'no vehicle'}"
    failed = any(result.get("outcome") == "failed" for result in results)
    return text + (f" (not {'; '.join(others)})" if others else ""), "alarm" if failed else "warn"


def _low(data: Data) -> tuple[str, str]:
    return f"{data.get('uav_id')} is low on battery ({data.get('detail')}): you can send it home", "warn"


def _warning(data: Data) -> tuple[str, str]:
    return f"{data.get('uav_id')} reports a failsafe and flies on: {data.get('detail')}", "warn"


def _withdrawn(data: Data) -> tuple[str, str]:
    verdict = str(data.get("verdict")).replace("_", " ")
    return f"{data.get('uav_id')} was not {verdict}: {data.get('because')}; its air is reserved again", "alarm"


def _gcs_heartbeat(data: Data) -> tuple[str, str]:
    if data.get("sent"):
        return "the service sends its HEARTBEAT again", "ok"
    return f"the service no longer sends its HEARTBEAT: {data.get('because')}", "alarm"


def _solver_moved(data: Data) -> tuple[str, str]:
    because = data.get("because")
    return f"solves go to {data.get('to')}" + (f": {because}" if because else ""), "warn" if because else "ok"


def _condition(data: Data) -> tuple[str, str]:
    after = str(data.get("after"))
    level = {"live": "ok", "low_battery": "warn", "landed": "", "rebooted": "warn", "stale": "warn"}.get(after, "alarm")
    return f"{data.get('uav_id')} {after.replace('_', ' ')}: {data.get('cause')}", level


def _recovery(data: Data) -> tuple[str, str]:
    if data.get("outcome") == "flying":
        solved = data.get("replan_ms") or 0.0
        changed = disruption_words(data.get("disruption"))
        what = f"survivors fly {data.get('plan_id')} (replanned in {solved:.0f} ms)"
        return f"{what}: {changed}" if changed else what, "ok"
    return f"recovery: {str(data.get('outcome')).replace('_', ' ')}: {data.get('error')}", "alarm"


def _plan_ended(data: Data) -> tuple[str, str]:
    error = data.get("error")
    return f"{data.get('plan_id')} {data.get('status')}" + (f": {error}" if error else ""), "warn" if error else ""


def _uploaded(data: Data) -> tuple[str, str]:
    return f"{data.get('uavs')} missions uploaded and verified in {data.get('upload_s', 0):.2f} s", "ok"


def _incident(data: Data) -> tuple[str, str]:
    step, uav = str(data.get("step")), data.get("uav_id")
    text = f"recovery of incident {data.get('incident')}: {step}" + (f" {uav}" if uav else "")
    return text, "warn" if step in {"refused", "proposed"} else ""


def _drill(data: Data) -> tuple[str, str]:
    return f"drill: {data.get('fault')} of {data.get('uav_id')} {data.get('state')}", "warn"


def _returned(data: Data) -> tuple[str, str]:
    return f"{data.get('uav_id')} is heard again and can be readmitted", "ok"


def _resumed(data: Data) -> tuple[str, str]:
    if data.get("error"):
        return f"{data.get('uav_id')} flies on unguided: {data.get('error')}", "warn"
    return f"{data.get('uav_id')} is kept on schedule again", "ok"


def _guard(data: Data) -> tuple[str, str]:
    return f"the stream has no guard: UAVs would hold if the service died ({data.get('error')})", "warn"


def _lands(data: Data) -> tuple[str, str]:
    return f"UAVs land where they are, because their ways home would meet: {data.get('because')}", "warn"


def _registered(data: Data) -> tuple[str, str]:
    simulated = ", simulated" if data.get("simulated") else ""
    return f"{data.get('uav_id')} is system {data.get('system_id')}{simulated}", ""


def _slip(data: Data) -> tuple[str, str]:
    if not data.get("off_schedule"):
        return "", ""
    off = f"{data.get('uav_id')} is {float(data.get('distance_m') or 0.0):.1f} m off its plan"
    late_s = data.get("late_s")
    if late_s is None:
        return f"{off}, where it should hover", "warn"
    return f"{off}, {abs(late_s):.1f} s {'behind' if late_s > 0 else 'ahead of'} schedule", "warn"


def _preflight(data: Data) -> tuple[str, str]:
    text = f"{data.get('uav_id')} preflight: {data.get('name')} is {data.get('found')}, should be {data.get('should')}"
    return f"{text}: {data.get('why')}", "alarm" if data.get("level") == "blocker" else "warn"


def _moved(data: Data) -> tuple[str, str]:
    signed = "" if data.get("signed") else "; its frames are not signed, so check that it is the same aircraft"
    return f"{data.get('uav_id')} is now heard from {data.get('now')} instead of {data.get('before')}{signed}", "warn"


def _two_senders(data: Data) -> tuple[str, str]:
    uav, known, other = data.get("uav_id"), data.get("before"), data.get("now")
    return f"two senders use the system id of {uav}: {known}, and {other}, which is ignored", "alarm"


def _second_link(data: Data) -> tuple[str, str]:
    signed = "" if data.get("signed") else "; it is not signed, and may be another aircraft with the same system id"
    return f"{data.get('uav_id')} is heard on a second link, {data.get('now')}{signed}", "warn" if signed else ""


def _station(data: Data) -> tuple[str, str]:
    if data.get("is_dark"):
        return f"{data.get('station')} is dark: no UAV mans it", "alarm"
    return f"{data.get('station')} is manned again", "ok"


def _not_called_home(data: Data) -> tuple[str, str]:
    return f"{data.get('uav_id')} has to come home, and does not: {data.get('error')}", "alarm"


def _brought_down(data: Data) -> tuple[str, str]:
    if data.get("error"):
        return f"{data.get('uav_id')} still hovers and cannot be brought down: {data.get('error')}", "alarm"
    doing = "returns" if data.get("action") == "return" else "lands"
    return f"{data.get('uav_id')} {doing}: {data.get('because')}", "warn"


def _speed_restored(data: Data) -> tuple[str, str]:
    text = f"{data.get('uav_id')} left the commanded mode (for {data.get('mode')}) at a commanded speed"
    if data.get("error"):
        return f"{text}, and its cruise speed could not be restored: {data.get('error')}", "alarm"
    return f"{text}: its cruise speed of {data.get('speed_mps'):g} m/s is restored", "warn"


def _stuck(data: Data) -> tuple[str, str]:
    where = f"stayed {data.get('distance_m')} m from item {data.get('item')} for {data.get('for_s')} s"
    return f"{data.get('uav_id')} {where}: sent on to item {data.get('next_item')}", "warn"


def _altitude(data: Data) -> tuple[str, str]:
    if data.get("level") == "ok":
        return f"{data.get('uav_id')} is at its planned altitude again", "ok"
    off_m = float(data.get("off_m") or 0.0)
    return (
        f"{data.get('uav_id')} is {abs(off_m):.1f} m {'above' if off_m > 0 else 'below'} its planned altitude",
        "warn",
    )


def _home_moved(data: Data) -> tuple[str, str]:
    where = f"{data.get('moved_m')} m away and {data.get('up_m')} m up"
    return f"{data.get('uav_id')} has a new home, {where}: its altitudes now count from there", "warn"


def _waits(data: Data) -> tuple[str, str]:
    return f"{data.get('uav_id')} has not reported its {', '.join(data.get('missing') or ())} yet: waiting", "warn"


def _arming_refused(data: Data) -> tuple[str, str]:
    return f"{data.get('uav_id')} cannot be armed yet: {data.get('because')}", "warn"


def _stream_ended(data: Data) -> tuple[str, str]:
    return f"setpoints end: {data.get('because')}", "warn"


def _taken_over(data: Data) -> tuple[str, str]:
    return f"service {data.get('service')} has taken the operation over, and asks its vehicles what they fly", "warn"


def _left(data: Data) -> tuple[str, str]:
    return f"service {data.get('service')} has left the operation: {data.get('because')}", "alarm"


DESCRIPTIONS: Mapping[str, Callable[[Data], tuple[str, str]]] = {
    "operation": _operation,
    "link": _link,
    "uav_lost": _lost,
    "condition": _condition,
    "geofence": _geofence,
    "rally_point": _rally_point,
    "telemetry_log": _telemetry_log,
    "link_moved": _moved,
    "two_senders": _two_senders,
    "second_link": _second_link,
    "fleet_order": _order,
    "uav_low_on_battery": _low,
    "uav_warning": _warning,
    "verdict_withdrawn": _withdrawn,
    "gcs_heartbeat": _gcs_heartbeat,
    "solver_moved": _solver_moved,
    "recovery": _recovery,
    "plan_ended": _plan_ended,
    "missions_uploaded": _uploaded,
    "incident": _incident,
    "drill": _drill,
    "slip": _slip,
    "stuck": _stuck,
    "speed_restored": _speed_restored,
    "altitude_off_plan": _altitude,
    "home_moved": _home_moved,
    "preflight": _preflight,
    "waiting_for_facts": _waits,
    "arming_refused": _arming_refused,
    "uav_returned": _returned,
    "guidance_resumed": _resumed,
    "guard": _guard,
    "lands_instead_of_returning": _lands,
    "brought_down": _brought_down,
    "station": _station,
    "not_called_home": _not_called_home,
    "vehicle_registered": _registered,
    "stream_ended": _stream_ended,
    "operation_taken_over": _taken_over,
    "operation_left": _left,
    **RADIO_DESCRIPTIONS,
}
