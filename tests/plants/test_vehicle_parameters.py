"""Cars as files, and the one that is known here beside its source."""

import msgspec
import pytest

from plants.vehicle_parameters import (
    BMW_320I,
    BMW_320I_FITTED,
    Car,
    CarError,
    car_from_toml,
    car_to_toml,
)


def test_a_car_survives_its_file():
    for car in (BMW_320I, BMW_320I_FITTED, msgspec.structs.replace(BMW_320I, name='a "car" \\ é')):
        assert car_from_toml(car_to_toml(car)) == car


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("name = ", "not TOML"),
        ('name = "x"', "mass_kg"),
        (car_to_toml(BMW_320I) + "wheels = 4\n", "wheels"),
        (car_to_toml(BMW_320I).replace('"rear"', '"both"'), "both"),
        (car_to_toml(BMW_320I).replace("friction = 1.0489", "friction = -1.0"), "above 0"),
        (car_to_toml(BMW_320I).replace("friction = 1.0489", "friction = nan"), "above 0"),
    ],
)
def test_a_bad_file_is_refused_by_what_is_wrong(text: str, says: str):
    with pytest.raises(CarError, match=says):
        car_from_toml(text)


def test_the_axles_carry_the_car_in_balance():
    car = BMW_320I
    assert car.front_load_n + car.rear_load_n == pytest.approx(car.mass_kg * 9.81)
    assert car.front_load_n * car.front_axle_m == pytest.approx(car.rear_load_n * car.rear_axle_m)


def test_the_known_car_is_the_librarys():
    pytest.importorskip("vehiclemodels", reason="needs concord[vehicle]")
    from plants.vehicle_truth import BMW, data_sheet

    library = msgspec.structs.asdict(data_sheet(BMW))
    for field, value in msgspec.structs.asdict(BMW_320I).items():
        if isinstance(value, float):
            assert library[field] == pytest.approx(value, rel=1e-5), field
        else:
            assert library[field] == value, field


def test_fitting_changes_the_tyres_alone():
    assert isinstance(BMW_320I_FITTED, Car)
    same = {"mass_kg", "yaw_inertia_kg_m2", "front_axle_m", "rear_axle_m", "rear_track_m"}
    for field in same:
        assert getattr(BMW_320I_FITTED, field) == getattr(BMW_320I, field)
