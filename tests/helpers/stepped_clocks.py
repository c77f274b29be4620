"""Logs of a computer whose clock is set while it records, by other people's writer."""

from dataclasses import replace

import numpy as np
from mcap.writer import Writer

from tests.helpers.imulogs import IMU, T0, store
from tests.helpers.unseen_drives import RATE, fix_messages, imu_rows

# Whose times step: stamps of the IMU and of the receiver, and times of recording
TOGETHER = ("imu", "gnss", "recorder")


def stepped(seconds, steps):
    """What a clock shows at true times that is set forward by sizes at times, both s."""
    return seconds + sum(size * (seconds >= at) for at, size in steps)


def nanoseconds(seconds):
    return T0 + np.round(seconds * 1e9).astype(np.int64)


def write_stepped(path, data, steps, who=TOGETHER, seed=0, late_s=0.03, channels=1):
    """A log of a record, its messages in the order in which they arrive.

    Parameters
    ----------
    steps : sequence of (float, float)
        Times and sizes, s.
    who : collection of str
        The clocks that step, of `TOGETHER`; the others go on.
    late_s : float
        From a fix to its message, with milliseconds of jitter.
    channels : int
        Of the IMU's topic, which take turns.

    Returns
    -------
    log_ns : ndarray, shape (n,)
        Log times of the samples.
    """
    random = np.random.default_rng([seed, 77])

    def shown(clock, seconds):
        return nanoseconds(stepped(seconds, steps if clock in who else ()))

    flip = np.array([1.0, -1.0, -1.0]) * RATE
    stamps = shown("imu", data.seconds)
    rows = imu_rows(stamps, data.gyro * flip, data.accel * flip)
    arrival = data.seconds + 0.0005 + random.gamma(2.0, 0.0002, len(rows))
    fixes = data.fixes
    # `fix_messages` writes the seconds it is given
    clocked = stepped(fixes.seconds, steps if "gnss" in who else ())
    others = fix_messages(replace(fixes, seconds=clocked))
    each = len(others) // len(fixes.seconds)
    delay = late_s + random.gamma(2.0, 0.005, len(fixes.seconds))
    arrivals = np.concatenate(
        [np.maximum.accumulate(arrival), np.repeat(fixes.seconds + delay, each)]
    )
    log_ns = shown("recorder", arrivals)
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        number = {}
        for topic, name in {"/imu": IMU, **{m[1]: m[2] for m in others}}.items():
            text = store().generate_msgdef(name, ros_version=2)[0].encode()
            schema = writer.register_schema(name, "ros2msg", text)
            number[topic] = [
                writer.register_channel(topic, "cdr", schema, {"number": str(n)})
                for n in range(channels if topic == "/imu" else 1)
            ]
        for k in np.argsort(arrivals, kind="stable").tolist():
            time = int(log_ns[k])
            if k < len(rows):
                channel = number["/imu"][k % channels]
                writer.add_message(channel, time, rows[k].tobytes(), time)
            else:
                _, topic, _, payload = others[k - len(rows)]
                writer.add_message(number[topic][0], time, payload, time)
        writer.finish()
    return log_ns[: len(rows)]
