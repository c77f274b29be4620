"""Frames and rotations from the transforms of a log, in /tf and /tf_static."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.errors import UnsupportedLogError
from sinstool.core.rotation import conjugate, multiply, normalise, rotate
from sinstool.io.messages.layout import Layout
from sinstool.io.readers.log import Channel, Log
from sinstool.io.readers.streams import layouts

TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
STATIC = "tf_static"
# The tree of a vehicle is complete within its first messages; reading on would cost a Python call
# for each of possibly millions.
MAX_TF_MESSAGES = 20_000
# Frames whose x axis is the vehicle's forward, by REP 105 and by custom.
VEHICLE_FRAMES = ("base_link", "base_footprint", "base_frame", "chassis", "rear_axle", "vehicle")
# A quaternion shorter than this was left empty.
_EMPTY = 1e-3


@dataclass(frozen=True)
class StaticRotation:
    """Rotation of a frame in the frame of its vehicle.

    Attributes
    ----------
    vehicle : str
        Frame id.
    q : ndarray, shape (4,)
        w, x, y, z; takes vectors from the frame to the vehicle's, both forward, left, up.
    """

    vehicle: str
    q: FloatArray


@dataclass(frozen=True)
class _Pose:
    """Where a frame is in another one: its origin, m, and the rotation of its vectors."""

    q: FloatArray
    origin: FloatArray

    def then(self, outer: _Pose) -> _Pose:
        """The same in the frame in which that other one is at `outer`."""
        return _Pose(multiply(outer.q, self.q), outer.origin + rotate(outer.q, self.origin))


_HERE = _Pose(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))


def tf_parent(log: Log, child: str) -> str | None:
    """Parent of a frame in the log's own /tf and /tf_static; None where it has none.

    Parameters
    ----------
    child : str
        Frame id.
    """
    channels = _channels(log)
    for layout, payload in islice(layouts(log, channels), MAX_TF_MESSAGES) if channels else ():
        for path in _transforms(layout):
            if _same(layout.text(f"{path}.child_frame_id", payload), child):
                return layout.text(f"{path}.header.frame_id", payload)
    return None


def in_vehicle(log: Log, child: str) -> StaticRotation | None:
    """Rotation of a frame in its vehicle, by the static transforms of a log.

    Parameters
    ----------
    child : str
        Frame id.

    Returns
    -------
    StaticRotation or None
        None where no chain of static transforms leads to a frame of :data:`VEHICLE_FRAMES`.
    """
    for frame, pose in islice(_ancestors(_static(log), child), 1, None):
        if frame.rsplit("/", 1)[-1] in VEHICLE_FRAMES:
            return StaticRotation(frame, normalise(pose.q))
    return None


def position_in(log: Log, child: str, frame: str) -> FloatArray | None:
    """Where the origin of a frame is in another, by the static transforms of a log.

    Parameters
    ----------
    child, frame : str
        Frame ids.

    Returns
    -------
    ndarray or None
        Shape (3,), m, in the axes of `frame`. None where static transforms do not join the two.
    """
    static = _static(log)
    ours = dict(_ancestors(static, frame))
    for common, theirs in _ancestors(static, child):
        if common in ours:
            here = ours[common]
            return np.asarray(rotate(conjugate(here.q), theirs.origin - here.origin))
    return None


def _static(log: Log) -> dict[str, tuple[str, _Pose]]:
    """Parents of frames, and where these are in them, by static transforms."""
    channels = [c for c in _channels(log) if c.topic.rsplit("/", 1)[-1] == STATIC]
    parents: dict[str, tuple[str, _Pose]] = {}
    for layout, payload in islice(layouts(log, channels), MAX_TF_MESSAGES) if channels else ():
        for path in _transforms(layout):
            q = _quaternion(layout, f"{path}.transform.rotation", payload)
            if q is not None:
                name = layout.text(f"{path}.child_frame_id", payload).lstrip("/")
                parent = layout.text(f"{path}.header.frame_id", payload).lstrip("/")
                origin = _numbers(layout, f"{path}.transform.translation", "xyz", payload)
                parents[name] = parent, _Pose(q, origin)
    return parents


def _ancestors(parents: dict[str, tuple[str, _Pose]], child: str) -> Iterator[tuple[str, _Pose]]:
    """A frame, its parent, that one's parent and so on, and where the frame is in each."""
    frame, pose = child.lstrip("/"), _HERE
    yield frame, pose
    # A tree has no loops, but that of a faulty log may
    for _ in range(len(parents)):
        if frame not in parents:
            return
        frame, outer = parents[frame]
        pose = pose.then(outer)
        yield frame, pose


def _channels(log: Log) -> list[Channel]:
    """Channels with transforms whose definition can be read."""
    channels = []
    for channel in log.channels.values():
        if channel.type in TF_TYPES:
            with suppress(UnsupportedLogError):
                channel.definition(log.path)
                channels.append(channel)
    return channels


def _transforms(layout: Layout) -> Iterator[str]:
    """Paths of the transforms of a message."""
    index = 0
    while f"transforms[{index}].child_frame_id" in layout.leaves:
        yield f"transforms[{index}]"
        index += 1


def _quaternion(layout: Layout, path: str, payload: bytes) -> FloatArray | None:
    """Unit quaternion, w first; None where it is missing or zero."""
    q = _numbers(layout, path, "wxyz", payload)
    if not np.isfinite(q).all() or np.linalg.norm(q) < _EMPTY:
        return None
    return normalise(q)


def _numbers(layout: Layout, path: str, axes: str, payload: bytes) -> FloatArray:
    """Components of a vector; NaN where they are missing."""
    order = ">" if layout.big_endian else "<"
    leaves = [layout.leaves.get(f"{path}.{axis}") for axis in axes]
    return np.array(
        [
            np.nan if leaf is None else np.frombuffer(payload, order + "f8", 1, leaf.offset)[0]
            for leaf in leaves
        ]
    )


def _same(one: str, other: str) -> bool:
    return one.lstrip("/") == other.lstrip("/")
