"""Description of a rig: calibration matrices, the encoder, stamps of samples.

A heading-sensitive error belongs to one set of these numbers: with another calibration it is
another error. :meth:`Rig.sha256` tells whether two sets are the same in this sense.

``C_s_to_b`` is used as it is given. What it lacks of being orthonormal acts like any other
calibration error: the part along the axis is in the coefficient that is estimated, the rest is
a constant offset of heading. Orthonormalising it here would change the coefficient silently, so
that is left to its author; :meth:`Rig.remarks` gives the size of its contribution. An axis ``e`` in
its place is a direction: its length, which must be 1 within the tolerance, is divided out.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray
from sinstool.core.errors import ConfigurationError
from sinstool.core.units import ARCSEC

GYRO_FRAMES = ("g", "s")
STAMPS = ("end", "mid", "start")
UNITS = ("rad", "deg")
ORTHONORMAL = 1e-3
"""Largest element of ``C C^T - I``, and largest ``| |e| - 1 |``, that pass."""
LARGEST_CONDITION = 10.0

_REMARKABLE = 0.1 * ARCSEC
_RIG_KEYS = (
    *("K_g", "C_s_to_b", "e", "K_a", "gyro_bias", "accel_bias", "gyro_frame", "accel_frame"),
    *("gyro_scale", "imu_stamp", "latitude_deg", "encoder"),
)
_ENCODER_KEYS = ("joint", "sign", "offset_rad", "delay_s", "unit", "harmonics")


@dataclass(frozen=True)
class EncoderModel:
    """How the encoder's reading becomes the angle alpha of the table.

    ``alpha(t) = sign * corrected(reading(t + delay)) + offset``.

    Attributes
    ----------
    joint : str
        Name of the joint in the log; empty where the log has only one.
    sign : int
        1 where readings grow clockwise seen from above (about the axis that points down),
        else -1.
    offset : float
        rad: alpha where the reading is 0.
    delay : float
        s, positive where a reading is older than its stamp says.
    unit : {'rad', 'deg'}
        Of the readings; they may wrap at a whole turn or count on.
    harmonics : tuple of (int, float, float)
        Known errors ``a cos(k reading) + b sin(k reading)`` of the reading as ``(k, a, b)``,
        rad; they are subtracted.

    Raises
    ------
    ConfigurationError
        If a value is impossible.
    """

    joint: str = ""
    sign: int = 1
    offset: float = 0.0
    delay: float = 0.0
    unit: str = "rad"
    harmonics: tuple[tuple[int, float, float], ...] = ()

    def __post_init__(self) -> None:
        if self.sign not in (1, -1) or isinstance(self.sign, bool):
            raise ConfigurationError(f"rig.encoder.sign is {self.sign!r}", "give 1 or -1")
        if self.unit not in UNITS:
            raise ConfigurationError(f"rig.encoder.unit is {self.unit!r}", 'give "rad" or "deg"')
        for name, key in (("offset", "offset_rad"), ("delay", "delay_s")):
            value = _number(getattr(self, name), f"rig.encoder.{key}")
            object.__setattr__(self, name, value)
        if abs(self.delay) > 1.0:
            raise ConfigurationError(
                f"rig.encoder.delay_s is {self.delay:g} s",
                "it must be in seconds, and is a few milliseconds at most in a working rig",
            )
        rows = []
        for i, row in enumerate(self.harmonics):
            where = f"rig.encoder.harmonics[{i}]"
            if isinstance(row, str | bytes) or np.shape(row) != (3,):
                raise ConfigurationError(f"{where} is {row!r}", "give [order, cosine, sine] in rad")
            order, cosine, sine = (_number(value, where) for value in row)
            if order != int(order) or order < 1:
                raise ConfigurationError(f"{where} has order {order:g}", "give 1, 2, 3 ...")
            rows.append((int(order), cosine, sine))
        object.__setattr__(self, "harmonics", tuple(rows))


@dataclass(frozen=True, eq=False)
class Rig:
    """Calibration of a system on its turntable.

    Attributes
    ----------
    K_g : ndarray, shape (3, 3)
        Lower triangular: a rate of the raw triad becomes one in ``s``.
    C_s_to_b : ndarray, shape (3, 3)
        C_s^b: a vector in ``s`` becomes one in ``b``; see :func:`axis_to_matrix`.
    K_a : ndarray, shape (3, 3)
        Raw accelerations become those in ``s``.
    gyro_bias, accel_bias : ndarray, shape (3,)
        rad/s and m/s^2, of the samples as they are in the log; subtracted first.
    gyro_frame, accel_frame : {'g', 's'}
        ``'g'``: samples are those of the raw triad, to which K_g (K_a) is applied. ``'s'``:
        that has been done already.
    gyro_scale : float
        Factor on all rates, whatever their frame.
    imu_stamp : {'end', 'mid', 'start'}
        Where in the interval over which a gyro sample is the mean its stamp lies.
    latitude : float or None
        Geodetic, rad.

    Raises
    ------
    ConfigurationError
        If a value is impossible; names the key as in the configuration file.
    """

    K_g: FloatArray
    C_s_to_b: FloatArray
    K_a: FloatArray = field(default_factory=lambda: np.eye(3))
    gyro_bias: FloatArray = field(default_factory=lambda: np.zeros(3))
    accel_bias: FloatArray = field(default_factory=lambda: np.zeros(3))
    gyro_frame: str = "g"
    accel_frame: str = "s"
    gyro_scale: float = 1.0
    imu_stamp: str = "end"
    latitude: float | None = None
    encoder: EncoderModel = field(default_factory=EncoderModel)

    def __post_init__(self) -> None:
        for name in ("K_g", "C_s_to_b", "K_a"):
            object.__setattr__(self, name, _array(getattr(self, name), (3, 3), f"rig.{name}"))
        for name in ("gyro_bias", "accel_bias"):
            object.__setattr__(self, name, _array(getattr(self, name), (3,), f"rig.{name}"))
        for name, allowed in (
            ("gyro_frame", GYRO_FRAMES),
            ("accel_frame", GYRO_FRAMES),
            ("imu_stamp", STAMPS),
        ):
            if getattr(self, name) not in allowed:
                raise ConfigurationError(
                    f"rig.{name} is {getattr(self, name)!r}", f"give one of {', '.join(allowed)}"
                )
        scale = _number(self.gyro_scale, "rig.gyro_scale")
        if not 0.5 < scale < 2.0:
            raise ConfigurationError(
                f"rig.gyro_scale is {scale:g}", "it must be a factor close to 1"
            )
        object.__setattr__(self, "gyro_scale", scale)
        self._check_matrices()
        if self.latitude is not None:
            latitude = _number(self.latitude, "rig.latitude_deg")
            if abs(latitude) > np.pi / 2.0:
                raise ConfigurationError(
                    f"rig.latitude_deg is {np.degrees(latitude):g}", "give -90 to 90 degrees"
                )
            object.__setattr__(self, "latitude", latitude)

    def _check_matrices(self) -> None:
        if np.any(np.triu(self.K_g, 1)):
            raise ConfigurationError(
                "rig.K_g is not lower triangular",
                "x of s is along the x gyro and y in the plane of the x and y gyros, so that "
                "what is above the diagonal is 0; transpose it if it is the other way round",
            )
        for name in ("K_g", "K_a"):
            condition = np.linalg.cond(getattr(self, name))
            if not condition < LARGEST_CONDITION:
                raise ConfigurationError(
                    f"rig.{name} is nearly singular (condition {condition:.3g})",
                    f"a calibration has less than {LARGEST_CONDITION:g}; look for a misprint",
                )
        if self.accel_frame == "s" and not np.array_equal(self.K_a, np.eye(3)):
            raise ConfigurationError(
                'rig.K_a is given, but rig.accel_frame = "s" says that it has been applied',
                'set rig.accel_frame = "g", or leave rig.K_a out',
            )
        error = self.orthonormality_error
        if not error <= ORTHONORMAL:
            raise ConfigurationError(
                f"rig.C_s_to_b is not orthonormal (by {error:.2g}, {ORTHONORMAL:g} allowed)",
                "its rows are the axes of b in s; give more digits, or rig.e in its place",
            )
        if np.linalg.det(self.C_s_to_b) < 0.0:
            raise ConfigurationError(
                "rig.C_s_to_b mirrors (determinant -1)", "change the sign of one of its rows"
            )

    @property
    def orthonormality_error(self) -> float:
        """Largest element of ``C_s_to_b C_s_to_b^T - I``."""
        with np.errstate(over="ignore"):  # infinite is large enough
            return float(np.abs(self.C_s_to_b @ self.C_s_to_b.T - np.eye(3)).max())

    @property
    def gyro_to_b(self) -> FloatArray:
        """Matrix that takes the log's rates, less their bias, to ``b``; shape (3, 3)."""
        to_s = self.K_g if self.gyro_frame == "g" else np.eye(3)
        return self.gyro_scale * (self.C_s_to_b @ to_s)

    @property
    def accel_to_b(self) -> FloatArray:
        """Matrix that takes the log's specific forces, less their bias, to ``b``."""
        return self.C_s_to_b @ self.K_a

    def require_latitude(self) -> float:
        """Latitude in rad; ConfigurationError if it is missing."""
        if self.latitude is None:
            raise ConfigurationError(
                "rig.latitude_deg is missing",
                "heading cannot be found from the Earth's rate without it",
            )
        return self.latitude

    def scaled(self, c: float) -> Rig:
        """The rig with a relative rate error along the axis removed.

        Parameters
        ----------
        c : float
            X33 of :mod:`sinstool.methods.hse`, which is ``-lambda2 / 3``.

        Returns
        -------
        Rig
            K_g times ``1 - c`` (``gyro_scale`` where K_g is not applied), which removes the
            heading-sensitive error where it arises.
        """
        if self.gyro_frame == "g":
            return replace(self, K_g=(1.0 - c) * self.K_g)
        return replace(self, gyro_scale=(1.0 - c) * self.gyro_scale)

    def sha256(self) -> str:
        """Fingerprint of all that the coefficient lambda2 depends on.

        Returns
        -------
        str
            64 hexadecimal digits. Not in it: latitude, biases and the accelerometers'
            matrix, on which it does not depend, and the joint's name, unit and offset, which
            describe the log and the zero of heading.
        """
        e = self.encoder
        parts = {
            "K_g": self.K_g.tolist() if self.gyro_frame == "g" else None,
            "C_s_to_b": self.C_s_to_b.tolist(),
            "gyro_scale": self.gyro_scale,
            "imu_stamp": self.imu_stamp,
            "encoder": [e.sign, e.delay, sorted(e.harmonics)],
        }
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()

    def remarks(self) -> list[str]:
        """Remarks on this calibration for its owner, one sentence each."""
        share = -3.0 * (float(np.linalg.norm(self.C_s_to_b[2])) - 1.0)
        if abs(share) < _REMARKABLE:
            return []
        return [
            f"rig.C_s_to_b is orthonormal to {self.orthonormality_error:.1g} only; it is used as "
            f"it is, which changes lambda2 by {share / ARCSEC:+.2f} arcsec"
        ]

    def to_table(self) -> dict[str, Any]:
        """The rig as the table ``[rig]`` of a configuration file; see :func:`from_table`."""
        e = self.encoder
        arrays = ("K_g", "C_s_to_b", "K_a", "gyro_bias", "accel_bias")
        others = ("gyro_frame", "accel_frame", "gyro_scale", "imu_stamp")
        table: dict[str, Any] = {
            **{name: getattr(self, name).tolist() for name in arrays},
            **{name: getattr(self, name) for name in others},
            "encoder": {
                "joint": e.joint,
                "sign": e.sign,
                "offset_rad": e.offset,
                "delay_s": e.delay,
                "unit": e.unit,
                "harmonics": [list(row) for row in e.harmonics],
            },
        }
        if self.latitude is not None:
            table["latitude_deg"] = float(np.degrees(self.latitude))
        return table


def axis_to_matrix(e: ArrayLike) -> FloatArray:
    """C_s^b from the axis of rotation.

    Parameters
    ----------
    e : array_like, shape (3,)
        Direction of the axis, downward, in ``s``; ``-(1, 1, 1)/sqrt(3)`` in an ideal rig.

    Returns
    -------
    ndarray, shape (3, 3)
        Rows ``r_x = r_y x e``, ``r_y = e x x / |e x x|`` and ``e``: x of ``b`` is where the x
        gyro points, seen along the axis. Yu et al. 2013, section 1.1 (there transposed, as
        C_b^s).

    Raises
    ------
    ConfigurationError
        If the length of ``e`` is not 1, or it points along the x gyro.
    """
    r_z = _array(e, (3,), "rig.e")
    length = float(np.linalg.norm(r_z))
    if not abs(length - 1.0) <= ORTHONORMAL:
        raise ConfigurationError(
            f"rig.e has length {length:.6g}", "give the unit vector of the rotation axis in s"
        )
    r_z = r_z / length
    across = np.array([0.0, r_z[2], -r_z[1]])  # e x x
    size = float(np.linalg.norm(across))
    if size < 1e-3:
        raise ConfigurationError(
            "rig.e points along the x gyro, so that x of b is not defined",
            "give rig.C_s_to_b in its place",
        )
    r_y = across / size
    return np.stack([np.cross(r_y, r_z), r_y, r_z])


def from_table(table: Mapping[str, Any]) -> Rig:
    """Rig from the table ``[rig]`` of a configuration file.

    Parameters
    ----------
    table : mapping
        ``C_s_to_b`` or ``e``, and ``K_g`` unless ``gyro_frame = "s"``; optional are
        ``gyro_frame``, ``accel_frame``, ``K_a``, ``gyro_bias`` (rad/s), ``accel_bias``
        (m/s^2), ``gyro_scale``, ``imu_stamp``, ``latitude_deg`` and a table ``encoder`` with
        ``joint``, ``sign``, ``offset_rad``, ``delay_s``, ``unit``, ``harmonics``.

    Raises
    ------
    ConfigurationError
        If a key is unknown or missing, or a value impossible; names the key with its path.
    """
    _refuse_unknown(table, _RIG_KEYS, "rig")
    values: dict[str, Any] = dict(table)
    if ("e" in values) == ("C_s_to_b" in values):
        both = "both given" if "e" in values else "both missing"
        raise ConfigurationError(f"rig.C_s_to_b and rig.e are {both}", "give one of them")
    if "e" in values:
        values["C_s_to_b"] = axis_to_matrix(values.pop("e"))
    if "K_g" not in values:
        if values.get("gyro_frame") != "s":
            raise ConfigurationError(
                "rig.K_g is missing", 'give it, or rig.gyro_frame = "s" if it has been applied'
            )
        values["K_g"] = np.eye(3)
    if "latitude_deg" in values:
        degrees = _number(values.pop("latitude_deg"), "rig.latitude_deg")
        values["latitude"] = float(np.radians(degrees))
    encoder = values.pop("encoder", {})
    if not isinstance(encoder, Mapping):
        raise ConfigurationError(f"rig.encoder is {encoder!r}", "write it as a table [rig.encoder]")
    _refuse_unknown(encoder, _ENCODER_KEYS, "rig.encoder")
    names = {"offset_rad": "offset", "delay_s": "delay"}
    model: dict[str, Any] = {names.get(str(key), str(key)): value for key, value in encoder.items()}
    if not isinstance(model.get("joint", ""), str):
        raise ConfigurationError(f"rig.encoder.joint is {model['joint']!r}", "give a name")
    if not isinstance(model.get("harmonics", []), list | tuple):
        raise ConfigurationError(
            f"rig.encoder.harmonics is {model['harmonics']!r}",
            "give a list of [order, cosine, sine]",
        )
    return Rig(**values, encoder=EncoderModel(**model))


def _refuse_unknown(table: Mapping[str, Any], keys: tuple[str, ...], where: str) -> None:
    unknown = [key for key in table if key not in keys]
    if unknown:
        raise ConfigurationError(f"{where}.{unknown[0]} is not known", f"keys: {', '.join(keys)}")


def _number(value: Any, where: str) -> float:
    number = math.nan
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        with suppress(OverflowError):  # a whole number beyond all floats
            number = float(value)
    if not math.isfinite(number):
        raise ConfigurationError(f"{where} is {value!r}", "give a number")
    return number + 0.0  # no negative zero, which would be another fingerprint


def _array(value: Any, shape: tuple[int, ...], where: str) -> FloatArray:
    """A read-only copy; no negative zeros, which would be another fingerprint."""
    size = " x ".join(map(str, shape))
    try:
        array = np.array(value, dtype=np.float64) + 0.0
    except (TypeError, ValueError, OverflowError):
        raise ConfigurationError(
            f"{where} is not an array of numbers", f"give {size} numbers"
        ) from None
    if array.shape != shape or not np.isfinite(array).all():
        raise ConfigurationError(
            f"{where} has shape {array.shape} or values that are not finite", f"give {size} numbers"
        )
    array.flags.writeable = False
    return array
