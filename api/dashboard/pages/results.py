"""The right side of the plan editor: figures of plans, mu and its trade-off, comparisons, what-if, export, flying."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from nicegui import events, ui

from skyfolio.api.dashboard import changes, charts, plan_metrics
from skyfolio.api.dashboard.elements import attempt, figures, panel, say_refusal, text
from skyfolio.api.dashboard.pages.desk import Desk
from skyfolio.api.dashboard.pages.fly_dialog import FlyDialog
from skyfolio.api.dashboard.pages.reasons_dialog import ReasonsDialog
from skyfolio.api.dashboard.rest import RestError
from skyfolio.api.dashboard.watch import Watch
from skyfolio.planner import Pins, Plan, Scenario

TRADE_OFF_MUS = (0.0, -0.02, -0.05, -0.1, -0.2, -0.5, -1.0, -2.0)
FORMS = {"GeoJSON": "geojson", "KML": "kml", "CSV": "csv"}


@dataclass(frozen=True)
class TitledPlan:
    """A plan made on this page, and its title."""

    title: str
    plan: Plan


class Results:
    """The plans of one open editor.

    `on_show(plan, other)` is called with what the map should show, `on_mu` with a chosen mu. `desk` stores the plans
    for a reload.
    """

    def __init__(
        self,
        watch: Watch,
        desk: Desk,
        on_show: Callable[[Plan | None, Plan | None], None],
        on_mu: Callable[[float], None],
    ) -> None:
        self._watch, self._feed, self._desk = watch, watch.feed, desk
        self._on_show, self._on_mu = on_show, on_mu
        self._plans: dict[str, TitledPlan] = {}
        self._current: str | None = None
        self._tried: dict[float, Plan] = {}
        self._scenario: Scenario | None = None
        with ui.element("div").classes("sf-col sf-scroll"):
            self._plan_panel()
            self._trade_off_panel()
            self._what_if_panel()
        self._fly = FlyDialog(watch)
        self._reasons = ReasonsDialog(watch.feed)
        self._refresh()

    def _plan_panel(self) -> None:
        with panel("Plan", "sf-noshrink"), ui.element("div").classes("sf-body"):
            self._choice = ui.select({}, label="Plan", on_change=self._chosen).props("dense outlined")
            self._other = ui.select({}, label="Compare with", on_change=self._show, clearable=True)
            self._other.props("dense outlined")
            with ui.element("div").classes("sf-row"):
                self._fly_button = ui.button("Fly it", on_click=self._open_fly).props("unelevated")
                self._explain = ui.button("Explain", on_click=self._open_reasons).props("outline")
                self._explain.props('title="Why users get little, what more would be worth, which constraint binds"')
                self._export_uav = ui.select([], label="UAV").props("dense outlined").classes("sf-short")
                self._export = ui.button("Export .plan", on_click=self._export_plan).props("outline")
            with ui.element("div").classes("sf-row"):
                self._form = ui.select(list(FORMS), label="Format", value=next(iter(FORMS))).props("dense outlined")
                self._export_all = ui.button("Export map", on_click=self._export_map).props("outline")
                self._export_all.props('title="Paths and positions in each slot, users and zones in degrees"')
            self._metrics = ui.element("div").props('aria-live="polite"')
            self._sums = ui.echart(charts.sums({}, 1)).classes("sf-chart sf-sums")

    def _trade_off_panel(self) -> None:
        with panel("Steadiness against rate", "sf-noshrink"), ui.element("div").classes("sf-body"):
            text("p", "Each point is a plan with another mu. Click a point to use its mu.", "sf-sub")
            self._curve = ui.echart(charts.trade_off([], None), on_point_click=self._curve_clicked).classes(
                "sf-chart sf-curve"
            )
            self._sweep = ui.button("Draw the curve", on_click=self._draw_curve).props("outline")

    def _what_if_panel(self) -> None:
        with panel("What if", "sf-noshrink"), ui.element("div").classes("sf-row sf-body"):
            self._lose = ui.select([], label="Lose").props("dense outlined")
            self._at_slot = ui.number("at slot", min=0, step=1, value=10).props("dense outlined")
            self._ask = ui.button("Show", on_click=self._what_if).props("outline")
            self._ask_all = ui.button("Compare all UAVs", on_click=self._what_if_any).props("outline")
            self._weight = ui.number("changes must be worth, kbit/s", min=0, step=1, value=0).props("dense outlined")
            self._any = ui.element("div").classes("sf-all").props('aria-live="polite"')

    # --- what the editor calls ---

    async def make(self, scenario: Scenario, pins: Pins) -> None:
        """Plan the scenario and show the result, which keeps these pins."""

        async def begin() -> None:
            self._desk.keep_running(await self._feed.begin_plan(scenario, pins))

        if await attempt(begin):
            await self.resume_running()

    async def resume_running(self) -> None:
        """Wait for the plan that is being made, even if it was begun before a reload, and show it."""
        running = self._desk.running
        if running is None:
            return
        try:
            plan = await self._feed.awaited_plan(running)
        except RestError as error:
            say_refusal(error)
            return
        finally:
            self._desk.keep_running(None)
        self._scenario = plan.scenario
        self._tried = {plan.scenario.utility.mu_per_kbps: plan}
        self._keep(plan_metrics.title(plan.scenario), plan)

    async def recall(self) -> None:
        """Show the plans that were made before a reload, except those that the service no longer stores."""
        for plan_id, title in self._desk.plans:
            with suppress(RestError):
                self._plans[plan_id] = TitledPlan(title, await self._feed.plan(plan_id))
        if self._plans:
            self._current = next(reversed(self._plans))
            self._scenario = self._plans[self._current].plan.scenario
            self._refresh()

    def forget_current(self) -> None:
        """Show no plan until the next one is made, because the scenario has changed."""
        if self._current is not None:
            self._current = None
            self._tried = {}
            self._refresh()

    # --- plans ---

    async def _plan(self, scenario: Scenario, pins: Pins) -> Plan | None:
        try:
            return await self._feed.make_plan(scenario, pins=pins)
        except RestError as error:
            say_refusal(error)
            return None

    def _keep(self, title: str, plan: Plan) -> None:
        self._plans[plan.id] = TitledPlan(f"{len(self._plans) + 1}: {title}", plan)
        self._desk.keep_plan(plan.id, self._plans[plan.id].title)
        self._current = plan.id
        self._refresh()

    def _chosen(self, event: events.ValueChangeEventArguments[str | None]) -> None:
        if event.value and event.value != self._current:
            self._current = event.value
            self._refresh()

    def _refresh(self) -> None:
        options = {plan_id: titled.title for plan_id, titled in self._plans.items()}
        self._choice.set_options(options, value=self._current)
        others = {plan_id: title for plan_id, title in options.items() if plan_id != self._current}
        self._other.set_options(others, value=self._other.value if self._other.value in others else None)
        plan = self._plans[self._current].plan if self._current else None
        uavs = list(plan.scenario.uav_ids) if plan else []
        for select in (self._export_uav, self._lose):
            select.set_options(uavs, value=select.value if select.value in uavs else (uavs[0] if uavs else None))
        for button in (self._export, self._export_all, self._explain, self._ask, self._ask_all, self._sweep):
            button.set_enabled(plan is not None)
        self._fly_button.set_enabled(plan is not None and plan.parent is None)
        self._show()

    def _show(self) -> None:
        plan = self._plans[self._current].plan if self._current else None
        chosen = self._other.value
        other = self._plans[chosen].plan if chosen in self._plans else None
        self._metrics.clear()
        with self._metrics:
            if plan is None:
                text("p", "No plan of this scenario yet: press “Plan it”.", "sf-sub")
            else:
                figures(*plan_metrics.rows(plan, other))
                if (flown := plan_metrics.altitudes(plan))[0]:
                    figures(*flown)
                if energy := plan_metrics.energy(plan):
                    figures(energy, plan_metrics.ENERGY_HEAD)
                for line in changes.of_plan(plan):
                    text("p", line, "sf-sub")
                if unmet := plan_metrics.unmet(plan):
                    text("p", f"{len(unmet)} users do not always get their minimum rate", "sf-fail").props(
                        'role="alert"'
                    )
                    figures(unmet, ("user", "requires, kbit/s", "lowest rate", "slots below"))
        self._draw_sums(plan, other)
        self._draw_trade_off()
        self._on_show(plan, other)

    def _draw_sums(self, plan: Plan | None, other: Plan | None) -> None:
        self._sums.set_visibility(plan is not None)
        if plan is None:
            return
        n = max(option.first_slot + option.scenario.slots for option in (plan, other) if option)
        lines = {"this": plan_metrics.sums(plan, n)} | ({"other": plan_metrics.sums(other, n)} if other else {})
        _redraw(self._sums, charts.sums(lines, n))

    # --- mu ---

    async def _draw_curve(self) -> None:
        scenario = self._scenario
        if scenario is None or self._current is None:
            return
        pins = self._plans[self._current].plan.pins
        self._sweep.props("loading")
        try:
            for mu in TRADE_OFF_MUS:
                if mu not in self._tried:
                    plan = await self._plan(plan_metrics.with_mu(scenario, mu), pins)
                    if plan is None or scenario is not self._scenario:
                        return
                    self._tried[mu] = plan
                    self._draw_trade_off()
                    await asyncio.sleep(0)
        finally:
            self._sweep.props(remove="loading")

    def _draw_trade_off(self) -> None:
        points = plan_metrics.trade_off(self._tried)
        current = self._plans[self._current].plan.scenario.utility.mu_per_kbps if self._current else None
        _redraw(self._curve, charts.trade_off(points, current))

    def _curve_clicked(self, event: events.EChartPointClickEventArguments) -> None:
        mu = plan_metrics.trade_off(self._tried)[event.data_index][0]
        plan = self._tried[mu]
        self._on_mu(mu)
        if plan.id in self._plans:
            self._current = plan.id
            self._refresh()
        else:
            self._keep(plan_metrics.title(plan.scenario), plan)

    # --- what if, export, fly ---

    async def _what_if(self) -> None:
        base, uav, slot = self._current, self._lose.value, self._at_slot.value
        if base is None or uav is None or slot is None:
            return

        async def ask() -> None:
            plan = await self._feed.what_if(base, str(uav), int(slot), float(self._weight.value or 0.0))
            self._keep(f"{uav} lost at slot {int(slot)}", plan)
            self._other.set_value(base)

        await attempt(ask)

    async def _what_if_any(self) -> None:
        base, slot = self._current, self._at_slot.value
        if base is None or slot is None:
            return

        async def ask() -> None:
            table = await self._feed.contingencies(base, int(slot))
            self._any.clear()
            with self._any:
                figures(plan_metrics.losses(table), (f"lost at slot {int(slot)}", "with a replan", "without"))
                text("p", f"mean sum rate from then on, kbit/s; without a loss {plan_metrics.planned(table)}", "sf-sub")

        self._ask_all.props("loading")
        await attempt(ask)
        self._ask_all.props(remove="loading")

    async def _export_plan(self) -> None:
        plan_id, uav = self._current, self._export_uav.value
        if plan_id is None or uav is None:
            return

        async def export() -> None:
            document = await self._feed.mission_file(plan_id, str(uav))
            ui.download.content(json.dumps(document, indent=4), f"{plan_id}-{uav}.plan", "application/json")

        await attempt(export)

    async def _open_reasons(self) -> None:
        if self._current is not None:
            self._explain.props("loading")
            await self._reasons.open(self._current)
            self._explain.props(remove="loading")

    async def _export_map(self) -> None:
        plan_id, form = self._current, FORMS[str(self._form.value)]
        if plan_id is None:
            return

        async def export() -> None:
            ui.download.content(await self._feed.plan_file(plan_id, form), f"{plan_id}.{form}")

        await attempt(export)

    def _open_fly(self) -> None:
        if self._current is not None:
            self._fly.open(self._plans[self._current].plan)


def _redraw(chart: ui.echart, options: charts.Json) -> None:
    chart.options.clear()
    chart.options.update(options)
    chart.update()
