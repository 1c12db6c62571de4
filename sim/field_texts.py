"""Things of a simulated field as they are written on a command line and in settings: `FIELD=VALUE,...`."""

from collections.abc import Iterable
from dataclasses import MISSING, dataclass, fields
from typing import Any, TypeVar

from skyfolio.sim.airframe import capacity_for_mah
from skyfolio.sim.fault_schedule import value_of
from skyfolio.sim.ground_crew import HANDS_OFF_S, GroundCrew
from skyfolio.sim.knobs import check_number
from skyfolio.sim.packs import Packs
from skyfolio.sim.specs import BATTERY_MAH
from skyfolio.sim.weather import WindFront

Made = TypeVar("Made")
OFF_S = 20.0
"""For how many seconds of a turnaround a vehicle is off, unless that is too short."""
LEAST_TURNAROUND_S = 2 * HANDS_OFF_S
TURNAROUND_S = 90.0
LONGEST_MINUTES = 300.0


@dataclass(frozen=True, kw_only=True)
class FieldKnobs:
    """What happens around a simulated fleet: nothing, by default.

    crew: who changes batteries, of which packs. battery_minutes: how long a vehicle hovers on a new, full battery until
    `airframe.RESERVE_SHARE` is left; None: the battery of the airframe. fronts: how the wind changes.
    """

    crew: GroundCrew | None = None
    battery_minutes: float | None = None
    fronts: tuple[WindFront, ...] = ()

    @property
    def battery_mah(self) -> float:
        """What a new battery holds."""
        return BATTERY_MAH if self.battery_minutes is None else capacity_for_mah(self.battery_minutes)


def field_from(
    *, crew: int, turnaround_s: float, packs: str, battery_minutes: float | None, fronts: Iterable[str]
) -> FieldKnobs:
    """Return what is said of a field in numbers and texts: see `crew_from` and `fronts_from`.

    ValueError names what is wrong.
    """
    if battery_minutes is not None:
        check_number("battery_minutes", battery_minutes, 1.0, LONGEST_MINUTES)
    return FieldKnobs(
        crew=crew_from(crew, turnaround_s, packs), battery_minutes=battery_minutes, fronts=fronts_from(fronts)
    )


def made_from(kind: type[Made], text: str, what: str) -> Made:
    """Return a dataclass with the fields that `FIELD=VALUE,...` names. `what`: what it is, with its article.

    ValueError names the part that cannot be read, a field that it does not have, or one that it needs.
    """
    known = {field.name: field for field in fields(kind)}  # type: ignore[arg-type]
    values: dict[str, Any] = {}
    for part in text.split(",") if text else []:
        name, equals, value = (word.strip() for word in part.partition("="))
        if not equals:
            raise ValueError(f"{part!r} must look like FIELD=VALUE")
        if name not in known:
            raise ValueError(f"{name}: {what} has no such field, it has {', '.join(sorted(known))}")
        values[name] = value_of(value)
    missing = [name for name, field in known.items() if _is_needed(field) and name not in values]
    if missing:
        raise ValueError(f"{missing[0]}: {what} needs it")
    return kind(**values)


def _is_needed(field: Any) -> bool:
    return field.default is MISSING and field.default_factory is MISSING


def fronts_from(texts: Iterable[str]) -> tuple[WindFront, ...]:
    """Return the fronts that texts such as `at_s=600,east_mps=6,gust_mps=2,ramp_s=120` describe, in order of time.

    ValueError names what is wrong.
    """
    fronts = [made_from(WindFront, text, "a wind front") for text in texts]
    return tuple(sorted(fronts, key=lambda front: front.at_s))


def crew_from(members: int, turnaround_s: float, packs: str) -> GroundCrew | None:
    """Return a ground crew with the packs that a text such as `count=4,charge_s=3600` describes; None for no members.

    ValueError names what is wrong, and refuses packs without anybody to change them.
    """
    if members == 0 and packs:
        raise ValueError("packs: nobody changes them without a crew")
    if members == 0:
        return None
    if not turnaround_s >= LEAST_TURNAROUND_S:
        raise ValueError(f"turnaround_s must be at least {LEAST_TURNAROUND_S:g}, got {turnaround_s:g}")
    off_s = min(OFF_S, turnaround_s - HANDS_OFF_S)
    made = made_from(Packs, packs, "a pad")
    return GroundCrew(members=members, turnaround_s=turnaround_s, off_s=off_s, packs=made)
