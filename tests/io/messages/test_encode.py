import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sinstool.io.messages.decode import Decoder
from sinstool.io.messages.encode import Encoder, standard_definition
from sinstool.io.messages.layout import LayoutError, walk
from tests.io.messages.samples import (
    TYPES,
    deserialise,
    encoding_of,
    field_at,
    look_up,
    pack,
    random_message,
    same,
    serialise,
)


def dismantle(payload, definition):
    """Everything in a message: numbers by path, texts by path, lengths by path."""
    layout = walk(definition, payload)
    texts, numbers, lengths = {}, [], {}
    for path, leaf in layout.leaves.items():
        for match in re.finditer(r"\[(\d+)\]", path):
            array = path[: match.start()]
            lengths[array] = max(lengths.get(array, 0), int(match[1]) + 1)
        ftype = field_at(definition, path)
        if ftype.name == "string":
            texts[path] = layout.text(path, payload)
        elif leaf.count:
            numbers.append(path)
            if ftype.kind == "sequence":
                lengths[path] = leaf.count
    decoder = Decoder(definition, {path: [path] for path in numbers})
    columns = decoder.decode(*pack([payload]))
    assert columns.valid.all()
    return columns.values, texts, lengths


@pytest.mark.parametrize("flavour", ["cdr", "ros1"])
@pytest.mark.parametrize("name", TYPES)
@given(seed=st.integers(0, 2**32))
@settings(max_examples=15, deadline=None)
def test_encoding_what_was_decoded_gives_the_same_bytes(name, flavour, seed):
    rng = np.random.default_rng(seed)
    payload = serialise(random_message(name, flavour, rng), flavour)
    encoding = encoding_of(flavour)
    numbers, texts, lengths = dismantle(payload, standard_definition(name, encoding))
    columns = {path: values.reshape(1, -1) for path, values in numbers.items()}
    again = Encoder(name, encoding, texts, lengths).encode(columns, 1)
    assert again.tobytes() == payload


@pytest.mark.parametrize("flavour", ["cdr", "ros1"])
def test_rosbags_reads_what_we_write(flavour):
    rng = np.random.default_rng(0)
    encoder = Encoder("nav_msgs/msg/Odometry", flavour, {"header.frame_id": "odom"})
    n = 7
    columns = {
        "header.stamp.sec": np.arange(n),
        "header.stamp.nanosec": 5,
        "pose.pose.position.x": rng.normal(size=(n, 3)),
        "pose.pose.orientation.x": rng.normal(size=(n, 4)),
        "pose.covariance": rng.normal(size=(n, 36)),
    }
    rows = encoder.encode(columns, n)
    for k in range(n):
        message = deserialise(rows[k].tobytes(), "nav_msgs/msg/Odometry", flavour)
        assert message.header.frame_id == "odom"
        assert message.header.stamp.sec == k
        assert message.header.stamp.nanosec == 5
        position = [look_up(message, f"pose.pose.position.{axis}") for axis in "xyz"]
        assert same(columns["pose.pose.position.x"][k], position)
        turned = [look_up(message, f"pose.pose.orientation.{axis}") for axis in "xyzw"]
        assert same(columns["pose.pose.orientation.x"][k], turned)
        assert same(columns["pose.covariance"][k], message.pose.covariance)
        assert not message.twist.covariance.any()


def test_values_that_would_run_into_other_fields_are_refused():
    encoder = Encoder("sensor_msgs/msg/NavSatFix", "cdr")
    with pytest.raises(LayoutError, match="do not fit"):
        encoder.encode({"position_covariance": np.zeros((2, 10))}, 2)
    with pytest.raises(LayoutError, match="no field speed"):
        encoder.encode({"speed": np.zeros(2)}, 2)


def test_elements_of_an_array_lie_where_they_are_named():
    encoder = Encoder("nav_msgs/msg/Odometry", "cdr")
    whole = np.arange(72.0).reshape(2, 36)
    rows = {f"pose.covariance[{6 * k}]": whole[:, 6 * k : 6 * k + 6] for k in range(6)}
    expected = encoder.encode({"pose.covariance": whole}, 2)
    np.testing.assert_array_equal(encoder.encode(rows, 2), expected)
    for path in ("pose.covariance[36]", "pose.covariance[-1]", "pose.covariance[x]", "pose[0]"):
        with pytest.raises(LayoutError, match="no field"):
            encoder.encode({path: whole[:, :1]}, 2)
