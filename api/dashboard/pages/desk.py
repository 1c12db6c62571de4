"""What an open editor stores for its browser tab, so that a reload loses neither the scenario nor any plan.

NiceGUI's tab storage lives in the server's memory for as long as the tab does.
"""

from __future__ import annotations

from typing import Any

from nicegui import app, ui

_DRAFT, _PINS, _PLANS, _RUNNING = "plan-draft", "plan-pins", "plan-kept", "plan-running"


class Desk:
    """The storage of one tab. Reading and writing need a connected tab: `ready` waits for it."""

    async def ready(self) -> None:
        """Wait until the tab is connected; its storage can be used from then on."""
        await ui.context.client.connected()

    @property
    def draft(self) -> dict[str, Any] | None:
        """The scenario as last edited, as JSON; None in a new tab."""
        draft: dict[str, Any] | None = self._shelf.get(_DRAFT)
        return draft

    @property
    def pins(self) -> dict[str, Any] | None:
        """The pins as last edited, as JSON; None in a new tab."""
        pins: dict[str, Any] | None = self._shelf.get(_PINS)
        return pins

    def keep_draft(self, data: dict[str, Any], pins: dict[str, Any]) -> None:
        """Store the scenario and its pins."""
        self._shelf[_DRAFT] = data
        self._shelf[_PINS] = pins

    @property
    def plans(self) -> list[tuple[str, str]]:
        """(plan id, title) of the plans made in this tab, in the order in which they were made."""
        return [(str(plan_id), str(title)) for plan_id, title in self._shelf.get(_PLANS, [])]

    def keep_plan(self, plan_id: str, title: str) -> None:
        """Store a plan that was made in this tab."""
        known = [entry for entry in self.plans if entry[0] != plan_id]
        self._shelf[_PLANS] = [*known, (plan_id, title)]

    @property
    def running(self) -> str | None:
        """The id of the plan that is being made, None if there is none."""
        plan_id: str | None = self._shelf.get(_RUNNING)
        return plan_id

    def keep_running(self, plan_id: str | None) -> None:
        """Store the id of the plan that is being made."""
        self._shelf[_RUNNING] = plan_id

    @property
    def _shelf(self) -> Any:
        return app.storage.tab
