"""The frame of every page: navigation, the state of the operation, and the four controls that are always there."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from nicegui import ui

from skyfolio.api.dashboard.elements import attempt, say_refusal, text
from skyfolio.api.dashboard.rest import RestError
from skyfolio.api.dashboard.watch import Watch

PAGES = (("Fly", "./"), ("Plan", "plan"), ("Drill", "drill"), ("Replay", "replay"))
REFRESH_S = 0.5
HEARD = ("live", "stale")
"""Link states of vehicles that can be commanded."""
THEME = """
const kept = localStorage.getItem("skyfolio-theme");
const dark = kept ? kept === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
Quasar.Dark.set(dark);
"""
TOGGLE = "Quasar.Dark.toggle(); localStorage.setItem('skyfolio-theme', Quasar.Dark.isActive ? 'dark' : 'light')"


class Shell:
    """The header and the banner of one open page."""

    def __init__(self, watch: Watch, active: str) -> None:
        self._watch = watch
        ui.page_title(f"{active} · skyfolio")
        ui.colors(primary="#0072b2", positive="#00795a", negative="#b3400a", warning="#c98500")
        ui.run_javascript(THEME)
        with ui.element("header").classes("sf-head"):
            text("span", "skyfolio", "sf-brand")
            with ui.element("nav").classes("sf-nav").props('aria-label="pages"'):
                for name, target in PAGES:
                    link = text("a", name).props(f'href="{target}"')
                    if name == active:
                        link.props('aria-current="page"')
            with ui.element("div").classes("sf-status").props('role="status" aria-live="polite"'):
                self._what = text("span", "connecting", "sf-what")
            theme = ui.button(icon="contrast").props('flat dense color="white" aria-label="light or dark"')
            theme.on("click", js_handler=f"() => {{ {TOGGLE} }}")
            self._controls()
        self._banner = text("div", "", "sf-banner").props('role="alert"')
        self._banner.set_visibility(False)
        ui.keyboard(on_key=self._on_key, ignore=["input", "select", "textarea"])
        ui.timer(REFRESH_S, self._refresh)

    def _controls(self) -> None:
        self._confirm_rtl = self._asking(
            "Return the whole fleet home?", "flies home and lands", "RTL ALL", "rtl", "#b84a00", self._rtl_all
        )
        self._confirm_land = self._asking(
            "Land the whole fleet?", "lands where it is", "LAND ALL", "land", "#7a2e8a", self._land_all
        )
        with ui.element("div").classes("sf-controls").props('role="group" aria-label="fleet control"'):
            self._pause = ui.button("PAUSE", on_click=self._toggle_pause, color=None).classes("sf-act-pause")
            self._hold = ui.button("HOLD ALL", on_click=self._hold_all, color=None).classes("sf-act-hold")
            self._rtl = ui.button("RTL ALL", on_click=self._confirm_rtl.open, color=None).classes("sf-act-rtl")
            self._land = ui.button("LAND ALL", on_click=self._confirm_land.open, color=None).classes("sf-act-land")
            for button, key, what in (
                (self._pause, "Shift+P", "hold in place, to be resumed later"),
                (self._hold, "Shift+H", "every vehicle that is heard holds; operations end"),
                (self._rtl, "Shift+R", "every vehicle that is heard returns home; operations end"),
                (self._land, "Shift+L", "every vehicle that is heard lands where it is; operations end"),
            ):
                button.props(f'unelevated title="{what} ({key})"')

    @staticmethod
    def _asking(
        question: str, what: str, label: str, name: str, colour: str, act: Callable[[], Awaitable[None]]
    ) -> ui.dialog:
        """Return a dialog that asks for confirmation before the fleet comes down."""
        with ui.dialog() as dialog, ui.card():
            text("h2", question)
            ui.label(f"Every vehicle that is heard {what}. Operations end.")
            with ui.element("div").classes("sf-row"):
                ui.button(label, on_click=act, color=None).props("unelevated autofocus").classes(
                    f"sf-act-{name} sf-confirm-{name}"
                ).style(f"background:{colour};color:#fff")
                ui.button("Keep flying", on_click=dialog.close).props("flat")
        return dialog

    def _refresh(self) -> None:
        operation = self._watch.operation
        under_way = operation is not None and not operation.ended
        self._what.set_text(self._status_text())
        heard = any(tracked.vehicle.link in HEARD for tracked in self._watch.vehicles.values())
        self._pause.set_enabled(under_way)
        for button in (self._hold, self._rtl, self._land):
            button.set_enabled(heard)
        self._pause.set_text("RESUME" if operation and operation.state == "paused" else "PAUSE")
        self._banner.set_text(f"The service cannot be read: {self._watch.error}" if self._watch.error else "")
        self._banner.set_visibility(bool(self._watch.error))

    def _status_text(self) -> str:
        operation = self._watch.operation
        if operation is None:
            return "no operation" if self._watch.loaded else "connecting"
        plan = self._watch.first_plan()
        words = [f"{operation.id} {operation.state.replace('_', ' ').upper()}"]
        if operation.slot is not None and plan is not None:
            words.append(f"slot {operation.slot} of {plan.scenario.slots - 1}")
        if operation.lost:
            words.append(f"lost: {', '.join(operation.lost)}")
        words.append(f"replans: {operation.policy}")
        return " · ".join(words)

    async def _on_operation(self, action: Callable[[str], Awaitable[None]], done: str) -> None:
        operation = self._watch.operation
        if operation is not None and not operation.ended:
            await attempt(lambda: action(operation.id), done)

    async def _toggle_pause(self) -> None:
        operation = self._watch.operation
        if operation is not None and operation.state == "paused":
            await self._on_operation(self._watch.feed.resume, "Operation resumed")
        else:
            await self._on_operation(self._watch.feed.pause, "Paused: every vehicle holds in place")

    async def _hold_all(self) -> None:
        await self._order("hold", "holds")

    async def _rtl_all(self) -> None:
        self._confirm_rtl.close()
        await self._order("return", "returns home")

    async def _land_all(self) -> None:
        self._confirm_land.close()
        await self._order("land", "lands")

    async def _order(self, action: str, does: str) -> None:
        """Order the whole fleet; a message names the vehicles that do not obey until the operator closes it."""
        try:
            results = await self._watch.feed.order(action)
        except RestError as error:
            say_refusal(error)
            return
        obedient = [result.uav_id for result in results if result.outcome == "ok"]
        ui.notify(
            f"{does}: {', '.join(obedient) or 'no vehicle'}", type="positive", position="bottom-left", timeout=2500
        )
        failed = "; ".join(f"{result.uav_id}: {result.reason}" for result in results if result.outcome == "failed")
        if failed:
            say_refusal(RestError(502, f"Not every vehicle {does}", failed))

    async def _on_key(self, event: object) -> None:
        key, action, modifiers = (getattr(event, name) for name in ("key", "action", "modifiers"))
        if not (action.keydown and not action.repeat and modifiers.shift):
            return
        if key == "P":
            await self._toggle_pause()
        elif key == "H":
            await self._hold_all()
        elif key == "R":
            self._confirm_rtl.open()
        elif key == "L":
            self._confirm_land.open()
