"""What an open editor keeps in its browser tab, so that a reload loses no scenario, no plan and no running one.

NiceGUI's tab storage lives in the server's memory for as long as the tab does.
"""

from __future__ import annotations

from typing import Any

from nicegui import app, ui

_DRAFT, _PLANS, _RUNNING = "plan-draft", "plan-kept", "plan-running"


class Desk:
    """The tab's own shelf. Reading and writing need a connected tab: `ready` waits for it."""

    async def ready(self) -> None:
        """Wait until the tab is connected; its shelf can be used from then on."""
        await ui.context.client.connected()

    @property
    def draft(self) -> dict[str, Any] | None:
        """The scenario as it was last edited, as JSON; None in a new tab."""
        kept: dict[str, Any] | None = self._shelf.get(_DRAFT)
        return kept

    def keep_draft(self, data: dict[str, Any]) -> None:
        """Remember the scenario."""
        self._shelf[_DRAFT] = data

    @property
    def plans(self) -> list[tuple[str, str]]:
        """(plan id, title) of the plans that were made here, the first made first."""
        return [(str(one), str(title)) for one, title in self._shelf.get(_PLANS, [])]

    def keep_plan(self, plan_id: str, title: str) -> None:
        """Remember a plan that was made here."""
        known = [entry for entry in self.plans if entry[0] != plan_id]
        self._shelf[_PLANS] = [*known, (plan_id, title)]

    @property
    def running(self) -> str | None:
        """The plan that is being made, None while none is."""
        kept: str | None = self._shelf.get(_RUNNING)
        return kept

    def keep_running(self, plan_id: str | None) -> None:
        """Remember the plan that is being made."""
        self._shelf[_RUNNING] = plan_id

    @property
    def _shelf(self) -> Any:
        return app.storage.tab
