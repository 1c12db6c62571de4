"""Users that move, in files: lines with a place for each slot, and velocities."""

from __future__ import annotations

import pytest

from skyfolio.api.places.assembling import ScenarioSettings
from skyfolio.api.places.faults import FaultyFilesError
from skyfolio.api.places.files import SourceFile
from skyfolio.api.places.importing import import_files
from skyfolio.api.places.writing import Format, write_scenario
from skyfolio.planner import EXAMPLES, Scenario, User


def town() -> Scenario:
    """Return users on a track, with a velocity and growing uncertainty, and at a place."""
    track = ((20.0, 50.0), (25.5, 50.0), (25.5, 50.0), (31.0, 52.25))
    return EXAMPLES["minimal"]().with_changes(
        users=(
            User(id="walks", position_m=track[0], positions_m=track),
            User(
                id="drifts",
                position_m=(60.0, 60.0),
                velocity_mps=(1.5, -0.5),
                uncertainty_m=3.0,
                uncertainty_mps=0.25,
            ),
            User(id="stays", position_m=(140.0, 60.0)),
        )
    )


@pytest.mark.parametrize("form", ["geojson", "kml", "csv"])
def test_tracks_and_velocities_survive_the_way_out_and_in(form: Format) -> None:
    scenario = town()
    file = SourceFile(name=f"town.{form}", content=write_scenario(scenario, form).encode())
    settings = ScenarioSettings(origin=scenario.origin, slots=4)  # a table has none
    read = import_files([file], settings=settings).scenario
    for user, was in zip(read.users, scenario.users, strict=True):
        assert (user.id, user.velocity_mps) == (was.id, was.velocity_mps)
        assert (user.uncertainty_m, user.uncertainty_mps) == (was.uncertainty_m, was.uncertainty_mps)
        for n in range(4):
            assert user.place_m(n, 5.0) == pytest.approx(was.place_m(n, 5.0), abs=2e-6)


def test_windows_weights_and_demands_are_columns() -> None:
    text = (
        "id,lat,lon,arrives_at_slot,leaves_at_slot,weight,demand_bps\na,47.398,8.546,1,3,2.5,4000\nb,47.398,8.547,,,,\n"
    )
    a, b = import_files(
        [SourceFile(name="users.csv", content=text.encode())], base=EXAMPLES["minimal"]()
    ).scenario.users
    assert (a.arrives_at_slot, a.leaves_at_slot, a.weight, a.demand_bps) == (1, 3, 2.5, 4000.0)
    assert (b.arrives_at_slot, b.leaves_at_slot, b.weight, b.demand_bps) == (None,) * 4
    wrong = text.replace("1,3", "3,1")
    with pytest.raises(FaultyFilesError, match=r"users\.csv: row 2: .*leaves_at_slot: 1 must be greater"):
        import_files([SourceFile(name="users.csv", content=wrong.encode())], base=EXAMPLES["minimal"]())


def test_half_a_velocity_is_refused_by_row_and_column() -> None:
    text = "id,lat,lon,velocity_east_mps\na,47.398,8.546,1.5\n"
    with pytest.raises(FaultyFilesError) as raised:
        import_files([SourceFile(name="users.csv", content=text.encode())], base=EXAMPLES["minimal"]())
    [fault] = raised.value.faults
    assert (fault.row, fault.column) == ("row 2", "velocity_east_mps")
    assert "belong together" in fault.message


def test_a_kml_line_of_one_place_is_refused() -> None:
    text = (
        '<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Folder><name>Users</name><Placemark><name>a</name>'
        "<LineString><coordinates>8.546,47.398</coordinates></LineString></Placemark></Folder></Document></kml>"
    )
    with pytest.raises(FaultyFilesError, match="a line must have two places or more"):
        import_files([SourceFile(name="users.kml", content=text.encode())], base=EXAMPLES["minimal"]())
