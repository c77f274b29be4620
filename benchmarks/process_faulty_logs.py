"""Run `process` on logs that are valid but bad, very many, and look at every message it writes.

    python benchmarks/process_faulty_logs.py --count 300 --seed 1 --jobs 2

A drive with GNSS and barometer is spoilt by gaps, lost and repeated messages, jitter, late
arrival, stamps of zero or years off, clocks that are set, values that are no numbers, saturation,
and fixes that are none; written in one of the encodings (MCAP of ROS 2 and ROS 1, ROS 1 bag, .db3);
and processed in one of the modes with a random coning algorithm. A run may ask for 6 GiB of memory
and refuse the log, in one line. Of a run that does not, each orientation must be finite and a unit
quaternion to 1e-12, each stamp (unless samples are taken as evenly spaced) and each log time that
of an Imu message of the input, and no stamp there twice. Logs that fail are kept in --keep. Needs
the extra `test`.
"""

from __future__ import annotations

import multiprocessing
import resource
import shutil
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from benchmarks.common import parser
from tests.helpers.imulogs import (
    IMU,
    Message,
    imu_messages,
    read_topic,
    serialised,
    stamp_ns,
    store,
)
from tests.helpers.imulogs import write_bag as write_bag1
from tests.helpers.logs import Row, write_bag2

SCENARIO = (
    "drive", "--grade", "mems", "--still", "15", "--duration", "60", "--rate", "50",
    "--gnss-rate", "5", "--seed", "4", "--wheels", "odometry",
)  # fmt: skip
START = {"latitude": 48.0, "longitude": 9.0, "height": 400.0}
MODES = ("attitude", "ins", "ins-gnss")
ALGORITHMS = ("previous-3", "optimal-4", "uncompensated", "picard-3", "singular-perturbation")
EMITS = {
    "attitude": "imu,attitude,euler,pose,tf",
    "ins": "imu,attitude,euler,odometry,pose,fix,tf",
    "ins-gnss": "imu,attitude,euler,odometry,pose,fix,tf,height,diagnostics",
}
UNIT = 1e-12
# A step of years is known to some nanoseconds only
ROUNDING_NS = 100
# Of memory that a run may ask for: a grid over years would fill it
MOST_BYTES = 6 * 2**30


class Sensors:
    """IMU samples as columns that can be spoilt, and the other topics' messages."""

    def __init__(self, stamp: Any, log: Any, gyro: Any, accel: Any, others: list[Message]) -> None:
        self.stamp, self.log = stamp.copy(), log.copy()
        self.gyro, self.accel = gyro.copy(), accel.copy()
        self.others = list(others)

    def keep(self, rows: Any) -> None:
        """Leave out, repeat or reorder samples."""
        self.stamp, self.log = self.stamp[rows], self.log[rows]
        self.gyro, self.accel = self.gyro[rows], self.accel[rows]


def base(folder: Path) -> Sensors:
    """The drive as it was before anything happened to it."""
    from click.testing import CliRunner

    from sinstool.cli.main import cli

    path = folder / "drive.mcap"
    ran = CliRunner().invoke(cli, ["simulate", *SCENARIO, "-o", str(path), "--no-truth"])
    assert ran.exit_code == 0, ran.output
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    others, columns = [], None
    for channel in summary.channels.values():
        result = read_topic(path, channel.topic)
        if summary.schemas[channel.schema_id].name == IMU:
            vector = lambda v: (v.x, v.y, v.z)  # noqa: E731
            columns = (
                np.array([stamp_ns(m) for _, m in result]),
                np.array([at for at, _ in result]),
                np.array([vector(m.angular_velocity) for _, m in result]),
                np.array([vector(m.linear_acceleration) for _, m in result]),
            )
        else:
            others += [Message(channel.topic, m.__msgtype__, at, m) for at, m in result]
    assert columns is not None
    return Sensors(*columns, others)


# -- what happens to logs -----------------------------------------------------------------------

Rng = np.random.Generator


def _gaps(s: Sensors, rng: Rng) -> None:
    for _ in range(rng.integers(1, 4)):
        start = int(rng.integers(len(s.stamp)))
        length = int(rng.choice([3, 20, 200, 1000]))
        s.keep(np.r_[0:start, min(len(s.stamp), start + length) : len(s.stamp)])


def _lost(s: Sensors, rng: Rng) -> None:
    s.keep(np.flatnonzero(rng.random(len(s.stamp)) > rng.choice([0.01, 0.2, 0.6])))


def _few(s: Sensors, rng: Rng) -> None:
    s.keep(np.arange(len(s.stamp))[: int(rng.choice([1, 2, 3, 10, 100]))])


def _jitter(s: Sensors, rng: Rng) -> None:
    size = float(rng.choice([1e3, 1e5, 1e7, 5e7]))
    s.stamp = s.stamp + np.round(size * rng.standard_normal(len(s.stamp))).astype(np.int64)


def _late(s: Sensors, rng: Rng) -> None:
    delay = rng.exponential(float(rng.choice([1e6, 3e7, 1e9])), len(s.log))
    s.log = s.log + np.round(delay).astype(np.int64)
    s.keep(np.argsort(s.log, kind="stable"))


def _shuffled(s: Sensors, rng: Rng) -> None:
    start = int(rng.integers(len(s.stamp)))
    rows = np.arange(len(s.stamp))
    rng.shuffle(rows[start : start + int(rng.choice([2, 10, 100]))])
    s.keep(rows)


def _repeated(s: Sensors, rng: Rng) -> None:
    rows = np.sort(np.r_[np.arange(len(s.stamp)), rng.integers(0, len(s.stamp), 30)])
    s.keep(rows)
    if rng.random() < 0.5:
        s.gyro = s.gyro + 1e-3 * rng.standard_normal(s.gyro.shape)


def _zero_stamps(s: Sensors, rng: Rng) -> None:
    share = rng.choice([0.001, 0.5, 1.0])
    s.stamp = np.where(rng.random(len(s.stamp)) < share, 0, s.stamp)


def _constant_stamps(s: Sensors, rng: Rng) -> None:
    s.stamp = np.where(np.arange(len(s.stamp)) > rng.integers(len(s.stamp)), s.stamp[0], s.stamp)


def _clock_set(s: Sensors, rng: Rng) -> None:
    at = int(rng.integers(len(s.stamp)))
    step = int(rng.choice([-3_600, -30, -1, 1, 30, 3_600, 10**8]) * 1e9)
    s.stamp = np.where(np.arange(len(s.stamp)) >= at, s.stamp + step, s.stamp)
    if rng.random() < 0.5:
        s.log = np.where(np.arange(len(s.log)) >= at, s.log + step, s.log)


def _no_numbers(s: Sensors, rng: Rng) -> None:
    value = rng.choice([np.nan, np.inf, -np.inf])
    for column in (s.gyro, s.accel):
        column[rng.integers(0, len(column), 5), rng.integers(3)] = value


def _saturated(s: Sensors, rng: Rng) -> None:
    share = rng.choice([0.3, 0.8])
    for column in (s.gyro, s.accel):
        limit = np.quantile(np.abs(column), share)
        np.clip(column, -limit, limit, out=column)


def _huge(s: Sensors, rng: Rng) -> None:
    column = (s.gyro, s.accel)[rng.integers(2)]
    column[rng.integers(0, len(column), 3)] = float(rng.choice([1e4, 1e30, 1e200, 1e-310]))


def _stuck(s: Sensors, rng: Rng) -> None:
    start = int(rng.integers(len(s.gyro)))
    s.gyro[start:], s.accel[start:] = s.gyro[start], s.accel[start]


def _others_spoilt(s: Sensors, rng: Rng) -> None:
    keep = rng.choice([0.0, 0.5, 1.0])
    out = []
    for m in s.others:
        if rng.random() > keep + 0.02:
            continue
        if rng.random() < 0.02:
            m = m._replace(log_ns=m.log_ns + int(rng.choice([-(10**9), 10**9, 10**11])))
        copied = as_ros(m.message, 2)
        if rng.random() < 0.05:
            _spoil(copied, rng)
        out.append(m._replace(message=copied))
    s.others = out


def _others_far(s: Sensors, rng: Rng) -> None:
    """One message of another topic, of a node that publishes before its clock is set, or worse."""
    k = int(rng.integers(len(s.others)))
    copied = as_ros(s.others[k].message, 2)
    copied.header.stamp.sec = int(rng.choice([0, 2**31 - 1]))
    s.others[k] = s.others[k]._replace(message=copied)


def _all_set(s: Sensors, rng: Rng) -> None:
    """All clocks are set forward, as by a time server that a computer finds."""
    at = int(rng.integers(len(s.stamp)))
    begin, step = int(s.log[at]), int(rng.choice([60, 86_400, 3 * 10**7])) * 10**9
    s.stamp = np.where(np.arange(len(s.stamp)) >= at, s.stamp + step, s.stamp)
    s.log = np.where(np.arange(len(s.log)) >= at, s.log + step, s.log)
    for k, m in enumerate(s.others):
        if m.log_ns >= begin:
            copied = as_ros(m.message, 2)
            copied.header.stamp.sec += step // 10**9
            s.others[k] = m._replace(message=copied, log_ns=m.log_ns + step)


def _spoil(message: Any, rng: Rng) -> None:
    """Make one of a message's numbers no number, or nought."""
    numbers = [f.name for f in fields(message) if isinstance(getattr(message, f.name), float)]
    deeper = [f.name for f in fields(message) if is_dataclass(getattr(message, f.name))]
    if numbers:
        value = float(rng.choice([np.nan, 0.0, np.inf, 1e6]))
        object.__setattr__(message, str(rng.choice(numbers)), value)
    elif deeper:
        _spoil(getattr(message, str(rng.choice(deeper))), rng)


FAULTS: tuple[Callable[[Sensors, Rng], None], ...] = (
    _gaps, _lost, _few, _jitter, _late, _shuffled, _repeated, _zero_stamps, _constant_stamps,
    _clock_set, _no_numbers, _saturated, _huge, _stuck, _others_spoilt,
    _others_far, _all_set,
)  # fmt: skip


# -- encodings ------------------------------------------------------------------------------------


def as_ros(message: Any, ros: int) -> Any:
    """The same message as a type of ROS 1 or 2; a copy."""
    kind = store(ros).types[message.__msgtype__]
    extra = {"seq": 0} if ros == 1 and message.__msgtype__ == "std_msgs/msg/Header" else {}
    values = {}
    for one in fields(message):
        value = getattr(message, one.name)
        if one.name != "seq":
            values[one.name] = as_ros(value, ros) if is_dataclass(value) else value
    return kind(**values, **extra)


def _mcap(path: Path, messages: list[Message], ros: int, rng: Rng) -> Path:
    compression = list(CompressionType)[int(rng.integers(3))]
    with path.open("wb") as stream:
        writer = Writer(stream, 65536, compression, use_chunking=bool(rng.random() < 0.8))
        writer.start(profile=f"ros{ros}")
        ids: dict[str, int] = {}
        for m in messages:
            if m.topic not in ids:
                text = store(ros).generate_msgdef(m.type_name, ros_version=ros)[0].encode()
                name = m.type_name.replace("/msg/", "/") if ros == 1 else m.type_name
                schema = writer.register_schema(name, f"ros{ros}msg", text)
                ids[m.topic] = writer.register_channel(m.topic, ("ros1", "cdr")[ros - 1], schema)
            data = serialised(m.message, m.type_name, ros)
            writer.add_message(ids[m.topic], m.log_ns, data, m.log_ns)
        writer.finish()
    return path


def _folder(path: Path, messages: list[Message]) -> Path:
    content = [
        Row(m.topic, m.log_ns, m.log_ns, serialised(m.message, m.type_name, 2)) for m in messages
    ]
    return write_bag2(path, content, types={m.topic: m.type_name for m in messages})


ENCODINGS = ("mcap", "ros1 mcap", "bag", "db3 folder", "db3")


def write(sensors: Sensors, encoding: str, folder: Path, rng: Rng) -> Path:
    """Write a log in one of `ENCODINGS`."""
    ros = 1 if encoding in ("ros1 mcap", "bag") else 2
    stamps = np.maximum(sensors.stamp, 0)
    messages = imu_messages(stamps, sensors.gyro, sensors.accel, np.maximum(sensors.log, 0),
                            topic="/imu/data_raw", ros=ros)  # fmt: skip
    messages += [m._replace(message=as_ros(m.message, ros)) for m in sensors.others]
    if rng.random() < 0.7:  # as they came; else topic by topic
        messages.sort(key=lambda m: m.log_ns)
    if ros == 1:
        # its times end in 2106
        messages = [m._replace(log_ns=min(m.log_ns, 4 * 10**18)) for m in messages]
    if encoding == "bag":
        return write_bag1(folder / "log.bag", messages)
    if encoding.startswith("db3"):
        path = _folder(folder / "log", messages)
        return path if encoding == "db3 folder" else next(path.glob("*.db3"))
    return _mcap(folder / "log.mcap", messages, ros, rng)


# -- a run, and what it wrote -----------------------------------------------------------------


def make_log(sensors: Sensors, seed: int, number: int, folder: Path) -> tuple[Path, dict[str, Any]]:
    """A spoilt log, and the groups of options to process it with."""
    rng = np.random.default_rng([seed, number])
    spoilt = Sensors(sensors.stamp, sensors.log, sensors.gyro, sensors.accel, sensors.others)
    chosen = rng.permutation(len(FAULTS))[: rng.integers(1, 4)]
    for k in chosen:
        if len(spoilt.stamp):
            FAULTS[k](spoilt, rng)
    encoding = ENCODINGS[rng.integers(len(ENCODINGS))]
    log = write(spoilt, encoding, folder, rng)
    mode = MODES[rng.integers(len(MODES))]
    emits = EMITS[mode].split(",")
    options: dict[str, Any] = {
        "navigation": {"mode": mode},
        "coning": {"coning": str(rng.choice(ALGORITHMS))},
        "output": {"emit": emits, "only_results": bool(rng.random() < 0.3)},
        "about": {"encoding": encoding, "faults": [FAULTS[k].__name__[1:] for k in chosen]},
    }
    if mode == "ins":
        options["align"] = {"align": "level", **START}
    if mode == "ins-gnss" and rng.random() < 0.3:
        options["filter"] = {"smooth": True}
    if rng.random() < 0.2:
        options["input"] = {"imu_rate": 50.0}
    return log, options


def times_of_input(log: Path) -> tuple[set[int], set[int]]:
    """Stamps and log times of the input's Imu messages, by rosbags and mcap's own reader."""
    from rosbags.highlevel import AnyReader

    if log.suffix == ".mcap":
        result = read_topic(log, "/imu/data_raw")
    else:
        with AnyReader([log]) as reader:
            expected = [c for c in reader.connections if c.topic == "/imu/data_raw"]
            result = [
                (at, reader.deserialize(data, c.msgtype))
                for c, at, data in reader.messages(connections=expected)
            ]
    return {stamp_ns(m) for _, m in result}, {at for at, _ in result}


def check(log: Path, out: Path, summary: dict[str, Any]) -> list[str]:
    """What is wrong with an output, and with the summary of its run."""
    wrong = []
    stamps, logged = times_of_input(log)
    if any("log time" in text for text in summary["warnings"]):
        stamps = stamps | logged
    # A clock that was set is set right, and the run says by how much
    for finding in summary["findings"]:
        step_ns = round(finding["numbers"].get("step_s", 0.0) * 1e9)
        if step_ns and finding["kind"] == "clock-step":
            stamps |= {t - step_ns for t in stamps} | {t + step_ns for t in stamps}
            logged |= {t - step_ns for t in logged} | {t + step_ns for t in logged}
    kinds = {finding["kind"] for finding in summary["findings"]}
    even, rounding_ns = "uneven-stamps" in kinds, ROUNDING_NS * ("clock-step" in kinds)
    with out.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        known = reader.get_summary()
        assert known is not None
        topics = {c.topic for c in known.channels.values()}
        assert sum(1 for _ in reader.iter_messages()) == known.statistics.message_count
    orientation = {
        "/sinstool/imu": lambda m: m.orientation,
        "/sinstool/attitude": lambda m: m.quaternion,
        "/sinstool/pose": lambda m: m.pose.orientation,
        "/sinstool/odometry": lambda m: m.pose.pose.orientation,
        "/tf": lambda m: m.transforms[0].transform.rotation,
    }
    for topic in sorted(t for t in topics if t.startswith("/sinstool/") or t == "/tf"):
        result = read_topic(out, topic)
        at = np.array([t for t, _ in result], np.int64)
        own = [stamp_ns(m.transforms[0] if topic == "/tf" else m) for _, m in result]
        if topic in orientation and result:
            q = [(v.w, v.x, v.y, v.z) for v in (orientation[topic](m) for _, m in result)]
            off = np.abs(np.linalg.norm(np.array(q), axis=1) - 1.0)
            if not (off <= UNIT).all():
                wrong.append(f"{topic}: {np.sum(~(off <= UNIT))} orientations are none")
        if topic == "/sinstool/diagnostics":
            continue  # of epochs, not of samples
        if not even and (invented := _far_from(own, stamps, rounding_ns)):
            wrong.append(f"{topic}: {len(invented)} stamps are no IMU's, as {min(invented)}")
        if invented := _far_from(at.tolist(), logged, rounding_ns):
            wrong.append(f"{topic}: {len(invented)} log times are no IMU's")
        if len(set(own)) < len(own):
            wrong.append(f"{topic}: stamps repeat")
    if "/sinstool/attitude" not in topics:
        wrong.append("no attitude")
    return wrong


def _far_from(times: list[int], known: set[int], rounding_ns: int) -> set[int]:
    """Times that are none of these."""
    ordered = np.array(sorted(known), np.int64)
    after = np.clip(np.searchsorted(ordered, times), 1, len(ordered) - 1)
    near = np.minimum(np.abs(ordered[after] - times), np.abs(ordered[after - 1] - times))
    return set(np.array(times, np.int64)[near > rounding_ns].tolist())


def one_run(sensors: Sensors, seed: int, number: int, folder: Path) -> tuple[str, str]:
    """Make, process and check a log; one of `FINE` or a failure, and details."""
    from sinstool.config import ProcessConfig
    from sinstool.core.errors import SinstoolError
    from sinstool.pipelines.process.run import process

    log, options = make_log(sensors, seed, number, folder)
    about = options.pop("about")
    out = folder / "out.mcap"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            # of values like 1e200, which the command line does not pass on either
            warnings.simplefilter("ignore", RuntimeWarning)
            result = process(log, out, ProcessConfig(**options))
    except SinstoolError as exc:
        if out.exists() or len(list(folder.iterdir())) > 1:
            return "left something behind", f"{about} {options}: {exc}"
        return "refused", str(exc)
    except Exception:
        return "crash", f"{about} {options}\n{traceback.format_exc()}"
    wrong = check(log, out, result.to_json())
    if wrong:
        return "wrong", f"{about} {options}: {'; '.join(wrong)}"
    return "written, with losses" if result.exit_status else "written", ""


FINE = ("written", "written, with losses", "refused")
_sensors: dict[str, Sensors] = {}


def _job(task: tuple[int, int, Path]) -> tuple[int, str, str]:
    seed, number, keep = task
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, resource.RLIM_INFINITY))
    with tempfile.TemporaryDirectory() as name:
        if "base" not in _sensors:
            _sensors["base"] = base(Path(name))
        folder = Path(name) / "run"
        folder.mkdir()
        outcome, details = one_run(_sensors["base"], seed, number, folder)
        if outcome not in FINE:
            copy = keep / f"seed{seed}-{number}"
            shutil.rmtree(copy, ignore_errors=True)
            shutil.copytree(folder, copy)
            (copy / "why.txt").write_text(details)
    return number, outcome, details


def main(arguments: Sequence[str] | None = None) -> int:
    made = parser(__doc__, count=300, seed=1, first=0, jobs=2)
    made.add_argument("--keep", type=Path, default=Path("faulty_logs"))
    made.add_argument("-v", "--verbose", action="store_true", help="say why logs are refused")
    options = made.parse_args(arguments)
    outcomes: Counter[str] = Counter()
    tasks = [
        (options.seed, n, options.keep) for n in range(options.first, options.first + options.count)
    ]
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
        for number, outcome, details in pool.imap_unordered(_job, tasks):
            outcomes[outcome] += 1
            if outcome not in FINE or (options.verbose and outcome == "refused"):
                print(f"  {number}: {outcome}: {details}", flush=True)
    wrong = sum(n for name, n in outcomes.items() if name not in FINE)
    said = ", ".join(f"{name} {n}" for name, n in sorted(outcomes.items()))
    print(f"seed {options.seed}, {outcomes.total()} logs: {said}; failures {wrong}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
