"""sim.station: a vehicle that stands disarmed is left alone, and nobody outside can tell"""

from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim import Fleet, GpsLoss, LowBattery, Reboot, VirtualClock, Weather, grid_of, station
from skyfolio.sim.dynamics import Dynamics
from skyfolio.sim.wire import Decoder

HOME = (47.397742, 8.545594)
BOTH = pytest.mark.parametrize("flavour", ["px4", "ardupilot"])


def standing(flavour: str = "px4", weather: Weather | None = None) -> Fleet:
    return Fleet(grid_of(1, *HOME, autopilot=flavour), clock=VirtualClock(), weather=weather)


def heard_from(fleet: Fleet) -> list[tuple[float, bytes]]:
    """What the fleet sends from now on, and when."""
    heard: list[tuple[float, bytes]] = []
    fleet.attach(lambda data, _: heard.append((round(fleet.now_s, 3), data)))
    return heard


def day(flavour: str) -> tuple[list[tuple[float, bytes]], float]:
    """A minute on the ground with faults, and a flight in its middle; what was sent, and the charge at the end."""
    fleet = standing(flavour, Weather(wind_east_mps=3.0))
    heard = heard_from(fleet)
    fleet.inject(LowBattery(1, share=0.3), at_s=7.3)
    fleet.inject(GpsLoss(1, for_s=3.0), at_s=10.0)
    fleet.inject(Reboot(1), at_s=70.0)
    fleet.step_to(20.0)
    autopilot = fleet.vehicles[1].autopilot
    fleet.vehicles[1].wake()
    autopilot.arm(force=True)
    autopilot.takeoff(5.0)
    fleet.step_to(30.0)
    autopilot.set_mode(next(mode for mode in autopilot.traits.custom_modes if mode.name == "LAND"))
    fleet.step_to(150.0)
    return heard, autopilot.battery.share


@BOTH
def test_it_sends_the_same_bytes_at_the_same_times_as_if_each_step_were_flown(
    flavour: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rested, share = day(flavour)
    monkeypatch.setattr(station, "REST_S", -1.0)
    monkeypatch.setattr("skyfolio.sim.autopilot.Autopilot.rests", property(lambda _: False))
    flown, full_share = day(flavour)
    assert len(rested) == len(flown)
    assert rested == flown
    assert share == pytest.approx(full_share, abs=1e-9)


def test_nothing_of_it_is_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[float] = []
    move: Callable[..., None] = Dynamics.step

    def counted(dynamics: Dynamics, now_s: float, dt_s: float) -> None:
        steps.append(now_s)
        move(dynamics, now_s, dt_s)

    monkeypatch.setattr(Dynamics, "step", counted)
    fleet = standing()
    fleet.step_to(2.0)
    steps.clear()
    fleet.step_to(30.0)
    assert steps == []
    fleet.vehicles[1].autopilot.arm()
    fleet.step_to(31.0)
    assert len(steps) == 20


def test_it_answers_at_once_and_arms_in_the_middle_of_its_rest() -> None:
    fleet = standing()
    decoder, heard = Decoder(), list[Any]()
    send = fleet.attach(lambda data, _: heard.extend((fleet.now_s, one) for one in decoder.decode(data)))
    fleet.step_to(10.25)
    order = dialect.MAVLink_command_long_message(1, 1, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1.0, *[0.0] * 6)
    send(bytes(order.pack(dialect.MAVLink(None, srcSystem=245, srcComponent=190))), 1)
    (ack,) = [(at_s, one) for at_s, one in heard if one.get_type() == "COMMAND_ACK"]
    assert ack[0] == pytest.approx(10.25)
    assert fleet.vehicles[1].armed
    assert fleet.vehicles[1].autopilot.now_s == pytest.approx(10.25)


def test_its_position_wanders_as_satellites_err() -> None:
    fleet = standing(weather=Weather(gps_m=1.0, gps_s=5.0))
    decoder, places = Decoder(), list[Any]()
    fleet.attach(lambda data, _: places.extend(decoder.decode(data)))
    fleet.step_to(60.0)
    seen = {(one.lat, one.lon) for one in places if one.get_type() == "GLOBAL_POSITION_INT"}
    assert len(seen) > 200
