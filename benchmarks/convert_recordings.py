"""Public recordings as MCAP logs, so that the other programs can be run on more of them.

From the folder of a clone: the trials of BROAD (dlaidig/broad, `data_mat/*.mat`: IMU, magnetometer,
optical reference) and the drives of yongkyuns/imu_gnss_fusion (`web/datasets/*`: IMU, GNSS). What a
clone lacks, or holds as a pointer to a large file, is left out. Then

python benchmarks/convert_recordings.py --broad ../broad --drives ../imu_gnss_fusion --out ../more
python benchmarks/attitude_logs.py --data ../more --only broad
python benchmarks/land_vehicles.py --data ../more --log drives/urban-mixed-turns-nominal-001.mcap

The axes of the sensors are the logs' own; stamps are even in BROAD, which has none.
"""

from __future__ import annotations

import argparse
import gzip
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap_ros2.writer import Writer
from scipy.io import loadmat

from benchmarks.common import FloatArray
from tests.helpers.logs import definition

START_NS = 1_600_000_000 * 10**9
IMU, FIX = "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix"
FIELD, TWIST = "sensor_msgs/msg/MagneticField", "geometry_msgs/msg/TwistWithCovarianceStamped"
# Every so many rows of BROAD's reference are kept.
THINNED = 4

Timed = tuple[int, str, str, dict[str, Any]]


def stamps(seconds: FloatArray) -> list[int]:
    """Of seconds since the start, ns."""
    return [START_NS + round(1e9 * t) for t in seconds.tolist()]


def header(time_ns: int, frame: str) -> dict[str, Any]:
    """Of a message."""
    sec, nanosec = divmod(time_ns, 10**9)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame}


def vector(values: FloatArray) -> dict[str, float]:
    """Of a message."""
    return dict(zip("xyz", values.tolist(), strict=True))


def imu(times: list[int], gyro: FloatArray, accel: FloatArray) -> Iterator[Timed]:
    """Messages of an IMU without an orientation."""
    for time, omega, force in zip(times, gyro, accel, strict=True):
        message = {
            "header": header(time, "imu_link"),
            "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
            "orientation_covariance": [-1.0] + [0.0] * 8,
            "angular_velocity": vector(omega),
            "angular_velocity_covariance": [0.0] * 9,
            "linear_acceleration": vector(force),
            "linear_acceleration_covariance": [0.0] * 9,
        }
        yield time, "/imu/data_raw", IMU, message


def magnetic(times: list[int], field: FloatArray) -> Iterator[Timed]:
    """Messages of a magnetometer, T."""
    for time, values in zip(times, field, strict=True):
        message = {
            "header": header(time, "imu_link"),
            "magnetic_field": vector(values),
            "magnetic_field_covariance": [0.0] * 9,
        }
        yield time, "/imu/mag", FIELD, message


def fixes(gnss: Any) -> Iterator[Timed]:
    """Messages of a receiver, whose columns are those of the drives."""
    axes = ("e", "n", "d")
    for time, row in zip(stamps(gnss["t_s"]), gnss, strict=True):
        head = header(time, "gnss")
        place, speed = ([float(row[f"{of}_std_{a}_{unit}"]) ** 2 for a in axes] for of, unit in
                        (("pos", "m"), ("vel", "mps")))  # fmt: skip
        fix = {
            "header": head,
            "status": {"status": 0, "service": 1},
            "latitude": float(row["lat_deg"]),
            "longitude": float(row["lon_deg"]),
            "altitude": float(row["height_m"]),
            "position_covariance": np.diag(place).ravel().tolist(),
            "position_covariance_type": 2,
        }
        yield time, "/gnss/fix", FIX, fix
        velocity = np.array([row["ve_mps"], row["vn_mps"], -row["vd_mps"]])
        twist = {
            "twist": {"linear": vector(velocity), "angular": vector(np.zeros(3))},
            "covariance": np.diag([*speed, 0.0, 0.0, 0.0]).ravel().tolist(),
        }
        yield time, "/gnss/vel", TWIST, {"header": head, "twist": twist}


def write(path: Path, messages: list[Timed]) -> None:
    """A log of messages, by time."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as stream:
        writer = Writer(stream)
        names = {name for _, _, name, _ in messages}
        schemas = {name: writer.register_msgdef(name, definition(name)[0]) for name in names}
        for time, topic, name, message in sorted(messages, key=lambda one: one[0]):
            writer.write_message(topic, schemas[name], message, time, time)
        writer.finish()
    print(path)


def broad(clone: Path, out: Path) -> None:
    """All trials that a clone of BROAD holds, with their references."""
    for file in sorted((clone / "data_mat").glob("*.mat")):
        trial = loadmat(file)
        count = len(trial["imu_gyr"])
        times = stamps(np.arange(count) / float(trial["sampling_rate"].item()))
        path = out / "broad" / f"broad_{file.stem}.mcap"
        field = 1e-6 * trial["imu_mag"]
        write(path, [*imu(times, trial["imu_gyr"], trial["imu_acc"]), *magnetic(times, field)])
        q, moves = trial["opt_quat"], trial["movement"].ravel().astype(int)
        lines = ["# optical reference: sensor to a world with z up", "time_s,qw,qx,qy,qz,movement"]
        for k in np.flatnonzero(np.isfinite(q).all(axis=1))[::THINNED].tolist():
            sec, nanosec = divmod(times[k], 10**9)
            lines.append(f"{sec}.{nanosec:09d},{','.join(f'{v:.7f}' for v in q[k])},{moves[k]}")
        path.with_suffix(".ref.csv").write_text("\n".join(lines) + "\n")


def columns(file: Path) -> Any:
    """A compressed table with names."""
    with gzip.open(file, "rt") as stream:
        return np.genfromtxt(stream, delimiter=",", names=True)


def drives(clone: Path, out: Path) -> None:
    """All drives that a clone holds whole."""
    for folder in sorted((clone / "web" / "datasets").iterdir()):
        files = [folder / f"{name}.csv.gz" for name in ("imu", "gnss")]
        if not all(file.exists() for file in files):
            continue
        samples, gnss = (columns(file) for file in files)
        gyro, accel = (
            np.column_stack([samples[f"{of}{a}_{unit}"] for a in "xyz"])
            for of, unit in (("g", "radps"), ("a", "mps2"))
        )
        messages = [*imu(stamps(samples["t_s"]), gyro, accel), *fixes(gnss)]
        write(out / "drives" / f"{folder.name}.mcap", messages)


def main() -> None:
    """Convert what is there."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--broad", type=Path, help="clone of dlaidig/broad")
    parser.add_argument("--drives", type=Path, help="clone of yongkyuns/imu_gnss_fusion")
    parser.add_argument("--out", type=Path, required=True, help="folder for the logs")
    args = parser.parse_args()
    if args.broad:
        broad(args.broad, args.out)
    if args.drives:
        drives(args.drives, args.out)


if __name__ == "__main__":
    main()
