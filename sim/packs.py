"""Battery packs on the ground: how they charge, and how they age. Seeded; new packs that never age by default."""

import random
from dataclasses import dataclass

from skyfolio.sim.airframe import RESISTANCE_OHM, Battery
from skyfolio.sim.knobs import check_duration, check_number, check_whole

LEAST_HEALTH = 0.1
"""A pack never holds less than this share of what it held when it was new: it would be thrown away before that."""
MOST_PACKS = 100
MOST_CYCLES = 10_000.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Packs:
    """The packs of each pad.

    count: how many there are, with the one on board. charge_s: seconds that a charger, of which each pack has its own,
    takes from empty to full. worn_cycles: full cycles behind the oldest pack when the fleet is switched on; each pack's
    are drawn between 0 and this. fade_per_cycle: share of the capacity when new that is lost with each full cycle.
    resistance_per_cycle: how much the internal resistance rises with each, as a share of that when new. spread: how
    much packs differ in both, as a standard deviation over the mean. ValueError names a field that is out of range.
    """

    count: int = 4
    charge_s: float = 3600.0
    worn_cycles: float = 0.0
    fade_per_cycle: float = 0.0
    resistance_per_cycle: float = 0.0
    spread: float = 0.0

    def __post_init__(self) -> None:
        check_whole("count", self.count, 2, MOST_PACKS)
        check_duration("charge_s", self.charge_s)
        check_number("worn_cycles", self.worn_cycles, 0.0, MOST_CYCLES)
        check_number("fade_per_cycle", self.fade_per_cycle, 0.0, 1.0)
        check_number("resistance_per_cycle", self.resistance_per_cycle, 0.0, 1.0)
        check_number("spread", self.spread, 0.0, 1.0)


class Pack:
    """One pack: `pack_id`, `cycles` (full ones that it has given so far), `share` of charge when it was last looked at.

    rate: how fast it ages, over the mean of its kind.
    """

    def __init__(self, pack_id: str, kind: Packs, *, cycles: float = 0.0, rate: float = 1.0) -> None:
        self.pack_id = pack_id
        self.cycles = cycles
        self.share = 1.0
        self._kind = kind
        self._rate = rate
        self._charging_since_s: float | None = None

    @property
    def health(self) -> float:
        """What it holds now, over what it held when it was new."""
        return max(LEAST_HEALTH, 1.0 - self._kind.fade_per_cycle * self._rate * self.cycles)

    @property
    def resistance_ohm(self) -> float:
        """Its internal resistance."""
        return RESISTANCE_OHM * (1.0 + self._kind.resistance_per_cycle * self._rate * self.cycles)

    def full_in_s(self, now_s: float) -> float:
        """Return the seconds until it is full; 0 for one that is."""
        since_s = now_s if self._charging_since_s is None else self._charging_since_s
        return max(0.0, since_s + (1.0 - self.share) * self._kind.charge_s - now_s)

    def put_in(self, battery: Battery) -> None:
        """Become the battery on board, fully charged."""
        self.share, self._charging_since_s = 1.0, None
        battery.share, battery.health, battery.resistance_ohm = self.share, self.health, self.resistance_ohm

    def take_out(self, battery: Battery, now_s: float) -> None:
        """Come back from on board, a little older, and begin to charge."""
        self.cycles += max(0.0, self.share - battery.share)
        self.share, self._charging_since_s = battery.share, now_s


def packs_of(pad: int, kind: Packs, seed: int) -> list[Pack]:
    """Return the packs of one pad, ids "<pad>-1", "<pad>-2", ...; the same seed gives the same packs."""
    chance = random.Random(f"packs/{seed}/{pad}")  # noqa: S311
    return [
        Pack(
            f"{pad}-{number}",
            kind,
            cycles=chance.uniform(0.0, kind.worn_cycles),
            rate=max(0.0, chance.gauss(1.0, kind.spread)),
        )
        for number in range(1, kind.count + 1)
    ]
