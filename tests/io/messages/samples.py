"""Random messages of every type we meet, made and read by rosbags, and paths into them."""

import re

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from sinstool.io.messages.encode import standard_definition

TYPES = [
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/NavSatFix",
    "sensor_msgs/msg/FluidPressure",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/MagneticField",
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/TwistWithCovarianceStamped",
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/QuaternionStamped",
    "geometry_msgs/msg/Vector3Stamped",
    "tf2_msgs/msg/TFMessage",
    "diagnostic_msgs/msg/DiagnosticArray",
]
FLAVOURS = ["cdr", "cdr_be", "ros1"]

ROS2 = get_typestore(Stores.ROS2_HUMBLE)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1.register(
    get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
)
_ALPHABET = "abcz/_ äµ漢"


def store_of(flavour):
    return ROS1 if flavour == "ros1" else ROS2


def encoding_of(flavour):
    return "ros1" if flavour == "ros1" else "cdr"


def serialise(message, flavour):
    name = message.__msgtype__
    if flavour == "ros1":
        return bytes(ROS1.serialize_ros1(message, name))
    return bytes(ROS2.serialize_cdr(message, name, little_endian=flavour == "cdr"))


def deserialise(payload, name, flavour):
    if flavour == "ros1":
        return ROS1.deserialize_ros1(payload, name)
    return ROS2.deserialize_cdr(payload, name)


def random_message(name, flavour, rng, lengths=(0, 1, 2, 3), texts=(0, 1, 3, 4, 7, 8)):
    """A message of random content; sequences and strings have one of the given lengths."""
    store = store_of(flavour)
    fields = {}
    for field, (node, value) in store.fielddefs[name][1]:
        if node == Nodetype.BASE:
            fields[field] = _value(value[0], rng, texts, None)
        elif node == Nodetype.NAME:
            fields[field] = random_message(value, flavour, rng, lengths, texts)
        else:
            (subnode, sub), count = value
            count = count if node == Nodetype.ARRAY else int(rng.choice(lengths))
            if subnode == Nodetype.NAME:
                fields[field] = [
                    random_message(sub, flavour, rng, lengths, texts) for _ in range(count)
                ]
            else:
                fields[field] = _value(sub[0], rng, texts, count)
    return store.types[name](**fields)


def _value(base, rng, texts, count):
    if base == "string":
        if count is not None:
            return [_value(base, rng, texts, None) for _ in range(count)]
        return "".join(rng.choice(list(_ALPHABET), int(rng.choice(texts))))
    if base.startswith("float"):
        # any bit pattern: NaN payloads, infinities and denormals must survive too
        raw = rng.integers(0, 256, (count or 1) * 8, np.uint8).view(np.float64).astype(base)
        if count is None:
            return float(rng.normal()) if rng.random() < 0.5 else float(raw[0])
        return raw[:count]
    # rosbags has byte as signed, ROS 2 as unsigned: what both can say is drawn
    kind = np.iinfo("int8" if base in ("byte", "char") else base)
    top = min(int(kind.max), 2**31 - 1)  # rosbags has ROS 1 seconds as int32
    return int(rng.integers(0, top, endpoint=True))


def look_up(message, path):
    """Value at a dotted path such as ``status[0].values[1].key``."""
    for part in path.split("."):
        name, *indices = re.split(r"[\[\]]+", part.rstrip("]"))
        message = getattr(message, name)
        for index in indices:
            message = message[int(index)]
    return message


def field_at(definition, path):
    """The FieldType behind a path; for an element, that of the whole array."""
    here, ftype = definition.name, None
    for part in path.split("."):
        ftype = dict(definition.types[here])[part.split("[")[0]]
        here = ftype.name
    return ftype


def fixed_paths(name, flavour):
    """Paths of all numbers that every message of the type has."""
    definition = standard_definition(name, encoding_of(flavour))

    def walk(here, prefix):
        for field, ftype in definition.types[here]:
            path = f"{prefix}{field}"
            if ftype.kind == "message":
                yield from walk(ftype.name, path + ".")
            elif ftype.kind != "sequence" and ftype.name != "string":
                yield path

    return list(walk(name, ""))


def pack(payloads, rng=None):
    """Buffer, offsets and lengths of payloads laid behind each other, with gaps if `rng`."""
    out, offset = bytearray(), []
    for payload in payloads:
        if rng is not None:
            out += bytes(int(rng.integers(0, 40)))
        offset.append(len(out))
        out += payload
    length = np.array([len(p) for p in payloads], np.int64)
    return np.frombuffer(bytes(out), np.uint8), np.array(offset, np.int64), length


def same(ours, theirs):
    """Bit for bit, so that NaN equals NaN."""
    theirs = np.asarray(theirs, ours.dtype)
    return ours.tobytes() == theirs.tobytes()
