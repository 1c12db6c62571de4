"""Plays a stored operation, from the event log and the recorded tracks, at a chosen speed."""

from __future__ import annotations

import time
from typing import Any

from nicegui import events, ui

from skyfolio.api.dashboard import charts, map_scene
from skyfolio.api.dashboard.elements import attempt, text
from skyfolio.api.dashboard.recording import Recording, placed
from skyfolio.api.dashboard.report import lost_at
from skyfolio.api.dashboard.shell import Shell
from skyfolio.api.dashboard.situation import Situation, achieved_line, stats_line
from skyfolio.api.dashboard.views import ServiceEvent
from skyfolio.api.dashboard.watch import Watch

SPEEDS = (1, 2, 5, 10, 20, 50)
TICK_S = 0.2


class ReplayPage:
    """One open player."""

    def __init__(self, watch: Watch, tile_url: str | None) -> None:
        self._watch, self._feed, self._tile_url = watch, watch.feed, tile_url
        self._recording: Recording | None = None
        self._at_s = 0.0
        self._playing = False
        self._last = time.monotonic()
        self._drawn: dict[str, Any] = {}
        self._shown_events = 0
        Shell(watch, "Replay")
        with ui.element("div").classes("sf-player").props('role="group" aria-label="player"'):
            self._choice = ui.select({}, label="Operation", on_change=self._chosen).props("dense outlined")
            self._play = ui.button("Play", on_click=self._toggle).props("unelevated")
            self._speed = ui.select({speed: f"{speed} times" for speed in SPEEDS}, value=10, label="Speed").props(
                "dense outlined"
            )
            self._bar = ui.slider(min=0, max=1, step=0.5, value=0, on_change=self._dragged)
            self._bar.props('aria-label="time in the operation, seconds"').classes("sf-grow")
            self._clock = text("span", "", "sf-slotno")
        self._setting = False
        self._situation = Situation(self._to_slot, live_word="START")
        self._situation.show_overlay("Reading stored operations", "", spinner=True)
        ui.timer(0.1, self._load, once=True)
        ui.timer(TICK_S, self._tick)

    async def _load(self) -> None:
        titles: dict[str, str] = {}

        async def read() -> None:
            for line in await self._feed.operations():
                began = time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(line.created_at))
                titles[line.id] = f"{began} UTC, {line.id}, {line.state}"

        if not await attempt(read):
            return
        if not titles:
            self._situation.show_overlay(
                "No operation is stored yet", "Fly a plan or a drill; it can then be replayed here."
            )
            return
        self._choice.set_options(titles, value=next(iter(titles)))

    async def _chosen(self, event: events.ValueChangeEventArguments[str | None]) -> None:
        if event.value:
            await attempt(lambda: self._open(str(event.value)))

    async def _open(self, operation_id: str) -> None:
        operation = await self._feed.operation(operation_id)
        plans = {plan_id: await self._feed.plan(plan_id) for plan_id in operation.plan_ids}
        history = await self._history(operation_id)
        track = await self._feed.track(operation_id)
        self._recording = Recording(operation, plans, track, placed(history, operation_id, self._watch.time_scale))
        self._drawn.clear()
        self._playing = False
        self._play.set_text("Play")
        self._situation.overlay.set_visibility(False)
        self._situation.set_slots(self._recording.first.scenario.slots)
        self._bar.props(f"min={self._recording.begins_s:.1f} max={self._recording.ends_s:.1f}")
        self._go(max(self._recording.begins_s, 0.0))

    async def _history(self, operation_id: str) -> list[ServiceEvent]:
        """Return the stored events of the operation."""
        stored: list[ServiceEvent] = []
        after = 0
        while page := await self._feed.log(after):
            stored += [event for event in page if event.data.get("operation_id") == operation_id]
            after = page[-1].id or after + 1  # stored ones all have a number
        return stored

    # --- playing ---

    def _toggle(self) -> None:
        recording = self._recording
        if recording is None:
            return
        self._playing = not self._playing
        self._play.set_text("Stop" if self._playing else "Play")
        self._last = time.monotonic()
        if self._playing and self._at_s >= recording.ends_s:
            self._go(recording.begins_s)

    def _tick(self) -> None:
        now = time.monotonic()
        passed, self._last = now - self._last, now
        recording = self._recording
        if not self._playing or recording is None:
            return
        self._go(min(self._at_s + passed * float(self._speed.value or 1), recording.ends_s))
        if self._at_s >= recording.ends_s:
            self._toggle()

    def _dragged(self, event: events.ValueChangeEventArguments[float | None]) -> None:
        if not self._setting and event.value is not None:
            self._go(float(event.value))

    def _to_slot(self, slot: int | None) -> None:
        recording = self._recording
        if recording is not None:
            self._go(0.0 if slot is None else slot * recording.first.scenario.slot_duration_s)

    def _go(self, at_s: float) -> None:
        """Show this moment."""
        recording = self._recording
        if recording is None:
            return
        back, self._at_s = at_s < self._at_s, at_s
        self._setting = True
        self._bar.set_value(round(at_s, 1))
        self._setting = False
        self._clock.set_text(f"{at_s:.0f} s")
        slot = recording.slot(at_s)
        self._draw_scene(recording, at_s, moved_back=back)
        self._situation.map.set_frame(recording.frame(at_s))
        self._situation.fleet.set_rows(recording.rows(at_s))
        self._situation.show_slot(slot or 0, "" if slot is None else f"slot {slot}")
        self._draw_timeline(recording, slot)
        self._draw_events(recording, at_s, moved_back=back)
        known = tuple(
            recovery for recovery in recording.operation.recoveries if (recovery.declared_at_s or 0.0) <= at_s
        )
        if self._changed("recoveries", known):
            self._situation.show_recoveries(known)

    def _changed(self, name: str, value: object) -> bool:
        if name in self._drawn and self._drawn[name] == value:
            return False
        self._drawn[name] = value
        return True

    def _draw_scene(self, recording: Recording, at_s: float, *, moved_back: bool) -> None:
        plan, first = recording.in_force(at_s), recording.first
        flown = recording.tracks(at_s)
        if (
            not self._changed("scene", (plan.id, recording.lost(at_s), len(next(iter(flown.values()), []))))
            and not moved_back
        ):
            return
        plans = [("former", first), ("current", plan)] if plan.id != first.id else [("current", first)]
        taken = map_scene.reserved(first, recording.lost(at_s), recording.slot(at_s) or 0)
        self._situation.map.set_scene(
            map_scene.scene(first.scenario, plans, reserved=taken, tiles=self._tile_url), flown
        )

    def _draw_timeline(self, recording: Recording, slot: int | None) -> None:
        if not self._changed("timeline", slot):
            return
        operation, first = recording.operation, recording.first
        n = first.scenario.slots
        lines: dict[str, Any] = {
            "planned": charts.total(first.user_rates_bps, n),
            "achieved": charts.total(operation.user_rates_bps, n),
        }
        stats = [stats_line("planned", first), achieved_line(operation.user_rates_bps, operation.measured_slots)]
        last = recording.in_force(recording.ends_s)
        if last.id != first.id:
            begun: list[float | None] = [None] * last.first_slot
            lines["after replan"] = [*begun, *charts.total(last.user_rates_bps, last.scenario.slots)]
            stats.append(stats_line("after replan", last))
        users = {user: operation.user_rates_bps.get(user, []) for user in first.scenario.user_ids}
        lost = lost_at(operation, first.scenario.slot_duration_s)
        self._situation.draw_timeline(n, lines, users, cursor=slot, lost=lost)
        self._situation.set_stats("σ² in (kbit/s)², Jain:  " + "   ".join(figure for figure in stats if figure))

    def _draw_events(self, recording: Recording, at_s: float, *, moved_back: bool) -> None:
        if moved_back or self._changed("events of", recording.operation.id):
            self._situation.clear_events()
            self._shown_events = 0
        due = [event for at, event in recording.events if at <= at_s]
        if len(due) > self._shown_events:
            self._situation.add_events(due[self._shown_events :])
            self._shown_events = len(due)
