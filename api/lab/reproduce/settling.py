"""For each claim that is not reproduced: why, or the experiment that would settle it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from skyfolio.api.lab.reproduce.courses import BASELINE_1, BASELINE_2, BASELINE_2_ONCE
from skyfolio.api.lab.reproduce.fit import UNLIKELY
from skyfolio.api.lab.reproduce.verdicts import Judged, Verdict


def statement(one: Judged) -> str:
    """Return what the letter says, whatever utility and reading of Baseline 2 it is judged under."""
    said = one.claim
    if one.kind is not None:
        said = said.removeprefix(one.kind).lstrip(":, ")
    return said if one.reading is None else said.replace(one.reading, "Baseline 2")


def otherwise(one: Judged, claims: Iterable[Judged]) -> list[str]:
    """Under which other utilities and readings the same statement is reproduced."""
    found = []
    for other in claims:
        if other.verdict is Verdict.REPRODUCED and other.claim != one.claim and statement(other) == statement(one):
            words = [f"`{other.kind}`"] if other.kind is not None and other.kind != one.kind else []
            if other.reading is not None and other.reading != one.reading:
                words.append(other.reading)
            found.append(" and ".join(words))
    return list(dict.fromkeys(found))


def settling(one: Judged, claims: Iterable[Judged], study: Mapping[str, Any]) -> str:
    """In words: another reading under which the letter is met, what excludes this one, the experiment that decides."""
    read = otherwise(one, claims)
    share = _share_of_reading(one, study["calibration"])
    parts = []
    if read and one.kind is None and share is not None and share >= UNLIKELY:
        parts.append(f"met under {'; '.join(read)}, which the joint fit excludes")
    elif read:
        parts.append(f"met under {'; '.join(read)}, which excludes this reading")
    if share is not None and share < UNLIKELY:
        parts.append(f"the joint fit excludes this reading (best in {share:.0%} of resamples)")
    parts += _reasons(one, study)
    if one.settles:
        parts.append(one.settles)
    return "; ".join(parts) or "the letter's own user positions and draws, which nothing here can stand in for"


def _reasons(one: Judged, study: Mapping[str, Any]) -> list[str]:
    """Return what is known of this claim beyond its readings."""
    found = []
    if one.claim == "per_user: variance falls with |mu|":
        found.append("by its formula: it steadies each user, and users' rates that are steady each may vary in sum")
    if one.claim == f"{BASELINE_2_ONCE.name} regains sum rate by adjusting":
        found.append(
            "where the survivors already serve the users with the best mean channel, nothing is left to adjust"
        )
    if one.claim == f"{BASELINE_1.name} regains sum rate by adjusting":
        found.append(
            "by construction: equal shares for more users, the new ones farther away, are worth less in sum than those "
            "for the users who were near"
        )
    if one.claim == f"SR-Max over {BASELINE_2.name}":
        parts = {row["name"]: row["mean"] for row in study["ablation"]["parts"]}
        nearest, joint = (parts[f"Q planned, {rest}"] for rest in ("A nearest, B planned", "A and B planned"))
        found.append(
            "a Baseline 2 that follows every draw loses little by nearest association once UAVs fly where they should "
            f"({nearest:.1f} against {joint:.1f} kbit/s with any association), and cannot be a sixth below SR-Max"
        )
    return found


def _share_of_reading(one: Judged, calibration: Mapping[str, Any] | None) -> float | None:
    """In what share of resamples the claim's reading of Baseline 2 belongs to the best fit."""
    if calibration is None or one.reading is None:
        return None
    said = one.reading.removeprefix("Baseline 2 (").removesuffix(")")
    values = calibration["refined"]["told_apart"]["baseline_2"]
    return next(float(row["best_in"]) for row in values if row["value"] == said)
