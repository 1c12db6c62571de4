"""A scenario being edited: plain JSON that may break rules until it is validated as a `Scenario`. Pure."""

from __future__ import annotations

import json
from copy import deepcopy
from typing import Any, Literal

from pydantic import ValidationError

from skyfolio.api.dashboard.draft_pins import DraftPins
from skyfolio.planner import PinError, Pins, Scenario, pinned

Kind = Literal["uav", "user"]
LISTS: dict[str, str] = {"uav": "uavs", "user": "users"}


class DraftError(ValueError):
    """The file or the edit does not make a valid scenario; the message names the fields and the rules."""


class Draft:
    """A scenario that is being edited. Positions are metres east/north of its origin."""

    def __init__(self, scenario: Scenario) -> None:
        self.data: dict[str, Any] = scenario.model_dump(mode="json")
        self.pins = DraftPins()

    @classmethod
    def of_data(cls, data: dict[str, Any], pins: dict[str, Any] | None = None) -> Draft:
        """Return a draft from stored data, whether or not it is a valid scenario."""
        draft = cls.__new__(cls)
        draft.data = deepcopy(data)
        draft.pins = DraftPins.of_data(pins or {})
        return draft

    @classmethod
    def from_file(cls, content: bytes) -> Draft:
        """Read a scenario, or the scenario and the pins of a plan, from a JSON file. Raises DraftError."""
        try:
            document = json.loads(content.decode("utf-8-sig"))
        except (UnicodeDecodeError, ValueError) as error:
            raise DraftError(f"the file is not JSON: {error}") from error
        if not isinstance(document, dict):
            raise DraftError("the file must hold one JSON object: a scenario, or a plan")
        pins = document.pop("pins", None) or {}
        if isinstance(document.get("scenario"), dict):
            document = document["scenario"]
        try:
            draft = cls(Scenario.model_validate_json(json.dumps(document)))
            draft.pins = DraftPins(Pins.model_validate_json(json.dumps(pins)))
        except ValidationError as error:
            raise DraftError(broken(error)) from error
        return draft

    def scenario(self) -> Scenario:
        """Return the scenario as edited. Raises DraftError with every broken rule."""
        try:
            return Scenario.model_validate_json(json.dumps(self.data))
        except (ValidationError, ValueError) as error:
            raise DraftError(broken(error) if isinstance(error, ValidationError) else str(error)) from error

    def pinned(self) -> Pins:
        """Return the pins of the scenario as edited. Raises DraftError with the first one that cannot be kept."""
        try:
            pinned(self.scenario(), self.pins.pins)
        except PinError as error:
            raise DraftError(str(error)) from error
        return self.pins.pins

    def ids(self, kind: Kind) -> list[str]:
        """Return the ids of all UAVs, or of all users."""
        return [entry["id"] for entry in self.data[LISTS[kind]]]

    def position(self, kind: Kind, entry_id: str) -> tuple[float, float]:
        """Return the position of a UAV or user. Raises KeyError."""
        east, north = self._entry(kind, entry_id)[_where(kind)]
        return float(east), float(north)

    def place(self, kind: Kind, east_m: float, north_m: float) -> str:
        """Add a UAV or a user with the properties of the last one, and return its id."""
        rows = self.data[LISTS[kind]]
        number = 1 + max((int(tail) for entry in rows if (tail := entry["id"].rpartition("-")[2]).isdigit()), default=0)
        new = {**deepcopy(rows[-1]), "id": f"{kind}-{number}"}
        if kind == "uav":
            new.update(end_m=None, leaves_at_slot=None)
            new.pop("end_deg", None)
        _put(new, kind, east_m, north_m)
        rows.append(new)
        return str(new["id"])

    def move(self, kind: Kind, entry_id: str, east_m: float, north_m: float) -> None:
        """Move a UAV or a user. Raises KeyError."""
        _put(self._entry(kind, entry_id), kind, east_m, north_m)
        if kind == "uav":
            self.pins.release_path(entry_id)

    def remove(self, kind: Kind, entry_id: str) -> None:
        """Remove a UAV or a user. Raises DraftError if it is the last one, and KeyError if there is none."""
        rows = self.data[LISTS[kind]]
        if len(rows) == 1:
            raise DraftError(f"{LISTS[kind]}: at least one must remain")
        rows.remove(self._entry(kind, entry_id))
        self.pins.keep_only(self.ids("uav"), self.ids("user"))

    def set_mu(self, mu_per_kbps: float) -> None:
        """Set the weight of steadiness: 0 maximises the sum rate alone, more negative values are steadier."""
        self.data["utility"]["mu_per_kbps"] = mu_per_kbps

    @property
    def mu_per_kbps(self) -> float:
        """The weight of steadiness."""
        return float(self.data["utility"]["mu_per_kbps"])

    def _entry(self, kind: Kind, entry_id: str) -> dict[str, Any]:
        for entry in self.data[LISTS[kind]]:
            if entry["id"] == entry_id:
                match: dict[str, Any] = entry
                return match
        raise KeyError(entry_id)


def broken(error: ValidationError) -> str:
    """Return the first five broken rules as `field: message`."""
    rows = []
    for problem in error.errors():
        field = ".".join(str(part) for part in problem["loc"])
        message = str(problem["msg"]).removeprefix("Value error, ")
        rows.append(f"{field}: {message}" if field else message)
    return "; ".join(rows[:5])


def _put(entry: dict[str, Any], kind: Kind, east_m: float, north_m: float) -> None:
    """Set the position, and move a user's track along; where it was in degrees is no longer so."""
    east, north = entry[_where(kind)]
    entry[_where(kind)] = [east_m, north_m]
    entry.pop(_where(kind).replace("_m", "_deg"), None)
    if kind == "user" and entry.get("positions_m"):
        track = [[e + east_m - east, n + north_m - north] for e, n in entry["positions_m"]]
        entry["positions_m"] = [[east_m, north_m], *track[1:]]
        entry.pop("positions_deg", None)


def _where(kind: Kind) -> str:
    return "start_m" if kind == "uav" else "position_m"
