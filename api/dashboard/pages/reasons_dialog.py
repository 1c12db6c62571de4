"""Why a plan is as it is: a dialog of three tables, made by the service when it is opened."""

from __future__ import annotations

from nicegui import ui

from skyfolio.api.dashboard import reasons
from skyfolio.api.dashboard.elements import attempt, figures, text
from skyfolio.api.dashboard.feed import Feed
from skyfolio.planner import Explanation


class ReasonsDialog:
    """The dialog; `open` asks the service and fills it."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        # seamless and at the bottom: the emergency controls in the header stay in sight and in reach
        with ui.dialog().props("full-width seamless position=bottom") as self._dialog:
            self._card = ui.card().classes("sf-decide sf-reasons")

    async def open(self, plan_id: str) -> bool:
        """Explain this plan, show why it is as it is, and return whether the service could."""
        found: list[Explanation] = []

        async def read() -> None:
            found.append(await self._feed.explanation(plan_id))

        if not await attempt(read):
            return False
        self._fill(found[0])
        self._dialog.open()
        return True

    def _fill(self, found: Explanation) -> None:
        self._card.clear()
        with self._card:
            with ui.element("div").classes("sf-row sf-between"):
                text("h2", "Why the plan is as it is")
                ui.button("Close", on_click=self._dialog.close).props("flat autofocus")
            text("p", reasons.summary(found), "sf-sub")
            self._table("Users", reasons.users(found), reasons.USERS_HEAD, "rates in kbit/s")
            self._table("What it would be worth", reasons.worths(found), reasons.WORTHS_HEAD, "gains in kbit/s")
            self._table("Constraints that bind", reasons.prices(found), reasons.PRICES_HEAD, "utility gained")
            for note in (reasons.HOW_LONG, *found.notes):
                text("p", note, "sf-sub")

    @staticmethod
    def _table(title: str, rows: list[reasons.Row], head: reasons.Row, unit: str) -> None:
        with ui.element("section").props(f'aria-label="{title}"'):
            text("h3", f"{title} ({unit})")
            if rows:
                figures(rows, head).classes("sf-words")
            else:
                text("p", "None.", "sf-sub")
