"""Drills: choose a fault, a UAV and a slot; watch what the service does; save the report."""

from __future__ import annotations

from nicegui import ui

from skyfolio.api.dashboard import live
from skyfolio.api.dashboard.elements import MapView, attempt, figures, panel, text
from skyfolio.api.dashboard.pages.fly_dialog import POLICIES
from skyfolio.api.dashboard.report import Report, report_of
from skyfolio.api.dashboard.report_page import page
from skyfolio.api.dashboard.rest import RestError
from skyfolio.api.dashboard.shell import Shell
from skyfolio.api.dashboard.situation import show_recovery
from skyfolio.api.dashboard.views import Drill, Operation
from skyfolio.api.dashboard.watch import Watch
from skyfolio.planner import Plan, Scenario

SLOT = 10


class DrillPage:
    """One open drill page. The drill itself runs in the service, whether or not somebody looks."""

    def __init__(self, watch: Watch) -> None:
        self._watch, self._feed = watch, watch.feed
        self._drill: Drill | None = None
        self._operation_id: str | None = None
        self._drawn: object = None
        self._scene_of: object = None
        self._report: Report | None = None
        Shell(watch, "Drill")
        with ui.element("main").classes("sf-work two"):
            with ui.element("div").classes("sf-col"):
                self._form()
                with panel("Course of the drill", "sf-grow"), ui.element("div").classes("sf-scroll sf-body"):
                    self._course = ui.element("div").props('aria-live="polite"')
            with ui.element("div").classes("sf-col"):
                with panel("Map", "sf-mapbox"):
                    self._map = MapView("Map of the drill")
                with panel("Report", "sf-report"), ui.element("div").classes("sf-scroll sf-body"):
                    self._result = ui.element("div").props('aria-live="polite"')
        self._say("No drill yet: choose on the left and start.")
        with self._result:
            text("p", "The report appears when the operation has ended.", "sf-sub")
        ui.timer(0.1, self._load, once=True)
        ui.timer(0.5, self._tick)
        ui.timer(0.2, self._draw_map)

    def _form(self) -> None:
        with panel("Drill", "sf-noshrink"), ui.element("div").classes("sf-body"):
            text(
                "p",
                "Plans the example, flies it with the service's own simulated fleet, and injects a fault.",
                "sf-sub",
            )
            self._example = ui.select([], label="Scenario", on_change=self._example_chosen).props("dense outlined")
            self._fault = ui.select([], label="Fault").props("dense outlined")
            with ui.element("div").classes("sf-row"):
                self._uav = ui.select([], label="UAV").props("dense outlined")
                self._slot = ui.number("When this slot begins", value=SLOT, min=0, step=1).props("dense outlined")
            self._policy = ui.select(POLICIES, value="auto", label="When a UAV is lost").props("dense outlined")
            self._begin = ui.button("Start the drill", on_click=self._start).props("unelevated")

    async def _load(self) -> None:
        async def read() -> None:
            examples, faults = await self._feed.examples(), await self._feed.faults()
            self._fault.set_options(faults, value="kill" if "kill" in faults else faults[0])
            self._example.set_options(examples, value="paper" if "paper" in examples else examples[0])
            newest, operation = await self._feed.newest_drill(), self._watch.operation
            if newest is not None and operation is not None and newest.operation_id == operation.id:
                self._drill, self._operation_id = newest, newest.operation_id

        await attempt(read)

    async def _example_chosen(self) -> None:
        async def read() -> None:
            scenario = await self._feed.example(str(self._example.value))
            self._uav.set_options(list(scenario.uav_ids), value=scenario.uav_ids[-1])
            self._slot.props(f"max={scenario.slots - 1}")
            self._slot.set_value(min(SLOT, scenario.slots // 2))

        if self._example.value:
            await attempt(read)

    async def _start(self) -> None:
        self._begin.props("loading")
        self._result.clear()
        with self._result:
            text("p", "The report appears when the operation has ended.", "sf-sub")
        self._report = None
        try:
            await attempt(self._fly)
        finally:
            self._begin.props(remove="loading")

    async def _fly(self) -> None:
        scenario = await self._feed.example(str(self._example.value))
        systems = await self._simulated(scenario)
        self._say("planning")
        plan = await self._feed.make_plan(scenario)
        operation = await self._feed.start(plan.id, systems, str(self._policy.value))
        self._operation_id = operation.id
        self._watch.show(operation.id)
        slot = None if self._slot.value is None else int(self._slot.value)
        try:
            self._drill = await self._feed.drill(operation.id, str(self._uav.value), str(self._fault.value), slot)
        except BaseException:
            await self._feed.abort(operation.id, "hold")
            raise

    async def _simulated(self, scenario: Scenario) -> dict[str, int]:
        """Return the system id of each UAV. Raises RestError if one is not simulated: a drill never flies real ones."""
        known = {vehicle.uav_id: vehicle for vehicle in await self._feed.vehicles() if vehicle.simulated}
        missing = [uav for uav in scenario.uav_ids if uav not in known]
        if missing:
            self._say("No drill: this service does not simulate a fleet for this scenario.")
            start = f"start the service with `skyfolio serve --simulate {self._example.value}`"
            raise RestError(409, "No simulated fleet", f"{', '.join(missing)} are not simulated; {start}")
        return {uav: known[uav].system_id for uav in scenario.uav_ids}

    async def _tick(self) -> None:
        operation, first = self._watch.operation, self._watch.first_plan()
        if self._operation_id is None or operation is None or first is None or operation.id != self._operation_id:
            return
        if self._drill is not None and self._drill.state == "scheduled":
            self._drill = await self._feed.drill_now(self._drill.id)
        state = (operation.state, operation.slot, operation.lost, operation.recoveries, self._drill)
        if state != self._drawn:
            self._drawn = state
            self._draw(operation, first)
        if operation.ended and self._report is None:
            await self._finish(operation)

    def _draw(self, operation: Operation, first: Plan) -> None:
        slot = "" if operation.slot is None else f", slot {operation.slot} of {first.scenario.slots - 1}"
        self._say(f"operation {operation.state}{slot}")
        with self._course:
            if self._drill is not None:
                when = "at once" if self._drill.at_slot is None else f"when slot {self._drill.at_slot} begins"
                text("p", f"{self._drill.fault} of {self._drill.uav_id} {when}: {self._drill.state}", "sf-sub")
            for recovery in operation.recoveries:
                show_recovery(recovery)

    async def _finish(self, operation: Operation) -> None:
        plans = [self._watch.plans[plan_id] for plan_id in operation.plan_ids if plan_id in self._watch.plans]
        track = await self._feed.track(operation.id)
        self._report = report = report_of(operation, plans, track, self._drill)
        self._result.clear()
        with self._result:
            text("p", report.verdict, "sf-pass" if report.recovered else "sf-fail")
            figures(report.rows, report.head)
            with ui.element("div").classes("sf-row"):
                ui.button("Save the report (HTML)", on_click=lambda: _save(report)).props("unelevated")

    def _draw_map(self) -> None:
        operation, plan, first = self._watch.operation, self._watch.plan_in_force(), self._watch.first_plan()
        if operation is None or plan is None or first is None or operation.id != self._operation_id:
            return
        if (operation.id, plan.id, operation.lost) != self._scene_of:
            self._scene_of = (operation.id, plan.id, operation.lost)
            self._map.set_scene(live.scene(operation, plan, first, None), live.tracks(self._watch))
        self._map.set_frame(live.frame(self._watch, operation, plan, first))

    def _say(self, message: str) -> None:
        self._course.clear()
        with self._course:
            text("p", message)


def _save(report: Report) -> None:
    ui.download.content(page(report), f"drill-{report.operation_id}.html", "text/html")
