"""The two elements that run in the browser, and small elements that pages share."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from nicegui import ui
from nicegui.elements.mixins.text_element import TextElement

from skyfolio.api.dashboard.map_scene import Json
from skyfolio.api.dashboard.rest import RestError


class MapView(ui.element, component="components/map.js"):
    """The canvas map. Without a tool a click selects; with one it emits `place` with metres east/north."""

    def __init__(self, label: str) -> None:
        super().__init__()
        self._props["label"] = label
        self._props["tool"] = None

    def set_scene(self, scene: Json, tracks: Json | None = None) -> None:
        """Draw what stays; `tracks` replaces the flown tracks: {uav: [[east, north]]}."""
        self.run_method("set_scene", scene, tracks)

    def set_frame(self, frame: Json) -> None:
        """Draw what moves."""
        self.run_method("set_frame", frame)

    def select(self, uav_id: str | None) -> None:
        """Highlight one UAV, or none."""
        self.run_method("select", uav_id)

    def use(self, tool: str | None) -> None:
        """Choose what a click on the map does."""
        self._props["tool"] = tool
        self.update()


class FleetTable(ui.element, component="components/fleet.js"):
    """The fleet, with one row for each UAV."""

    def set_rows(self, rows: list[Json]) -> None:
        """Replace all rows."""
        self.run_method("set_rows", rows)

    def select(self, uav_id: str | None) -> None:
        """Highlight one row, or none."""
        self.run_method("select", uav_id)


def text(tag: str, words: str, classes: str = "") -> TextElement:
    """Return an HTML element that holds text."""
    return TextElement(tag=tag, text=words).classes(classes)


def panel(title: str, classes: str = "") -> ui.element:
    """Return a section with a heading, to be used as a context manager."""
    with ui.element("section").classes(f"sf-panel {classes}").props(f'aria-label="{title}"') as section:
        text("h2", title, "sf-title")
    return section


async def attempt(action: Callable[[], Awaitable[Any]], done: str | None = None) -> bool:
    """Do something for the operator, show a refusal prominently, and return whether it succeeded."""
    try:
        await action()
    except RestError as error:
        say_refusal(error)
        return False
    if done:
        ui.notify(done, type="positive", position="bottom-left", timeout=2500)
    return True


def say_refusal(error: RestError) -> None:
    """Show a refusal until the operator closes it."""
    ui.notify(
        f"{error.title}: {error.detail}",
        type="negative",
        position="top",
        timeout=0,
        close_button="Close",
        multi_line=True,
    )


def figures(rows: list[tuple[str, ...]], head: tuple[str, ...] | None = None) -> ui.element:
    """Return a small table of figures; the first column names them."""
    with ui.element("table").classes("sf-figures") as table:
        if head:
            with ui.element("thead"), ui.element("tr"):
                for name in head:
                    text("th", name)
        with ui.element("tbody"):
            for first, *rest in rows:
                with ui.element("tr"):
                    text("th", first)
                    for cell in rest:
                        text("td", cell)
    return table
