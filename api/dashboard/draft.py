"""A scenario being edited: plain JSON that may break rules until it is made a `Scenario`. Pure."""

from __future__ import annotations

import json
from copy import deepcopy
from typing import Any, Literal

from pydantic import ValidationError

from skyfolio.planner import Scenario

Kind = Literal["uav", "user"]
LISTS: dict[str, str] = {"uav": "uavs", "user": "users"}


class DraftError(ValueError):
    """The file or the edit makes no scenario; the message names the fields and the rules."""


class Draft:
    """Edits a scenario. Positions are metres east/north of its origin."""

    def __init__(self, scenario: Scenario) -> None:
        self.data: dict[str, Any] = scenario.model_dump(mode="json")

    @classmethod
    def of_data(cls, data: dict[str, Any]) -> Draft:
        """A draft as it was kept, whether or not it makes a scenario."""
        draft = cls.__new__(cls)
        draft.data = deepcopy(data)
        return draft

    @classmethod
    def from_file(cls, content: bytes) -> Draft:
        """From a scenario as JSON, or from a plan, whose scenario it takes. Raises DraftError."""
        try:
            given = json.loads(content.decode("utf-8-sig"))
        except (UnicodeDecodeError, ValueError) as error:
            raise DraftError(f"the file is not JSON: {error}") from error
        if not isinstance(given, dict):
            raise DraftError("the file must hold one JSON object: a scenario, or a plan")
        if isinstance(given.get("scenario"), dict):
            given = given["scenario"]
        try:
            return cls(Scenario.model_validate_json(json.dumps(given)))
        except ValidationError as error:
            raise DraftError(broken(error)) from error

    def scenario(self) -> Scenario:
        """The scenario as edited. Raises DraftError with every broken rule."""
        try:
            return Scenario.model_validate_json(json.dumps(self.data))
        except (ValidationError, ValueError) as error:
            raise DraftError(broken(error) if isinstance(error, ValidationError) else str(error)) from error

    def ids(self, kind: Kind) -> list[str]:
        """Ids of all UAVs, or of all users."""
        return [one["id"] for one in self.data[LISTS[kind]]]

    def position(self, kind: Kind, one_id: str) -> tuple[float, float]:
        """Where it is. Raises KeyError."""
        east, north = self._one(kind, one_id)[_where(kind)]
        return float(east), float(north)

    def place(self, kind: Kind, east_m: float, north_m: float) -> str:
        """Add a UAV or a user, like the one before it; its id."""
        rows = self.data[LISTS[kind]]
        number = 1 + max((int(tail) for one in rows if (tail := one["id"].rpartition("-")[2]).isdigit()), default=0)
        new = {**deepcopy(rows[-1]), "id": f"{kind}-{number}", _where(kind): [east_m, north_m]}
        if kind == "uav":
            new.update(end_m=None, leaves_at_slot=None)
        rows.append(new)
        return str(new["id"])

    def move(self, kind: Kind, one_id: str, east_m: float, north_m: float) -> None:
        """Put it somewhere else. Raises KeyError."""
        self._one(kind, one_id)[_where(kind)] = [east_m, north_m]

    def remove(self, kind: Kind, one_id: str) -> None:
        """Take it out. Raises DraftError when it is the last one."""
        rows = self.data[LISTS[kind]]
        if len(rows) == 1:
            raise DraftError(f"{LISTS[kind]}: one must stay")
        rows.remove(self._one(kind, one_id))

    def set_mu(self, mu_per_kbps: float) -> None:
        """The weight of steadiness: 0 is pure sum rate, more negative is steadier."""
        self.data["utility"]["mu_per_kbps"] = mu_per_kbps

    @property
    def mu_per_kbps(self) -> float:
        """The weight of steadiness."""
        return float(self.data["utility"]["mu_per_kbps"])

    def _one(self, kind: Kind, one_id: str) -> dict[str, Any]:
        for one in self.data[LISTS[kind]]:
            if one["id"] == one_id:
                found: dict[str, Any] = one
                return found
        raise KeyError(one_id)


def broken(error: ValidationError) -> str:
    """Every broken rule as `field: message`."""
    rows = []
    for each in error.errors():
        field = ".".join(str(part) for part in each["loc"])
        message = str(each["msg"]).removeprefix("Value error, ")
        rows.append(f"{field}: {message}" if field else message)
    return "; ".join(rows[:5])


def _where(kind: Kind) -> str:
    return "start_m" if kind == "uav" else "position_m"
