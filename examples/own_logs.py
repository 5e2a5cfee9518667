"""Logs of docs/own_data.md: a car with three sensors, a reactor, and a robot's ROS 2 bag.

Usage: python examples/own_logs.py [FOLDER]. It writes drive/gps.csv, drive/imu.csv and
drive/odometer.csv, reactor.csv, and robot.mcap (which needs the extra `logs`).
"""

import sys
from pathlib import Path

import numpy as np
from own_log import IMU

ODOMETRY = "float64 distance\nfloat64 speed"
START_NS = 1_780_315_200_000_000_000


def write_table(file: Path, names: str, rows: list[list[float]]) -> None:
    """Write names and rows of numbers as CSV."""
    lines = [names, *(",".join(f"{value:.6g}" for value in row) for row in rows)]
    file.write_text("\n".join(lines) + "\n")


def write_drive(folder: Path) -> None:
    """Drive 20 s: GPS at 4 Hz that comes 0.1 s late, IMU at 20 Hz, odometer at 10 Hz
    with missing rows."""
    generator, step_s, wheelbase = np.random.default_rng(1), 0.05, 2.7
    east = north = heading = steering = 0.0
    speed = 8.0
    gps, imu, odometer = [], [], []
    for k in range(400):
        time_ms = 50 * k
        turning = speed / wheelbase * np.tan(steering)
        noise = generator.standard_normal(6)
        imu.append([time_ms, np.degrees(turning + 0.01 * noise[0])])
        if k % 2 == 0 and generator.random() > 0.1:
            odometer.append([time_ms, 3.6 * (speed + 0.1 * noise[1])])
        if k % 5 == 0:
            gps.append([time_ms, east + 0.8 * noise[2], north + 0.8 * noise[3]])
        east += step_s * speed * np.cos(heading)
        north += step_s * speed * np.sin(heading)
        heading += step_s * turning
        speed += 0.03 * noise[4]
        steering += 0.003 * noise[5]
    folder.mkdir(parents=True, exist_ok=True)
    write_table(folder / "gps.csv", "t,east,north", gps)
    write_table(folder / "imu.csv", "t,gyro_z", imu)
    write_table(folder / "odometer.csv", "t,speed", odometer)


def write_reactor(file: Path) -> None:
    """Heat a stirred tank in steps; a thermometer reads every second."""
    generator, rows = np.random.default_rng(2), []
    state, dynamics = np.zeros(2), np.array([[-0.05, -0.01], [0.02, -0.08]])
    for k in range(300):
        heating = float(k % 100 < 50)
        rows.append([k, heating, state[1] + 0.1 * generator.standard_normal(), *state])
        for _ in range(20):
            change = dynamics @ state + np.array([0.0, 0.4]) * heating
            state = state + 0.05 * (change + 0.05 * generator.standard_normal(2))
    write_table(file, "time,heating,thermometer,concentration,temperature", rows)


def write_bag(file: Path) -> None:
    """Record the gyroscope and the odometer of a robot as ROS 2 does."""
    from mcap_ros2.writer import Writer

    generator = np.random.default_rng(3)
    with file.open("wb") as stream:
        writer = Writer(stream)
        imu = writer.register_msgdef("sensor_msgs/msg/Imu", IMU)
        odometry = writer.register_msgdef("robot_msgs/msg/Odometry", ODOMETRY)
        for k in range(300):
            stamp_ns, turning = START_NS + 50_000_000 * k, 0.3 * np.sin(0.05 * k)
            stamp = {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}
            noise = 0.02 * generator.standard_normal()
            covariances = ("orientation", "angular_velocity", "linear_acceleration")
            message = {f"{name}_covariance": [0.0] * 9 for name in covariances} | {
                "header": {"stamp": stamp, "frame_id": "imu"},
                "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
                "angular_velocity": {"x": 0.0, "y": 0.0, "z": turning + noise},
                "linear_acceleration": {"x": 0.0, "y": 0.0, "z": 9.81},
            }
            writer.write_message("/imu", imu, message, stamp_ns)
            if k % 4 == 0:
                speed = 0.5 + 0.1 * np.sin(0.03 * k) + 0.02 * generator.standard_normal()
                content = {"distance": 0.025 * k, "speed": speed}
                writer.write_message("/odometry", odometry, content, stamp_ns)
        writer.finish()


if __name__ == "__main__":
    FOLDER = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    write_drive(FOLDER / "drive")
    write_reactor(FOLDER / "reactor.csv")
    write_bag(FOLDER / "robot.mcap")
    print(f"drive/, reactor.csv and robot.mcap are in {FOLDER.resolve()}")
