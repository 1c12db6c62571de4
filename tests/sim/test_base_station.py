"""Base stations on vehicles: they serve what they acknowledged, and faults strike them alone."""

import math

import pytest

from skyfolio import sim
from skyfolio.sim import BaseStation, RadioTruth, Served, TruthChannel, VirtualClock

NOW, LATER = Served(0.0, 5.0, {"a": 1000.0}), Served(5.0, 10.0, {"b": 2000.0})
HERE = (47.3977, 8.5456)


def serving(station: BaseStation, revision: int = 1) -> BaseStation:
    station.hear(revision, [NOW, LATER], 0.0)
    assert station.ready(0.0) == revision
    station.acknowledge(revision)
    return station


def test_it_serves_nothing_that_it_has_not_acknowledged() -> None:
    station = BaseStation()
    station.hear(1, [NOW], 0.0)
    assert station.serves(1.0) == {}
    station.acknowledge(1)
    assert station.serves(1.0) == {"a": 1000.0}


def test_it_serves_each_slot_while_that_is_valid() -> None:
    station = serving(BaseStation())
    assert [station.serves(at) for at in (0.0, 4.9, 5.0, 9.9, 10.0)] == [
        *({"a": 1000.0}, {"a": 1000.0}, {"b": 2000.0}, {"b": 2000.0}, {})
    ]


def test_an_older_order_changes_nothing() -> None:
    station = serving(BaseStation(), revision=5)
    station.hear(4, [Served(0.0, 9.0, {"z": 1.0})], 1.0)
    assert station.ready(1.0) is None
    assert station.serves(1.0) == {"a": 1000.0}


def test_a_deaf_one_serves_on_by_what_it_knows_and_then_nobody() -> None:
    station = serving(BaseStation())
    station.deaf = True
    station.hear(2, [Served(5.0, 20.0, {"c": 1.0})], 4.0)
    assert station.ready(6.0) is None
    assert (station.serves(6.0), station.serves(12.0)) == ({"b": 2000.0}, {})


def test_a_late_one_is_ready_when_it_is_and_not_before() -> None:
    station = BaseStation()
    station.late_s = 2.0
    station.hear(1, [NOW], 1.0)
    assert [station.ready(at) for at in (1.0, 2.9, 3.0)] == [None, None, 1]


# -- in the air -------------------------------------------------------------------------------------------------------


def hover(vehicle: sim.Vehicle) -> None:
    """It is 20 m up, from one moment to the next."""
    dynamics = vehicle.autopilot.dynamics
    dynamics.body = dynamics.body._replace(up_m=20.0)


def fleet_above(users: dict[str, tuple[float, float]], channel: TruthChannel) -> tuple[sim.Fleet, RadioTruth]:
    """Two vehicles 20 m up, the second some 170 m north of the first; both serve the first user."""
    specs = [sim.VehicleSpec(1, *HERE), sim.VehicleSpec(2, HERE[0] + 0.0015, HERE[1])]
    fleet = sim.Fleet(specs, clock=VirtualClock())
    for vehicle in fleet.vehicles.values():
        hover(vehicle)
        vehicle.base_station.hear(1, [Served(-1.0, 1e6, {"near": 10_000.0})], 0.0)
    return fleet, RadioTruth(fleet, channel, users, {1: 0.1, 2: 0.1})


def of(truth: RadioTruth, system_id: int = 1) -> sim.Received:
    [found] = [one for one in truth.received() if one.system_id == system_id]
    return found


def alone(channel: TruthChannel) -> tuple[sim.Fleet, RadioTruth]:
    fleet, truth = fleet_above({"near": HERE}, channel)
    fleet.vehicles[1].base_station.acknowledge(1)
    return fleet, truth


def test_the_sinr_is_worked_out_as_by_hand() -> None:
    fleet, truth = alone(TruthChannel(noise_dbm=-60.0))
    frame = fleet.vehicles[1].autopilot.frame
    north_m = frame.to_local(HERE[0] + 0.0015, HERE[1])[1]
    own, other, noise = 0.1 * 0.01 / 400.0, 0.1 * 0.01 / (400.0 + north_m**2), 1e-9
    sinr = own / (other + noise)
    assert of(truth).sinr_db == pytest.approx(10 * math.log10(sinr), abs=1e-3)
    assert of(truth).rate_bps == pytest.approx(10_000.0 * math.log2(1 + sinr), rel=1e-4)


def test_one_that_is_told_to_be_silent_disturbs_nobody_while_that_is_valid() -> None:
    fleet, truth = alone(TruthChannel(noise_dbm=-60.0))
    before = of(truth).sinr_db
    other = fleet.vehicles[2].base_station
    other.hear(2, [Served(-1.0, 1e6, {}, sends=False)], 0.0)
    assert of(truth).sinr_db == before, "it has not acknowledged that"
    other.acknowledge(2)
    assert of(truth).sinr_db > before + 10.0


def test_a_dead_vehicle_neither_serves_nor_disturbs() -> None:
    fleet, truth = alone(TruthChannel(noise_dbm=-60.0))
    before = of(truth).sinr_db
    fleet.inject(sim.Kill(2))
    assert of(truth).sinr_db > before + 10.0
    fleet.inject(sim.Kill(1))
    assert truth.received() == []


def test_bias_and_shadowing_are_of_links_and_from_a_seed() -> None:
    plain, biased = TruthChannel(), TruthChannel(bias_db=-6.0)
    assert plain.link_db(1, "a") == 0.0
    assert biased.link_db(1, "a") == -6.0
    shadowed = TruthChannel(shadowing_db=4.0, seed=3)
    drawn = [shadowed.link_db(system, f"u{k}") for system in range(1, 4) for k in range(200)]
    assert drawn == [
        TruthChannel(shadowing_db=4.0, seed=3).link_db(s, f"u{k}") for s in range(1, 4) for k in range(200)
    ]
    assert abs(sum(drawn) / len(drawn)) < 0.6
    assert 3.5 < math.sqrt(sum(db**2 for db in drawn) / len(drawn)) < 4.5
    fading = TruthChannel(rician_k_db=3.0)
    gains = [fading.fading(1, "a", float(second)) for second in range(2000)]
    assert sum(gains) / len(gains) == pytest.approx(1.0, abs=0.05)


def test_faults_strike_the_base_station_and_pass() -> None:
    fleet, truth = alone(TruthChannel(noise_dbm=-40.0))
    before = of(truth).sinr_db
    fleet.inject(sim.StationPower(1, db=-6.0, for_s=1.0))
    assert of(truth).sinr_db == pytest.approx(before - 6.0, abs=1e-6)
    fleet.step_to(fleet.now_s + 2.0)
    for vehicle in fleet.vehicles.values():
        hover(vehicle)
    fleet.inject(sim.StationJammed(1, db=20.0))
    assert of(truth).sinr_db < before - 15.0
    fleet.inject(sim.StationDeaf(1))
    fleet.inject(sim.StationLate(1, seconds=3.0))
    station = fleet.vehicles[1].base_station
    assert (station.deaf, station.late_s) == (True, 3.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("station-power:1,db=90", "db must be between -60 and 60"),
        ("station-jammed:1,db=-3", "db must be between 0 and 60"),
        ("station-late:1,seconds=-1", "seconds must be between 0 and 3600"),
        ("station-deaf:0", "system_id must be a whole number"),
        ("station-deaf:1,for_s=0", "for_s must be a number of seconds above 0"),
    ],
)
def test_what_no_fault_can_be_is_refused_by_name(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        sim.parse_fault(text)
    with pytest.raises(ValueError, match="bias_db must be between"):
        TruthChannel(bias_db=100.0)


def test_any_mean_gain_may_stand_for_free_space() -> None:
    def gain(system: int, user: str, position: tuple[float, float, float]) -> float:
        assert (user, position[2]) == ("near", 20.0)
        return 1e-6 if system == 1 else 1e-7

    fleet, _ = fleet_above({"near": HERE}, TruthChannel())
    fleet.vehicles[1].base_station.acknowledge(1)
    truth = RadioTruth(fleet, TruthChannel(noise_dbm=-60.0), {"near": HERE}, {1: 0.1, 2: 0.1}, mean_gain=gain)
    assert of(truth).sinr_db == pytest.approx(10 * math.log10(1e-7 / (1e-8 + 1e-9)), abs=1e-6)
