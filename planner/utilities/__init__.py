"""The utilities there are: one file and one row of the table for each (`docs/utilities.md` shows how to add one)."""

from skyfolio.planner.utilities.all_users import POOLED
from skyfolio.planner.utilities.each_user import PER_USER
from skyfolio.planner.utilities.kind import Expectation, Kind
from skyfolio.planner.utilities.slot_sums import SUM

__all__ = ["UTILITIES", "Expectation", "Kind", "kind_of"]

UTILITIES: dict[str, Kind] = {
    "sum": SUM,
    "per_user": PER_USER,
    "pooled": POOLED,
}


def kind_of(name: str) -> Kind:
    """Return the utility of this name. Raises ValueError with the names there are."""
    if name not in UTILITIES:
        raise ValueError(f"utility.kind: {name!r} must be one of {', '.join(UTILITIES)}")
    return UTILITIES[name]
