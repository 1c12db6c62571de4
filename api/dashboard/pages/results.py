"""The right side of the plan editor: what plans are worth, mu and its trade-off, comparing, what-if, export, flying."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from nicegui import events, ui

from api.dashboard import charts
from api.dashboard.elements import attempt, figures, panel, say_refusal, text
from api.dashboard.rest import RestError
from api.dashboard.watch import Watch
from planner import Plan, Scenario

TRADE_OFF_MUS = (0.0, -0.02, -0.05, -0.1, -0.2, -0.5, -1.0, -2.0)
POLICIES = {"auto": "replan and fly it", "approve": "replan, then ask me", "off": "only tell me"}


@dataclass(frozen=True)
class Kept:
    """A plan made on this page, and what it was made for."""

    title: str
    plan: Plan


class Results:
    """Plans of one open editor. `on_show(plan, other)` hears what the map shall show; `on_mu` a chosen mu."""

    def __init__(
        self, watch: Watch, on_show: Callable[[Plan | None, Plan | None], None], on_mu: Callable[[float], None]
    ) -> None:
        self._watch, self._feed = watch, watch.feed
        self._on_show, self._on_mu = on_show, on_mu
        self._kept: dict[str, Kept] = {}
        self._current: str | None = None
        self._tried: dict[float, Plan] = {}
        self._scenario: Scenario | None = None
        with ui.element("div").classes("sf-col sf-scroll"):
            self._worth_panel()
            self._trade_off_panel()
            self._what_if_panel()
        self._fly = FlyDialog(watch)
        self._refresh()

    def _worth_panel(self) -> None:
        with panel("Plan", "sf-noshrink"), ui.element("div").classes("sf-body"):
            self._choice = ui.select({}, label="Plan", on_change=self._chosen).props("dense outlined")
            self._other = ui.select({}, label="Compare with", on_change=self._show, clearable=True)
            self._other.props("dense outlined")
            with ui.element("div").classes("sf-row"):
                self._fly_button = ui.button("Fly it", on_click=self._open_fly).props("unelevated")
                self._export_uav = ui.select([], label="UAV").props("dense outlined").classes("sf-short")
                self._export = ui.button("Export .plan", on_click=self._export_plan).props("outline")
            self._worth = ui.element("div").props('aria-live="polite"')
            self._sums = ui.echart(charts.sums({}, 1)).classes("sf-chart sf-sums")

    def _trade_off_panel(self) -> None:
        with panel("Steadiness against rate", "sf-noshrink"), ui.element("div").classes("sf-body"):
            text("p", "Each point is a plan with another mu. Click one to use it.", "sf-sub")
            self._curve = ui.echart(charts.trade_off([], None), on_point_click=self._curve_clicked).classes(
                "sf-chart sf-curve"
            )
            self._sweep = ui.button("Draw the curve", on_click=self._draw_curve).props("outline")

    def _what_if_panel(self) -> None:
        with panel("What if", "sf-noshrink"), ui.element("div").classes("sf-row sf-body"):
            self._lose = ui.select([], label="Lose").props("dense outlined")
            self._at_slot = ui.number("at slot", min=0, step=1, value=10).props("dense outlined")
            self._ask = ui.button("Show", on_click=self._what_if).props("outline")

    # --- what the editor calls ---

    async def make(self, scenario: Scenario) -> None:
        """Plan the scenario and show the result."""
        plan = await self._plan(scenario)
        if plan is not None:
            self._scenario = scenario
            self._tried = {scenario.utility.mu_per_kbps: plan}
            self._keep(_title(scenario), plan)

    def forget_current(self) -> None:
        """The scenario has changed: no plan is shown until the next one is made."""
        if self._current is not None:
            self._current = None
            self._tried = {}
            self._refresh()

    # --- plans ---

    async def _plan(self, scenario: Scenario) -> Plan | None:
        try:
            return await self._feed.make_plan(scenario)
        except RestError as error:
            say_refusal(error)
            return None

    def _keep(self, title: str, plan: Plan) -> None:
        self._kept[plan.id] = Kept(f"{len(self._kept) + 1}: {title}", plan)
        self._current = plan.id
        self._refresh()

    def _chosen(self, event: events.ValueChangeEventArguments[str | None]) -> None:
        if event.value and event.value != self._current:
            self._current = event.value
            self._refresh()

    def _refresh(self) -> None:
        options = {plan_id: kept.title for plan_id, kept in self._kept.items()}
        self._choice.set_options(options, value=self._current)
        others = {plan_id: title for plan_id, title in options.items() if plan_id != self._current}
        self._other.set_options(others, value=self._other.value if self._other.value in others else None)
        plan = self._kept[self._current].plan if self._current else None
        uavs = list(plan.scenario.uav_ids) if plan else []
        for select in (self._export_uav, self._lose):
            select.set_options(uavs, value=select.value if select.value in uavs else (uavs[0] if uavs else None))
        for button in (self._export, self._ask, self._sweep):
            button.set_enabled(plan is not None)
        self._fly_button.set_enabled(plan is not None and plan.parent is None)
        self._show()

    def _show(self) -> None:
        plan = self._kept[self._current].plan if self._current else None
        chosen = self._other.value
        other = self._kept[chosen].plan if chosen in self._kept else None
        self._worth.clear()
        with self._worth:
            if plan is None:
                text("p", "No plan of this scenario yet: press “Plan it”.", "sf-sub")
            else:
                figures(*_worth(plan, other))
        self._draw_sums(plan, other)
        self._draw_trade_off()
        self._on_show(plan, other)

    def _draw_sums(self, plan: Plan | None, other: Plan | None) -> None:
        self._sums.set_visibility(plan is not None)
        if plan is None:
            return
        n = max(each.first_slot + each.scenario.slots for each in (plan, other) if each)
        lines = {"this": _sums(plan, n)} | ({"other": _sums(other, n)} if other else {})
        _redraw(self._sums, charts.sums(lines, n))

    # --- mu ---

    async def _draw_curve(self) -> None:
        scenario = self._scenario
        if scenario is None:
            return
        self._sweep.props("loading")
        try:
            for mu in TRADE_OFF_MUS:
                if mu not in self._tried:
                    plan = await self._plan(_with_mu(scenario, mu))
                    if plan is None or scenario is not self._scenario:
                        return
                    self._tried[mu] = plan
                    self._draw_trade_off()
                    await asyncio.sleep(0)
        finally:
            self._sweep.props(remove="loading")

    def _draw_trade_off(self) -> None:
        points = [
            (mu, plan.summary.sum_rate_variance_kbps2**0.5, plan.summary.mean_sum_rate_bps / 1e3)
            for mu, plan in sorted(self._tried.items())
        ]
        current = self._kept[self._current].plan.scenario.utility.mu_per_kbps if self._current else None
        _redraw(self._curve, charts.trade_off(points, current))

    def _curve_clicked(self, event: events.EChartPointClickEventArguments) -> None:
        mu, plan = sorted(self._tried.items())[event.data_index]
        self._on_mu(mu)
        if plan.id in self._kept:
            self._current = plan.id
            self._refresh()
        else:
            self._keep(_title(plan.scenario), plan)

    # --- what if, export, fly ---

    async def _what_if(self) -> None:
        base, uav, slot = self._current, self._lose.value, self._at_slot.value
        if base is None or uav is None or slot is None:
            return

        async def ask() -> None:
            plan = await self._feed.what_if(base, str(uav), int(slot))
            self._keep(f"{uav} lost at slot {int(slot)}", plan)
            self._other.set_value(base)

        await attempt(ask)

    async def _export_plan(self) -> None:
        plan_id, uav = self._current, self._export_uav.value
        if plan_id is None or uav is None:
            return

        async def export() -> None:
            document = await self._feed.mission_file(plan_id, str(uav))
            ui.download.content(json.dumps(document, indent=4), f"{plan_id}-{uav}.plan", "application/json")

        await attempt(export)

    def _open_fly(self) -> None:
        if self._current is not None:
            self._fly.open(self._kept[self._current].plan)


class FlyDialog:
    """Asks which vehicle flies which UAV, and what shall happen after a loss; then starts the operation."""

    def __init__(self, watch: Watch) -> None:
        self._watch = watch
        self._plan: Plan | None = None
        self._systems: dict[str, ui.number] = {}
        with ui.dialog() as self._dialog, ui.card().classes("sf-flycard"):
            text("h2", "Fly this plan")
            text("p", "MAVLink system id of the vehicle that flies each UAV:", "sf-sub")
            self._rows = ui.element("div").classes("sf-systems")
            self._policy = ui.select(POLICIES, value="auto", label="When a UAV is lost").props("dense outlined")
            with ui.element("div").classes("sf-row"):
                self._start = ui.button("Start: upload, arm, take off", on_click=self._begin).props(
                    "unelevated autofocus"
                )
                ui.button("Cancel", on_click=self._dialog.close).props("flat")

    def open(self, plan: Plan) -> None:
        """Ask about this plan."""
        self._plan = plan
        self._rows.clear()
        known = {uav: seen.vehicle.system_id for uav, seen in self._watch.seen.items()}
        with self._rows:
            self._systems = {
                uav: ui.number(uav, value=known.get(uav, number), min=1, max=254, step=1).props("dense outlined")
                for number, uav in enumerate(plan.scenario.uav_ids, start=1)
            }
        self._dialog.open()

    async def _begin(self) -> None:
        plan = self._plan
        if plan is None:
            return
        systems: Mapping[str, int] = {uav: int(number.value or 0) for uav, number in self._systems.items()}

        async def begin() -> None:
            operation = await self._watch.feed.start(plan.id, systems, str(self._policy.value))
            self._watch.show(operation.id)

        self._start.props("loading")
        started = await attempt(begin)
        self._start.props(remove="loading")
        if started:
            self._dialog.close()
            ui.navigate.to("/")


def _title(scenario: Scenario) -> str:
    return f"{len(scenario.uavs)} UAVs, {len(scenario.users)} users, mu {scenario.utility.mu_per_kbps:g}"


def _with_mu(scenario: Scenario, mu: float) -> Scenario:
    return scenario.with_changes(utility=scenario.utility.model_copy(update={"mu_per_kbps": mu}))


def _sums(plan: Plan, n_slots: int) -> list[float | None]:
    before: list[float | None] = [None] * plan.first_slot
    if plan.achieved_rates_bps:
        before = list(charts.total(plan.achieved_rates_bps, plan.first_slot))
    made = [*before, *charts.total(plan.user_rates_bps, plan.scenario.slots)]
    return [*made, *[None] * (n_slots - len(made))]


def _worth(plan: Plan, other: Plan | None) -> tuple[list[tuple[str, ...]], tuple[str, ...] | None]:
    """Rows of the table, and its head when two plans are compared."""
    shown = [each for each in (plan, other) if each is not None]
    worst = [min(sum(row) / len(row) for row in each.user_rates_bps.values()) for each in shown]
    sums = [each.summary for each in shown]
    rows: list[tuple[str, ...]] = [
        ("utility, kbit/s", *(f"{each.utility_bps / 1e3:.2f}" for each in sums)),
        ("mean sum rate, kbit/s", *(f"{each.mean_sum_rate_bps / 1e3:.2f}" for each in sums)),
        ("variance, (kbit/s)²", *(f"{each.sum_rate_variance_kbps2:.2f}" for each in sums)),
        ("Jain index", *(f"{each.jain:.3f}" for each in sums)),
        ("worst user's mean, kbit/s", *(f"{value / 1e3:.2f}" for value in worst)),
        ("gap to the upper bound", *(f"{each.gap:.1%}" for each in sums)),
        ("solved in", *("–" if each.solve_ms is None else f"{each.solve_ms:.0f} ms" for each in shown)),  # noqa: RUF001
    ]
    return rows, ("", "this", "other") if other else None


def _redraw(chart: ui.echart, options: charts.Json) -> None:
    chart.options.clear()
    chart.options.update(options)
    chart.update()
