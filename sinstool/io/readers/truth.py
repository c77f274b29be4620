"""Reference attitudes: from a topic of the log, or from a CSV file."""

from __future__ import annotations

import csv
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from sinstool.core.errors import LogError, TopicError
from sinstool.io.readers.frames import q_nb_from_log
from sinstool.io.readers.log import Log
from sinstool.io.readers.streams import Losses, header, read_columns, stamp

# Path of the orientation in each message type that has one
PATHS = {
    "sensor_msgs/msg/Imu": "orientation",
    "geometry_msgs/msg/QuaternionStamped": "quaternion",
    "geometry_msgs/msg/PoseStamped": "pose.orientation",
    "nav_msgs/msg/Odometry": "pose.pose.orientation",
}
CSV_COLUMNS = ("qw", "qx", "qy", "qz")
_CSV_NEEDS = "it needs columns time_s or time_ns, and qw, qx, qy, qz"


def read_truth(log: Log, truth: str, body_axes: str) -> tuple[np.ndarray, np.ndarray]:
    """Times and attitudes of a reference.

    Parameters
    ----------
    log : Log
        In which a topic is looked for.
    truth : str
        A topic of the log (Imu, QuaternionStamped, PoseStamped, Odometry), or a CSV file with
        the columns ``time_s`` or ``time_ns`` and ``qw, qx, qy, qz``: body to world, Hamilton.
    body_axes : {'flu', 'frd'}
        Of the reference: FLU in ENU, or FRD in NED.

    Returns
    -------
    time_ns : ndarray of int64, shape (k,)
        Increasing.
    q_nb : ndarray, shape (k, 4)

    Raises
    ------
    TopicError, LogError
        There is no such topic or file, or it holds no attitudes.
    """
    channels = log.channels_of(truth)
    if channels:
        time_ns, q = _from_topic(log, truth)
    elif Path(truth).is_file():
        time_ns, q = _from_csv(Path(truth))
    else:
        raise TopicError(
            log.path,
            f"--truth {truth} is neither a topic of the log nor a file",
            "name a topic of the log or a CSV file",
        )
    good = np.isfinite(q).all(axis=1) & (np.abs(np.linalg.norm(q, axis=1) - 1.0) < 0.05)
    time_ns, first = np.unique(time_ns[good], return_index=True)
    if len(time_ns) < 2:
        raise LogError(log.path, f"--truth {truth} holds fewer than two attitudes")
    q = q[good][first]
    return time_ns, q_nb_from_log(q / np.linalg.norm(q, axis=1)[:, None], body_axes)


def _from_topic(log: Log, topic: str) -> tuple[np.ndarray, np.ndarray]:
    suitable = log.channels_of(topic, *PATHS)
    if not suitable:
        kinds = ", ".join(t.replace("/msg/", "/") for t in PATHS)
        other = log.channels_of(topic)[0].type_name
        raise TopicError(log.path, f"--truth {topic} is {other}", f"it must be one of {kinds}")
    channels = log.channels_of(topic, suitable[0].type)
    path = PATHS[suitable[0].type]
    columns = {**header(), "q": [f"{path}.{axis}" for axis in "wxyz"]}
    times, q = [], []
    for _, values in read_columns(log, channels, columns, Losses()):
        times.append(stamp(values))
        q.append(values["q"])
    if not times:
        return np.empty(0, np.int64), np.empty((0, 4))
    return np.concatenate(times), np.concatenate(q)


def _from_csv(path: Path) -> tuple[np.ndarray, np.ndarray]:
    with path.open(newline="", encoding="utf-8-sig") as stream:
        lines = (line for line in stream if line.strip() and not line.startswith("#"))
        reader = csv.DictReader(lines, skipinitialspace=True)
        try:
            return _columns_of(reader, path)
        except UnicodeDecodeError as exc:
            raise LogError(path, "the file is not text (UTF-8)", _CSV_NEEDS) from exc
        except csv.Error as exc:
            raise LogError(path, f"line {reader.line_num + 1} cannot be read ({exc})") from exc


def _columns_of(reader: csv.DictReader[str], path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Times and quaternions (w first, as in the file) of a table of attitudes."""
    names = reader.fieldnames or []
    missing = [c for c in CSV_COLUMNS if c not in names]
    clock = next((c for c in ("time_ns", "time_s") if c in names), None)
    if missing or clock is None:
        column = missing[0] if missing else "time_s or time_ns"
        raise LogError(path, f"the file has no column {column}", _CSV_NEEDS)
    # Exact: seconds since 1970 do not fit a float64 to the nanosecond
    scale = 1 if clock == "time_ns" else 1_000_000_000
    times: list[int] = []
    rows: list[list[float]] = []
    for row in reader:
        try:
            time_ns = int(Decimal(row[clock]) * scale)
            rows.append([float(row[c] or "nan") for c in CSV_COLUMNS])
        except (InvalidOperation, ValueError, TypeError, OverflowError) as exc:
            raise LogError(path, f"line {reader.line_num} holds no numbers") from exc
        if not -(2**63) <= time_ns < 2**63:
            raise LogError(path, f"line {reader.line_num} holds a time that no log has")
        times.append(time_ns)
    return np.array(times, np.int64), np.array(rows, np.float64).reshape(-1, 4)


def at_times(time_ns: np.ndarray, q_nb: np.ndarray, at_ns: np.ndarray) -> np.ndarray:
    """Attitude between the instants of a reference, by spherical linear interpolation.

    Parameters
    ----------
    time_ns : ndarray of int64, shape (k,)
        Increasing.
    q_nb : ndarray, shape (k, 4)
    at_ns : ndarray of int64, shape (n,)
        Within the reference's times.

    Returns
    -------
    ndarray, shape (n, 4)
    """
    if not len(at_ns):
        return np.empty((0, 4))
    # Importing it takes longer than processing most logs, and few runs have a reference
    from scipy.spatial.transform import Rotation, Slerp

    origin = int(time_ns[0])
    course = Slerp((time_ns - origin) / 1e9, Rotation.from_quat(q_nb, scalar_first=True))
    q = course((at_ns - origin) / 1e9).as_quat(scalar_first=True)
    # At the reference's own instants its attitude is returned as it is, without Slerp's rounding.
    place = np.searchsorted(time_ns, at_ns)
    place = np.minimum(place, len(time_ns) - 1)
    exact = time_ns[place] == at_ns
    q[exact] = q_nb[place[exact]]
    return np.asarray(q)
