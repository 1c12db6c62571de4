"""Where the users of a scenario are in each slot, when they are not there, and what they ask for, as arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.scenario import Scenario


def tracks_of(scenario: Scenario) -> tuple[Array, Array]:
    """Return where users are, (K, S, 2) metres, and what is added to squared distances from there, (K, S) m^2.

    S is the number of slots, or 1 where nothing changes from slot to slot.
    """
    users, slot_s = scenario.users, scenario.slot_duration_s
    changing = any(user.moves or user.uncertainty_mps for user in users)
    slots = range(scenario.slots if changing else 1)
    places_m = np.array([[user.place_m(n, slot_s) for n in slots] for user in users], dtype=float)
    radii_m = np.array([[user.radius_m(n, slot_s) for n in slots] for user in users])
    return places_m, radii_m**2 / 2


def demands_bps(scenario: Scenario) -> Array:
    """Return what each user asks for, (K,) bit/s, infinite where it has no limit."""
    return np.array([np.inf if user.demand_bps is None else user.demand_bps for user in scenario.users])


def are_plain(scenario: Scenario) -> bool:
    """Return whether all users are as the letter's: see `User.is_plain`."""
    return all(user.is_plain(scenario.slots) for user in scenario.users)


def absences_of(scenario: Scenario, first_slot: int = 0, n_slots: int | None = None) -> NDArray[np.bool_]:
    """Return whether each user is not there in some slots, by default all of the scenario's: (K, N)."""
    slots = first_slot + np.arange(scenario.slots if n_slots is None else n_slots)
    came = [-np.inf if user.arrives_at_slot is None else user.arrives_at_slot for user in scenario.users]
    goes = [np.inf if user.leaves_at_slot is None else user.leaves_at_slot for user in scenario.users]
    away: NDArray[np.bool_] = (slots < np.array(came)[:, None]) | (slots >= np.array(goes)[:, None])
    return away
