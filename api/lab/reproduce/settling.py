"""For each claim that is not reproduced: why, or the experiment that would settle it."""

from __future__ import annotations

from collections.abc import Iterable

from skyfolio.api.lab.reproduce.verdicts import Judged, Verdict


def statement(one: Judged) -> str:
    """What the letter says, whatever utility and reading of Baseline 2 it is judged under."""
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


def settling(one: Judged, claims: Iterable[Judged]) -> str:
    """In words: another reading under which the letter is met, then the experiment that would decide."""
    read = otherwise(one, claims)
    met = [f"met under {'; '.join(read)}, which excludes this reading"] if read else []
    if one.settles:
        return "; ".join([*met, one.settles])
    if met:
        return met[0]
    if one.kind not in (None, "sum"):
        return "the letter optimises eq. (9), which is `sum`: only its authors' code can say that it did not"
    return "the letter's own user positions and draws: no other setting of the calibration comes nearer"
