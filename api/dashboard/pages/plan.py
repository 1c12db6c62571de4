"""The plan editor: draw or load a scenario, make plans of it, compare, export and fly them."""

from __future__ import annotations

from collections.abc import Coroutine
from typing import Any

from nicegui import events, ui

from skyfolio.api.dashboard import map_scene
from skyfolio.api.dashboard.draft import Draft, DraftError
from skyfolio.api.dashboard.elements import MapView, attempt, panel, text
from skyfolio.api.dashboard.pages.desk import Desk
from skyfolio.api.dashboard.pages.pins_panel import PinsPanel
from skyfolio.api.dashboard.pages.results import Results
from skyfolio.api.dashboard.rest import RestError
from skyfolio.api.dashboard.shell import Shell
from skyfolio.api.dashboard.watch import Watch
from skyfolio.planner import Plan, Scenario

TOOLS = {None: "Look", "user": "+ User", "uav": "+ UAV", "remove": "Remove"}
FIELDS = (
    ("slots", "Slots", 1, 1),
    ("slot_duration_s", "Slot, s", 0.1, 1.0),
    ("altitude_m", "Altitude, m", 1.0, 5.0),
    ("min_separation_m", "Separation, m", 0.0, 1.0),
)
START_WITH = "paper"
PLACES = (".geojson", ".csv", ".tsv", ".kml", ".tif", ".tiff", ".hgt")
"""Endings of files that are imported; a `.json` file is a scenario or a plan."""
LOADS = (
    "A scenario or a plan as JSON; or users, UAVs and zones as GeoJSON, CSV or KML, and the ground as GeoTIFF or SRTM"
)


class PlanPage:
    """One open editor with its own draft and plans."""

    def __init__(self, watch: Watch) -> None:
        self._feed, self._desk = watch.feed, Desk()
        self._draft: Draft | None = None
        self._shown: Plan | None = None
        self._other: Plan | None = None
        self._setting = False
        Shell(watch, "Plan")
        with ui.element("main").classes("sf-work"):
            with ui.element("div").classes("sf-col"):
                self._editor()
            with panel("Scenario and plan", "sf-mapbox"):
                self._map = MapView("Scenario. With a tool chosen, click to place and drag to move.")
                self._map.on("place", lambda event: self._place(event.args))
                self._map.on("moved", lambda event: self._moved(event.args))
                with ui.element("div").classes("sf-row sf-body sf-nowrap"):
                    self._slot_label = text("span", "slot 0", "sf-slotno")
                    self._slider = ui.slider(min=0, max=1, step=1, value=0, on_change=self._draw_frame)
                    self._slider.props('aria-label="slot"').classes("sf-grow")
            self._results = Results(watch, self._desk, self._plan_chosen, self._mu_chosen)
        ui.timer(0.05, self._load, once=True)

    def _editor(self) -> None:
        with panel("Scenario", "sf-noshrink"), ui.element("div").classes("sf-body"):
            with ui.element("div").classes("sf-row"):
                self._example = ui.select({}, label="Example", on_change=self._example_chosen).props("dense outlined")
                upload = ui.upload(multiple=True, auto_upload=True, on_multi_upload=self._uploaded)
                upload.props(f'accept=".json,{",".join(PLACES)}" max-files=20').classes("sf-upload")
                load = ui.button("Load file", on_click=lambda: upload.run_method("pickFiles")).props("outline")
                load.props(f'title="{LOADS}"')
            with ui.element("div").classes("sf-row"):
                self._fields = {
                    name: ui.number(label, min=least, step=step, on_change=self._fields_changed).props("dense outlined")
                    for name, label, least, step in FIELDS
                }
            self._mu = ui.number("mu, 1/(kbit/s): 0 maximises the rate, below 0 is steadier", max=0, step=0.05)
            self._mu.props("dense outlined").on_value_change(self._fields_changed)
            self._counts = text("p", "", "sf-sub")
            self._complaint = text("p", "", "sf-fail").props('role="alert"')
            self._run = ui.button("Plan it", on_click=self._plan_it).props("unelevated").classes("sf-run")
        self._pins = PinsPanel(lambda: self._changed(moved=False))
        with panel("Place", "sf-grow"):
            with ui.element("div").classes("sf-body"):
                self._tool = ui.toggle({key or "look": name for key, name in TOOLS.items()}, value="look")
                self._tool.props("no-caps dense unelevated spread").on_value_change(self._tool_chosen)
                text("p", "Choose a tool and click the map to place, drag to move, or type positions here:", "sf-sub")
            with ui.element("div").classes("sf-scroll sf-positions") as self._positions:
                pass

    # --- loading ---

    async def _load(self) -> None:
        """Restore what this tab had before a reload, or begin with an example."""
        await self._desk.ready()
        stored = self._desk.draft
        await self._load_examples(choose=stored is None)
        if stored is not None:
            self._use(Draft.of_data(stored, self._desk.pins))
        await self._results.recall()
        if self._desk.running is not None:
            await self._awaiting(self._results.resume_running())

    async def _load_examples(self, *, choose: bool) -> None:
        names: list[str] = []

        async def read() -> None:
            names.extend(await self._feed.examples())

        if await attempt(read):
            first = START_WITH if START_WITH in names else names[0]
            self._example.set_options(names, value=first if choose else None)

    async def _example_chosen(self, event: events.ValueChangeEventArguments[str | None]) -> None:
        if event.value:
            name = event.value

            async def read() -> None:
                self._use(Draft(await self._feed.example(name)))

            await attempt(read)

    async def _uploaded(self, event: events.MultiUploadEventArguments) -> None:
        event.sender.run_method("reset")
        names = ", ".join(file.name for file in event.files)
        try:
            draft, notes = await self._read({file.name: await file.read() for file in event.files})
        except DraftError as error:
            self._complaint.set_text(f"{names}: {error}")
            return
        except RestError as error:
            self._complaint.set_text(error.detail)
            return
        self._example.set_value(None)
        self._use(draft)
        said = "; ".join([f"{names} loaded", *notes])
        ui.notify(said, type="positive", position="bottom-left", timeout=8000 if notes else 2500)

    async def _read(self, files: dict[str, bytes]) -> tuple[Draft, list[str]]:
        """Return the draft that the files hold. Raises DraftError and RestError."""
        if not any(name.lower().endswith(PLACES) for name in files):
            if len(files) > 1:
                raise DraftError("a scenario or a plan in JSON is loaded alone")
            return Draft.from_file(*files.values()), []
        scenario, notes = await self._feed.imported(files, self._base())
        return Draft(scenario), notes

    def _base(self) -> Scenario | None:
        """Return the scenario on the page, if it is a valid one: what the files do not have is taken from it."""
        try:
            return None if self._draft is None else self._draft.scenario()
        except DraftError:
            return None  # its broken rules are shown on the page already

    def _use(self, draft: Draft) -> None:
        self._draft = draft
        self._results.forget_current()
        self._setting = True
        for name, number in self._fields.items():
            number.set_value(draft.data[name])
        self._mu.set_value(draft.mu_per_kbps)
        self._setting = False
        self._changed()

    # --- editing ---

    def _tool_chosen(self, event: events.ValueChangeEventArguments[str | None]) -> None:
        self._map.use(None if event.value == "look" else event.value)

    def _place(self, args: map_scene.Json) -> None:
        if self._draft is None:
            return
        try:
            if args["tool"] != "remove":
                self._draft.place(args["tool"], args["e"], args["n"])
            elif args.get("id"):
                self._draft.remove(args["kind"], args["id"])
        except DraftError as error:
            ui.notify(str(error), type="warning", position="top")
        self._changed()

    def _moved(self, args: map_scene.Json) -> None:
        if self._draft is not None:
            self._draft.move(args["kind"], args["id"], args["e"], args["n"])
            self._changed()

    def _fields_changed(self) -> None:
        if self._draft is None or self._setting:
            return
        for name, number in self._fields.items():
            value = number.value
            self._draft.data[name] = int(value) if name == "slots" and value is not None else value
        self._draft.set_mu(self._mu.value if self._mu.value is not None else 0.0)
        self._changed(moved=False)

    def _changed(self, *, moved: bool = True) -> None:
        """Draw the draft as it is now; a plan of an older draft is no longer shown."""
        if self._draft is None:
            return
        self._results.forget_current()
        if moved:
            self._list_positions(self._draft)
        self._desk.keep_draft(self._draft.data, self._draft.pins.data())
        self._pins.show(self._draft.pins, self._draft.ids("uav"), self._draft.ids("user"))
        counts = f"{len(self._draft.ids('uav'))} UAVs, {len(self._draft.ids('user'))} users"
        self._counts.set_text(", ".join([counts, *map_scene.ground_words(self._draft.data)]))
        self._shown = None
        self._slot_label.set_text("not planned")
        drawn, frame = map_scene.sketch(self._draft.data, self._draft.pins.pins)
        self._map.set_scene(drawn, {})
        self._map.set_frame(frame)
        try:
            self._draft.pinned()
        except DraftError as error:
            self._complaint.set_text(str(error))
            self._run.disable()
            return
        self._complaint.set_text("")
        self._run.enable()

    def _list_positions(self, draft: Draft) -> None:
        self._positions.clear()
        with self._positions, ui.element("table").classes("sf-figures"), ui.element("tbody"):
            for kind in ("uav", "user"):
                for entry_id in draft.ids(kind)[:60]:
                    with ui.element("tr"):
                        text("th", entry_id)
                        for axis in (0, 1):
                            with ui.element("td"):
                                self._coordinate(draft, kind, entry_id, axis)

    def _coordinate(self, draft: Draft, kind: str, entry_id: str, axis: int) -> None:
        where = draft.position(kind, entry_id)  # type: ignore[arg-type]

        def changed(event: events.ValueChangeEventArguments[float | None]) -> None:
            if event.value is not None:
                here = list(draft.position(kind, entry_id))  # type: ignore[arg-type]
                here[axis] = float(event.value)
                draft.move(kind, entry_id, *here)  # type: ignore[arg-type]
                self._changed(moved=False)

        number = ui.number(value=where[axis], step=5, format="%.2f", on_change=changed).props("dense borderless")
        number.props(f'aria-label="{entry_id} {("east", "north")[axis]}, metres" suffix="{"EN"[axis]}"').classes(
            "sf-coord"
        )

    # --- planning and drawing ---

    async def _plan_it(self) -> None:
        if self._draft is not None:
            await self._awaiting(self._results.make(self._draft.scenario(), self._draft.pinned()))

    async def _awaiting(self, work: Coroutine[Any, Any, None]) -> None:
        self._run.props("loading")
        try:
            await work
        finally:
            self._run.props(remove="loading")

    def _mu_chosen(self, mu: float) -> None:
        self._setting = True
        self._mu.set_value(mu)
        self._setting = False
        if self._draft is not None:
            self._draft.set_mu(mu)
            self._desk.keep_draft(self._draft.data, self._draft.pins.data())

    def _plan_chosen(self, plan: Plan | None, other: Plan | None) -> None:
        """Draw the plan that was chosen among the results, and offer its paths to be pinned."""
        self._pins.offer(plan if plan is not None and plan.parent is None else None)
        if plan is not None:
            self._other = other
            self._draw(plan, other)

    def _last_positions(self, plan: Plan) -> dict[str, tuple[float, float]]:
        """Return the UAVs that only the compared plan has, and where they were lost."""
        other = self._other
        if other is None or plan.parent != other.id:
            return {}
        gone = set(other.scenario.uav_ids) - set(plan.scenario.uav_ids)
        return {uav: other.trajectories_m[uav][plan.first_slot - other.first_slot] for uav in gone}

    def _draw(self, plan: Plan, other: Plan | None) -> None:
        plans = [("current", plan)] + ([("other", other)] if other else [])
        largest = max((shown for _, shown in plans), key=lambda shown: len(shown.scenario.uavs)).scenario
        self._map.set_scene(map_scene.scene(largest, plans), {})
        self._shown = plan
        last = plan.first_slot + plan.scenario.slots - 1
        self._slider.props(f"min={plan.first_slot} max={max(last, plan.first_slot + 1)}")
        if not plan.first_slot <= (self._slider.value or 0) <= last:
            self._slider.set_value(plan.first_slot)
        self._draw_frame()

    def _draw_frame(self) -> None:
        plan = self._shown
        if plan is not None:
            slot = int(self._slider.value or 0)
            self._slot_label.set_text(f"slot {slot}")
            self._map.set_frame(map_scene.planned_frame(plan, slot, lost_at_m=self._last_positions(plan)))
