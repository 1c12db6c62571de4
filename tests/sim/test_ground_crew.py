"""sim.ground_crew and sim.packs: batteries that are changed on the pads of a fleet, and that age"""

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim import Fleet, GroundCrew, Kill, LowBattery, Packs, Reboot, VirtualClock, as_line, grid_of
from skyfolio.sim.airframe import RESISTANCE_OHM, Battery
from skyfolio.sim.packs import Pack, packs_of
from skyfolio.sim.station import Vehicle
from skyfolio.sim.wire import Decoder

HOME = (47.397742, 8.545594)
CREW = GroundCrew(turnaround_s=40.0, off_s=10.0)
BOTH = pytest.mark.parametrize("flavour", ["px4", "ardupilot"])


def fleet_of(count: int, crew: GroundCrew | None = CREW, *, flavour: str = "px4", seed: int = 0) -> Fleet:
    return Fleet(grid_of(count, *HOME, autopilot=flavour), clock=VirtualClock(), crew=crew, seed=seed)


def hop(fleet: Fleet, *system_ids: int, for_s: float = 10.0) -> None:
    """Take off, hover, and come down again."""
    for system_id in system_ids:
        vehicle = fleet.vehicles[system_id]
        order(vehicle, dialect.MAV_CMD_DO_SET_MODE, 1.0, *((4.0,) if is_copter(vehicle) else (4.0, 3.0)))
        order(vehicle, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        assert vehicle.armed
        vehicle.autopilot.takeoff(8.0)
    fleet.step_to(fleet.now_s + for_s)
    for system_id in system_ids:
        order(fleet.vehicles[system_id], dialect.MAV_CMD_NAV_LAND)
    fly_until(fleet, lambda: not any(fleet.vehicles[number].armed for number in system_ids))


def is_copter(vehicle: Vehicle) -> bool:
    return vehicle.spec.autopilot == "ardupilot"


def order(vehicle: Vehicle, command: int, *params: float) -> None:
    message = dialect.MAVLink_command_long_message(
        vehicle.system_id, 1, command, 0, *params, *[0.0] * (7 - len(params))
    )
    frame = message.pack(dialect.MAVLink(None, srcSystem=245, srcComponent=190))
    (decoded,) = Decoder().decode(bytes(frame))
    vehicle.autopilot.handle(decoded)


def fly_until(fleet: Fleet, is_so: Callable[[], bool], within_s: float = 200.0) -> float:
    """Step the fleet until it is so; the fleet second in which it is."""
    until_s = fleet.now_s + within_s
    while not is_so():
        assert fleet.now_s < until_s, fleet.truth.events[-5:]
        fleet.step_to(fleet.now_s + 0.05)
    return fleet.now_s


def told(fleet: Fleet, system_id: int) -> list[str]:
    """What happened on a vehicle's pad, in order."""
    kinds = {"off_pad", "swap_waits", "swap_begun", "swap_abandoned", "switched_off", "swapped", "booted"}
    return [event.kind for event in fleet.truth.events if event.kind in kinds and event.system_id == system_id]


def message_of(vehicle: Vehicle, message_id: int) -> Any:
    return vehicle.autopilot.telemetry.build(message_id)


@BOTH
def test_a_vehicle_that_has_landed_on_its_pad_gets_a_full_battery_and_boots(flavour: str) -> None:
    fleet = fleet_of(1, flavour=flavour)
    vehicle = fleet.vehicles[1]
    hop(fleet, 1)
    down_s = fleet.now_s
    assert vehicle.autopilot.battery.share < 0.99
    fly_until(fleet, lambda: vehicle.is_off)
    assert fleet.now_s == pytest.approx(down_s + 30.0, abs=1.0)
    on_s = fly_until(fleet, lambda: not vehicle.is_off)
    assert on_s == pytest.approx(down_s + 40.0, abs=1.0)
    assert told(fleet, 1) == ["swap_begun", "switched_off", "swapped", "booted"]
    status, battery = message_of(vehicle, 1), message_of(vehicle, dialect.MAVLINK_MSG_ID_BATTERY_STATUS)
    assert (status.battery_remaining, battery.battery_remaining, battery.current_consumed) == (100, 100, 0)
    assert battery.voltages[0] > 4100
    assert vehicle.autopilot.clock.boot_ms == 0
    assert message_of(vehicle, dialect.MAVLINK_MSG_ID_HOME_POSITION) is None
    fleet.step_to(on_s + 45.0)
    assert message_of(vehicle, dialect.MAVLINK_MSG_ID_HOME_POSITION) is not None
    hop(fleet, 1)
    assert message_of(vehicle, dialect.MAVLINK_MSG_ID_BATTERY_STATUS).current_consumed > 0


def test_a_vehicle_that_is_off_sends_and_receives_nothing() -> None:
    fleet = fleet_of(1)
    heard: list[float] = []
    fleet.attach(lambda _data, _id: heard.append(fleet.now_s))
    hop(fleet, 1)
    off_s = fly_until(fleet, lambda: fleet.vehicles[1].is_off)
    fleet.inject(Reboot(1))
    on_s = fly_until(fleet, lambda: not fleet.vehicles[1].is_off)
    assert [at_s for at_s in heard if off_s < at_s < on_s] == []
    assert on_s - off_s == pytest.approx(10.0, abs=0.6)
    fleet.step_to(on_s + 5.0)
    assert heard[-1] > on_s
    assert told(fleet, 1).count("booted") == 1


def test_a_crew_of_two_serves_who_came_first() -> None:
    fleet = fleet_of(3, replace(CREW, members=2))
    for system_id in (3, 1, 2):
        hop(fleet, system_id, for_s=4.0)
    fly_until(fleet, lambda: len(fleet.truth.happened("swapped")) == 3)
    begun = {event.system_id: event.t_s for event in fleet.truth.happened("swap_begun")}
    done = {event.system_id: event.t_s for event in fleet.truth.happened("swapped")}
    assert sorted(begun, key=begun.__getitem__) == [3, 1, 2]
    assert begun[1] < done[3] <= begun[2]
    assert "swap_waits" in told(fleet, 2)


def test_who_has_not_flown_or_stands_elsewhere_is_left_alone() -> None:
    fleet = fleet_of(2)
    fleet.step_to(5.0)
    strayed = fleet.vehicles[2].autopilot
    strayed.arm()
    strayed.takeoff(5.0)
    fleet.step_to(15.0)
    strayed.reposition(20.0, 0.0, None, 5.0)
    fleet.step_to(30.0)
    order(fleet.vehicles[2], dialect.MAV_CMD_NAV_LAND)
    fleet.step_to(150.0)
    assert (told(fleet, 1), told(fleet, 2)) == ([], ["off_pad"])
    assert fleet.truth.happened("off_pad")[0].detail["distance_m"] == pytest.approx(20.0, abs=1.0)


def test_a_vehicle_whose_battery_has_run_down_where_it_stands_gets_another() -> None:
    fleet = fleet_of(1)
    fleet.inject(LowBattery(1, share=0.5), at_s=5.0)
    fleet.step_to(60.0)
    assert told(fleet, 1) == ["swap_begun", "switched_off", "swapped", "booted"]


def test_the_crew_steps_back_from_a_vehicle_that_is_armed_or_destroyed() -> None:
    fleet = fleet_of(2)
    hop(fleet, 1, 2)
    fleet.step_to(fleet.now_s + 10.0)
    fleet.inject(Kill(2))
    order(fleet.vehicles[1], dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    fleet.step_to(fleet.now_s + 2.0)
    begun = {event.system_id for event in fleet.truth.happened("swap_begun")}
    abandoned = {event.system_id: event.detail["because"] for event in fleet.truth.happened("swap_abandoned")}
    assert begun == set(abandoned) == {1}
    assert abandoned == {1: "armed"}
    fleet.step_to(fleet.now_s + 100.0)
    assert not fleet.truth.happened("swapped", 2)


def test_packs_charge_and_a_vehicle_waits_until_one_is_full() -> None:
    fleet = fleet_of(1, replace(CREW, packs=Packs(count=2, charge_s=2000.0)))
    vehicle = fleet.vehicles[1]
    for _ in range(2):
        hop(fleet, 1, for_s=60.0)
        share = vehicle.autopilot.battery.share
        fly_until(fleet, lambda: vehicle.is_off, within_s=300.0)
        fly_until(fleet, lambda: not vehicle.is_off)
        fleet.step_to(fleet.now_s + 10.0)
    first, second = fleet.truth.happened("swapped")
    assert (first.detail["pack"], second.detail["pack"]) == ("1-2", "1-1")
    waits = fleet.truth.happened("swap_waits")[0].detail
    assert waits["because"] == "no pack is charged"
    assert second.t_s - first.t_s >= (1.0 - first.detail["removed_share"]) * 2000.0
    assert share < 0.95
    assert fleet.truth.samples[-1].pack == "1-1"


def test_an_aged_pack_holds_less_and_sags_more() -> None:
    kind = Packs(fade_per_cycle=0.001, resistance_per_cycle=0.002)
    pack, new, old = Pack("1-1", kind, cycles=200.0), Battery(), Battery()
    pack.put_in(old)
    assert old.health == pytest.approx(0.8)
    assert old.resistance_ohm == pytest.approx(1.4 * RESISTANCE_OHM)
    for battery in (new, old):
        battery.drain(200.0, 60.0, 5000.0)
    assert 1.0 - old.share == pytest.approx((1.0 - new.share) / 0.8)
    old.share = new.share
    assert old.voltage_v < new.voltage_v
    pack.take_out(old, 0.0)
    assert pack.cycles == pytest.approx(200.0 + 1.0 - old.share)


def test_arducopter_takes_an_aged_pack_for_a_new_one_and_px4_does_not() -> None:
    worn = replace(CREW, packs=Packs(worn_cycles=500.0, fade_per_cycle=0.001, spread=0.1))
    seen = {}
    for flavour in ("px4", "ardupilot"):
        fleet = fleet_of(1, worn, flavour=flavour, seed=4)
        hop(fleet, 1, for_s=200.0)
        autopilot = fleet.vehicles[1].autopilot
        assert autopilot.battery.health < 0.95
        seen[flavour] = autopilot.gauge.share - autopilot.battery.share
        used_mah = message_of(fleet.vehicles[1], dialect.MAVLINK_MSG_ID_BATTERY_STATUS).current_consumed
        drawn_mah = (1.0 - autopilot.battery.share) * autopilot.battery.health * 5000.0
        assert used_mah == pytest.approx(drawn_mah, abs=1.0)
    assert seen["px4"] == 0.0
    assert seen["ardupilot"] > 0.01


@pytest.mark.parametrize(("flavour", "told_percent"), [("px4", 40), ("ardupilot", 100)])
def test_after_a_restart_without_a_swap_arducopter_believes_its_battery_to_be_full(
    flavour: str, told_percent: int
) -> None:
    fleet = fleet_of(1, None, flavour=flavour)
    fleet.inject(LowBattery(1, share=0.4))
    vehicle = fleet.vehicles[1]
    assert message_of(vehicle, 1).battery_remaining == 40
    fleet.inject(Reboot(1))
    fleet.step_to(5.0)
    assert message_of(vehicle, 1).battery_remaining == told_percent
    assert message_of(vehicle, dialect.MAVLINK_MSG_ID_BATTERY_STATUS).current_consumed == 0


def test_the_same_seed_gives_the_same_packs_and_the_same_day() -> None:
    kind = Packs(count=3, worn_cycles=300.0, fade_per_cycle=0.0005, resistance_per_cycle=0.002, spread=0.2)

    def day(seed: int) -> list[str]:
        fleet = fleet_of(2, replace(CREW, packs=kind), seed=seed)
        hop(fleet, 1, 2)
        fleet.step_to(fleet.now_s + 100.0)
        return list(fleet.truth.lines())

    assert day(1) == day(1)
    assert day(1) != day(2)
    assert [pack.cycles for pack in packs_of(1, kind, 5)] != [pack.cycles for pack in packs_of(2, kind, 5)]
    assert all(0.0 <= pack.cycles <= 300.0 for pack in packs_of(1, kind, 5))


def test_events_of_the_crew_are_written_as_lines() -> None:
    fleet = fleet_of(1)
    rows: list[dict[str, Any]] = []
    fleet.truth.sink = lambda row: rows.append(json.loads(as_line(row)))
    hop(fleet, 1)
    fleet.step_to(fleet.now_s + 60.0)
    (swapped,) = [row for row in rows if row.get("kind") == "swapped"]
    assert (swapped["pack"], swapped["removed"], swapped["health"]) == ("1-2", "1-1", 1.0)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: GroundCrew(members=0), "members must be a whole number between 1"),
        (lambda: GroundCrew(turnaround_s=20.0, off_s=20.0), "turnaround_s must be between 25"),
        (lambda: GroundCrew(swap_below=1.5), "swap_below must be between 0 and 1"),
        (lambda: Packs(count=1), "count must be a whole number between 2"),
        (lambda: Packs(charge_s=0.0), "charge_s must be a number of seconds above 0"),
        (lambda: Packs(fade_per_cycle=-0.1), "fade_per_cycle must be between 0 and 1"),
    ],
)
def test_an_impossible_crew_or_pack_is_refused(make: Callable[[], object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        make()
