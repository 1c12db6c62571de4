"""The situation: map, fleet, timeline, events and recoveries. The pages Fly and Replay show it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from nicegui import events, ui

from skyfolio.api.dashboard import charts
from skyfolio.api.dashboard.elements import FleetTable, MapView, panel, text
from skyfolio.api.dashboard.event_text import describe
from skyfolio.api.dashboard.map_scene import Json
from skyfolio.api.dashboard.measured import source_words
from skyfolio.api.dashboard.views import Recovery, ServiceEvent
from skyfolio.planner import Plan
from skyfolio.planner.utility import jain_index

SHOWN_EVENTS = 120
Row = Sequence[float | None]


class Situation:
    """The elements, which a page fills. `on_slot` is called with the chosen slot, or None for live."""

    def __init__(self, on_slot: Callable[[int | None], None], *, live_word: str = "LIVE") -> None:
        self._on_slot = on_slot
        self._selected: str | None = None
        self._setting = False
        with ui.element("main").classes("sf-situation"):
            with ui.element("section").classes("sf-panel sf-mapbox").props('aria-label="map"'):
                self.map = MapView("Map of the fleet. Arrow keys move, plus and minus zoom, 0 shows everything.")
                self.map.on("pick", lambda event: self._pick(event.args))
                self.overlay = ui.element("div").classes("sf-overlay")
            with ui.element("div").classes("sf-side"):
                with panel("Fleet", "sf-fleetbox"), ui.element("div").classes("sf-scroll"):
                    self.fleet = FleetTable()
                    self.fleet.on("pick", lambda event: self._pick(event.args))
                self._recoveries_panel = panel("Recovery", "sf-txbox")
                with (
                    self._recoveries_panel,
                    ui.element("div").classes("sf-scroll").props('aria-live="polite"') as self._recoveries,
                ):
                    pass
                self._recoveries_panel.set_visibility(False)
                with panel("Events", "sf-feedbox"), ui.element("div").classes("sf-scroll"):
                    self._events = ui.element("ol").classes("sf-events").props('aria-label="events, newest first"')
            self._timeline(live_word)

    def _timeline(self, live_word: str) -> None:
        with ui.element("section").classes("sf-panel sf-time").props('aria-label="timeline"'):
            with ui.element("div").classes("sf-timehead"):
                text("h2", "Timeline", "sf-title")
                self._stats = text("div", "", "sf-stats")
                self._slot_label = text("span", "slot", "sf-slotno")
                self._live = ui.button(live_word, on_click=self.go_live).props("dense unelevated").classes("sf-live")
            self._chart = ui.echart(charts.timeline(1, {}, {}), on_point_click=self._clicked).classes("sf-chart")
            with ui.element("div").classes("sf-scrub") as self._scrub:
                self._slider = ui.slider(min=0, max=1, step=1, value=0, on_change=self._slid)
                self._slider.props('aria-label="slot" markers snap')

    # --- what the page calls ---

    def show_overlay(self, title: str, body: str, *, spinner: bool = False) -> None:
        """Show a text in place of the map."""
        self.overlay.clear()
        self.overlay.set_visibility(True)
        with self.overlay:
            if spinner:
                ui.spinner(size="lg")
            text("h2", title)
            text("p", body)

    def set_slots(self, n_slots: int) -> None:
        """Set how many slots the operation has."""
        self._slider.props(f"max={max(n_slots - 1, 1)}")
        self._scrub.style(f"--sf-slots: {n_slots}")

    def show_slot(self, slot: int, label: str) -> None:
        """Move the slider to a slot without choosing that slot."""
        self._setting = True
        self._slider.set_value(slot)
        self._setting = False
        self._slot_label.set_text(label)

    def mark_live(self, live: bool) -> None:
        """Show whether the page follows the present."""
        self._live.props(f"color={'positive' if live else 'grey-7'} aria-pressed={'true' if live else 'false'}")

    def draw_timeline(self, n_slots: int, lines: Mapping[str, Row], users: Mapping[str, Row], **more: object) -> None:
        """Draw sum rates and user rates over the slots, in bit/s; `more` as for `charts.timeline`."""
        options = charts.timeline(n_slots, lines, users, **more)  # type: ignore[arg-type]
        self._chart.options.clear()
        self._chart.options.update(options)
        self._chart.update()

    def set_stats(self, stats: str) -> None:
        """Show variance and fairness as text."""
        self._stats.set_text(stats)

    def add_events(self, new: Sequence[ServiceEvent]) -> None:
        """Add new events at the top."""
        with self._events:
            for event in new:
                description, level = describe(event)
                if not description:
                    continue
                with ui.element("li").classes(level).props(f'data-kind="{event.kind}"') as line:
                    text("time", event.at[11:19])
                    text("span", description)
                line.move(target_index=0)
        children = list(self._events.default_slot.children)
        for old in children[SHOWN_EVENTS:]:
            old.delete()

    def clear_events(self) -> None:
        """Remove all events."""
        self._events.clear()

    def show_recoveries(self, recoveries: Sequence[Recovery]) -> None:
        """Show the recoveries with their steps, the newest first."""
        self._recoveries_panel.set_visibility(bool(recoveries))
        self._recoveries.clear()
        with self._recoveries:
            for recovery in reversed(recoveries):
                show_recovery(recovery)

    def go_live(self) -> None:
        """Return to the present."""
        self._on_slot(None)

    def select(self, uav_id: str | None) -> None:
        """Highlight one UAV on the map and in the table."""
        self._selected = uav_id
        self.map.select(uav_id)
        self.fleet.select(uav_id)

    def _pick(self, args: Json) -> None:
        if args.get("kind") == "uav":
            chosen = args.get("id")
            self.select(None if chosen == self._selected else chosen)

    def _slid(self, event: events.ValueChangeEventArguments[float | None]) -> None:
        if not self._setting and event.value is not None:
            self._on_slot(int(event.value))

    def _clicked(self, event: events.EChartPointClickEventArguments) -> None:
        cell = event.value
        self._on_slot(int(cell[0] if isinstance(cell, list) else event.data_index))


def show_recovery(recovery: Recovery) -> None:
    """Show one recovery: its steps, and how long each took."""
    with ui.element("div").classes("sf-tx").props(f'data-phase="{recovery.phase}"'):
        text("h3", recovery.title)
        with ui.element("ol").classes("sf-steps"):
            for step in recovery.steps:
                with ui.element("li").classes(step.state):
                    text("span", step.name)
                    text("span", step.took, "sf-took")
                    if step.detail:
                        text("span", step.detail, "sf-detail")
        for line in recovery.changes:
            text("p", line, "sf-sub sf-change")


def stats_line(name: str, plan: Plan) -> str:
    """Return a plan's variance in (kbit/s)² and Jain's index as text."""
    return f"{name} {plan.summary.sum_rate_variance_kbps2:.1f}, {plan.summary.jain:.3f}"


def achieved_line(table: Mapping[str, Row], measured_slots: Mapping[str, Sequence[int]]) -> str | None:
    """Return the same of achieved rates in bit/s, over the slots in which all are known; None before the second.

    It says whether they were measured.
    """
    rows = np.array([[np.nan if x is None else x for x in row] for row in table.values()], dtype=float)
    known = rows[:, ~np.isnan(rows).any(axis=0)] / 1e3 if rows.size else rows
    if known.size == 0 or known.shape[1] < 2:
        return None
    jain = jain_index(known) if known.any() else 0.0
    return f"achieved {float(known.sum(axis=0).var()):.1f}, {jain:.3f} ({source_words(table, measured_slots)})"
