"""Cars as files, and the one that is known here beside its source."""

import msgspec
import pytest

from concord.features.vehicle.plant.cars import FITTED_CARS
from concord.features.vehicle.plant.parameters import (
    BMW_320I,
    CarError,
    ProcessNoise,
    car_from_toml,
    car_to_toml,
)

MY_CAR = car_to_toml(BMW_320I).partition("\n[")[0] + "\n"


def test_a_car_survives_its_file():
    for car in (
        BMW_320I,
        *FITTED_CARS.values(),
        msgspec.structs.replace(BMW_320I, name='a "car" \\ é'),
        msgspec.structs.replace(BMW_320I, process_noise=ProcessNoise(side_slip_rad=0.5)),
    ):
        assert car_from_toml(car_to_toml(car)) == car


def test_a_file_may_leave_process_noise_out_or_give_some_of_it():
    assert car_from_toml(MY_CAR) == BMW_320I
    given = car_from_toml(MY_CAR + "[process_noise]\nsteering_rad = 0.1\n").process_noise
    assert given == ProcessNoise(steering_rad=0.1)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("name = ", "not TOML"),
        ('name = "x"', "mass_kg"),
        (car_to_toml(BMW_320I) + "wheels = 4\n", "wheels"),
        (car_to_toml(BMW_320I).replace('"rear"', '"both"'), "both"),
        (car_to_toml(BMW_320I).replace("friction = 1.0489", "friction = -1.0"), "above 0"),
        (car_to_toml(BMW_320I).replace("friction = 1.0489", "friction = nan"), "above 0"),
        (MY_CAR + "[process_noise]\nside_slip_rad = 0.0\n", "process_noise: side_slip_rad is 0.0"),
        (MY_CAR + "[process_noise]\nslip = 0.1\n", "slip"),
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
    pytest.importorskip("vehiclemodels", reason="needs the extra vehicle")
    from concord.features.vehicle.plant.truth import BMW, data_sheet

    library = msgspec.structs.asdict(data_sheet(BMW))
    for field, value in msgspec.structs.asdict(BMW_320I).items():
        if isinstance(value, float):
            assert library[field] == pytest.approx(value, rel=1e-5), field
        else:
            assert library[field] == value, field


@pytest.mark.parametrize("name", FITTED_CARS)
def test_fitting_changes_the_tyres_alone(name: str):
    pytest.importorskip("vehiclemodels", reason="needs the extra vehicle")
    from concord.features.vehicle.plant.truth import TRUE_CARS, data_sheet

    library = msgspec.structs.asdict(data_sheet(TRUE_CARS[name]))
    tyres = {"name", "front_stiffness_n_rad", "rear_stiffness_n_rad", "friction"}
    for field, value in msgspec.structs.asdict(FITTED_CARS[name]).items():
        if field not in tyres:
            same = value == library[field] or value == pytest.approx(library[field], rel=1e-9)
            assert same, field


@pytest.mark.slow
@pytest.mark.parametrize("name", FITTED_CARS)
def test_the_fitted_tyres_are_what_identification_finds(name: str):
    pytest.importorskip("vehiclemodels", reason="needs the extra vehicle")
    from concord.features.vehicle.plant.manoeuvres import MANOEUVRES
    from concord.features.vehicle.plant.truth import TRUE_CARS, data_sheet, simulate
    from concord.features.vehicle.plant.tyre_identification import identify

    car = TRUE_CARS[name]
    drive = simulate(MANOEUVRES["ramp-steer"], car, 0.01)
    found = identify(drive, data_sheet(car), seek_friction=True).car
    for field in ("front_stiffness_n_rad", "rear_stiffness_n_rad", "friction"):
        assert getattr(FITTED_CARS[name], field) == pytest.approx(getattr(found, field), rel=2e-3)


def test_every_simulated_car_has_one_who_believes_in_it():
    from concord.features.vehicle.plant.truth import TRUE_CARS

    assert list(TRUE_CARS) == list(FITTED_CARS)
