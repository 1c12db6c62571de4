"""What a sweep is asked for, as a TOML file: a base scenario, what is set for all cases, and what is varied."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Sequence
from itertools import product
from math import prod
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, ValidationError, model_validator

from skyfolio.api.common.errors import ServiceError
from skyfolio.api.common.validation import broken_rules
from skyfolio.planner.scenario import Frozen

Settings = dict[str, Any]
"""Values by the path of the field: `utility.mu_per_kbps`, `uavs.*.bandwidth_hz`, `layout.seed`, `method`, ..."""
MOST_CASES = 10_000_000


class SpecError(ServiceError):
    """The file of a sweep is wrong; the message begins with the field."""


class Layout(Frozen):
    """Users at random. kind: `letter` (3 UAVs, 9 users), `scattered`, or as `planner.layouts.LAYOUTS` has them."""

    kind: Literal["letter", "scattered", "uniform", "clustered", "stadium", "corridor", "two_towns"]
    uavs: Annotated[int, Field(strict=True, ge=1, le=1000)] = 3
    users: Annotated[int, Field(strict=True, ge=1, le=100_000)] = 9
    slots: Annotated[int, Field(strict=True, ge=1, le=100_000)] = 20
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**31)] = 0

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.kind == "letter" and (self.uavs, self.users, self.slots) != (3, 9, 20):
            raise ValueError("kind: 'letter' has 3 UAVs, 9 users and 20 slots; choose another layout to change them")
        return self


class Base(Frozen):
    """The scenario that is varied: an example by name, a file, or a layout; one of the three."""

    example: Literal["paper", "minimal"] | None = None
    scenario: dict[str, Any] | None = None
    layout: Layout | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if sum(one is not None for one in (self.example, self.scenario, self.layout)) != 1:
            raise ValueError("give example, scenario or layout, one of them")
        return self


class Integers(Frozen):
    """All integers from the first to the last."""

    range: tuple[Annotated[int, Field(strict=True)], Annotated[int, Field(strict=True)]]

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.range[0] <= self.range[1]:
            raise ValueError(f"range: [{self.range[0]}, {self.range[1]}] must be [first, last] with first <= last")
        return self

    @property
    def count(self) -> int:
        """Return how many values a grid has of it."""
        return self.range[1] - self.range[0] + 1

    def grid(self) -> Sequence[Any]:
        """Return all values."""
        return range(self.range[0], self.range[1] + 1)

    def draw(self, rng: np.random.Generator) -> Any:
        """Return one of them."""
        return int(rng.integers(self.range[0], self.range[1], endpoint=True))


class Interval(Frozen):
    """Numbers between two ends: `steps` of them in a grid, any in a random design; by equal ratios on a `log` scale."""

    between: tuple[float, float]
    steps: Annotated[int, Field(strict=True, ge=2, le=100_000)] | None = None
    scale: Literal["linear", "log"] = "linear"

    @model_validator(mode="after")
    def _check(self) -> Self:
        low, high = self.between
        if not low < high:
            raise ValueError(f"between: [{low:g}, {high:g}] must be [low, high] with low < high")
        if self.scale == "log" and low * high <= 0:
            raise ValueError("between: a log scale needs two ends of the same sign, neither of them 0")
        return self

    @property
    def count(self) -> int:
        """Return how many values a grid has of it."""
        return self.steps or 2

    def grid(self) -> Sequence[Any]:
        """Return the `steps` values; the ends without `steps`."""
        return [self._at(share) for share in np.linspace(0.0, 1.0, self.count)]

    def draw(self, rng: np.random.Generator) -> Any:
        """Return a number between the ends."""
        return self._at(rng.random())

    def _at(self, share: float) -> float:
        low, high = self.between
        if self.scale == "log":
            return float(low * (high / low) ** share)
        return float(low + share * (high - low))


class Choice(Frozen):
    """One of several values, which are made alike: all floats where one is."""

    values: Annotated[tuple[Any, ...], Field(min_length=1)]

    @property
    def count(self) -> int:
        """Return how many values a grid has of it."""
        return len(self.values)

    def grid(self) -> Sequence[Any]:
        """Return all values."""
        return self.values

    def draw(self, rng: np.random.Generator) -> Any:
        """Return one of them."""
        return self.values[int(rng.integers(len(self.values)))]


Axis = Choice | Integers | Interval


class Spec(Frozen):
    """One sweep. draws, seed: of a random design. batch: cases that one worker computes in a row, one Parquet part.

    What a worker was computing when it died is computed again, so a batch should take a second or two. over: the axes
    that the summary averages over; by default those whose name ends with `seed`.
    """

    design: Literal["grid", "random"] = "grid"
    draws: Annotated[int, Field(strict=True, ge=1, le=MOST_CASES)] | None = None
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)] = 0
    batch: Annotated[int, Field(strict=True, ge=1, le=100_000)] = 16
    over: tuple[str, ...] | None = None
    base: Base
    fixed: Settings = Field(default_factory=dict)
    vary: dict[str, Axis] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.design == "random") != (self.draws is not None):
            raise ValueError("draws: a random design needs it, and a grid has none")
        for name, axis in self.vary.items():
            if name in self.fixed:
                raise ValueError(f"vary.{name}: it is set, too")
            if self.design == "grid" and isinstance(axis, Interval) and axis.steps is None:
                raise ValueError(f"vary.{name}: in a grid, `between` needs `steps`")
        unknown = [name for name in self.over or () if name not in self.vary]
        if unknown:
            raise ValueError(f"over: {unknown[0]!r} is not varied")
        if self.n_cases > MOST_CASES:
            raise ValueError(f"vary: {self.n_cases} cases are more than {MOST_CASES}")
        return self

    @property
    def n_cases(self) -> int:
        """Return how many cases there are."""
        return self.draws or prod(axis.count for axis in self.vary.values())

    @property
    def averaged(self) -> tuple[str, ...]:
        """Return the axes that the summary averages over."""
        if self.over is not None:
            return self.over
        return tuple(name for name in self.vary if name.endswith("seed"))

    def cases(self) -> list[Settings]:
        """Return the varied settings of every case, the first axis slowest: appending to it keeps what was before."""
        if self.design == "grid":
            names = list(self.vary)
            return [
                dict(zip(names, values, strict=True))
                for values in product(*(axis.grid() for axis in self.vary.values()))
            ]
        drawn = []
        for number in range(self.draws or 0):
            rng = np.random.default_rng((self.seed, number))
            drawn.append({name: axis.draw(rng) for name, axis in self.vary.items()})
        return drawn


def read_spec(file: Path) -> Spec:
    """Return the sweep that a TOML file asks for. Raises SpecError naming each broken rule, one on a line."""
    try:
        tree = tomllib.loads(file.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise SpecError(f"{file}: {error}") from error
    return spec_of(tree, file.parent)


def spec_of(tree: dict[str, Any], folder: Path = Path()) -> Spec:
    """Return the sweep of a parsed file. folder: where a scenario's file is looked for. Raises SpecError."""
    tree = dict(tree)
    try:
        if "fixed" in tree:
            raise SpecError("fixed: what is the same for all cases is called `set`")
        base = dict(tree.pop("base", {}))
        if isinstance(base.get("scenario"), str):
            base["scenario"] = _scenario(folder / base["scenario"])
        fixed = _flat(tree.pop("set", {}))
        vary = {name: _axis(name, value) for name, value in _flat(tree.pop("vary", {}), axes=True).items()}
        _require_plain(fixed | {name: list(axis.values) for name, axis in vary.items() if isinstance(axis, Choice)})
        return Spec(base=Base(**base), fixed=fixed, vary=vary, **tree)
    except ValidationError as error:
        rows = broken_rules(error.errors(), ())
        raise SpecError("\n".join(f"{row['field']}: {row['message']}" for row in rows)) from error
    except TypeError as error:
        raise SpecError(f"spec: {error}") from error


def _require_plain(settings: Settings) -> None:
    """Refuse values that no field can have: dates, and numbers that are not finite. Raises SpecError."""
    for name, value in settings.items():
        try:
            json.dumps(value, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise SpecError(f"{name}: {error}") from error


def _scenario(file: Path) -> dict[str, Any]:
    try:
        tree = json.loads(file.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise SpecError(f"base.scenario: {file}: {error}") from error
    if not isinstance(tree, dict):
        raise SpecError(f"base.scenario: {file}: must hold a scenario")
    return tree


AXES: dict[str, type[Integers | Interval]] = {"range": Integers, "between": Interval}


def _flat(tree: Any, path: str = "", *, axes: bool = False) -> Settings:
    """Return the leaves of nested tables by their dotted path; a table that is an axis is a leaf."""
    if not isinstance(tree, dict) or (axes and AXES.keys() & tree.keys()):
        return {path: tree}
    found: Settings = {}
    for name, value in tree.items():
        found |= _flat(value, f"{path}.{name}" if path else name, axes=axes)
    return found


def _axis(name: str, value: Any) -> Axis:
    if isinstance(value, dict):
        return next(kind for key, kind in AXES.items() if key in value)(**value)
    if not isinstance(value, list) or not value:
        raise SpecError(f"vary.{name}: must be a list of values, {{range = [..]}} or {{between = [..]}}")
    return Choice(values=tuple(_alike(name, value)))


def _alike(name: str, values: list[Any]) -> list[Any]:
    """Return values of one type, so that every part has the same columns: all floats where one is."""
    kinds = {type(value) for value in values}
    if kinds == {int, float}:
        values, kinds = [float(value) for value in values], {float}
    if len(kinds) > 1 or not kinds <= {str, int, float, bool, list, dict}:
        raise SpecError(
            f"vary.{name}: must hold values of one type, not {', '.join(sorted(k.__name__ for k in kinds))}"
        )
    return values
