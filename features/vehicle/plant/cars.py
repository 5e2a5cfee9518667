"""The simulated cars as estimators believe in them, by name.

Masses and geometry are those of the CommonRoad vehicle models (Althoff and Wuersching, 2020, tables
6 and 7). The tyres are those that `tyre_identification` finds, friction included, in the ramp-steer
drive of the car with 29 states (`vehicle_truth.TRUE_CARS`): what suspension and load transfer leave
of the data sheet's stiffness, which contains neither.
"""

from msgspec.structs import replace

from concord.features.vehicle.plant.parameters import BMW_320I, Car

FITTED_CARS = {
    "bmw-320i": replace(
        BMW_320I,
        name="BMW 320i, tyres fitted",
        front_stiffness_n_rad=146.5e3,
        rear_stiffness_n_rad=116.6e3,
        friction=1.013,
    ),
    "bmw-320i-soft": replace(
        BMW_320I,
        name="BMW 320i on soft tyres, fitted",
        front_stiffness_n_rad=67.9e3,
        rear_stiffness_n_rad=58.2e3,
        friction=1.102,
    ),
    "ford-escort": Car(
        name="Ford Escort, tyres fitted",
        mass_kg=1225.8878467253344,
        yaw_inertia_kg_m2=1538.8533713561394,
        front_axle_m=0.88392,
        rear_axle_m=1.50876,
        front_stiffness_n_rad=179.5e3,
        rear_stiffness_n_rad=120.7e3,
        friction=1.012,
        front_track_m=1.389888,
        rear_track_m=1.423416,
        driven_axle="front",
    ),
    "vw-vanagon": Car(
        name="VW Vanagon, tyres fitted",
        mass_kg=1478.8979637767998,
        yaw_inertia_kg_m2=2473.1176915564442,
        front_axle_m=1.1507916024,
        rear_axle_m=1.3211363976,
        front_stiffness_n_rad=186.3e3,
        rear_stiffness_n_rad=167.2e3,
        friction=1.000,
        front_track_m=1.574292,
        rear_track_m=1.543812,
        driven_axle="rear",
    ),
}
