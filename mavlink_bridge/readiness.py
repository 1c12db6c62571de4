"""Wait until a vehicle has reported what the preflight audit judges, and until it can be armed.

An autopilot that has just booted knows nothing yet: ArduCopter takes about 40 s to its first position estimate and
streams nothing unless asked, PX4 rejects arming for its first seconds. Asked too early it looks broken. All waits are
wall seconds, and bounded.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial

from skyfolio.mavlink_bridge.confirming import REQUEST, error_of
from skyfolio.mavlink_bridge.telemetry import FIX_3D, TelemetryState
from skyfolio.mavlink_bridge.vehicle import NotDone, Vehicle

TOLD_WITHIN_S = 10.0
"""The time in which what is only measured (satellites, battery) is reported; streams are sent at 1 Hz."""
ESTIMATED_WITHIN_S = 60.0
"""The time in which an autopilot that has just booted knows its position and its home."""
ARMABLE_WITHIN_S = 60.0
ARM_AGAIN_S = 1.0
ASK_AGAIN_S = 1.0

ARM, _HOME_POSITION = 400, 242
_ESTIMATES = frozenset({"position", "GPS fix", "home position"})

OnWait = Callable[[tuple[str, ...]], None]
"""Called with the facts that are waited for, whenever they change."""
OnRefused = Callable[[str], None]
"""Called with the reason why arming is refused, whenever it changes."""


def missing_facts(state: TelemetryState) -> tuple[str, ...]:
    """Return what it has not reported yet, by the names the audit uses."""
    facts = {
        "GPS fix": state.gps_fix is not None and state.gps_fix >= FIX_3D,
        "position": state.place_deg is not None,
        "home position": state.home_deg is not None,
        "battery": state.battery_told,
    }
    return tuple(name for name, known in facts.items() if not known)


async def wait_for_facts(vehicle: Vehicle, on_wait: OnWait = lambda _missing: None) -> tuple[str, ...]:
    """Wait until it has reported everything the audit judges; return what is missing when the time is over.

    HOME_POSITION is requested meanwhile: ArduPilot sends it on request or when it changes.
    """
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    waited_for: tuple[str, ...] = ()
    while missing := missing_facts(vehicle.state):
        if missing != waited_for:
            waited_for = missing
            on_wait(missing)
        within_s = ESTIMATED_WITHIN_S if _ESTIMATES & set(missing) else TOLD_WITHIN_S
        left_s = began_s + within_s - loop.time()
        if left_s <= 0:
            return missing
        if "home position" in missing:
            await error_of(vehicle.command(REQUEST, _HOME_POSITION))
        await vehicle.wait_until(partial(_has_told_more, vehicle.state, missing), min(ASK_AGAIN_S, left_s))
    return ()


def _has_told_more(state: TelemetryState, missing: tuple[str, ...]) -> bool:
    return missing_facts(state) != missing


async def arm_when_ready(
    vehicle: Vehicle, patience_s: float = ARMABLE_WITHIN_S, on_refused: OnRefused = lambda _why: None
) -> None:
    """Arm it as soon as it can be armed, within `patience_s`. Raises NotDone with its own words for why it cannot.

    No message reports beforehand whether it can: the PREARM bit of SYS_STATUS is set before the checks ran.
    """
    loop = asyncio.get_running_loop()
    began_s, reported = loop.time(), ""
    while True:
        asked_s = loop.time()
        answer = await error_of(vehicle.command(ARM, 1.0))
        if answer is None:
            return
        if answer.endswith("UNSUPPORTED"):
            raise NotDone(answer)
        await asyncio.sleep(ARM_AGAIN_S)
        why = _reason(vehicle, answer, asked_s)
        if why != reported:
            reported = why
            on_refused(why)
        if loop.time() - began_s >= patience_s:
            raise NotDone(f"{why}, tried for {loop.time() - began_s:.0f} s")


def _reason(vehicle: Vehicle, answer: str, since_s: float) -> str:
    """Return the refusal, and what its STATUSTEXTs have said of it since."""
    texts = vehicle.texts.since(since_s)
    reasons = [text for text in texts if text.startswith(_REFUSALS)] or texts
    return answer if not reasons else f"{answer} ({'; '.join(reasons[:3])})"


_REFUSALS = ("Arm", "PreArm", "Preflight")
"""How texts begin that explain it: ArduPilot's `Arm:` and `PreArm:`, PX4's `Arming denied:` and `Preflight Fail:`."""
