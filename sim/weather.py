"""Wind with gusts, and the error of the satellites: seeded for each vehicle, calm and exact by default."""

import math
import random
from collections.abc import Iterator
from dataclasses import dataclass, fields

from skyfolio.sim.knobs import LONGEST_S, check_number

DRIFT_MPS = 0.3
"""How fast a position estimate without satellites walks away in still air."""
DRIFT_PER_WIND = 0.2
"""How much faster it does so per m/s of wind."""


MOST_MPS = 100.0


@dataclass(frozen=True, kw_only=True, slots=True)
class WindFront:
    """A front that passes over the field: from fleet second `at_s` on, within `ramp_s`, the wind becomes another one.

    east_mps, north_mps: where the mean wind then blows to. gust_mps: standard deviation of its gusts on each axis.
    ValueError names a field that is out of range.
    """

    at_s: float
    east_mps: float = 0.0
    north_mps: float = 0.0
    gust_mps: float = 0.0
    ramp_s: float = 60.0

    def __post_init__(self) -> None:
        check_number("at_s", self.at_s, 0.0, LONGEST_S)
        check_number("east_mps", self.east_mps, -MOST_MPS, MOST_MPS)
        check_number("north_mps", self.north_mps, -MOST_MPS, MOST_MPS)
        check_number("gust_mps", self.gust_mps, 0.0, MOST_MPS)
        check_number("ramp_s", self.ramp_s, 0.0, LONGEST_S)


@dataclass(frozen=True, kw_only=True, slots=True)
class Weather:
    """The air over the field and the satellites' error.

    wind_east_mps, wind_north_mps: where the mean wind blows to. gust_mps: standard deviation of gusts on each axis,
    a first-order Gauss-Markov process with time constant gust_s. gps_m, gps_s: the same for the error of the position
    estimate, horizontally; the altitude's is twice as large. fronts: how the wind changes later, in order of time.
    ValueError names a field that is out of range.
    """

    wind_east_mps: float = 0.0
    wind_north_mps: float = 0.0
    gust_mps: float = 0.0
    gust_s: float = 3.0
    gps_m: float = 0.0
    gps_s: float = 30.0
    fronts: tuple[WindFront, ...] = ()

    def __post_init__(self) -> None:
        for field in fields(self):
            if field.name == "fronts":
                continue
            value = getattr(self, field.name)
            if not math.isfinite(value):
                raise ValueError(f"{field.name} must be a finite number, got {value}")
            if field.name in ("gust_mps", "gps_m") and value < 0.0:
                raise ValueError(f"{field.name} must not be negative, got {value}")
            if field.name in ("gust_s", "gps_s") and value <= 0.0:
                raise ValueError(f"{field.name} must be above 0, got {value}")
        times_s = [front.at_s for front in self.fronts]
        if times_s != sorted(times_s):
            raise ValueError(f"fronts must be in order of at_s, got {times_s}")

    def wind_at(self, now_s: float) -> tuple[float, float, float]:
        """Return the mean wind east and north and the spread of gusts at a fleet second, m/s.

        A front that comes before the one before it has passed begins from the wind of that moment.
        """
        wind = (self.wind_east_mps, self.wind_north_mps, self.gust_mps)
        for front, until_s in self._passing():
            if now_s <= front.at_s:
                break
            passed_s = min(now_s, until_s) - front.at_s
            share = min(1.0, passed_s / front.ramp_s) if front.ramp_s > 0.0 else 1.0
            after = (front.east_mps, front.north_mps, front.gust_mps)
            east, north, gust = (one + (other - one) * share for one, other in zip(wind, after, strict=True))
            wind = (east, north, gust)
        return wind

    def _passing(self) -> Iterator[tuple[WindFront, float]]:
        """Yield each front, and the fleet second at which the next one takes over."""
        for number, front in enumerate(self.fronts, start=1):
            yield front, self.fronts[number].at_s if number < len(self.fronts) else math.inf


class Air:
    """The weather around one vehicle; `step` moves it on.

    `wind_mps` and `gust_mps` are (east, north), `error_m` is the position estimate's (east, north, up).
    """

    def __init__(self, weather: Weather, seed: str) -> None:
        self.weather = weather
        self.gust_mps = (0.0, 0.0)
        self.error_m = (0.0, 0.0, 0.0)
        self._random = random.Random(seed)  # noqa: S311
        self._drift = self._random.uniform(0.0, math.tau)
        gusts = [weather.gust_mps, *(front.gust_mps for front in weather.fronts)]
        self._noisy = weather.gps_m > 0.0 or max(gusts) > 0.0
        self._mean_mps = (weather.wind_east_mps, weather.wind_north_mps)
        self._spread_mps = weather.gust_mps

    @property
    def wind_mps(self) -> tuple[float, float]:
        """Mean wind and gust together, m/s east and north."""
        east, north = self.gust_mps
        mean_east, mean_north = self._mean_mps
        return mean_east + east, mean_north + north

    @property
    def is_still(self) -> bool:
        """Whether nothing blows and nothing is in error."""
        return not self._noisy and self.error_m == (0.0, 0.0, 0.0) and self.wind_mps == (0.0, 0.0)

    def step(self, now_s: float, dt_s: float, *, satellites: bool) -> None:
        """Move on by `dt_s` seconds, to fleet second `now_s`; without `satellites` the estimate drifts away."""
        weather = self.weather
        if weather.fronts:
            east_mps, north_mps, self._spread_mps = weather.wind_at(now_s)
            self._mean_mps = (east_mps, north_mps)
        if self._noisy:
            east, north = self.gust_mps
            self.gust_mps = (
                self._wander(east, self._spread_mps, weather.gust_s, dt_s),
                self._wander(north, self._spread_mps, weather.gust_s, dt_s),
            )
        if not satellites:
            self._walk_away(dt_s)
        elif weather.gps_m > 0.0:
            sizes = (weather.gps_m, weather.gps_m, 2.0 * weather.gps_m)
            errors = [self._wander(e, s, weather.gps_s, dt_s) for e, s in zip(self.error_m, sizes, strict=True)]
            self.error_m = (errors[0], errors[1], errors[2])
        elif self.error_m != (0.0, 0.0, 0.0):
            self.error_m = (0.0, 0.0, 0.0)

    def _walk_away(self, dt_s: float) -> None:
        east, north, up = self.error_m
        wind_east, wind_north = self.wind_mps
        east -= (DRIFT_MPS * math.sin(self._drift) + DRIFT_PER_WIND * wind_east) * dt_s
        north -= (DRIFT_MPS * math.cos(self._drift) + DRIFT_PER_WIND * wind_north) * dt_s
        self.error_m = (east, north, up)

    def _wander(self, value: float, size: float, time_s: float, dt_s: float) -> float:
        keep = math.exp(-dt_s / time_s)
        return value * keep + size * math.sqrt(1.0 - keep * keep) * self._random.gauss(0.0, 1.0)
