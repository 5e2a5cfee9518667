"""A log of your own, from file to verdict: a small netCDF, MCAP or ULog file, and a run on it.

Usage: python examples/own_log.py [nc|mcap|ulg] [FOLDER]. The sensors of a simulated car have four
rates and stamps of their own. MCAP and ULog need the extra `logs`.
"""

import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import xarray as xr

CAR = """name = "simulated"
mass_kg = 1225.0
yaw_inertia_kg_m2 = 1540.0
front_axle_m = 0.88
rear_axle_m = 1.51
front_stiffness_n_rad = 180e3
rear_stiffness_n_rad = 120e3
"""


def signals(duration_s: float = 2.0, seed: int = 1) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Drive a slalom at 20 m/s; return stamps in s and noisy readings of each sensor."""
    step_s, speed = 1e-4, 20.0
    times_s = np.arange(0.0, duration_s, step_s)
    steering = 0.02 * np.sin(2.5 * times_s)
    yaw_rate, slip, lateral = np.zeros((3, len(times_s)))
    for k in range(len(times_s)):
        front = -180e3 * (slip[k] + 0.88 * yaw_rate[k] / speed - steering[k])
        rear = -120e3 * (slip[k] - 1.51 * yaw_rate[k] / speed)
        lateral[k] = (front + rear) / 1225.0
        if k + 1 < len(times_s):
            yaw_rate[k + 1] = yaw_rate[k] + step_s * (0.88 * front - 1.51 * rear) / 1540.0
            slip[k + 1] = slip[k] + step_s * (lateral[k] / speed - yaw_rate[k])
    inertial = [yaw_rate, lateral, -yaw_rate * slip * speed]  # without this a the speed would drift
    wheels = [speed - 0.75 * yaw_rate, speed + 0.75 * yaw_rate]
    true = {  # rate in Hz, columns, standard deviations
        "inertial": (200, inertial, [0.005, 1.0, 0.05]),
        "wheels": (50, wheels, [0.1, 0.1]),
        "steering": (90, [steering], [0.0005]),
        "side_slip": (20, [slip], [0.0]),
    }
    generator, logged = np.random.default_rng(seed), {}
    for name, (rate_hz, columns, std) in true.items():
        stamps_s = np.arange(0.0, duration_s - 0.02, 1 / rate_hz)
        stamps_s = np.round(stamps_s + generator.uniform(0, 0.3 / rate_hz, len(stamps_s)), 6)
        exact = np.stack([np.interp(stamps_s, times_s, values) for values in columns], axis=-1)
        logged[name] = stamps_s, exact + std * generator.standard_normal(exact.shape)
    return logged


def write_netcdf(folder: Path, logged: dict[str, tuple[np.ndarray, np.ndarray]]) -> str:
    """Write an xarray.Dataset with a time coordinate for each sensor; return its column map."""
    start = np.datetime64("2026-06-01T12:00:00", "ns")
    names = {
        "inertial": ["yaw_rate", "lateral_acceleration", "longitudinal_acceleration"],
        "wheels": ["rear_left_wheel", "rear_right_wheel"],
        "steering": ["steering"],
        "side_slip": ["side_slip"],
    }
    log = xr.Dataset()
    for sensor, (stamps_s, values) in logged.items():
        stamps = start + (stamps_s * 1e9).astype("timedelta64[ns]")
        for place, name in enumerate(names[sensor]):
            log[name] = (f"time_{sensor}", values[:, place])
        log = log.assign_coords({f"time_{sensor}": stamps})
    log.to_netcdf(folder / "drive.nc", engine="h5netcdf")
    return columns_map("drive.nc", {name: name for some in names.values() for name in some})


HEADER = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
IMU = f"""std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
================================================================================
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z{HEADER}"""
JOINTS = f"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort{HEADER}"""


def write_mcap(folder: Path, logged: dict[str, tuple[np.ndarray, np.ndarray]]) -> str:
    """Write messages of ROS 2, sensor_msgs/Imu and JointState and std_msgs/Float64."""
    from mcap_ros2.writer import Writer

    start_ns = 1_780_315_200_000_000_000
    with (folder / "drive.mcap").open("wb") as stream:
        writer = Writer(stream)
        imu = writer.register_msgdef("sensor_msgs/msg/Imu", IMU)
        joints = writer.register_msgdef("sensor_msgs/msg/JointState", JOINTS)
        number = writer.register_msgdef("std_msgs/msg/Float64", "float64 data")
        for sensor, (stamps_s, values) in logged.items():
            for stamp_s, reading in zip(stamps_s.tolist(), values.tolist(), strict=True):
                stamp_ns = start_ns + round(stamp_s * 1e9)
                stamp = {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}
                message: dict = {"header": {"stamp": stamp, "frame_id": sensor}}
                arrived_ns = stamp_ns + 3_000_000  # after the stamp, so the header must be read
                if sensor == "inertial":
                    yaw_rate, lateral, longitudinal = reading
                    covariances = ("orientation", "angular_velocity", "linear_acceleration")
                    message |= {f"{name}_covariance": [0.0] * 9 for name in covariances}
                    message["orientation"] = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
                    message["angular_velocity"] = {"x": 0.0, "y": 0.0, "z": yaw_rate}
                    message["linear_acceleration"] = {"x": longitudinal, "y": lateral, "z": 9.81}
                    writer.write_message("/imu", imu, message, arrived_ns)
                elif sensor == "wheels":
                    message |= {"name": ["rear_left", "rear_right"], "velocity": reading}
                    writer.write_message(
                        "/wheels", joints, {**message, "position": [], "effort": []}, arrived_ns
                    )
                else:  # a number has no header: the time of its record is its stamp
                    writer.write_message(f"/{sensor}", number, {"data": reading[0]}, stamp_ns)
        writer.finish()
    return columns_map(
        "drive.mcap",
        {
            "yaw_rate": "/imu.angular_velocity.z",
            "lateral_acceleration": "/imu.linear_acceleration.y",
            "longitudinal_acceleration": "/imu.linear_acceleration.x",
            "rear_left_wheel": "/wheels.velocity[0]",
            "rear_right_wheel": "/wheels.velocity[1]",
            "steering": "/steering.data",
            "side_slip": "/side_slip.data",
        },
    )


def write_ulog(folder: Path, logged: dict[str, tuple[np.ndarray, np.ndarray]]) -> str:
    """Write a ULog file (docs.px4.io, ULog File Format): header, formats, subscriptions, data."""

    def record(kind: str, content: bytes) -> bytes:
        return struct.pack("<HB", len(content), ord(kind)) + content

    formats, subscriptions, data = b"", b"", []
    for number, (sensor, (stamps_s, values)) in enumerate(logged.items()):
        columns = values.shape[1]
        formats += record("F", f"{sensor}:uint64_t timestamp;double[{columns}] value;".encode())
        subscriptions += record("A", struct.pack("<BH", 0, number) + sensor.encode())
        for stamp_s, reading in zip(stamps_s.tolist(), values.tolist(), strict=True):
            stamp_us = round(stamp_s * 1e6)
            content = struct.pack(f"<HQ{columns}d", number, stamp_us, *reading)
            data.append((stamp_us, record("D", content)))
    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
    flags = record("B", bytes(40))
    log = b"".join(content for _, content in sorted(data))
    (folder / "drive.ulg").write_bytes(head + flags + formats + subscriptions + log)
    return columns_map(
        "drive.ulg",
        {
            "yaw_rate": "inertial.value[0]",
            "lateral_acceleration": "inertial.value[1]",
            "longitudinal_acceleration": "inertial.value[2]",
            "rear_left_wheel": "wheels.value[0]",
            "rear_right_wheel": "wheels.value[1]",
            "steering": "steering.value[0]",
            "side_slip": "side_slip.value[0]",
        },
    )


def columns_map(file: str, columns: dict[str, str]) -> str:
    """Return the text of columns.toml."""
    lines = [f'file = "{file}"']
    for quantity, column in columns.items():
        unit = "rad/s" if quantity == "yaw_rate" else "m/s" if "wheel" in quantity else "rad"
        unit = "m/s2" if "acceleration" in quantity else unit
        lines.append(f'{quantity} = {{ column = "{column}", unit = "{unit}" }}')
    return "\n".join(lines) + "\n"


WRITERS = {"nc": write_netcdf, "mcap": write_mcap, "ulg": write_ulog}


def main() -> None:
    """Write the log, then let the command judge a run on it."""
    kind = sys.argv[1] if len(sys.argv) > 1 else "nc"
    if kind not in WRITERS:
        sys.exit(f"{kind}: no such kind of log; choose {', '.join(WRITERS)}")
    folder = Path(sys.argv[2] if len(sys.argv) > 2 else f"runs/own_log_{kind}")
    folder.mkdir(parents=True)
    (folder / "columns.toml").write_text(WRITERS[kind](folder, signals()))
    (folder / "car.toml").write_text(CAR)
    command = [sys.executable, "-m", "concord.experiments", "run", "--scenario", "vehicle-network"]
    subprocess.run([*command, "--data", folder, "--filter", "ukf"], check=True)


if __name__ == "__main__":
    main()
