"""The schedule keeper: compare where a UAV in flight is with the slot clock, and have it catch up or wait. Pure.

There is no mission item that says when to arrive. So while a mission is flown, the keeper looks at the next point of
the plan, what is left of the way and of the time, and at the vehicle's limits, and asks for the ground speed that meets
both (MAV_CMD_DO_CHANGE_SPEED). A hold that would last past its slot is cut short by making the next item current, and
so is a waypoint that a vehicle does not come nearer to although it is overdue. After the last slot the vehicle gets its
own cruise speed back.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import dist, inf

from skyfolio.mavlink_bridge.items import Command, Mission
from skyfolio.mavlink_bridge.pace import VehicleModel, cruise_speed, lateness
from skyfolio.mavlink_bridge.profiles import profile_of
from skyfolio.mavlink_bridge.reach import head_start_s
from skyfolio.mavlink_bridge.route import Route
from skyfolio.mavlink_bridge.schedule import SAME_PLACE_M
from skyfolio.mavlink_bridge.slip import Slip
from skyfolio.planner.geometry import Point

EVERY_S = 0.5
"""Fleet seconds between two orders to one vehicle: a command takes a while to show."""
WORTH_MPS = 0.15
"""A smaller change of speed is not worth a command."""
ANEW_S = 1.0
"""A hold that has to go on is restarted this early."""
WORTH_WAITING_S = 1.5
"""A hold that is left early by less than this is made up for by a slower leg."""
LEAST_TIME_S = 0.6
"""With less time left to a point, the one after it is aimed at."""


LEAD_S = 0.2
"""Orders are given this early: about so long passes until they are flown."""
STUCK_S = 4.0
"""A vehicle that is overdue at a waypoint and has come no nearer for so long (fleet seconds) is stuck."""
FROM_REST = 0.3
"""On the first leg a vehicle slower than this share of the needed speed has yet to build up its acceleration."""
NEAR_M = 2.0
"""Within this much of a stop it is there, as far as GPS can show, even if its acceptance radius is smaller."""
NEARER_M = 1.0
"""Coming nearer by less than this does not count: the vehicle hovers, or circles."""


@dataclass(frozen=True, slots=True)
class Order:
    """What a vehicle is ordered: fly this fast, or go on with this item. `late_s`: how far behind the clock it is.

    its_own_speed: the speed is the vehicle's own, and the last order. stuck: why the item is made current, if it is
    because the vehicle did not move on by itself.
    """

    late_s: float
    speed_mps: float | None = None
    item: int | None = None
    its_own_speed: bool = False
    stuck: Stuck | None = None


@dataclass(frozen=True, slots=True)
class Stuck:
    """It stayed `distance_m` from the waypoint of `item` for `for_s` fleet seconds, although it was overdue."""

    item: int
    for_s: float
    distance_m: float


class Keeper:
    """Keeps one UAV on schedule. Times are fleet seconds since slot 0 of its plan began.

    `mission` is what it flies, compiled from `path_m` ((n_slots, 2) metres east/north, slot n begins at n * slot_s).
    `since_s`: when keeping began; slots that began earlier have no slip.
    """

    def __init__(
        self, path_m: list[Point], slot_s: float, mission: Mission, model: VehicleModel, *, since_s: float = 0.0
    ) -> None:
        self.model = model
        self._route = Route(path_m, slot_s)
        self.mission = mission
        self._restarts_hold = profile_of(mission.autopilot).restarts_hold
        self._stops = sorted(mission.slot_of_item.items())
        self._departures = [self._departs(number) for number in range(len(self._stops))]
        """The last slot spent at each stop: the leg that follows begins with it."""
        self._ordered_s = -EVERY_S
        self._ordered_item = -1
        self._speed_mps: float | None = None
        self._has_our_speed = False
        self._nearest: tuple[int, float, float] = (-1, inf, 0.0)
        self._since_s = since_s
        self._holding: tuple[int, float] | None = None
        """The item at which it holds, and since when as far as that was seen."""
        self._anew: int | None = None
        """The hold that was last restarted."""
        self._next_slot = int(max(since_s, 0.0) // slot_s) + 1

    @property
    def ends_s(self) -> float:
        """Return when the last slot begins."""
        return self._route.due_s(self._route.last)

    def advise(self, now_s: float, point_m: Point, velocity_mps: Point, current_item: int) -> Order | None:
        """Return the order to send now, if any. `current_item`: the seq of MISSION_CURRENT."""
        if now_s - self._ordered_s < EVERY_S:
            return None
        if now_s >= self._route.due_s(self._route.last):
            order = self._give_back(now_s) or self._end(now_s, current_item)
        else:
            number = next((n for n, (seq, _) in enumerate(self._stops) if seq >= current_item), None)
            if number is None:
                return None
            order = (
                self._leave(number, now_s, point_m)
                or self._stay(number, now_s, point_m)
                or self._free(number, now_s, point_m)
                or self._fly(number, now_s, point_m, velocity_mps)
            )
        if order is not None:
            self._ordered_s = now_s
            self._has_our_speed |= order.speed_mps is not None and not order.its_own_speed
        return order

    def not_taken(self, order: Order) -> None:
        """Take in that the vehicle did not follow this order, so that it is given again."""
        if order.item is not None:
            self._ordered_item = -1
        if order.speed_mps is not None:
            self._speed_mps = None
            self._has_our_speed = True

    def _give_back(self, now_s: float) -> Order | None:
        """Return the order to fly at its own cruise speed, once, if another speed was ordered."""
        if not self._has_our_speed:
            return None
        self._has_our_speed = False
        late_s = now_s - self._route.due_s(self._route.last)
        return Order(late_s=late_s, speed_mps=self.model.cruise_mps, its_own_speed=True)

    def _free(self, number: int, now_s: float, point_m: Point) -> Order | None:
        """Return the order to go on with the next item if it is overdue at this one and comes no nearer."""
        seq, _ = self._stops[number]
        left_m = self._to_stop_m(number, point_m)
        item, nearest_m, since_s = self._nearest
        overdue_s = self._route.due_s(self._departures[number])
        if item != seq or left_m < nearest_m - NEARER_M or now_s < overdue_s:
            self._nearest = (seq, left_m, now_s)
            return None
        if now_s - since_s < STUCK_S or number + 1 >= len(self._stops):
            return None
        self._nearest = (seq, left_m, now_s)
        self._speed_mps = None
        stuck = Stuck(item=seq, for_s=round(now_s - since_s, 1), distance_m=round(left_m, 1))
        return Order(late_s=now_s - overdue_s, item=seq + 1, stuck=stuck)

    def slip(self, now_s: float, point_m: Point) -> Slip | None:
        """Return the record of a slot that has just begun, once each."""
        slot = self._next_slot
        if slot > self._route.last or now_s < self._route.due_s(slot):
            return None
        self._next_slot += 1
        return Slip(slot, dist(point_m, self._route.path_m[slot]), self._route.late_s(slot, point_m))

    def _leave(self, number: int, now_s: float, point_m: Point) -> Order | None:
        """Return the order to end a hold whose time is over, or that needs a head start into the next leg."""
        seq, _ = self._stops[number]
        if number + 1 >= len(self._stops) or self.mission.items[seq].param1 <= 0 or seq == self._ordered_item:
            return None
        leaves_s = self._leaves_s(number)
        if not self._is_near(number, point_m) or now_s + LEAD_S < leaves_s:
            return None
        self._ordered_item = seq
        self._speed_mps = None
        return Order(late_s=now_s - leaves_s, item=seq + 1)

    def _stay(self, number: int, now_s: float, point_m: Point) -> Order | None:
        """Return the order to restart a hold that would end before its time, because the vehicle came early.

        ArduCopter counts its hold from the moment its current item is made current again; PX4 ignores that order.
        """
        seq, _ = self._stops[number]
        hold_s = self.mission.items[seq].param1
        if hold_s <= 0 or not self._restarts_hold or not self._is_near(number, point_m):
            return None
        if self._holding is None:
            self._holding = (seq, now_s - hold_s if self._since_s > 0 else now_s)  # when it came is not known
        elif self._holding[0] != seq:
            self._holding = (seq, now_s)
        left_s = self._holding[1] + hold_s - now_s
        early_s = self._leaves_s(number) - now_s - max(left_s, 0.0)
        if left_s > ANEW_S or early_s < WORTH_WAITING_S:
            return None
        self._holding = (seq, now_s)
        self._anew = seq
        return Order(late_s=-early_s, item=seq)

    def _end(self, now_s: float, current_item: int) -> Order | None:
        """Return the order to go on after the last slot from a hold that was restarted, and so lasts too long."""
        seq, _ = self._stops[-1]
        over_s = now_s - self._route.due_s(self._route.last) - self._route.slot_s
        if over_s < 0 or seq == self._ordered_item or not self._anew == current_item == seq:
            return None
        if seq + 1 >= len(self.mission.items):
            return None
        self._ordered_item = seq
        return Order(late_s=over_s, item=seq + 1)

    def _leaves_s(self, number: int) -> float:
        """Return when it should leave a stop: with the leg that follows, or at the end of the last slot."""
        departs = self._departures[number]
        if number + 1 >= len(self._stops):
            return self._route.due_s(departs) + self._route.slot_s
        return self._route.due_s(departs) - head_start_s(self._route.path_m, departs, self._route.slot_s, self.model)

    def _to_stop_m(self, number: int, point_m: Point) -> float:
        """Return the metres that are left to a stop."""
        return dist(point_m, self._route.path_m[self._stops[number][1]])

    def _is_near(self, number: int, point_m: Point) -> bool:
        return self._to_stop_m(number, point_m) <= max(NEAR_M, self.model.acceptance_radius_m)

    def _departs(self, number: int) -> int:
        """Return the last slot spent at a stop."""
        slot = self._stops[number][1]
        following = self._stops[number + 1][1] if number + 1 < len(self._stops) else self._route.last + 1
        while slot + 1 < following and self._route.way_m(slot, slot + 1) < SAME_PLACE_M:
            slot += 1
        return slot

    def _compiled_speed(self, seq: int) -> float:
        """Return the speed that the mission itself has for the leg to an item: the compiler looks further ahead."""
        speeds = [item.param2 for item in self.mission.items[:seq] if item.command == Command.DO_CHANGE_SPEED]
        return speeds[-1] if speeds else 0.0

    def _fly(self, number: int, now_s: float, point_m: Point, velocity_mps: Point) -> Order | None:
        """Return the order to fly at the speed that meets the next point of the plan in time."""
        seq, slot = self._stops[number]
        if seq < self.mission.start_item or self._waits(number, point_m):
            return None
        target = self._target(number, now_s)
        corner = self._route.path_m[min(slot, target)]
        left_m = dist(point_m, corner)
        distance_m = left_m + (self._route.way_m(slot, target) if target > slot else 0.0)
        left_s = max(self._route.due_s(target) - now_s - LEAD_S, LEAST_TIME_S / 2)
        along = 0.0
        if left_m > 0.1:
            east, north = corner[0] - point_m[0], corner[1] - point_m[1]
            along = (velocity_mps[0] * east + velocity_mps[1] * north) / left_m
        cruise = distance_m / left_s
        leg = {
            "entry_mps": min(along, cruise),
            "leave_mps": 0.0 if self._route.rests_at(target) else min(cruise, self._route.pace_mps(target)),
        }
        model = self.model.from_rest() if target == 1 and along < FROM_REST * cruise else self.model
        speed = cruise_speed(distance_m, left_s, model=model, **leg)
        if lateness(distance_m, left_s, model=model, **leg) > 0:
            speed = max(speed, self._compiled_speed(seq))
        speed = min(max(speed, self.model.min_speed_mps), self.model.max_speed_mps)
        if self._speed_mps is not None and abs(speed - self._speed_mps) < max(WORTH_MPS, 0.05 * speed):
            return None
        self._speed_mps = speed
        return Order(late_s=left_m / max(self._route.pace_mps(slot), 0.5) - left_s, speed_mps=round(speed, 2))

    def _waits(self, number: int, point_m: Point) -> bool:
        """Return whether it is at a stop that it should not leave yet, or close to the end of the leg anyway."""
        _, slot = self._stops[number]
        return self._to_stop_m(number, point_m) <= self.model.acceptance_radius_m and self._route.rests_at(slot)

    def _target(self, number: int, now_s: float) -> int:
        """Return the slot whose point is aimed at: the next that is far enough in time, on this leg or after it."""
        before = self._departures[number - 1] if number else 0
        slot = int((now_s + LEAST_TIME_S) // self._route.slot_s) + 1
        return min(max(slot, before + 1), self._route.last)
