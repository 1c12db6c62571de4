"""From a plan into the air: which vehicle flies which UAV, and what happens after a loss."""

from __future__ import annotations

from collections.abc import Mapping

from nicegui import ui

from skyfolio.api.dashboard import plan_metrics
from skyfolio.api.dashboard.elements import attempt, text
from skyfolio.api.dashboard.watch import Watch
from skyfolio.planner import Plan

POLICIES = {"auto": "replan and fly it", "approve": "replan, then ask me", "off": "only notify me"}


class FlyDialog:
    """A dialog that asks which vehicle flies which UAV and what to do after a loss, and starts the operation."""

    def __init__(self, watch: Watch) -> None:
        self._watch = watch
        self._plan: Plan | None = None
        self._systems: dict[str, ui.number] = {}
        with ui.dialog() as self._dialog, ui.card().classes("sf-flycard"):
            text("h2", "Fly this plan")
            text("p", "MAVLink system id of the vehicle that flies each UAV:", "sf-sub")
            self._short = text("p", "", "sf-fail").props('role="alert"')
            self._agreed = ui.checkbox("Fly it anyway", on_change=self._check)
            self._rows = ui.element("div").classes("sf-systems")
            self._policy = ui.select(POLICIES, value="auto", label="When a UAV is lost").props("dense outlined")
            self._weight = ui.number("A recovery's change must be worth, kbit/s", min=0, step=1)
            self._weight.props("dense outlined clearable").classes("sf-wide")
            text("p", "For each user that changes server, and each 100 m off the old paths; empty: as set.", "sf-sub")
            self._pins = text("p", "", "sf-sub")
            with ui.element("div").classes("sf-row"):
                self._start = ui.button("Start: upload, arm, take off", on_click=self._begin).props(
                    "unelevated autofocus"
                )
                ui.button("Cancel", on_click=self._dialog.close).props("flat")

    def open(self, plan: Plan) -> None:
        """Open the dialog for this plan."""
        self._plan = plan
        short = plan_metrics.unmet(plan)
        self._short.set_text(
            f"Below the minimum rate in some slots: {', '.join(row[0] for row in short)}." if short else ""
        )
        self._agreed.set_value(not short)
        self._agreed.set_visibility(bool(short))
        pinned = [*plan.pins.pinned_uavs, *plan.pins.associations]
        self._pins.set_text(f"Recoveries keep its pins as far as they hold: {', '.join(pinned)}." if pinned else "")
        self._check()
        self._rows.clear()
        known = {uav: tracked.vehicle.system_id for uav, tracked in self._watch.vehicles.items()}
        with self._rows:
            self._systems = {
                uav: ui.number(uav, value=known.get(uav, number), min=1, max=254, step=1).props("dense outlined")
                for number, uav in enumerate(plan.scenario.uav_ids, start=1)
            }
        self._dialog.open()

    def _check(self) -> None:
        self._start.set_enabled(bool(self._agreed.value))

    async def _begin(self) -> None:
        plan = self._plan
        if plan is None:
            return
        systems: Mapping[str, int] = {uav: int(number.value or 0) for uav, number in self._systems.items()}

        async def begin() -> None:
            policy, weight = str(self._policy.value), self._weight.value
            operation = await self._watch.feed.start(plan.id, systems, policy, weight)
            self._watch.show(operation.id)

        self._start.props("loading")
        started = await attempt(begin)
        self._start.props(remove="loading")
        if started:
            self._dialog.close()
            ui.navigate.to("/")
