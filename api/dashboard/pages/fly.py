"""The page that an operator keeps open in flight."""

from __future__ import annotations

from typing import Any

from nicegui import ui

from skyfolio.api.dashboard import charts, live, map_scene
from skyfolio.api.dashboard.approval import Notices
from skyfolio.api.dashboard.report import lost_at
from skyfolio.api.dashboard.shell import Shell
from skyfolio.api.dashboard.situation import Situation, achieved_line, stats_line
from skyfolio.api.dashboard.views import Operation
from skyfolio.api.dashboard.watch import Watch
from skyfolio.planner import Plan

TABLE_EVERY = 2


class FlyPage:
    """One open page, which draws what has changed in `Watch` since the last tick."""

    def __init__(self, watch: Watch, tile_url: str | None) -> None:
        self._watch, self._tile_url = watch, tile_url
        self._slot: int | None = None
        self._drawn: dict[str, Any] = {}
        self._version = -1
        self._ticks = 0
        self._shown_events = 0
        Shell(watch, "Fly")
        self._notices = Notices(watch)
        self._situation = Situation(self._choose_slot)
        self._situation.show_overlay(
            "Reading the fleet", "The service is being asked for its vehicles and operations.", spinner=True
        )
        self._situation.mark_live(True)
        ui.timer(0.2, self._tick)

    def _tick(self) -> None:
        watch = self._watch
        if watch.version == self._version:
            return
        self._version = watch.version
        self._ticks += 1
        self._draw_events()
        operation, plan, first = watch.operation, watch.plan_in_force(), watch.first_plan()
        if self._ticks % TABLE_EVERY == 0 or self._changed("lost", operation and operation.lost):
            self._situation.fleet.set_rows(map_scene.rows(live.spots(self._watch), operation))
        if operation is None or plan is None or first is None:
            self._draw_idle()
            return
        self._situation.overlay.set_visibility(False)
        self._draw_scene(operation, plan, first)
        self._draw_timeline(operation, plan, first)
        self._notices.draw(operation)
        if self._changed("recoveries", operation.recoveries):
            self._situation.show_recoveries(operation.recoveries)
        if self._slot is None:
            self._draw_live(operation, plan, first)

    def _changed(self, name: str, value: object) -> bool:
        if name in self._drawn and self._drawn[name] == value:
            return False
        self._drawn[name] = value
        return True

    def _choose_slot(self, slot: int | None) -> None:
        self._slot = slot
        self._situation.mark_live(slot is None)
        operation, plan, first = self._watch.operation, self._watch.plan_in_force(), self._watch.first_plan()
        self._drawn.pop("timeline", None)
        if slot is not None and operation is not None and plan is not None and first is not None:
            self._situation.show_slot(slot, f"slot {slot}")
            self._situation.map.set_frame(self._past_frame(slot, operation, plan, first))
            self._draw_timeline(operation, plan, first)

    # --- live ---

    def _draw_live(self, operation: Operation, plan: Plan, first: Plan) -> None:
        self._situation.map.set_frame(live.frame(self._watch, operation, plan, first))
        slot = operation.slot
        if self._changed("slot label", (slot, operation.state)):
            over = operation.ended or operation.state == "landing"
            at = slot if slot is not None else first.scenario.slots - 1 if over else 0
            self._situation.show_slot(at, f"slot {slot}" if slot is not None else operation.state)

    def _draw_scene(self, operation: Operation, plan: Plan, first: Plan) -> None:
        if self._changed("scene", (operation.id, plan.id, operation.lost)):
            scene = live.scene(operation, plan, first, self._tile_url)
            self._situation.map.set_scene(scene, live.tracks(self._watch))
            self._situation.set_slots(first.scenario.slots)

    def _draw_timeline(self, operation: Operation, plan: Plan, first: Plan) -> None:
        slot = operation.slot if self._slot is None else self._slot
        recorded = sum(rate is not None for row in operation.user_rates_bps.values() for rate in row)
        if not self._changed("timeline", (operation.id, slot, plan.id, operation.lost, recorded)):
            return
        n = first.scenario.slots
        lines: dict[str, Any] = {
            "planned": charts.total(first.user_rates_bps, n),
            "achieved": charts.total(operation.user_rates_bps, n),
        }
        stats = [stats_line("planned", first), achieved_line(operation.user_rates_bps, operation.measured_slots)]
        if plan.id != first.id:
            begun: list[float | None] = [None] * plan.first_slot
            lines["after replan"] = [*begun, *charts.total(plan.user_rates_bps, plan.scenario.slots)]
            stats.append(stats_line("after replan", plan))
        users = {user: operation.user_rates_bps.get(user, []) for user in first.scenario.user_ids}
        self._situation.draw_timeline(
            n, lines, users, cursor=slot, lost=lost_at(operation, first.scenario.slot_duration_s)
        )
        self._situation.set_stats("σ² in (kbit/s)², Jain:  " + "   ".join(figure for figure in stats if figure))

    def _draw_events(self) -> None:
        new = min(self._watch.event_count - self._shown_events, len(self._watch.events))
        if new:
            self._shown_events = self._watch.event_count
            self._situation.add_events(list(self._watch.events)[-new:])

    # --- before, and the past ---

    def _draw_idle(self) -> None:
        if not self._watch.loaded or self._watch.operation is not None:
            return
        if self._changed("overlay", "empty"):
            self._situation.show_overlay(
                "No operation yet",
                "Make a plan, choose which vehicle flies which UAV, and start. Everything that flies is shown here.",
            )
            with self._situation.overlay:
                ui.button("Make a plan", on_click=lambda: ui.navigate.to("/plan")).props("unelevated")

    def _past_frame(self, slot: int, operation: Operation, plan: Plan, first: Plan) -> map_scene.Json:
        then = plan if slot >= plan.first_slot else first
        at_s = slot * first.scenario.slot_duration_s
        rates = {user: row[slot] if slot < len(row) else None for user, row in operation.user_rates_bps.items()}
        known = any(rate is not None for rate in rates.values())
        planned = map_scene.planned_frame(then, slot, rates if known else None)
        if not known:
            return planned
        spots = []
        for uav, tracked in self._watch.vehicles.items():
            near = min(tracked.track, key=lambda row: abs(row[0] - at_s), default=None)
            if near is not None and abs(near[0] - at_s) < first.scenario.slot_duration_s:
                spots.append(map_scene.Spot(uav_id=uav, at_m=near[1:], course_deg=tracked.course_deg))
        return map_scene.frame(spots, then, slot, rates, promise=first, live=False) if spots else planned
