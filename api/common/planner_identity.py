"""What tells one planner from another: a worker on another machine must have that of the process that asks it."""

from __future__ import annotations

from functools import cache
from hashlib import sha256
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path


class OtherPlannerError(Exception):
    """A worker has another planner than the process that asks."""


def planner_home() -> Path:
    """Return the folder of the planner's sources."""
    return Path(str(getattr(find_spec("skyfolio.planner"), "origin", None))).parent


@cache
def planner_identity() -> str:
    """Return the version and a digest of all sources of the planner."""
    digest = sha256()
    for source in sorted(planner_home().rglob("*.py")):
        digest.update(source.name.encode() + b"\0" + source.read_bytes())
    return f"{version('skyfolio')}-{digest.hexdigest()[:16]}"


def require_planner(identity: str) -> None:
    """Check that the planner here is the one that is asked for. Raises OtherPlannerError."""
    if identity != planner_identity():
        raise OtherPlannerError(f"it has the planner {planner_identity()}, but {identity} is asked for")
