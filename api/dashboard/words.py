"""Events in an operator's words. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from api.dashboard.views import Happening

Data = Mapping[str, Any]
WORTH_TELLING_S, WORTH_TELLING_M = 2.0, 2.0
"""A UAV is late at the end of nearly every slot by a little; less than this is not told. Nor is a way of less than
this, however long it takes at the pace of a leg of a few metres."""
SKIP = {"operation_id", "plan_id"}


def words(happening: Happening) -> tuple[str, str]:
    """(what happened, level): the level is ok, warn, alarm or empty. No words: not worth an operator's look."""
    known = WORDS.get(happening.kind)
    if known is not None:
        return known(happening.data)
    rest = ", ".join(
        f"{name} {value}" for name, value in happening.data.items() if name not in SKIP and value is not None
    )
    return f"{happening.kind.replace('_', ' ')} {rest}".strip(), ""


def _operation(data: Data) -> tuple[str, str]:
    state, error = str(data.get("state")), data.get("error")
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
    if cause != "heartbeat_lost":
        return f"{data.get('uav_id')} declared LOST: {cause.replace('_', ' ')} ({data.get('detail')})", "alarm"
    return f"{data.get('uav_id')} declared LOST after {data.get('silent_for_s', 0):.1f} s of silence", "alarm"


def _geofence(data: Data) -> tuple[str, str]:
    if data.get("error"):
        return f"{data.get('uav_id')} flies without a geofence: {data.get('error')}", "warn"
    return f"{data.get('uav_id')} has the plan's area as its geofence", "ok"


def _rally_point(data: Data) -> tuple[str, str]:
    if data.get("error"):
        return f"{data.get('uav_id')} flies without a rally point: {data.get('error')}", "warn"
    return f"{data.get('uav_id')} has where it stands as its rally point", "ok"


def _low(data: Data) -> tuple[str, str]:
    return f"{data.get('uav_id')} is low on battery ({data.get('detail')}): it may be sent home", "warn"


def _gcs_heartbeat(data: Data) -> tuple[str, str]:
    if data.get("sent"):
        return "vehicles hear the service again", "ok"
    return f"vehicles hear the service no more: {data.get('because')}", "alarm"


def _condition(data: Data) -> tuple[str, str]:
    after = str(data.get("after"))
    level = {"live": "ok", "low_battery": "warn", "landed": "", "rebooted": "warn", "stale": "warn"}.get(after, "alarm")
    return f"{data.get('uav_id')} {after.replace('_', ' ')}: {data.get('cause')}", level


def _recovery(data: Data) -> tuple[str, str]:
    if data.get("outcome") == "flying":
        solved = data.get("replan_ms") or 0.0
        return f"survivors fly {data.get('plan_id')} (replanned in {solved:.0f} ms)", "ok"
    return f"answer to the loss: {str(data.get('outcome')).replace('_', ' ')}: {data.get('error')}", "alarm"


def _plan_ended(data: Data) -> tuple[str, str]:
    error = data.get("error")
    return f"{data.get('plan_id')} {data.get('status')}" + (f": {error}" if error else ""), "warn" if error else ""


def _uploaded(data: Data) -> tuple[str, str]:
    return f"{data.get('uavs')} missions uploaded and verified in {data.get('upload_s', 0):.2f} s", "ok"


def _incident(data: Data) -> tuple[str, str]:
    step, uav = str(data.get("step")), data.get("uav_id")
    text = f"answer {data.get('incident')}: {step}" + (f" {uav}" if uav else "")
    return text, "warn" if step in {"refused", "proposed"} else ""


def _drill(data: Data) -> tuple[str, str]:
    return f"drill: {data.get('fault')} of {data.get('uav_id')} {data.get('state')}", "warn"


def _returned(data: Data) -> tuple[str, str]:
    return f"{data.get('uav_id')} is heard again, and offered", "ok"


def _resumed(data: Data) -> tuple[str, str]:
    if data.get("error"):
        return f"{data.get('uav_id')} flies on unguided: {data.get('error')}", "warn"
    return f"{data.get('uav_id')} is kept on schedule again", "ok"


def _guard(data: Data) -> tuple[str, str]:
    return f"nobody guards the stream: UAVs would hold if the service died ({data.get('error')})", "warn"


def _lands(data: Data) -> tuple[str, str]:
    return f"UAVs land where they are, ways home would meet: {data.get('because')}", "warn"


def _registered(data: Data) -> tuple[str, str]:
    simulated = ", simulated" if data.get("simulated") else ""
    return f"{data.get('uav_id')} is system {data.get('system_id')}{simulated}", ""


def _slip(data: Data) -> tuple[str, str]:
    late, far = float(data.get("late_s") or 0.0), float(data.get("distance_m") or 0.0)
    if abs(late) < WORTH_TELLING_S or far < WORTH_TELLING_M:
        return "", ""
    way = "behind" if late > 0 else "ahead of"
    return f"{data.get('uav_id')} is {abs(late):.1f} s {way} schedule, {far:.1f} m off", "warn"


def _preflight(data: Data) -> tuple[str, str]:
    text = f"{data.get('uav_id')} preflight: {data.get('name')} is {data.get('found')}, should be {data.get('should')}"
    return f"{text}: {data.get('why')}", "alarm" if data.get("level") == "blocker" else "warn"


def _waits(data: Data) -> tuple[str, str]:
    return f"{data.get('uav_id')} has not told its {', '.join(data.get('missing') or ())} yet: waiting", "warn"


def _arming_refused(data: Data) -> tuple[str, str]:
    return f"{data.get('uav_id')} cannot be armed yet: {data.get('because')}", "warn"


WORDS: Mapping[str, Callable[[Data], tuple[str, str]]] = {
    "operation": _operation,
    "link": _link,
    "uav_lost": _lost,
    "condition": _condition,
    "geofence": _geofence,
    "rally_point": _rally_point,
    "uav_low_on_battery": _low,
    "gcs_heartbeat": _gcs_heartbeat,
    "recovery": _recovery,
    "plan_ended": _plan_ended,
    "missions_uploaded": _uploaded,
    "incident": _incident,
    "drill": _drill,
    "slip": _slip,
    "preflight": _preflight,
    "waiting_for_facts": _waits,
    "arming_refused": _arming_refused,
    "uav_returned": _returned,
    "guidance_resumed": _resumed,
    "guard": _guard,
    "lands_instead_of_returning": _lands,
    "vehicle_registered": _registered,
}
