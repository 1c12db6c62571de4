"""Corrections of single links: by how many dB a link is better than the channel model says, by UAV and user."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from skyfolio.planner.arrays import Array

CorrectionsDb = Mapping[str, Mapping[str, float]]


def require_known(corrections_db: CorrectionsDb, uav_ids: Collection[str], user_ids: Collection[str]) -> None:
    """Raise ValueError naming the first UAV or user that the scenario does not have."""
    for uav, by_user in corrections_db.items():
        if uav not in uav_ids:
            raise ValueError(f"channel.corrections_db: {uav!r} is not a UAV of the scenario")
        for user in by_user:
            if user not in user_ids:
                raise ValueError(f"channel.corrections_db.{uav}: {user!r} is not a user of the scenario")


def kept(
    corrections_db: CorrectionsDb, uav_ids: Collection[str], user_ids: Collection[str]
) -> dict[str, dict[str, float]]:
    """Return the corrections of the links between these UAVs and users."""
    rows = {
        uav: {user: db for user, db in by_user.items() if user in user_ids}
        for uav, by_user in corrections_db.items()
        if uav in uav_ids
    }
    return {uav: row for uav, row in rows.items() if row}


def link_factors(corrections_db: CorrectionsDb, uav_ids: Sequence[str], user_ids: Sequence[str]) -> Array:
    """Return what each link's gain is to be multiplied by: (U, K), 1 where nothing is said."""
    db = np.zeros((len(uav_ids), len(user_ids)))
    column = {user: k for k, user in enumerate(user_ids)}
    for row, uav in zip(db, uav_ids, strict=True):
        for user, value in corrections_db.get(uav, {}).items():
            if user in column:
                row[column[user]] = value
    factors: Array = 10.0 ** (db / 10.0)
    return factors


def by_id(corrections_db: Array, uav_ids: Sequence[str], user_ids: Sequence[str]) -> dict[str, dict[str, float]]:
    """Return a table of corrections, (U, K) dB, by ids, to a hundredth; those that are nothing are left out."""
    rows = {
        uav: {user: round(db, 2) for user, db in zip(user_ids, row, strict=True) if round(db, 2) != 0.0}
        for uav, row in zip(uav_ids, corrections_db.tolist(), strict=True)
    }
    return {uav: row for uav, row in rows.items() if row}
