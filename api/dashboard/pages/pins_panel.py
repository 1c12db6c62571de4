"""The pins of the plan editor: what the next plan keeps, added from two small forms and listed."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui

from skyfolio.api.dashboard import draft_pins
from skyfolio.api.dashboard.draft_pins import DraftPins
from skyfolio.api.dashboard.elements import panel, text
from skyfolio.planner import Plan

HOVER, PATH = "hover", "path"


class PinsPanel:
    """A panel that edits the pins of the draft; `on_change` is called after each edit."""

    def __init__(self, on_change: Callable[[], None]) -> None:
        self._on_change = on_change
        self._pins = DraftPins()
        self._plan: Plan | None = None
        with panel("Pins", "sf-noshrink"), ui.element("div").classes("sf-body"):
            text("p", "What the next plan keeps. The rest is planned around it.", "sf-sub")
            with ui.element("div").classes("sf-row sf-pinrow"):
                self._uav = ui.select([], label="UAV to pin").props("dense outlined")
                self._hover = ui.button("Hover", on_click=lambda: self._pin_uav(HOVER)).props("outline dense no-caps")
                self._hover.props('title="It stays at its start"')
                self._path = ui.button("Keep path", on_click=lambda: self._pin_uav(PATH)).props("outline dense no-caps")
                self._path.props('title="It flies as in the plan that is shown"')
            with ui.element("div").classes("sf-row sf-pinrow"):
                self._user = ui.select([], label="User to pin").props("dense outlined")
                self._server = ui.select([], label="to UAV").props("dense outlined")
                self._serve = ui.button("Pin", on_click=self._pin_user).props("outline dense no-caps")
            self._list = ui.element("ul").classes("sf-pins").props('aria-label="pins"')

    def show(self, pins: DraftPins, uav_ids: list[str], user_ids: list[str]) -> None:
        """Show the pins of a draft with these UAVs and users."""
        self._pins = pins
        for select, ids in ((self._uav, uav_ids), (self._server, uav_ids), (self._user, user_ids)):
            kept = select.value if select.value in ids else (ids[0] if ids else None)
            select.set_options(ids, value=kept)
        self._draw()

    def offer(self, plan: Plan | None) -> None:
        """Offer the paths of this plan, which is shown and is one of the draft's scenario; None: there is none."""
        self._plan = plan
        self._path.set_enabled(plan is not None)

    def _pin_uav(self, how: str) -> None:
        uav = self._uav.value
        if uav is None:
            return
        if how == HOVER:
            self._pins.hover(uav)
        elif self._plan is not None and uav in self._plan.trajectories_m:
            self._pins.keep_path(uav, self._plan.trajectories_m[uav])
        self._changed()

    def _pin_user(self) -> None:
        if self._user.value is not None and self._server.value is not None:
            self._pins.serve(self._user.value, self._server.value)
            self._changed()

    def _release(self, kind: draft_pins.Kind, entry_id: str) -> None:
        self._pins.release(kind, entry_id)
        self._changed()

    def _changed(self) -> None:
        self._draw()
        self._on_change()

    def _draw(self) -> None:
        self._list.clear()
        with self._list:
            for kind, entry_id, words in draft_pins.rows(self._pins.pins):
                with ui.element("li"):
                    text("span", f"{entry_id} {words}")
                    free = ui.button(
                        icon="close", on_click=lambda _, kind=kind, entry_id=entry_id: self._release(kind, entry_id)
                    )
                    free.props(f'flat dense round size="sm" aria-label="release {entry_id}"')
