"""Wheel speeds of a log: their topic, and their fit to a reference.

Wheels have no type of message of their own. Odometry, twists and joints are taken for wheels where
they hold forward speed alone, which no filter's output does, and where it is the speed of the fixes
but for a factor. Commands look the same, and are recognised by their names.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from sinstool.config import InputOptions
from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.earth import horizontal_metres
from sinstool.core.errors import UnsupportedLogError
from sinstool.core.order_statistics import SIGMA_PER_MAD
from sinstool.core.rotation import wrapped
from sinstool.core.streams import GnssEpochs, Readings
from sinstool.core.timeline import SECOND, sorted_stream
from sinstool.io.readers.log import Channel, Log
from sinstool.io.readers.message_types import JOINT_TYPE, VELOCITY_TYPES
from sinstool.io.readers.streams import Losses, joint_names, read_joint_rates, read_twist
from sinstool.io.readers.topics import NONE, optional_topics
from sinstool.methods.wheel_fit import WheelFit, fit_wheels, slipping_wheels

Unit = Literal["m/s", "rad/s"]

# One topic may hold joints of several publishers, each in messages of its own.
JOINT_MESSAGES = 50
# Faster than any wheels, m/s or rad/s, as damaged bytes may be.
FASTEST = 1e3
# Share of the messages whose other components may differ from zero.
STRAY = 0.01
# Mean speeds over spans of these lengths are compared, s: the longer where fixes are noisy.
SPANS_S = (4.0, 16.0)
LEAST_SPANS = 10
# Speeds are the same with at least this correlation, or at most this share that is left.
ALIKE, LEFT = 0.9, 0.1
# Share of the spans that have to agree; others are outliers, such as a ferry.
AGREEING = 0.6
# Limits of metres for each unit of the reading: of true speeds, and of radii of wheels, m.
SPEED, RADIUS = (0.8, 1.25), (0.02, 1.5)
COMMANDS = ("cmd", "command", "setpoint", "target", "desired", "reference")
SIDES = {"left": ("left", "l", "fl", "rl", "bl"), "right": ("right", "r", "fr", "rr", "br")}
REAR = ("rear", "back", "rl", "rr", "bl", "br")
NO_WHEELS = ("steer", "steering", "caster", "castor", "swivel")


@dataclass(frozen=True)
class WheelSpeeds:
    """Speed of a vehicle by its wheels.

    Attributes
    ----------
    topic : str
        '' for none.
    reason : str
        Why, as the end of a sentence: "as the log has ...".
    time_ns : ndarray of int64, shape (n,)
        Increasing.
    speed : ndarray, shape (n,)
        Forward, in `unit`; the mean of the wheels of an axle.
    unit : {'m/s', 'rad/s'}
    wheels : int
        How many it is the mean of; 0 where the log does not say.
    apart : ndarray, shape (n,), optional
        Left less right wheel, in `unit`.
    """

    topic: str = ""
    reason: str = "as the log was not searched for them"
    time_ns: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    speed: FloatArray = field(default_factory=lambda: np.empty(0))
    unit: Unit = "m/s"
    wheels: int = 0
    apart: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.time_ns)


@dataclass(frozen=True)
class _Likeness:
    """Agreement of readings with the speed of fixes; NaN where too few can be compared."""

    correlation: float = np.nan
    left: float = np.nan
    scale: float = np.nan

    @property
    def follows(self) -> bool:
        return bool(self.correlation >= ALIKE or self.left <= LEFT)


def read_wheels(
    log: Log,
    options: InputOptions,
    gnss: GnssEpochs | None,
    taken: str = "",
    log_time: bool = False,
) -> WheelSpeeds:
    """The wheels of a log, or why it has none.

    Parameters
    ----------
    gnss : GnssEpochs or None
        The speeds are compared with it.
    taken : str, optional
        The topic that is the velocity over ground already.
    log_time : bool
        Take the recorder's times for stamps.

    Raises
    ------
    TopicError
        The named topic is missing or of another type.
    UnsupportedLogError
        The named topic cannot be read.
    """
    name = options.wheels
    topics = optional_topics(log, "--wheels", name, JOINT_TYPE, *VELOCITY_TYPES)
    if name == NONE:
        return WheelSpeeds(reason="as --wheels is none")
    candidates, refused = [], []
    for topic, channels in topics.items():
        if topic == taken and name is None:
            continue
        try:
            wheels = _read(log, topic, channels, log_time, name is not None)
        except UnsupportedLogError as exc:
            if name is not None:
                raise
            wheels = WheelSpeeds(reason=f"{topic} cannot be read: {exc}")
        if name is not None:
            return _configured(wheels, topic, channels, gnss)
        if wheels.topic:
            wheels, likeness = _compared(wheels, channels, gnss)
            candidates += [(likeness.left, wheels)] if wheels.topic else []
        if not wheels.topic:
            refused.append(wheels.reason)
    if not candidates:
        none = "as no topic looks like wheel speeds"
        return WheelSpeeds(reason="as " + "; ".join(refused) if refused else none)
    best = min(candidates, key=lambda pair: pair[0])[1]
    if len(candidates) > 1:
        best = replace(best, reason=f"{best.reason}, best of {len(candidates)} topics that do")
    return best


def _configured(
    wheels: WheelSpeeds, topic: str, channels: tuple[Channel, ...], gnss: GnssEpochs | None
) -> WheelSpeeds:
    """A topic that the user names, whatever it holds; its unit where the fixes show it."""
    if not len(wheels):
        return WheelSpeeds(reason=f"as {wheels.reason}")
    scale = _likeness(wheels, gnss).scale
    joints = channels[0].type == JOINT_TYPE
    turning = joints and not SPEED[0] < scale < SPEED[1]
    unit: Unit = "rad/s" if turning else "m/s"
    return replace(wheels, topic=topic, reason="as configured", unit=unit)


def _read(
    log: Log, topic: str, channels: tuple[Channel, ...], log_time: bool, named: bool
) -> WheelSpeeds:
    """Forward speed of a topic; without a topic where it is something else."""
    if channels[0].type == JOINT_TYPE:
        return _joints(log, topic, channels, log_time, named)
    readings = _sorted(read_twist(log, channels, Losses()), log_time)
    if readings is None:
        return WheelSpeeds(reason=f"{topic} holds no velocity")
    wheels = WheelSpeeds(topic, "", readings.time_ns, readings.values[:, 0])
    if _words(topic) & set(COMMANDS):
        return replace(wheels, topic="", reason=f"{topic} seems to be a command")
    if np.mean(readings.values[:, 1:].any(axis=1)) > STRAY:
        why = f"{topic} holds more than forward speed, as a filter's output or world axes do"
        return replace(wheels, topic="", reason=why)
    return wheels


def _joints(
    log: Log, topic: str, channels: tuple[Channel, ...], log_time: bool, named: bool
) -> WheelSpeeds:
    """Mean rate of the joints that are wheels; of all joints if the user named the topic."""
    names = joint_names(log, channels, JOINT_MESSAGES)
    joints = wheel_joints(names) or (names if named else [])
    if not joints:
        return WheelSpeeds(reason=f"{topic} names no wheel")
    readings = _sorted(read_joint_rates(log, channels, joints, Losses()), log_time)
    if readings is None:
        return WheelSpeeds(reason=f"{topic} holds no velocity of {', '.join(joints)}")
    rates = readings.values
    # A wheel on the other side may count in reverse; vehicles mostly go forward
    rates = rates * np.where(rates.sum(axis=0) < 0.0, -1.0, 1.0)
    side = [_side(joint) for joint in joints]
    left, right = ([k for k, s in enumerate(side) if s == which] for which in ("left", "right"))
    apart = None
    if left and right:
        apart = rates[:, left].mean(axis=1) - rates[:, right].mean(axis=1)
    return WheelSpeeds(topic, "", readings.time_ns, rates.mean(axis=1), "rad/s", len(joints), apart)


def wheel_joints(names: Iterable[str]) -> list[str]:
    """Joints that are wheels; only those of the unsteered rear axle where names show them."""
    named = {name: _words(name) for name in names}
    wheels = [n for n, words in named.items() if "wheel" in words and not words & set(NO_WHEELS)]
    return [n for n in wheels if named[n] & set(REAR)] or wheels


def _side(joint: str) -> str:
    return next((side for side, marks in SIDES.items() if _words(joint) & set(marks)), "")


def _words(name: str) -> set[str]:
    """Words of a name, however they are joined: rearLeft_wheel2 is rear, left and wheel."""
    apart = re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower()
    return set(re.findall(r"wheel|[a-z]+", re.sub(r"(wheel)s?", r" \1 ", apart)))


def _sorted(blocks: Iterable[Readings], log_time: bool) -> Readings | None:
    usable = (b.rows((np.abs(b.values) < FASTEST).all(axis=1)) for b in blocks)
    ordered = sorted_stream(usable, log_time)
    return None if ordered is None else ordered.stream


def _compared(
    wheels: WheelSpeeds, channels: tuple[Channel, ...], gnss: GnssEpochs | None
) -> tuple[WheelSpeeds, _Likeness]:
    """Readings that are wheels, with the reason; without a topic where fixes contradict."""
    topic, fit = wheels.topic, _likeness(wheels, gnss)

    def refused(why: str) -> tuple[WheelSpeeds, _Likeness]:
        return replace(wheels, topic="", reason=f"{topic} {why}"), fit

    if np.isnan(fit.scale):
        return refused("moves too little to be compared with the fixes")
    if not fit.follows:
        return refused(f"does not follow the speed of the fixes: correlation {fit.correlation:.2f}")
    joints = channels[0].type == JOINT_TYPE
    unit: Unit = "m/s" if SPEED[0] < fit.scale < SPEED[1] else "rad/s"
    if unit == "rad/s" and not joints:
        return refused(f"is {1.0 / fit.scale:.3g} times the speed of the fixes")
    if unit == "rad/s" and not RADIUS[0] < fit.scale < RADIUS[1]:
        return refused(f"turns as wheels of {fit.scale:.3g} m do")
    reason = "as it is forward speed alone and follows the speed of the fixes"
    if joints:
        many = f"{wheels.wheels} wheel{'s' if wheels.wheels != 1 else ''}"
        size = f" of {fit.scale:.3f} m" if unit == "rad/s" else ""
        reason = f"as {many}{size} turn with the speed of the fixes"
    return replace(wheels, unit=unit, reason=reason), fit


def _likeness(wheels: WheelSpeeds, gnss: GnssEpochs | None) -> _Likeness:
    """Agreement of mean speeds over spans with those of the fixes."""
    best = _Likeness()
    if gnss is None or len(wheels) < 2 or not wheels.speed.any():
        return best
    for span_s in SPANS_S:
        fit = _agreement(*_spans(wheels, gnss, span_s))
        if not fit.left >= best.left:  # NaN is neither
            best = fit
        if best.follows:
            break
    return best


def _spans(wheels: WheelSpeeds, gnss: GnssEpochs, span_s: float) -> tuple[FloatArray, FloatArray]:
    """Mean speeds of wheels and of GNSS over the same spans, where both have them."""
    first = int(wheels.time_ns[0])
    span_ns = round(span_s * SECOND)
    # Those with readings alone: a single wrong stamp may be decades away
    spans = np.unique((wheels.time_ns - first) // span_ns)

    def means(time_ns: IntArray, values: FloatArray) -> FloatArray:
        """NaN where there is none."""
        span = (time_ns - first) // span_ns
        row = np.minimum(np.searchsorted(spans, span), len(spans) - 1)
        inside = spans[row] == span
        total = np.bincount(row[inside], values[inside], len(spans))
        number = np.bincount(row[inside], minlength=len(spans))
        return np.asarray(np.where(number > 0, total / np.maximum(number, 1), np.nan))

    turned = means(wheels.time_ns, np.abs(wheels.speed))
    moving = gnss.rows(np.isfinite(gnss.velocity_n[:, :2]).all(axis=1))
    if 2 * len(moving) >= len(gnss):
        speed = means(moving.time_ns, np.hypot(*moving.velocity_n[:, :2].T))
    else:
        speed = _by_fixes(gnss.rows(gnss.has_position), means, span_s)
    both = np.isfinite(turned) & np.isfinite(speed)
    return turned[both], speed[both]


def _by_fixes(
    fixes: GnssEpochs, means: Callable[[IntArray, FloatArray], FloatArray], span_s: float
) -> FloatArray:
    """Mean speed over spans from the distance between fixes of the first and last quarter."""
    if len(fixes) < 2:
        return means(fixes.time_ns, np.full(len(fixes), np.nan))
    place = np.stack(
        horizontal_metres(
            fixes.latitude - fixes.latitude[0],
            wrapped(fixes.longitude - fixes.longitude[0]),
            float(fixes.latitude[0]),
        )
    )
    # Each fix and the one nearest to half a span later
    half_ns = round(0.5 * span_s * SECOND)
    later = np.minimum(np.searchsorted(fixes.time_ns, fixes.time_ns + half_ns), len(fixes) - 1)
    apart = (fixes.time_ns[later] - fixes.time_ns) / SECOND
    good = (apart > 0.0) & (apart < span_s)
    way = np.hypot(*(place[:, later] - place)[:, good])
    middle = (fixes.time_ns + (fixes.time_ns[later] - fixes.time_ns) // 2)[good]
    return means(middle, way / apart[good])


def _agreement(turned: FloatArray, speed: FloatArray) -> _Likeness:
    """Robust proportionality of two speeds."""
    if len(turned) < LEAST_SPANS or not turned.any() or not speed.any():
        return _Likeness()
    use = np.ones(len(turned), np.bool_)
    for _ in range(5):
        scale = float(speed[use] @ turned[use] / (turned[use] @ turned[use]))
        rest = speed - scale * turned
        most = 4.0 * SIGMA_PER_MAD * float(np.median(np.abs(rest))) + 0.02 * float(speed.max())
        use = np.abs(rest) <= most
        if use.sum() < AGREEING * len(use) or not turned[use].any():
            return _Likeness(0.0, np.inf, scale)
    left = float(np.sqrt(np.mean(rest[use] ** 2) / np.mean(speed[use] ** 2)))
    spread = np.std(turned[use]) * np.std(speed[use])
    product = np.mean((turned[use] - turned[use].mean()) * (speed[use] - speed[use].mean()))
    return _Likeness(float(product / spread) if spread > 0.0 else 0.0, left, scale)


def matched(wheels: WheelSpeeds, time_ns: IntArray, speed: FloatArray) -> WheelFit | None:
    """Scale and latency of wheels against a reference.

    Parameters
    ----------
    time_ns : ndarray of int64, shape (m,)
        Of the reference, increasing.
    speed : ndarray, shape (m,)
        Forward speed of the rear axle, m/s.

    Returns
    -------
    WheelFit or None
        None where too little motion is in both.
    """
    return fit_wheels(wheels.time_ns, wheels.speed, time_ns, speed)


def slipping(
    wheels: WheelSpeeds, time_ns: IntArray, yaw_rate: FloatArray, latency_s: float = 0.0
) -> BoolArray:
    """Readings in which one wheel of an axle turns at another rate than the other implies.

    Parameters
    ----------
    time_ns : ndarray of int64, shape (m,)
        Of the yaw rates, increasing.
    yaw_rate : ndarray, shape (m,)
        rad/s, either sign.
    latency_s : float, optional
        Of the readings.

    Returns
    -------
    ndarray of bool, shape (n,)
        False throughout where the log does not distinguish left and right.
    """
    if wheels.apart is None:
        return np.zeros(len(wheels), np.bool_)
    return slipping_wheels(
        wheels.time_ns - round(latency_s * SECOND), wheels.speed, wheels.apart, time_ns, yaw_rate
    )
