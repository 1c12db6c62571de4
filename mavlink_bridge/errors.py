# ruff: noqa: N818 (the names say what happened)
"""Everything that can go wrong in the bridge, in one tree.

    BridgeError
    ├── CompileError            a plan cannot become a mission
    │   ├── UnknownUav
    │   ├── UnknownAutopilot
    │   ├── TooManyItems
    │   ├── ReturnPathsTooClose
    │   └── TransitionTooClose
    ├── FormatError             a .plan or .waypoints file cannot be read
    └── LinkError               the link itself, not one vehicle on it
        ├── ConnectionFailed
        ├── LinkClosed
        ├── SigningKeyInvalid
        └── VehiclesMissing

What fails on a single vehicle (an upload, a swap) is a result with an `error` text, never an exception.
"""

from __future__ import annotations

from collections.abc import Iterable


class BridgeError(Exception):
    """Base of all errors of this package."""


class CompileError(BridgeError):
    """A plan cannot become a mission."""


class UnknownUav(CompileError):
    """The plan has no trajectory for this UAV."""

    def __init__(self, uav_id: str, known: Iterable[str]) -> None:
        super().__init__(f"uav_id: '{uav_id}' is not in the plan; it flies {', '.join(known) or 'none'}")
        self.uav_id = uav_id


class UnknownAutopilot(CompileError):
    """The bridge has no profile of this autopilot, so nothing that it would send could be relied on."""

    def __init__(self, autopilot: str, known: str) -> None:
        super().__init__(f"its autopilot is {autopilot}; missions are compiled for {known} only")
        self.autopilot = autopilot


class TooManyItems(CompileError):
    """The mission exceeds what autopilots store."""

    def __init__(self, uav_id: str, items: int, limit: int) -> None:
        super().__init__(
            f"mission of '{uav_id}' needs {items} items, more than the {limit} a vehicle is given to store"
        )
        self.uav_id, self.items, self.limit = uav_id, items, limit


class ReturnPathsTooClose(CompileError):
    """Two UAVs would pass each other too closely on their straight ways home."""

    def __init__(self, first: str, second: str, apart_m: float, required_m: float) -> None:
        super().__init__(
            f"ways home of '{first}' and '{second}' come within {apart_m:.2f} m, closer than "
            f"min_separation_m {required_m:g}; land in place instead"
        )
        self.first, self.second, self.apart_m = first, second, apart_m


class TransitionTooClose(CompileError):
    """UAVs, or a UAV and the reserved air of a lost one, would come too close while changing to a new plan."""

    def __init__(self, what: str, required_m: float) -> None:
        super().__init__(f"transition: {what}, closer than min_separation_m {required_m:g}")
        self.required_m = required_m


class FormatError(BridgeError):
    """A mission file cannot be read; the message names the place and the rule."""


class LinkError(BridgeError):
    """The link to the fleet does not work."""


class ConnectionFailed(LinkError):
    """The connection URL cannot be opened."""

    def __init__(self, url: str, reason: str) -> None:
        super().__init__(f"cannot open '{url}': {reason}")
        self.url = url


class LinkClosed(LinkError):
    """The fleet link was used before it was opened or after it was closed."""


class GuardFailed(LinkError):
    """There is no guard process: vehicles hold when the process that streams to them dies."""


class SigningKeyInvalid(LinkError):
    """The key that messages are signed with cannot be used; the text never shows it."""

    def __init__(self, reason: str) -> None:
        super().__init__(f"signing key: {reason}")


class VehiclesMissing(LinkError):
    """Some expected vehicles never sent an autopilot heartbeat."""

    def __init__(self, missing: Iterable[int], present: Iterable[int], waited_s: float) -> None:
        self.missing = tuple(sorted(missing))
        self.present = tuple(sorted(present))
        super().__init__(
            f"no autopilot heartbeat from system {', '.join(map(str, self.missing))} within {waited_s:g} s; "
            f"heard: {', '.join(map(str, self.present)) or 'none'}"
        )
