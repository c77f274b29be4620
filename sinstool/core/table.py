"""Streams as tables: one named column for each component, with its unit in the name.

Arrays are in SI units and radians. Tables are for people: angles of attitude and position are in
degrees there, and covariances are standard deviations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from sinstool.core.errors import SinstoolError
from sinstool.core.rotation import to_euler
from sinstool.core.units import DEGREE

if TYPE_CHECKING:
    import pandas
    import polars

Table = dict[str, np.ndarray]

XYZ = ("x", "y", "z")
NED = ("north", "east", "down")


def _vector(stem: str, axes: tuple[str, ...], unit: str) -> Callable[[np.ndarray], Table]:
    """A column for each axis."""
    return lambda a: {f"{stem}_{axis}_{unit}": a[:, k] for k, axis in enumerate(axes)}


def _scalar(name: str, factor: float = 1.0) -> Callable[[np.ndarray], Table]:
    return lambda a: {name: a if factor == 1.0 else a / factor}


def _sigma(stem: str, unit: str, factor: float = 1.0) -> Callable[[np.ndarray], Table]:
    """Roots of the diagonal of covariances in NED."""

    def columns(covariance: np.ndarray) -> Table:
        sigma = np.sqrt(np.einsum("nii->ni", covariance)) / factor
        return _vector(stem, NED, unit)(sigma)

    return columns


def attitude_columns(q_nb: np.ndarray) -> Table:
    """The quaternion, and its Euler angles; headings from 0 up to 360 deg.

    Parameters
    ----------
    q_nb : ndarray, shape (n, 4)
    """
    roll, pitch, heading = (to_euler(q_nb) / DEGREE).T
    heading = heading % 360.0
    return {
        **{f"q_nb_{part}": q_nb[:, k] for k, part in enumerate("wxyz")},
        "roll_deg": roll,
        "pitch_deg": pitch,
        "heading_deg": np.where(heading == 360.0, 0.0, heading),
    }


def _position(position: np.ndarray) -> Table:
    return {
        "latitude_deg": position[:, 0] / DEGREE,
        "longitude_deg": position[:, 1] / DEGREE,
        "height_m": position[:, 2],
    }


def _vertical(vertical: np.ndarray) -> Table:
    names = ("damped_height_m", "damped_velocity_up_m_s", "damping_m_s2")
    return {name: vertical[:, k] for k, name in enumerate(names)}


def _plain(name: str) -> Callable[[np.ndarray], Table]:
    """A column with the name of its field, or numbered columns for a matrix."""
    return lambda a: {name: a} if a.ndim == 1 else {f"{name}_{k}": c for k, c in enumerate(a.T)}


# Columns of the fields of :mod:`sinstool.core.streams`. A key with the name of a stream is for a
# field that means something else in it; a field that is not listed keeps its name.
FIELDS: Mapping[str, Callable[[np.ndarray], Table]] = {
    "gyro": _vector("gyro", XYZ, "rad_s"),
    "accel": _vector("accel", XYZ, "m_s2"),
    "omega_ib_b": _vector("omega_ib_b", XYZ, "rad_s"),
    "specific_force_b": _vector("specific_force_b", XYZ, "m_s2"),
    "field": _vector("field", XYZ, "T"),
    "orientation": attitude_columns,
    "q_nb": attitude_columns,
    # The same in each row; the attitude of the vehicle is a stream of its own
    "q_vb": lambda a: {},
    "latitude": _scalar("latitude_deg", DEGREE),
    "longitude": _scalar("longitude_deg", DEGREE),
    "height": _scalar("height_m"),
    "position": _position,
    "velocity_n": _vector("velocity", NED, "m_s"),
    "vertical": _vertical,
    "sigma_position_n": _vector("sigma_position", NED, "m"),
    "sigma_velocity_n": _vector("sigma_velocity", NED, "m_s"),
    "covariance_position_n": _sigma("sigma_position", "m"),
    "covariance_velocity_n": _sigma("sigma_velocity", "m_s"),
    "covariance_attitude_n": _sigma("sigma_attitude", "deg", DEGREE),
    "pressure": _scalar("pressure_Pa"),
    "variance": _scalar("variance_Pa2"),
    "Gnss.covariance_n": _sigma("sigma_position", "m"),
    "Velocity.covariance_n": _sigma("sigma_velocity", "m_s"),
    "Encoder.position": _scalar("position_rad"),
}


def table_of(stream: object) -> Table:
    """Named columns of a stream.

    Parameters
    ----------
    stream : Stream
        Fields that are None have no columns.

    Returns
    -------
    dict of str to ndarray, shape (n,)
        Contiguous. Times in ns are int64.
    """
    columns: Table = {}
    for name, value in vars(stream).items():
        if value is not None:
            own = FIELDS.get(f"{type(stream).__name__}.{name}")
            columns |= (own or FIELDS.get(name) or _plain(name))(value)
    return {name: np.ascontiguousarray(column) for name, column in columns.items()}


def pandas_frame(columns: Table) -> pandas.DataFrame:
    """A pandas DataFrame of columns.

    Raises
    ------
    SinstoolError
        pandas is not installed.
    """
    return _library("pandas").DataFrame(columns)


def polars_frame(columns: Table) -> polars.DataFrame:
    """A polars DataFrame of columns.

    Raises
    ------
    SinstoolError
        polars is not installed.
    """
    return _library("polars").DataFrame(columns)


def arrow_stream(columns: Table, requested_schema: object = None) -> object:
    """Columns through the Arrow PyCapsule interface.

    Raises
    ------
    SinstoolError
        pyarrow is not installed.
    """
    table = _library("pyarrow").table(columns)
    return table.__arrow_c_stream__(requested_schema)


def _library(name: str) -> Any:
    from importlib import import_module

    try:
        return import_module(name)
    except ImportError as exc:
        raise SinstoolError(
            f"this table needs {name}, which is not installed", f"run: pip install {name}"
        ) from exc
