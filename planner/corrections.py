"""Corrections of links: by how many dB a link is better than the channel model says, by UAV and user.

A row may have `*`, which stands for all users whom it does not name. Rows with nothing else correct UAVs rather than
links: then all users of a UAV still have one gain, and no table of all links is needed (`planner.areas`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from statistics import median

import numpy as np

from skyfolio.planner.arrays import Array

CorrectionsDb = Mapping[str, Mapping[str, float]]
OTHERS = "*"
"""The key of all users of a row that it does not name."""


def require_known(corrections_db: CorrectionsDb, uav_ids: Collection[str], user_ids: Collection[str]) -> None:
    """Raise ValueError naming the first UAV or user that the scenario does not have."""
    for uav, by_user in corrections_db.items():
        if uav not in uav_ids:
            raise ValueError(f"channel.corrections_db: {uav!r} is not a UAV of the scenario")
        for user in by_user:
            if user != OTHERS and user not in user_ids:
                raise ValueError(f"channel.corrections_db.{uav}: {user!r} is not a user of the scenario")


def kept(
    corrections_db: CorrectionsDb, uav_ids: Collection[str], user_ids: Collection[str]
) -> dict[str, dict[str, float]]:
    """Return the corrections of the links between these UAVs and users."""
    rows = {
        uav: {user: db for user, db in by_user.items() if user == OTHERS or user in user_ids}
        for uav, by_user in corrections_db.items()
        if uav in uav_ids
    }
    return {uav: row for uav, row in rows.items() if row}


def link_factors(corrections_db: CorrectionsDb, uav_ids: Sequence[str], user_ids: Sequence[str]) -> Array:
    """Return what each link's gain is to be multiplied by: (U, K), 1 where nothing is said."""
    db = np.zeros((len(uav_ids), len(user_ids)))
    column = {user: k for k, user in enumerate(user_ids)}
    for row, uav in zip(db, uav_ids, strict=True):
        given = corrections_db.get(uav, {})
        row[:] = given.get(OTHERS, 0.0)
        for user, value in given.items():
            if user in column:
                row[column[user]] = value
    factors: Array = 10.0 ** (db / 10.0)
    return factors


def correction_db(corrections_db: CorrectionsDb, uav: str, user: str) -> float:
    """Return the correction of one link, dB; 0 where nothing is said."""
    row = corrections_db.get(uav, {})
    return row.get(user, row.get(OTHERS, 0.0))


def are_of_uavs(corrections_db: CorrectionsDb) -> bool:
    """Return whether all users of each UAV have the same correction: also where there are none."""
    return all(row.keys() <= {OTHERS} for row in corrections_db.values())


def of_uavs(corrections_db: CorrectionsDb, user_ids: Sequence[str]) -> dict[str, dict[str, float]]:
    """Return corrections of UAVs in the place of those of links: the median over the users, dB."""
    rows = {
        uav: round(median(correction_db(corrections_db, uav, user) for user in user_ids), 2) for uav in corrections_db
    }
    return {uav: {OTHERS: db} for uav, db in rows.items() if db != 0.0}


def uav_factors(corrections_db: CorrectionsDb, uav_ids: Sequence[str]) -> Array:
    """Return what the gain of each UAV is to be multiplied by, (U,), where `are_of_uavs`."""
    db = np.array([corrections_db.get(uav, {}).get(OTHERS, 0.0) for uav in uav_ids])
    factors: Array = 10.0 ** (db / 10.0)
    return factors


def by_id(corrections_db: Array, uav_ids: Sequence[str], user_ids: Sequence[str]) -> dict[str, dict[str, float]]:
    """Return a table of corrections, (U, K) dB, by ids, to a hundredth; those that are nothing are left out."""
    rows = {
        uav: {user: round(db, 2) for user, db in zip(user_ids, row, strict=True) if round(db, 2) != 0.0}
        for uav, row in zip(uav_ids, corrections_db.tolist(), strict=True)
    }
    return {uav: row for uav, row in rows.items() if row}
