"""sim.chatter: what a PX4 orders by itself"""

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tests.sim.conftest import Bench, Items


def orders(bench: "Bench") -> list[tuple[int, int, int, int, tuple[float, ...]]]:
    """Return target system and component, command, confirmation and parameters of its own commands."""
    return [
        (
            message.target_system,
            message.target_component,
            message.command,
            message.confirmation,
            tuple(getattr(message, f"param{n}") for n in range(1, 8)),
        )
        for message in bench.sent
        if message.get_type() == "COMMAND_LONG"
    ]


def test_a_px4_sends_its_missions_speed_four_times_to_component_0(airborne: "Bench", items: "Items") -> None:
    airborne.upload(items.speed(4.5, current=1.0), items.waypoint(300.0, 0.0))
    airborne.sent.clear()
    airborne.set_mode(4)
    airborne.fly(5.0)
    assert orders(airborne) == [(1, 0, 178, n, (1.0, 4.5, -1.0, 0.0, 0.0, 0.0, 0.0)) for n in range(4)]


def test_a_px4_that_leaves_its_mission_stops_camera_and_gimbal(airborne: "Bench", items: "Items") -> None:
    airborne.upload(items.waypoint(300.0, 0.0, current=1.0))
    airborne.set_mode(4)
    airborne.fly(1.0)
    airborne.sent.clear()
    airborne.set_mode(3)
    airborne.fly(5.0)
    sent = [(command, confirmation) for _, _, command, confirmation, _ in orders(airborne)]
    assert sent[:4] == [(2003, 0), (1001, 0), (1000, 0), (1001, 0)]
    assert sorted(sent) == sorted(
        [*((2003, n) for n in range(4)), *((1001, n) for n in range(4)), (1000, 0), (1001, 0)]
    )
    nothing: Any = next(params for _, _, command, _, params in orders(airborne) if command == 1000)
    assert all(math.isnan(value) for value in nothing[:4])


def test_an_arducopter_orders_nothing(copter_up: "Bench", items: "Items") -> None:
    copter_up.upload(items.waypoint(0.0, 0.0), items.speed(4.0), items.waypoint(60.0, 0.0))
    copter_up.set_mode(3)
    copter_up.fly(5.0)
    copter_up.set_mode(4)
    copter_up.fly(5.0)
    assert orders(copter_up) == []
