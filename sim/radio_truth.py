"""What users on the ground truly get from the base stations of a fleet: a channel that no planner knows.

The mean gain that planners assume (free space from a reference gain at one metre, or any other), and what they do not
know: a bias of all links, shadowing of each link, and Rician fading. Everything but the
vehicles' places is drawn from a seed.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from skyfolio.sim.field_texts import made_from
from skyfolio.sim.fleet import Fleet
from skyfolio.sim.geo import LocalFrame
from skyfolio.sim.knobs import check_number
from skyfolio.sim.station import Vehicle

LOWEST_M = 0.5
"""Metres above its home from which on a vehicle's base station is on."""
MOST_DB = 60.0
FADES_EVERY_S = 1.0
"""Fleet seconds after which fading is drawn anew."""
GeoPlace = tuple[float, float]
"""Latitude and longitude in degrees."""
MeanGain = Callable[[int, str, tuple[float, float, float]], float]
"""Mean power gain from a vehicle, by system id, to a user, by id, with the vehicle there: degrees, metres over home."""


@dataclass(frozen=True, kw_only=True)
class TruthChannel:
    """The true channel. bias_db: of all links. shadowing_db: standard deviation of each link's own, drawn from `seed`.

    rician_k_db: the factor of the fading; None for none. ValueError names a field that is out of range.
    """

    reference_gain_db: float = -20.0
    noise_dbm: float = -80.0
    bias_db: float = 0.0
    shadowing_db: float = 0.0
    rician_k_db: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        check_number("bias_db", self.bias_db, -MOST_DB, MOST_DB)
        check_number("shadowing_db", self.shadowing_db, 0.0, MOST_DB)
        if self.rician_k_db is not None:
            check_number("rician_k_db", self.rician_k_db, -MOST_DB, MOST_DB)

    def link_db(self, system_id: int, user_id: str) -> float:
        """Return by how many dB a link is better than the plain channel, fading aside."""
        drawn = random.Random(f"shadow/{self.seed}/{system_id}/{user_id}")  # noqa: S311
        return self.bias_db + drawn.gauss(0.0, self.shadowing_db)

    def fading(self, system_id: int, user_id: str, now_s: float) -> float:
        """Return the power gain |h|^2 of a link now, mean 1."""
        if self.rician_k_db is None:
            return 1.0
        number = int(now_s // FADES_EVERY_S)
        drawn = random.Random(f"fade/{self.seed}/{system_id}/{user_id}/{number}")  # noqa: S311
        k = 10 ** (self.rician_k_db / 10)
        scatter = math.sqrt(0.5 / (k + 1))
        real = math.sqrt(k / (k + 1)) + drawn.gauss(0.0, scatter)
        return real**2 + drawn.gauss(0.0, scatter) ** 2


def channel_from(text: str) -> TruthChannel:
    """Return the true channel that `FIELD=VALUE,...` describes, e.g. `bias_db=-6,seed=1`.

    ValueError names what is wrong.
    """
    return made_from(TruthChannel, text, "a channel")


@dataclass(frozen=True, slots=True)
class Received:
    """What a user gets from the base station that serves it, now."""

    system_id: int
    user_id: str
    bandwidth_hz: float
    sinr_db: float
    rate_bps: float


class RadioTruth:
    """Users on the ground, and a fleet's base stations above them.

    users_deg: where each user is. power_w: what the base station of each vehicle, by system id, is built to send.
    noise_dbm: in the band of each base station, where it differs from band to band; powers count by their density then.
    mean_gain: of links, instead of free space over level ground from `channel.reference_gain_db`.
    """

    def __init__(
        self,
        fleet: Fleet,
        channel: TruthChannel,
        users_deg: Mapping[str, GeoPlace],
        power_w: Mapping[int, float],
        noise_dbm: Mapping[int, float] | None = None,
        mean_gain: MeanGain | None = None,
    ) -> None:
        self._mean_gain = mean_gain or self._in_free_space
        self._fleet, self.channel, self._power_w = fleet, channel, dict(power_w)
        self._noise_dbm = dict.fromkeys(self._power_w, channel.noise_dbm) | dict(noise_dbm or {})
        self._frame = LocalFrame(*next(iter(users_deg.values())))
        self._users_m = {user: self._frame.to_local(*place) for user, place in users_deg.items()}
        self._link_db = {
            (system, user): channel.link_db(system, user) for system in self._power_w for user in self._users_m
        }

    def received(self) -> list[Received]:
        """Return what every user gets that some base station serves now.

        A base station in the air sends, whether it serves anybody or not, unless it was ordered to be silent.
        """
        now_s = self._fleet.now_s
        on = self._sending()
        found = []
        for system, vehicle in on.items():
            for user, hertz in vehicle.base_station.serves(now_s).items():
                sinr = self._sinr(system, user, on)
                found.append(
                    Received(system, user, hertz, 10.0 * math.log10(max(sinr, 1e-12)), hertz * math.log2(1.0 + sinr))
                )
        return found

    def _sending(self) -> dict[int, Vehicle]:
        vehicles = self._fleet.vehicles
        return {
            system: vehicles[system]
            for system in self._power_w
            if vehicles[system].alive
            and vehicles[system].position[2] > LOWEST_M
            and vehicles[system].base_station.sends(self._fleet.now_s)
        }

    def _sinr(self, serving: int, user: str, on: Mapping[int, Vehicle]) -> float:
        powers = {system: self._power_at(system, vehicle, user) for system, vehicle in on.items()}
        noise_w = 10 ** ((self._noise_dbm[serving] + on[serving].base_station.jam_db) / 10 - 3)
        others = (self._in_band(power, system, serving) for system, power in powers.items() if system != serving)
        return powers[serving] / (noise_w + sum(others))

    def _in_band(self, power_w: float, system: int, serving: int) -> float:
        """Return what of a base station's power lies in the band of another one: as much more as that is wider."""
        return power_w * float(10 ** ((self._noise_dbm[serving] - self._noise_dbm[system]) / 10))

    def _power_at(self, system: int, vehicle: Vehicle, user: str) -> float:
        """Return the power in watts that a user receives of a base station."""
        mean = self._mean_gain(system, user, vehicle.position)
        better_db = self._link_db[system, user] + vehicle.base_station.power_db
        fading = self.channel.fading(system, user, self._fleet.now_s)
        return float(self._power_w[system] * mean * 10 ** (better_db / 10) * fading)

    def _in_free_space(self, _: int, user: str, position: tuple[float, float, float]) -> float:
        lat_deg, lon_deg, up_m = position
        east_m, north_m = self._frame.to_local(lat_deg, lon_deg)
        at_m = self._users_m[user]
        squared_m2 = (east_m - at_m[0]) ** 2 + (north_m - at_m[1]) ** 2 + up_m**2
        return float(10 ** (self.channel.reference_gain_db / 10)) / squared_m2
