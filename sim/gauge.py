"""What an autopilot believes about its battery: it knows what it has measured since it was switched on."""

from skyfolio.sim.airframe import Battery


class Gauge:
    """The charge as one autopilot reports it, from one start to the next.

    Both count the charge drawn from 0 at each start (BATTERY_STATUS.current_consumed). ArduPilot takes the battery for
    new and full at its start, and subtracts what it has drawn since (AP_BattMonitor): after a restart in the middle of
    a flight, or with an aged pack, it reports more than there is. PX4 follows the voltage as well (its `battery`
    library), and comes close to the truth. counts_only: the first of the two.
    """

    def __init__(self, battery: Battery, *, counts_only: bool) -> None:
        self._battery = battery
        self._counts_only = counts_only
        self._at_start = battery.share

    @property
    def used(self) -> float:
        """Charge drawn since the start, as a share of what the battery held when it was new."""
        return max(0.0, self._at_start - self._battery.share) * self._battery.health

    @property
    def share(self) -> float:
        """The charge that it believes to be left, from 0 to 1."""
        return max(0.0, 1.0 - self.used) if self._counts_only else self._battery.share

    def take_for_drawn(self) -> None:
        """Take everything that is missing in the battery for drawn since the start, as if it had been full then."""
        self._at_start = self._battery.share + (1.0 - self._battery.share) / self._battery.health
