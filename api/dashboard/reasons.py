"""Explanations as rows of tables, in the words of operators. Pure; rates and utilities in kbit/s."""

from __future__ import annotations

from skyfolio.planner import Explanation

Row = tuple[str, ...]
USERS_HEAD: Row = ("user", "mean rate", "has", "because of", "could have", "how", "that is")
WORTHS_HEAD: Row = ("what", "UAV", "utility", "sum rate", "how", "that is")
PRICES_HEAD: Row = ("constraint", "binds at", "slots", "utility, bit/s", "for", "how")
BECAUSE = {
    "band": "little bandwidth",
    "distance": "UAVs fly elsewhere",
    "pins": "pins of the plan",
    "no_fly": "a no-fly zone",
    "battery": "a UAV that leaves early",
    "reach": "no UAV near in time",
    "interference": "other UAVs' interference",
    "separation": "the separation of UAVs",
}
WHATS = {"one_more_uav": "one more UAV", "more_band": "10 % more band", "moved_start": "another start"}
CONSTRAINTS = {
    "band": "bandwidth",
    "speed": "greatest speed",
    "separation": "separation",
    "no_fly": "no-fly zones",
    "battery": "early departures",
    "end": "end positions",
    "min_rate": "minimum rates",
    "pins": "pins",
}
PER = {"hertz": "1 Hz more", "m/s": "1 m/s more", "lifted": "being without it"}
HOW = {"bound": "at most", "resolve": "planned", "derivative": "first order"}
HOW_LONG = (
    "How a number was obtained: “at most” cannot be exceeded; “planned” was found by a plan of the changed scenario; "
    "“first order” is the slope at the plan, with all other choices kept."
)


def users(found: Explanation) -> list[Row]:
    """Return a row for each user, those that have least first."""
    made: list[Row] = []
    for row in sorted(found.users, key=lambda one: one.mean_rate_bps):
        rate = _kbps(row.mean_rate_bps)
        reason = next((one for one in row.reasons if one.kind == row.main), None)
        if row.main is None or reason is None:
            made.append((row.user_id, rate, _has(row.level), "", "", "", ""))
            continue
        how, detail = HOW[reason.method], _without_number(reason.detail)
        made.append((row.user_id, rate, _has(row.level), BECAUSE[row.main], _kbps(reason.rate_bps), how, detail))
    return made


def worths(found: Explanation) -> list[Row]:
    """Return what changes of the fleet would be worth: by what changes, then the greatest gain first."""
    order = list(WHATS)
    ranked = sorted(found.worth, key=lambda one: (order.index(one.what), -one.utility_gain_bps))
    return [
        (
            WHATS[one.what],
            one.uav_id,
            f"{one.utility_gain_bps / 1e3:+.2f}",
            "–" if one.mean_sum_rate_gain_bps is None else f"{one.mean_sum_rate_gain_bps / 1e3:+.2f}",  # noqa: RUF001
            HOW[one.method],
            one.detail,
        )
        for one in ranked
    ]


def prices(found: Explanation) -> list[Row]:
    """Return the constraints that bind, with their prices."""
    return [
        (
            CONSTRAINTS[one.constraint],
            ", ".join(one.uav_ids),
            str(one.slots),
            "–" if one.price_bps is None else _signed(one.price_bps),  # noqa: RUF001
            PER[one.per],
            HOW[one.method],
        )
        for one in found.constraints
        if one.slots
    ]


def summary(found: Explanation) -> str:
    """Return in words how many users have little, and what was solved for that."""
    short = sum(one.level in {"none", "little"} for one in found.users)
    who = f"{short} of {len(found.users)} users have little or nothing" if short else "Every user has its share"
    return f"{who}. Utility {_kbps(found.utility_bps)} kbit/s; {found.resolves} changed scenarios were planned."


def _without_number(detail: str) -> str:
    """Return a detail without the rate that has a column of its own."""
    return detail.split(": ", 1)[-1].split(" kbit/s ", 1)[-1]


def _signed(number: float) -> str:
    """Return a number with three digits at least, and no exponent."""
    return f"{number:+,.0f}" if abs(number) >= 100.0 else f"{number:+.3g}"


def _has(level: str) -> str:
    return {"none": "nothing", "little": "little", "served": "its share", "satisfied": "all it asked for"}[level]


def _kbps(rate_bps: float) -> str:
    return f"{rate_bps / 1e3:.2f}"
