"""A result written by sinstool, read back: its topics joined by time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import reduce

import numpy as np

from sinstool.core.congruence import of_turned
from sinstool.core.errors import DataError, TopicError, UnsupportedLogError
from sinstool.core.rotation import from_euler, rotate, to_dcm
from sinstool.core.streams import Solution
from sinstool.io.messages.decode import Decoder
from sinstool.io.messages.layout import LayoutError
from sinstool.io.readers.frames import enu_to_ned, enu_to_ned_covariance, q_for_log, turn_body
from sinstool.io.readers.log import Log
from sinstool.io.readers.streams import XYZ, XYZW, Losses, frame_id, header, stamp

PREFIX = "/sinstool/"


def _paths(stem: str, axes: Sequence[str]) -> list[str]:
    return [f"{stem}.{axis}" for axis in axes]


# Columns that are read from each topic, with the paths of their fields
COLUMNS: Mapping[str, Mapping[str, list[str]]] = {
    "imu": {
        "q": _paths("orientation", XYZW),
        "q_covariance": ["orientation_covariance"],
        "gyro": _paths("angular_velocity", XYZ),
        "accel": _paths("linear_acceleration", XYZ),
    },
    "attitude": {"q": _paths("quaternion", XYZW)},
    "odometry": {
        "q": _paths("pose.pose.orientation", XYZW),
        "position": _paths("pose.pose.position", XYZ),
        "velocity": _paths("twist.twist.linear", XYZ),
        "pose_covariance": ["pose.covariance"],
        "twist_covariance": ["twist.covariance"],
    },
    "pose": {"q": _paths("pose.orientation", XYZW), "position": _paths("pose.position", XYZ)},
    "fix": {
        "geodetic": ["latitude", "longitude", "altitude"],
        "fix_covariance": ["position_covariance"],
    },
    "euler": {"euler": _paths("vector", XYZ)},
    "height": {"vertical": _paths("vector", XYZ)},
    "vehicle": {"q": _paths("quaternion", XYZW)},
}
# Where the attitude is taken from: the first of these that the result has
ATTITUDES = ("imu", "attitude", "odometry", "pose", "euler")
# Topics whose frame_id is that of the reference
IN_REFERENCE = ("attitude", "odometry", "pose")
# A covariance of zeros stands for one that is not known
COVARIANCES = {
    "attitude": ("imu", "q_covariance"),
    "pose": ("odometry", "pose_covariance"),
    "velocity": ("odometry", "twist_covariance"),
    "fix": ("fix", "fix_covariance"),
}
Joined = dict[str, dict[str, np.ndarray]]


@dataclass(frozen=True)
class ResultBlock:
    """Consecutive rows of a result.

    Attributes
    ----------
    solution : Solution
        Angular rates and specific forces are NaN if the result does not have them.
    local_n : ndarray, shape (n, 3), or None
        Position from the origin of the reference frame, NED, m; None without a position.
    q_nv : ndarray, shape (n, 4), or None
        Attitude of the vehicle that the sensor is mounted in; None if it is unknown.
    has_rates : bool
        Whether the result has angular rates and specific forces, the same for all its blocks.
    """

    solution: Solution
    local_n: np.ndarray | None = None
    q_nv: np.ndarray | None = None
    has_rates: bool = True

    def __len__(self) -> int:
        return len(self.solution)

    def rows(self, which: slice | np.ndarray) -> ResultBlock:
        """Rows by slice, mask or index array."""
        local, q_nv = (None if one is None else one[which] for one in (self.local_n, self.q_nv))
        return ResultBlock(self.solution.rows(which), local, q_nv, self.has_rates)


class ResultReader:
    """Reads the topics of a result.

    Parameters
    ----------
    log : Log
        An MCAP that ``sinstool process`` wrote, or a bag with its topics.
    body_axes : {'flu', 'frd'}
        Body axes of the log that was processed, which are also those of the result.
    world : {'enu', 'ned'}
        World of the orientations, used where no topic has a frame_id that gives it.
    progress : callable, optional
        Called with the bytes of the log read so far.

    Attributes
    ----------
    topics : tuple of str
        Topics of the result that are read, by the names of ``--emit``.
    reference : str
        Frame id of the attitudes; '' where no topic gives it.
    losses : Losses
        Counts the messages that do not fit their definition, and rows that hold no attitude.

    Raises
    ------
    TopicError
        The log has no attitude of sinstool.
    """

    def __init__(
        self,
        log: Log,
        body_axes: str,
        world: str = "enu",
        progress: Callable[[int], None] | None = None,
    ) -> None:
        self._log = log
        self._axes = body_axes
        self._progress = progress
        self.losses = Losses()
        self._channels = {
            name: channels
            for name in COLUMNS
            if (channels := log.channels_of(PREFIX + name))
            and not any(log.counts.get(one.id) == 0 for one in channels)
        }
        self.topics = tuple(self._channels)
        source = next((name for name in ATTITUDES if name in self._channels), None)
        if source is None:
            raise TopicError(
                log.path,
                f"it is not a result of sinstool: it has no topic {PREFIX}imu or {PREFIX}attitude",
                f"make one with `sinstool process {log.path} -o RESULT.mcap`",
            )
        self._source: str = source
        self.reference = next(
            (frame_id(log, self._channels[one]) for one in IN_REFERENCE if one in self._channels),
            "",
        )
        self._enu = not self.reference.endswith("_ned") if self.reference else world == "enu"

    def blocks(self) -> Iterator[ResultBlock]:
        """Solutions in the order of time.

        Raises
        ------
        DataError
            Times go back, or the topics have no instant in common.
        """
        present = self._present()
        self.losses = Losses()  # of this pass alone
        empty = True
        for time_ns, log_time_ns, values in self._joined(self._progress):
            block = self._block(time_ns, log_time_ns, values, present)
            usable = _finite(block)
            self.losses.nonfinite += int(len(block) - np.count_nonzero(usable))
            if usable.any():
                empty = False
                yield block if usable.all() else block.rows(usable)
        if empty:
            raise DataError(
                self._log.path, f"{PREFIX}{self._source} holds no attitude that can be used"
            )

    def _present(self) -> set[str]:
        """Covariances that are not zero throughout."""
        searched = {n for n, (topic, _) in COVARIANCES.items() if topic in self._channels}
        present: set[str] = set()
        if searched:
            for _, _, values in self._joined():
                for name in searched - present:
                    topic, column = COVARIANCES[name]
                    if values[topic][column].any():
                        present.add(name)
                if present == searched:
                    break
        return present

    def _joined(
        self, progress: Callable[[int], None] | None = None
    ) -> Iterator[tuple[np.ndarray, np.ndarray, Joined]]:
        """Rows of all topics at the instants that they have in common."""
        held: dict[str, _Held] = {name: _Held() for name in self._channels}
        by_id = {one.id: name for name, many in self._channels.items() for one in many}
        decoders: dict[int, Decoder] = {}
        for name, many in self._channels.items():
            with self._named(name):
                columns = {**header(), **COLUMNS[name]}
                decoders |= {
                    one.id: Decoder(one.definition(self._log.path), columns) for one in many
                }
        for batch in self._log.batches(list(by_id)):
            if progress is not None:
                progress(batch.position)
            for number in np.unique(batch.channel).tolist():
                mine, name = batch.select([number]), by_id[number]
                with self._named(name):
                    decoded = decoders[number].decode(mine.buffer, mine.offset, mine.length)
                keep = decoded.valid
                self.losses.malformed += len(mine) - int(np.count_nonzero(keep))
                if keep.any():
                    values = {column: v[keep] for column, v in decoded.values.items()}
                    self._in_order(name, held[name].add(stamp(values), mine.log_time[keep], values))
            ready = min(one.last for one in held.values())
            if (rows := _common(held, ready)) is not None:
                yield rows
        # A topic without messages no longer holds the others back.
        held = {name: one for name, one in held.items() if one.any}
        if held and (rows := _common(held, max(one.last for one in held.values()))) is not None:
            yield rows

    @contextmanager
    def _named(self, name: str) -> Iterator[None]:
        """Errors about the fields of a message, with its topic."""
        try:
            yield
        except LayoutError as exc:
            raise UnsupportedLogError(self._log.path, f"topic {PREFIX}{name}: {exc}") from exc

    def _in_order(self, name: str, ascending: bool) -> None:
        if not ascending:
            raise DataError(
                self._log.path,
                f"times of {PREFIX}{name} go back or repeat, as in merged results",
                "export each result on its own",
            )

    def _block(
        self, time_ns: np.ndarray, log_time_ns: np.ndarray, values: Joined, present: set[str]
    ) -> ResultBlock:
        """A block in sinstool's own frames and units."""
        q_nb = self._attitude(values)
        blank = np.full((len(q_nb), 3), np.nan)
        imu, odometry = values.get("imu"), values.get("odometry")
        columns: dict[str, np.ndarray | None] = {
            "omega_ib_b": blank if imu is None else turn_body(imu["gyro"], self._axes),
            "specific_force_b": blank if imu is None else turn_body(imu["accel"], self._axes),
            "vertical": values["height"]["vertical"] if "height" in values else None,
        }
        if imu is not None and "attitude" in present:
            columns["covariance_attitude_n"] = self._turned(imu["q_covariance"].reshape(-1, 3, 3))
        local = None
        if odometry is not None:
            local = self._from_world(odometry["position"])
            body = turn_body(odometry["velocity"], self._axes)
            velocity_n = rotate(q_nb, body)
            columns["velocity_n"] = velocity_n
            if "pose" in present:
                pose = odometry["pose_covariance"].reshape(-1, 6, 6)
                columns["covariance_position_n"] = self._turned(pose[:, :3, :3])
                columns.setdefault("covariance_attitude_n", self._turned(pose[:, 3:, 3:]))
            if "velocity" in present:
                twist = odometry["twist_covariance"].reshape(-1, 6, 6)[:, :3, :3]
                c_nb = turn_body(to_dcm(q_nb), self._axes)
                twist = _unknown(c_nb @ twist @ np.swapaxes(c_nb, 1, 2))
                if "pose" in present:
                    attitude = self._turned(pose[:, 3:, 3:])
                    over_ground = twist - of_turned(velocity_n, attitude)
                    # Results of before it was in there have less than that
                    if not (np.einsum("nii->ni", over_ground) < 0.0).any():
                        twist = over_ground
                columns["covariance_velocity_n"] = twist
        elif "pose" in values and "fix" in values:
            local = self._from_world(values["pose"]["position"])
        if "fix" in values:
            geodetic = values["fix"]["geodetic"]
            columns["position"] = geodetic * np.array([np.pi / 180.0, np.pi / 180.0, 1.0])
            if "fix" in present:
                # always east, north, up in this message
                covariance = values["fix"]["fix_covariance"].reshape(-1, 3, 3)
                columns["covariance_position_n"] = _unknown(enu_to_ned_covariance(covariance))
        q_nv = self._turned_back(values["vehicle"]["q"]) if "vehicle" in values else None
        solution = Solution(time_ns, log_time_ns, q_nb, **columns)  # type: ignore[arg-type]
        return ResultBlock(solution, local, q_nv, has_rates=imu is not None)

    def _attitude(self, values: Joined) -> np.ndarray:
        if self._source == "euler":
            return np.asarray(from_euler(values["euler"]["euler"]))
        return self._turned_back(values[self._source]["q"])

    def _turned_back(self, q_xyzw: np.ndarray) -> np.ndarray:
        """Attitudes of messages as q_nb; NaN where they are no rotations."""
        q = q_xyzw[:, [3, 0, 1, 2]]
        norm = np.linalg.norm(q, axis=1)
        norm[~(np.abs(norm - 1.0) < 0.05)] = np.nan
        q = q / norm[:, None]
        # The conversions are half turns of both axes, and so their own inverse.
        return q_for_log(q, self._axes, "enu" if self._enu else "ned")

    def _from_world(self, vectors: np.ndarray) -> np.ndarray:
        return enu_to_ned(vectors) if self._enu else vectors

    def _turned(self, covariance: np.ndarray) -> np.ndarray:
        return _unknown(enu_to_ned_covariance(covariance) if self._enu else covariance)


def _finite(block: ResultBlock) -> np.ndarray:
    """Rows with an attitude, and with a position if the result has any."""
    good = np.isfinite(block.solution.q_nb).all(axis=1)
    for position in (block.solution.position, block.local_n):
        if position is not None:
            good &= np.isfinite(position).all(axis=1)
    return np.asarray(good)


def _unknown(covariance: np.ndarray) -> np.ndarray:
    """Covariances with NaN where they are unknown."""
    filled = np.asarray(covariance.any(axis=(1, 2)))
    return covariance if filled.all() else np.where(filled[:, None, None], covariance, np.nan)


class _Held:
    """Rows of a topic that wait for those of other topics."""

    def __init__(self) -> None:
        self.last = int(np.iinfo(np.int64).min)
        self.any = False
        self._parts: list[tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]] = []

    def add(
        self, time_ns: np.ndarray, log_time_ns: np.ndarray, values: dict[str, np.ndarray]
    ) -> bool:
        """Add rows; return whether all times ascend."""
        ascending = (not self.any or time_ns[0] > self.last) and bool((np.diff(time_ns) > 0).all())
        self._parts.append((time_ns, log_time_ns, values))
        self.last, self.any = int(time_ns[-1]), True
        return ascending

    def up_to(self, ready: int) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]] | None:
        """Remove and return the rows up to a time."""
        if not self._parts:
            return None
        times, log_times, values = zip(*self._parts, strict=True)
        time_ns, log_time_ns = np.concatenate(times), np.concatenate(log_times)
        together = {name: np.concatenate([one[name] for one in values]) for name in values[0]}
        count = int(np.searchsorted(time_ns, ready, side="right"))
        rest = {name: column[count:] for name, column in together.items()}
        self._parts = (
            [] if count == len(time_ns) else [(time_ns[count:], log_time_ns[count:], rest)]
        )
        rows = {name: column[:count] for name, column in together.items()}
        return (time_ns[:count], log_time_ns[:count], rows) if count else None


def _common(held: dict[str, _Held], ready: int) -> tuple[np.ndarray, np.ndarray, Joined] | None:
    """Rows up to a time at the instants that all topics have."""
    parts = {name: rows for name, one in held.items() if (rows := one.up_to(ready)) is not None}
    if len(parts) < len(held):
        return None
    every = [time_ns for time_ns, _, _ in parts.values()]
    same = every[0]
    if not all(np.array_equal(same, one) for one in every[1:]):
        same = reduce(np.intersect1d, every)
        for name, one in parts.items():
            which = np.searchsorted(one[0], same)
            parts[name] = same, one[1][which], {key: v[which] for key, v in one[2].items()}
    if not len(same):
        return None
    first = next(iter(parts.values()))[1]
    return same, first, {name: values for name, (_, _, values) in parts.items()}
