"""The files that are given, and what each of them holds."""

from __future__ import annotations

from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Any, Literal

from shapely.geometry.base import BaseGeometry

from skyfolio.api.places.faults import Fault, FaultyFilesError

MAX_BYTES = 10_000_000
MAX_TILE_BYTES = 60_000_000
"""Of an elevation tile: one of a degree with 3601 x 3601 heights has 26 MB."""
_TILES = (".tif", ".tiff", ".hgt")
MAX_FEATURES = 20_000
Kind = Literal["user", "uav", "no_fly", "area", "rally_point"]
Encoding = Literal["utf-8", "utf-16", "windows-1252", "iso-8859-1"]


@dataclass(frozen=True, kw_only=True, slots=True)
class SourceFile:
    """A file as it was given. kind: what is in it, if that is said outside of it; encoding: of its text, if known.

    is_map: whether it is said outside of it that it holds gains, which a name like `.tif` does not say.
    """

    name: str
    content: bytes
    kind: Kind | None = None
    encoding: Encoding | None = None
    is_map: bool = False

    def __post_init__(self) -> None:
        most = MAX_TILE_BYTES if self.is_tile or self.is_gain_map else MAX_BYTES
        if len(self.content) > most:
            raise FaultyFilesError([self.fault("size", f"it has {len(self.content)} bytes; at most are {most}")])

    @property
    def is_tile(self) -> bool:
        """Return whether its name says that it holds heights of the ground."""
        return self.suffix in _TILES and not self.is_map

    @property
    def is_gain_map(self) -> bool:
        """Return whether it holds gains of a channel (`gain_maps.py`)."""
        return self.is_map or self.suffix == ".npz"

    @property
    def suffix(self) -> str:
        """Return the end of the name, `.csv` for instance, in lower case."""
        return PurePath(self.name).suffix.lower()

    def fault(self, rule: str, message: str, row: str = "", column: str = "") -> Fault:
        """Return a fault of this file."""
        return Fault(file=self.name, rule=rule, message=message, row=row, column=column)

    def text(self) -> str:
        """Return the text, without a byte order mark. Raises FaultyFilesError if it is in another encoding."""
        encoding = self.encoding or _encoding_by_mark(self.content)
        try:
            return self.content.decode(encoding).removeprefix("\ufeff")
        except UnicodeDecodeError as error:
            line = self.content[: error.start].count(b"\n") + 1
            message = f"byte {error.start} is not {encoding.upper()}; save the file as UTF-8, or name its encoding"
            raise FaultyFilesError([self.fault("encoding", message, f"line {line}")]) from error


@dataclass(frozen=True, kw_only=True, slots=True)
class Feature:
    """One user, UAV, zone, area or rally point of a file.

    geometry: longitude and latitude, degrees; None if the file has none. values: what is said of it, by the names of
    the scenario's fields. columns: what these fields are called in the file.
    """

    file: SourceFile
    row: str
    kind: Kind
    geometry: BaseGeometry
    values: Mapping[str, Any] = field(default_factory=dict)
    columns: Mapping[str, str] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Return where it is: file and row."""
        return f"{self.file.name}: {self.row}"

    def fault(self, rule: str, message: str, name: str = "") -> Fault:
        """Return a fault of this feature; name: the field of the scenario that it is about."""
        is_place = name.endswith(("_deg", "positions_m")) and name not in self.values
        place = self.columns.get("lat", name) if is_place else name
        return self.file.fault(rule, message, self.row, self.columns.get(name, place))


@dataclass(frozen=True, kw_only=True, slots=True)
class Holding:
    """What a file holds. settings: those of a scenario, if it has any. ignored: columns that mean nothing here."""

    features: list[Feature]
    faults: list[Fault]
    settings: Mapping[str, Any] = field(default_factory=dict)
    ignored: frozenset[str] = frozenset()


def _encoding_by_mark(content: bytes) -> str:
    if content.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
        return "utf-16"
    return "utf-8-sig" if content.startswith(BOM_UTF8) else "utf-8"
