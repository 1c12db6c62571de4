"""What waits for the operator: a proposed replan, UAVs to readmit, and UAVs that are low on battery."""

from __future__ import annotations

from nicegui import ui

from skyfolio.api.dashboard import comparison, map_scene
from skyfolio.api.dashboard.changes import of_plan
from skyfolio.api.dashboard.elements import MapView, attempt, figures, text
from skyfolio.api.dashboard.views import Operation, Recovery
from skyfolio.api.dashboard.watch import Watch
from skyfolio.planner import Plan


class Notices:
    """Banners above the situation, and the dialog that compares plans. Call `draw` when the operation has changed."""

    def __init__(self, watch: Watch) -> None:
        self._watch = watch
        self._drawn: object = None
        self._figures_of: object = None
        self._place = ui.element("div").props(
            'role="region" aria-label="waiting for your decision" aria-live="assertive"'
        )
        # seamless and at the bottom: the emergency controls in the header stay in sight and in reach
        with ui.dialog().props("full-width seamless position=bottom") as self._dialog, ui.card().classes("sf-decide"):
            pass
        self._card = self._dialog.default_slot.children[0]

    def draw(self, operation: Operation) -> None:
        """Show what waits for a decision now."""
        proposal = operation.proposal
        ready = proposal is not None and proposal.plan_id in self._watch.plans
        number = proposal.number if proposal and ready else None
        waiting = (operation.id, number, operation.returned, operation.low_on_battery)
        if waiting == self._drawn:
            if proposal is not None and ready and (operation.slot, proposal.plan_id) != self._figures_of:
                self._fill(operation, proposal)  # a new slot changes the figures
            return
        self._drawn = waiting
        self._place.clear()
        self._dialog.close()
        with self._place:
            if proposal is not None and ready:
                self._banner(operation, proposal)
            for uav in operation.returned:
                self._returned(operation, uav)
            for uav in operation.low_on_battery:
                self._low(operation, uav)
        if proposal is not None and ready:
            self._fill(operation, proposal)
            self._dialog.open()

    def _banner(self, operation: Operation, proposal: Recovery) -> None:
        with ui.element("div").classes("sf-proposal"):
            text(
                "span",
                f"{', '.join(proposal.lost)} lost. A replan for the survivors waits for your approval.",
                "sf-what",
            )
            ui.button("Before and after", on_click=self._dialog.open).props("outline")
            self._buttons(operation, proposal)

    def _returned(self, operation: Operation, uav: str) -> None:
        async def back() -> None:
            await attempt(
                lambda: self._watch.feed.readmit(operation.id, uav), f"{uav} is readmitted; the fleet is replanned"
            )

        with ui.element("div").classes("sf-proposal"):
            text("span", f"{uav} is heard again. It is not commanded unless you readmit it.", "sf-what")
            ui.button(f"Readmit {uav}", on_click=back).props("unelevated")

    def _low(self, operation: Operation, uav: str) -> None:
        async def home() -> None:
            await attempt(
                lambda: self._watch.feed.retire(operation.id, uav), f"{uav} returns; the others are replanned"
            )

        with ui.element("div").classes("sf-proposal"):
            text("span", f"{uav} is low on battery. It continues to fly its plan unless you send it home.", "sf-what")
            ui.button(f"Send {uav} home", on_click=home).props("unelevated")

    def _buttons(self, operation: Operation, proposal: Recovery) -> None:
        async def decide(*, agreed: bool) -> None:
            done = "Approved: the new plan is being uploaded" if agreed else "Rejected: the plan in force stays"
            if await attempt(lambda: self._watch.feed.decide(operation.id, proposal.number, agreed=agreed), done):
                self._dialog.close()

        ui.button("Approve", on_click=lambda: decide(agreed=True)).props("unelevated color=positive")
        ui.button("Reject", on_click=lambda: decide(agreed=False)).props("outline color=negative")

    def _fill(self, operation: Operation, proposal: Recovery) -> None:
        now, new = self._watch.plan_in_force(), self._watch.plans.get(proposal.plan_id or "")
        self._figures_of = (operation.slot, proposal.plan_id)
        self._card.clear()
        if now is None or new is None:
            return
        lost, slot = list(proposal.lost), max(new.first_slot, (operation.slot or 0) + 1)
        unchanged = comparison.without(now, lost, slot)
        with self._card:
            text("h2", f"{', '.join(lost)} lost: fly the new plan from slot {slot}?")
            with ui.element("div").classes("sf-pair"):
                top = max(map_scene.scene(plan.scenario, [("current", plan)])["rate_max"] for plan in (now, new))
                self._map("Before: no recovery", now, slot, lost, unchanged, top)
                self._map("After: the proposed plan", new, slot, [], None, top)
            courses = [comparison.rest(now, slot), unchanged, comparison.rest(new, slot)]
            head = (f"slots {slot} to the end", "as planned", "if rejected", "if approved")
            figures(comparison.rows([comparison.course(rates) for rates in courses]), head)
            for line in of_plan(new):
                text("p", line, "sf-sub")
            with ui.element("div").classes("sf-row"):
                self._buttons(operation, proposal)
                ui.button("Later", on_click=self._dialog.close).props("flat")

    def _map(
        self, title: str, plan: Plan, slot: int, lost: list[str], rates: dict[str, list[float]] | None, top: float
    ) -> None:
        """Draw one side of the comparison; `top` is the rate, in bit/s, that both sides colour brightest."""
        first = self._watch.first_plan() or plan
        n = min(max(slot - plan.first_slot, 0), plan.scenario.slots - 1)
        spots = [
            map_scene.Spot(uav_id=uav, at_m=path[n], lost=uav in lost) for uav, path in plan.trajectories_m.items()
        ]
        rates_now = {user: row[n] for user, row in plan.user_rates_bps.items()} if rates is None else _now(rates)
        with ui.element("div"):
            text("h3", title)
            view = MapView(title)
        scene = map_scene.scene(
            first.scenario, [("current", plan)], reserved=map_scene.reserved(plan, lost, slot), rate_max=top
        )
        frame = map_scene.frame(spots, plan, slot, rates_now, promise=first, live=False)

        def draw() -> None:
            view.set_scene(scene, {})
            view.set_frame(frame)

        with self._card:
            ui.timer(0.3, draw, once=True)


def _now(rates: dict[str, list[float]]) -> dict[str, float | None]:
    return {user: row[0] for user, row in rates.items()}
