"""Wind with gusts, and the error of the satellites: seeded for each vehicle, calm and exact by default."""

import math
import random
from dataclasses import dataclass, fields

DRIFT_MPS = 0.3
"""How fast a position estimate without satellites walks away in still air."""
DRIFT_PER_WIND = 0.2
"""How much faster it does so per m/s of wind."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Weather:
    """The air over the field and the satellites' error.

    wind_east_mps, wind_north_mps: where the mean wind blows to. gust_mps: standard deviation of gusts on each axis,
    a first-order Gauss-Markov process with time constant gust_s. gps_m, gps_s: the same for the error of the position
    estimate, horizontally; the altitude's is twice as large. ValueError names a field that is out of range.
    """

    wind_east_mps: float = 0.0
    wind_north_mps: float = 0.0
    gust_mps: float = 0.0
    gust_s: float = 3.0
    gps_m: float = 0.0
    gps_s: float = 30.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not math.isfinite(value):
                raise ValueError(f"{field.name} must be a finite number, got {value}")
            if field.name in ("gust_mps", "gps_m") and value < 0.0:
                raise ValueError(f"{field.name} must not be negative, got {value}")
            if field.name in ("gust_s", "gps_s") and value <= 0.0:
                raise ValueError(f"{field.name} must be above 0, got {value}")


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
        self._noisy = weather.gust_mps > 0.0 or weather.gps_m > 0.0

    @property
    def wind_mps(self) -> tuple[float, float]:
        """Mean wind and gust together, m/s east and north."""
        east, north = self.gust_mps
        return self.weather.wind_east_mps + east, self.weather.wind_north_mps + north

    @property
    def is_still(self) -> bool:
        """Whether nothing blows and nothing is in error."""
        return not self._noisy and self.error_m == (0.0, 0.0, 0.0) and self.wind_mps == (0.0, 0.0)

    def step(self, dt_s: float, *, satellites: bool) -> None:
        """Move on by `dt_s` seconds; without `satellites` the estimate drifts away."""
        weather = self.weather
        if self._noisy:
            east, north = self.gust_mps
            self.gust_mps = (
                self._wander(east, weather.gust_mps, weather.gust_s, dt_s),
                self._wander(north, weather.gust_mps, weather.gust_s, dt_s),
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
