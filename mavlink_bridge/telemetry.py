"""What one autopilot reports about itself: MAVLink messages folded into a snapshot. Pure: each carries its time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from skyfolio.mavlink_bridge.autopilots import Autopilot, FlightMode
from skyfolio.mavlink_bridge.boot_clock import has_restarted
from skyfolio.mavlink_bridge.e7 import Place, place_of
from skyfolio.mavlink_bridge.power_log import PowerLog, power_w_of
from skyfolio.mavlink_bridge.profile import UNKNOWN_TOTAL, AutopilotProfile
from skyfolio.mavlink_bridge.speaker import Speaker

MESSAGES = (
    *("HEARTBEAT", "GLOBAL_POSITION_INT", "MISSION_CURRENT", "MISSION_ACK"),
    *("EXTENDED_SYS_STATE", "SYS_STATUS", "GPS_RAW_INT", "HOME_POSITION"),
)
"""Messages the snapshot is made of."""

FIX_3D = 3
"""GPS_FIX_TYPE_3D_FIX: with less a vehicle does not know where it is."""
_ARMED = 128
"""MAV_MODE_FLAG_SAFETY_ARMED."""
_ACCEPTED = 0
"""MAV_MISSION_ACCEPTED, and MAV_MISSION_TYPE_MISSION."""
_UNKNOWN_HEADING = 65535
_UNKNOWN_SATELLITES = 255


class LandedState(StrEnum):
    """MAV_LANDED_STATE of EXTENDED_SYS_STATE (245)."""

    UNDEFINED = "undefined"
    ON_GROUND = "on_ground"
    IN_AIR = "in_air"
    TAKEOFF = "takeoff"
    LANDING = "landing"


_LANDED = tuple(LandedState)


@dataclass(frozen=True, kw_only=True, slots=True)
class Telemetry:
    """One autopilot as last heard.

    Position: WGS-84 degrees (None while it does not know where it is: `place_of`), metres above the vehicle's own home,
    altitude_amsl_m above mean sea level; velocity m/s over ground. `mission_current` is the seq being flown,
    `mission_total` the number of items (ArduPilot's home is one), `mission_id` the checksum of the mission on board (0:
    unknown). `boot_ms`: milliseconds since the autopilot started. `heard_at_s`: fleet seconds of the position.
    """

    system_id: int
    lat_deg: float | None
    lon_deg: float | None
    relative_alt_m: float
    altitude_amsl_m: float
    velocity_north_mps: float
    velocity_east_mps: float
    armed: bool
    mode: FlightMode
    landed_state: LandedState
    mission_current: int | None
    mission_total: int | None
    mission_id: int
    boot_ms: int
    heard_at_s: float
    heading_deg: float | None = None
    """Heading of the nose, degrees clockwise from north; None if it is not reported."""
    battery: float | None = None
    """Share of charge, 0..1; None if it is not measured."""
    power_w: float | None = None
    """Electrical power drawn, W; None if it is not measured."""
    used_wh: float | None = None
    """Energy drawn since it was armed, Wh; None if it is not measured."""

    @property
    def place_deg(self) -> Place | None:
        """Return latitude and longitude, None while it does not know them."""
        return None if self.lat_deg is None or self.lon_deg is None else (self.lat_deg, self.lon_deg)


class TelemetryState:
    """Latest values of one autopilot. Feed only messages of its own system id and component 1."""

    def __init__(self, system_id: int) -> None:
        self.system_id = system_id
        self.mav_type: int | None = None
        """MAV_TYPE of its HEARTBEAT: 2 is a quadrotor."""
        self.mode = FlightMode.OTHER
        self.heartbeats = 0
        """The number of HEARTBEAT messages so far.

        A mode is only as fresh as the last one, and they are sent at 1 Hz.
        """
        self.armed = False
        self.landed_state = LandedState.UNDEFINED
        self.boot_ms: int | None = None
        self.mission_current: int | None = None
        self.mission_total: int | None = None
        self.mission_id = 0
        self.mission_reports = 0
        """The number of MISSION_CURRENT messages so far: distinguishes a fresh one from an old one."""
        self.accepted_id: int | None = None
        """opaque_id of the latest accepting MISSION_ACK, None if it had none."""
        self.battery: float | None = None
        """Share of charge, 0..1; None if it is not measured."""
        self.battery_told = False
        """Whether it has sent a SYS_STATUS, which reports whether the battery is measured."""
        self.power = PowerLog()
        """What it draws from its battery."""
        self.gps_fix: int | None = None
        """GPS_FIX_TYPE; 3 is a 3D fix."""
        self.satellites: int | None = None
        self.home_deg: tuple[float, float] | None = None
        """Latitude and longitude of the home it has reported; None for a home that is not set."""
        self.home_amsl_m: float | None = None
        """Metres above mean sea level of that home."""
        self.restarts = 0
        """How often what it had reported was forgotten, because it was switched off or has restarted."""
        self._position: Mapping[str, Any] | None = None
        self._position_at_s = self._battery_at_s = self._gps_at_s = self._home_at_s = 0.0
        self._stands_where_it_was = True
        """Whether it has not been switched off since its position was reported."""
        self._speaker = Speaker()
        self._heard = False
        self._snapshot: Telemetry | None = None
        self._folds: dict[str, Callable[[Mapping[str, Any], float], None]] = {
            "HEARTBEAT": self._heartbeat,
            "GLOBAL_POSITION_INT": self._global_position,
            "MISSION_CURRENT": self._mission_current,
            "MISSION_ACK": self._mission_ack,
            "EXTENDED_SYS_STATE": self._extended,
            "SYS_STATUS": self._sys_status,
            "GPS_RAW_INT": self._gps,
            "HOME_POSITION": self._home,
        }

    @property
    def autopilot(self) -> Autopilot | None:
        """Return which autopilot it is; None until it was heard, and for one without a profile."""
        return self._speaker.autopilot

    @property
    def profile(self) -> AutopilotProfile | None:
        """Return the profile of its autopilot; None until it was heard, and for one that has none."""
        return self._speaker.profile

    @property
    def mav_autopilot(self) -> int | None:
        """Return MAV_AUTOPILOT of its latest HEARTBEAT; None until it was heard."""
        return self._speaker.mav_autopilot

    @property
    def is_ours(self) -> bool:
        """Return whether the service may command it: in any other mode a human or a failsafe flies it."""
        return self.profile is not None and self.mode in self.profile.our_modes

    @property
    def heard(self) -> bool:
        """Return whether a HEARTBEAT of the autopilot itself was received."""
        return self._heard

    def fold(self, name: str, fields: Mapping[str, Any], heard_s: float) -> None:
        """Take in one message; fields as named in the MAVLink definition, `heard_s` in fleet seconds."""
        self._folds[name](fields, heard_s)
        self._snapshot = None

    def forget_before(self, since_s: float) -> None:
        """Forget what it reported before this fleet second, when it was not switched on yet, or may not have been.

        Somebody may have carried it elsewhere, and have given it another battery. A height is kept: it is on the
        ground.
        """
        self.restarts += 1
        self._snapshot = None
        if self._home_at_s < since_s:
            self.home_deg = self.home_amsl_m = None
        if self._battery_at_s < since_s:
            self.battery, self.battery_told = None, False
        if self._gps_at_s < since_s:
            self.gps_fix = self.satellites = None
        if self._position_at_s < since_s:
            self._stands_where_it_was = False

    def snapshot(self) -> Telemetry | None:
        """Return everything at once, the same object until a message comes.

        None until a heartbeat and a position were received.
        """
        if self._snapshot is None and self._position is not None and self._heard:
            self._snapshot = self._taken(self._position)
        return self._snapshot

    def _taken(self, position: Mapping[str, Any]) -> Telemetry:
        lat_deg, lon_deg = self.place_deg or (None, None)
        return Telemetry(
            system_id=self.system_id,
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            relative_alt_m=position["relative_alt"] / 1000,
            altitude_amsl_m=position["alt"] / 1000,
            velocity_north_mps=position["vx"] / 100,
            velocity_east_mps=position["vy"] / 100,
            armed=self.armed,
            mode=self.mode,
            landed_state=self.landed_state,
            mission_current=self.mission_current,
            mission_total=self.mission_total,
            mission_id=self.mission_id,
            boot_ms=position["time_boot_ms"],
            heard_at_s=self._position_at_s,
            heading_deg=_heading_deg(position),
            battery=self.battery,
            power_w=self.power.power_w,
            used_wh=self.power.used_wh,
        )

    @property
    def place_deg(self) -> Place | None:
        """Return its position; None before it was reported in this start, and while its receiver has no 3D fix."""
        if self._position is None or not self._stands_where_it_was:
            return None
        if self.gps_fix is not None and self.gps_fix < FIX_3D:
            return None
        return place_of(self._position["lat"], self._position["lon"])

    def _heartbeat(self, fields: Mapping[str, Any], heard_s: float) -> None:
        if not self._speaker.believes(fields, heard_s):
            return
        self._heard = True
        self.heartbeats += 1
        self.mav_type = int(fields["type"])
        self.mode = self._speaker.mode_of(int(fields["custom_mode"]))
        armed, before = bool(int(fields["base_mode"]) & _ARMED), self.armed
        self.armed = armed
        if armed and not before:
            self.power.arm()

    def _global_position(self, fields: Mapping[str, Any], heard_s: float) -> None:
        boot_ms, before_ms, after_s = int(fields["time_boot_ms"]), self.boot_ms, heard_s - self._position_at_s
        self._position, self._position_at_s, self.boot_ms = fields, heard_s, boot_ms
        self._stands_where_it_was = True
        if before_ms is not None and has_restarted(before_ms, boot_ms, after_s):
            self.forget_before(heard_s - boot_ms / 1000)

    def _mission_current(self, fields: Mapping[str, Any], heard_s: float) -> None:
        del heard_s
        self.mission_current = int(fields["seq"])
        self.mission_total = self._speaker.items_on_board(int(fields.get("total", UNKNOWN_TOTAL)))
        self.mission_id = int(fields.get("mission_id", 0))
        self.mission_reports += 1

    def _mission_ack(self, fields: Mapping[str, Any], heard_s: float) -> None:
        del heard_s
        if int(fields["type"]) == _ACCEPTED and int(fields.get("mission_type", 0)) == _ACCEPTED:
            self.accepted_id = int(fields.get("opaque_id", 0)) or None

    def _extended(self, fields: Mapping[str, Any], heard_s: float) -> None:
        del heard_s
        state = int(fields["landed_state"])
        self.landed_state = _LANDED[state] if state < len(_LANDED) else LandedState.UNDEFINED

    def _sys_status(self, fields: Mapping[str, Any], heard_s: float) -> None:
        remaining = int(fields["battery_remaining"])
        self.battery, self.battery_told = None if remaining < 0 else remaining / 100, True
        self._battery_at_s = heard_s
        self.power.add(power_w_of(fields), heard_s, armed=self.armed)
        if self._position is not None and self.landed_state is LandedState.IN_AIR:
            self.power.sample(self._position, self._position_at_s, heard_s)

    def _gps(self, fields: Mapping[str, Any], heard_s: float) -> None:
        self._gps_at_s = heard_s
        satellites = int(fields["satellites_visible"])
        self.gps_fix, self.satellites = (
            int(fields["fix_type"]),
            None if satellites == _UNKNOWN_SATELLITES else satellites,
        )

    def _home(self, fields: Mapping[str, Any], heard_s: float) -> None:
        self._home_at_s = heard_s
        self.home_deg = place_of(fields["latitude"], fields["longitude"])
        altitude_mm = fields.get("altitude")
        self.home_amsl_m = None if self.home_deg is None or altitude_mm is None else int(altitude_mm) / 1000


def _heading_deg(position: Mapping[str, Any]) -> float | None:
    """Return GLOBAL_POSITION_INT.hdg (hundredths of a degree) in degrees; None for 65535, unknown."""
    hundredths = int(position.get("hdg", _UNKNOWN_HEADING))
    return None if hundredths == _UNKNOWN_HEADING else hundredths / 100
