"""The vehicle that is simulated: a Holybro X500 V2 (500 mm quadrotor, 10 inch propellers) on a 4S 5000 mAh battery.

Its maker names about 18 minutes of hovering without a payload on such a battery; the power model below draws 80 % of it
in that time. Electrical power over airspeed V follows Y. Zeng, J. Xu, R. Zhang, "Energy minimization for wireless
communication with rotary-wing UAV", IEEE Trans. Wireless Commun. 18(4), 2019, eq. (6): blade profile, induced and
parasite power, plus the change of potential energy.
"""

import math

GRAVITY_MPS2 = 9.81
MASS_KG = 2.0
"""Frame, motors, flight controller, radio and battery."""
CELLS = 4
NOMINAL_V = 3.7 * CELLS
FULL_CELL_V, EMPTY_CELL_V = 4.15, 3.5
RESISTANCE_OHM = 0.03
"""Internal resistance of the whole pack when it is new."""
RESERVE_SHARE = 0.2
"""The charge with which a flight ends when the minutes that a battery lasts are counted."""
BLADE_W = 61.5
"""Blade profile power at hover: 197 W less the induced power."""
TIP_MPS = 90.0
INDUCED_MPS = 6.29
"""Mean rotor-induced velocity at hover: sqrt(m g / 2 rho A) for four 10 inch discs (A = 0.203 m^2)."""
INDUCED_W = 1.1 * MASS_KG * GRAVITY_MPS2 * INDUCED_MPS
PARASITE_W_PER_MPS3 = 0.018
"""Half the air density times the drag area (0.03 m^2)."""
DESCENT_RECOVERY = 0.3
"""Share of the potential power of a descent that is saved; the rest is lost in the wake."""
IDLE_W = 12.0
"""Power of electronics and radio with the motors off."""
ARMED_IDLE_W = 25.0
MAX_AIRSPEED_MPS = 18.0
"""Airspeed at full tilt; a stronger wind blows the vehicle away."""
GUST_SHARE = 0.2
"""Share of a gust's speed by which the vehicle is carried along before its controller leans against it."""


def flight_power_w(airspeed_mps: float, up_mps: float) -> float:
    """Return the electrical power of flying at an airspeed (m/s, horizontal) and a climb rate (m/s)."""
    speed2 = airspeed_mps * airspeed_mps
    ratio = speed2 / (2.0 * INDUCED_MPS**2)
    induced = INDUCED_W * math.sqrt(math.sqrt(1.0 + ratio * ratio) - ratio)
    blade = BLADE_W * (1.0 + 3.0 * speed2 / TIP_MPS**2)
    climb = MASS_KG * GRAVITY_MPS2 * (up_mps if up_mps > 0.0 else DESCENT_RECOVERY * up_mps)
    return max(IDLE_W, blade + induced + PARASITE_W_PER_MPS3 * airspeed_mps**3 + climb)


def capacity_for_mah(minutes: float) -> float:
    """Return the capacity in mAh on which it hovers so many minutes in still air, until `RESERVE_SHARE` is left."""
    used_wh = flight_power_w(0.0, 0.0) * minutes / 60.0
    return used_wh / (1.0 - RESERVE_SHARE) / NOMINAL_V * 1000.0


class Battery:
    """The battery on board: `share` is the charge left, from 0 to 1 of what it holds, and `power_w` the power drawn.

    health: what it holds now over what it held when it was new. resistance_ohm: its internal resistance.
    """

    def __init__(self) -> None:
        self.share = 1.0
        self.power_w = IDLE_W
        self.health = 1.0
        self.resistance_ohm = RESISTANCE_OHM

    @property
    def current_a(self) -> float:
        """Current drawn, in amperes: times the voltage under it, it is the power drawn, as a power module measures."""
        open_v = self._open_v
        ohm = self.resistance_ohm
        return (open_v - math.sqrt(max(0.0, open_v**2 - 4.0 * ohm * self.power_w))) / (2.0 * ohm)

    @property
    def voltage_v(self) -> float:
        """Voltage of the pack under its load."""
        return self._open_v - self.resistance_ohm * self.current_a

    @property
    def _open_v(self) -> float:
        return CELLS * (EMPTY_CELL_V + (FULL_CELL_V - EMPTY_CELL_V) * self.share)

    def drain(self, power_w: float, dt_s: float, capacity_mah: float) -> None:
        """Draw `power_w` watts for `dt_s` seconds from a battery that held `capacity_mah` when it was new and full."""
        self.power_w = power_w
        self.share = max(0.0, self.share - power_w * dt_s / (capacity_mah * self.health * 3.6 * NOMINAL_V))
