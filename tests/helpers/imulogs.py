"""IMU logs written by other people's writers, and attitudes read back by their readers."""

from functools import cache
from typing import NamedTuple

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from tests.helpers.logs import DATA

IMU = "sensor_msgs/msg/Imu"
T0 = 1_700_000_000_000_000_000
G = 9.80665

# What takes FLU vectors to FRD, and ENU vectors to NED (and back: both are half turns).
FLU_FRD = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
ENU_NED = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])

REAL = sorted(
    p.relative_to(DATA).as_posix()
    for pattern in ("*/*.mcap", "*/*.bag", "*/*_db3")
    for p in DATA.glob(pattern)
) or ["imu_tools/sparkfun_razor.bag"]  # one that says why it is skipped


class Message(NamedTuple):
    """One message for a log."""

    topic: str
    type_name: str
    log_ns: int
    message: object


@cache
def store(ros=2):
    if ros == 2:
        return get_typestore(Stores.ROS2_HUMBLE)
    types = get_typestore(Stores.ROS1_NOETIC)  # which lacks the one that tf2 is about
    text = "geometry_msgs/TransformStamped[] transforms"
    types.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
    return types


def header(time_ns, frame="imu_link", ros=2):
    types = store(ros).types
    sec, nanosec = divmod(int(time_ns), 10**9)
    extra = {"seq": 0} if ros == 1 else {}
    stamp = types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **extra)


def imu_messages(
    time_ns,
    gyro,
    accel,
    log_ns=None,
    q_xyzw=(0.0, 0.0, 0.0, 0.0),
    covariance=-1.0,
    topic="/imu",
    frame="imu_link",
    ros=2,
):
    """Imu messages from columns (rows may be broadcast)."""
    types = store(ros).types
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    n = len(time_ns)
    gyro, accel = np.broadcast_to(gyro, (n, 3)), np.broadcast_to(accel, (n, 3))
    q = np.broadcast_to(np.asarray(q_xyzw, float), (n, 4))
    log_ns = time_ns if log_ns is None else log_ns
    unknown, said = np.zeros(9), np.zeros(9)
    said[:] = covariance
    if np.ndim(covariance) == 0:
        said[1:] = 0.0
    return [
        Message(
            topic,
            IMU,
            int(log_ns[k]),
            types[IMU](
                header=header(time_ns[k], frame, ros),
                orientation=quaternion(*map(float, q[k])),
                orientation_covariance=said,
                angular_velocity=vector(*map(float, gyro[k])),
                angular_velocity_covariance=unknown,
                linear_acceleration=vector(*map(float, accel[k])),
                linear_acceleration_covariance=unknown,
            ),
        )
        for k in range(n)
    ]


def serialised(message, type_name, ros, types=None):
    types = types or store(ros)
    if isinstance(message, bytes):
        return message
    if ros == 1:
        return bytes(types.serialize_ros1(message, type_name))
    return bytes(types.serialize_cdr(message, type_name))


def write_log(path, messages, ros=2, types=None, channels=()):
    """MCAP by mcap's own writer, in the order given; ``channels`` are made though nobody writes."""
    types = types or store(ros)
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=65536)
        writer.start(profile=f"ros{ros}")
        numbers = {}

        def number(topic, name):
            if (topic, name) not in numbers:
                text = types.generate_msgdef(name, ros_version=ros)[0].encode()
                shown = name.replace("/msg/", "/") if ros == 1 else name
                schema = writer.register_schema(shown, f"ros{ros}msg", text)
                encoding = "ros1" if ros == 1 else "cdr"
                numbers[topic, name] = writer.register_channel(topic, encoding, schema)
            return numbers[topic, name]

        for topic, name in channels:
            number(topic, name)
        for m in messages:
            payload = serialised(m.message, m.type_name, ros, types)
            writer.add_message(number(m.topic, m.type_name), m.log_ns, payload, m.log_ns)
        writer.finish()
    return path


def write_bag(path, messages):
    """ROS 1 bag by rosbags' writer."""
    with BagWriter(path) as writer:
        numbers = {}
        for m in messages:
            if m.topic not in numbers:
                numbers[m.topic] = writer.add_connection(m.topic, m.type_name, typestore=store(1))
            writer.write(numbers[m.topic], m.log_ns, serialised(m.message, m.type_name, 1))
    return path


def imu_log(path, time_ns, gyro, accel, **options):
    return write_log(path, imu_messages(time_ns, gyro, accel, **options), options.get("ros", 2))


def read_topic(path, topic):
    """(log time, message) of a topic of an MCAP file, by mcap's reader and rosbags."""
    out = []
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages(topics=[topic]):
            name = schema.name
            if channel.message_encoding == "ros1":
                name = name if "/msg/" in name else name.replace("/", "/msg/")
                decoded = store(1).deserialize_ros1(message.data, name)
            else:
                decoded = store(2).deserialize_cdr(message.data, name)
            out.append((message.log_time, decoded))
    return out


def stamp_ns(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def read_attitude(path, topic="/sinstool/attitude"):
    """Stamps and rotations of a topic of QuaternionStamped or Imu."""
    messages = [m for _, m in read_topic(path, topic)]
    field = "quaternion" if hasattr(messages[0], "quaternion") else "orientation"
    q = [(v.x, v.y, v.z, v.w) for v in (getattr(m, field) for m in messages)]
    return np.array([stamp_ns(m) for m in messages]), np.array(q)


def in_log_axes(q_nb, axes="flu", world="enu"):
    """What a log says of attitudes of FRD in NED, by scipy."""
    r = Rotation.from_quat(q_nb, scalar_first=True)
    r = r * FLU_FRD if axes == "flu" else r
    return ENU_NED * r if world == "enu" else r


def angles_between(q_xyzw, rotations):
    """Angle of each difference, rad."""
    return (Rotation.from_quat(q_xyzw).inv() * rotations).magnitude()


def even_times(count, rate=200.0, start_ns=T0):
    return start_ns + np.round(np.arange(count) * (1e9 / rate)).astype(np.int64)


def resting(count, seed=0, gyro_noise=2e-3, accel_noise=0.02, bias=(0.0, 0.0, 0.0)):
    """A resting FLU sensor: rates and specific force."""
    rng = np.random.default_rng(seed)
    gyro = np.asarray(bias) + gyro_noise * rng.standard_normal((count, 3))
    accel = np.array([0.0, 0.0, G]) + accel_noise * rng.standard_normal((count, 3))
    return gyro, accel


def products(steps):
    """The product of each rotation and all before it."""
    out, shift = steps, 1
    while shift < len(steps):
        out = Rotation.concatenate((out[:shift], out[:-shift] * out[shift:]))
        shift *= 2
    return out


def handheld(count, rate=200.0, seed=0, size=2.0, rest_s=0.0, slowness_s=0.5, noise=2e-3):
    """A hand turns a FLU sensor in place: rates (rad/s), specific force and rotations to ENU."""
    rng = np.random.default_rng(seed)
    width = max(1, int(slowness_s * rate))
    window = np.hanning(2 * width + 1)
    smooth = np.array(
        [np.convolve(rng.standard_normal(count + 2 * width), window, "valid") for _ in range(3)]
    ).T
    gyro = size * smooth / np.sqrt(np.mean(smooth**2))
    still = int(rest_s * rate)
    gyro[:still] = 0.0
    steps = np.concatenate((np.zeros((1, 3)), 0.5 * (gyro[1:] + gyro[:-1]) / rate))
    attitude = products(Rotation.from_rotvec(steps))
    accel = attitude.inv().apply([0.0, 0.0, G])
    gyro = gyro + noise * rng.standard_normal(gyro.shape)
    return gyro, accel + 10.0 * noise * rng.standard_normal(accel.shape), attitude
