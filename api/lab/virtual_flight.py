"""Flights of one UAV in virtual time, by every kind of guidance, and its distance from the plan at slot ends.

The vehicle is the simulator's, the guidance the bridge's own: missions, keeper and stream, fed with what the vehicle
reports (GLOBAL_POSITION_INT at 5 Hz, MISSION_CURRENT), with the delay of a link in between.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import hypot
from typing import Any, Literal

from skyfolio import sim
from skyfolio.api.lab.virtual_wire import fields_of, incoming
from skyfolio.mavlink_bridge import (
    Autopilot,
    Mission,
    OnEnd,
    VehicleModel,
    compile_mission,
    east_north_to_geodetic,
    geodetic_to_east_north,
    model_from_parameters,
)
from skyfolio.mavlink_bridge.altitudes import altitudes_of
from skyfolio.mavlink_bridge.autopilots import FlightMode
from skyfolio.mavlink_bridge.keeper import Keeper, Order
from skyfolio.mavlink_bridge.mission_messages import Message
from skyfolio.mavlink_bridge.mission_protocol import Upload
from skyfolio.mavlink_bridge.profiles import profile_of
from skyfolio.mavlink_bridge.reach import head_start_s
from skyfolio.mavlink_bridge.stream import RATE_HZ, Streamer
from skyfolio.planner import Plan
from skyfolio.planner.geometry import Point

Guidance = Literal["naive", "mission", "keeper", "stream"]
STEP_S = 0.05
REPORT_S = 0.2
LATENCY_S = 0.1
CLIMB_LIMIT_S = 240.0
NAIVE = VehicleModel(acceleration_mps2=1e6, braking_mps2=1e6, max_speed_mps=30.0)
"""A vehicle that changes its speed at once: what a compiler assumes that divides way by time."""


@dataclass(frozen=True, kw_only=True)
class Flown:
    """Metres from the plan's point at the beginning of slots 1, 2, ..., and commands sent on the way."""

    distances_m: list[float]
    orders: int


class VirtualFlight:
    """One UAV of a plan at its altitude over its slot-0 point, ready to be guided; `parameters` are set first.

    weather: around it, with gusts drawn from `seed`.
    """

    def __init__(
        self,
        plan: Plan,
        uav_id: str,
        autopilot: Autopilot,
        parameters: dict[str, float] | None = None,
        *,
        weather: sim.Weather | None = None,
        seed: int = 0,
    ) -> None:
        self.plan, self.uav_id, self.autopilot = plan, uav_id, autopilot
        self.profile = profile_of(autopilot)
        self.path_m: list[Point] = list(plan.trajectories_m[uav_id])
        self.origin = plan.scenario.origin
        self.clock = sim.VirtualClock()
        place = east_north_to_geodetic(self.origin, *self.path_m[0])
        spec = sim.VehicleSpec(1, *place, autopilot=autopilot.value)
        self.fleet = sim.Fleet([spec], clock=self.clock, protocol_clock=self.clock.now, weather=weather, seed=seed)
        self.vehicle = self.fleet.vehicles[1]
        self.after_step: Callable[[], None] = lambda: None
        """Called after each step of the fleet."""
        self._pending: list[tuple[float, Message]] = []
        self._seen: tuple[float, Point, Point, int] | None = None
        for name, value in (parameters or {}).items():
            self.vehicle.autopilot.parameters[name] = value
        self._launch()

    def model(self) -> VehicleModel:
        """Return the model with the vehicle's own parameters."""
        known = self.vehicle.autopilot.parameters
        values = {}
        for name in self.profile.model_parameters:
            try:
                values[name] = float(known[name])
            except KeyError:
                continue
        return model_from_parameters(self.autopilot, values)

    def fly(self, guidance: Guidance) -> Flown:
        """Fly the whole plan."""
        return self._stream() if guidance == "stream" else self._mission(guidance)

    def _mission(self, guidance: Guidance) -> Flown:
        model = NAIVE if guidance == "naive" else self.model()
        mission = compile_mission(self.plan, self.uav_id, on_end=OnEnd.HOLD, autopilot=self.autopilot, model=model)
        self._upload(mission)
        self._tell(set_current(mission.start_item))
        self._mode(FlightMode.MISSION)
        keeper = Keeper(self.path_m, self.plan.scenario.slot_duration_s, mission, model)
        began_s, orders, distances = self.clock.now(), 0, []
        if guidance == "keeper":
            began_s += head_start_s(self.path_m, 0, self.plan.scenario.slot_duration_s, model)
        next_slot = 1
        while next_slot < len(self.path_m):
            self._step()
            elapsed_s = self.clock.now() - began_s
            if elapsed_s + 1e-9 >= next_slot * self.plan.scenario.slot_duration_s:
                distances.append(self._distance_to(self.path_m[next_slot]))
                next_slot += 1
            if guidance == "keeper" and self._seen is not None and elapsed_s >= 0:
                _, point, velocity, current = self._seen
                order = keeper.advise(elapsed_s, point, velocity, current)
                if order is not None:
                    orders += 1
                    self._later(order_message(order))
        return Flown(distances_m=distances, orders=orders)

    def _stream(self) -> Flown:
        scenario = self.plan.scenario
        streamer = Streamer(
            1,
            self.path_m,
            scenario.slot_duration_s,
            altitudes_of(self.plan, self.uav_id),
            lambda point: east_north_to_geodetic(self.origin, *point),
        )
        every = round(1 / RATE_HZ / STEP_S)
        for _ in range(round(1.5 / STEP_S)):  # PX4 wants to hear it before it changes the mode
            self._tell(streamer.setpoint(-1.0))
            self._step()
        self._mode(self.profile.stream_mode)
        began_s = self.clock.now()
        distances: list[float] = []
        steps = 0
        while len(distances) < len(self.path_m) - 1:
            if steps % every == 0:
                self._later(streamer.setpoint(self.clock.now() - began_s))
            steps += 1
            self._step()
            if self.clock.now() - began_s + 1e-9 >= (len(distances) + 1) * scenario.slot_duration_s:
                distances.append(self._distance_to(self.path_m[len(distances) + 1]))
        return Flown(distances_m=distances, orders=steps // every)

    def _launch(self) -> None:
        up_m = self.plan.scenario.altitude_m
        takeoff = self.profile.takeoff
        if takeoff.armed_in is not None:
            self._mode(takeoff.armed_in)
        self._tell(command(400, 1))
        self._tell(command(22, *takeoff.params(up_m, self.vehicle.autopilot.spec.home_alt_m)))
        while self.vehicle.position[2] < up_m - 0.5:
            self._step()
            if self.clock.now() > CLIMB_LIMIT_S:
                raise RuntimeError(f"{self.autopilot}: at {self.vehicle.position[2]:.1f} m after {CLIMB_LIMIT_S:g} s")
        for _ in range(round(5 / STEP_S)):
            self._step()

    def _upload(self, mission: Mission) -> None:
        transfer = Upload(mission.items, 1)
        messages = transfer.start(0.0)
        while not transfer.ended:
            answers = [answer for message in messages for answer in self._tell(message)]
            messages = [
                message for answer in answers for message in transfer.handle(answer.get_type(), fields_of(answer), 0.0)
            ]
            if not messages and not transfer.ended:
                raise RuntimeError(f"{self.autopilot}: the upload got stuck")

    def _mode(self, mode: FlightMode) -> None:
        self._tell(command(176, 1, *self.profile.numbers_of(mode)))

    def _tell(self, message: Message) -> list[Any]:
        answers: list[Any] = self.vehicle.autopilot.handle(incoming(message))
        return answers

    def _later(self, message: Message) -> None:
        self._pending.append((self.clock.now() + LATENCY_S, message))

    def _step(self) -> None:
        now = self.clock.now()
        due = [message for at_s, message in self._pending if at_s <= now + 1e-9]
        self._pending = [entry for entry in self._pending if entry[0] > now + 1e-9]
        for message in due:
            self._tell(message)
        self.fleet.step_to(self.clock.advance(STEP_S))
        self.after_step()
        if self._seen is None or self.clock.now() - self._seen[0] >= REPORT_S - 1e-9:
            body = self.vehicle.autopilot.body
            self._seen = (
                self.clock.now(),
                self._point(),
                (body.east_mps, body.north_mps),
                self.vehicle.autopilot.runner.index,
            )

    def _point(self) -> Point:
        lat_deg, lon_deg, _ = self.vehicle.position
        return geodetic_to_east_north(self.origin, lat_deg, lon_deg)

    def _distance_to(self, planned: Point) -> float:
        east, north = self._point()
        return hypot(east - planned[0], north - planned[1])


def command(number: int, *params: float | None) -> Message:
    """Return a COMMAND_LONG to vehicle 1; a parameter that is None is sent as NaN."""
    values = [*(float("nan") if value is None else value for value in params), *[0.0] * (7 - len(params))]
    fields = {f"param{n}": float(value) for n, value in enumerate(values, start=1)}
    return Message(
        "COMMAND_LONG", {"target_system": 1, "target_component": 1, "command": number, "confirmation": 0, **fields}
    )


def set_current(item: int) -> Message:
    """Return the message that makes an item current; every autopilot knows it, unlike the command (224)."""
    return Message("MISSION_SET_CURRENT", {"target_system": 1, "target_component": 1, "seq": item})


def order_message(order: Order) -> Message:
    """Return an order of the keeper as it is sent."""
    if order.item is not None:
        return set_current(order.item)
    assert order.speed_mps is not None  # noqa: S101
    return command(178, 1, order.speed_mps, -1)
