"""What `process --salvage` writes of a damaged log is itself whole."""

from collections import Counter

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader

from sinstool.config import ProcessConfig
from sinstool.pipelines.process.run import process
from tests.helpers.imulogs import even_times, handheld, imu_messages, serialised
from tests.helpers.logs import Row, mcap_records, patched, write_mcap

pytestmark = pytest.mark.slow

COUNT = 600
CHUNK = 0x06


def imu_rows():
    times = even_times(COUNT)
    gyro, accel, _ = handheld(COUNT)
    return [
        Row("/imu", m.log_ns, m.log_ns, serialised(m.message, m.type_name, 2))
        for m in imu_messages(times, gyro, accel, log_ns=times + 900_000)
    ]


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
@pytest.mark.parametrize("where", ["crc", "data", "cut"])
def test_salvaged_output_is_whole(tmp_path, compression, where):
    path = write_mcap(tmp_path / "a.mcap", imu_rows(), compression=compression)
    data = path.read_bytes()
    at = [pos for op, pos, _ in mcap_records(data) if op == CHUNK][3]
    if where == "cut":
        path.write_bytes(data[: at + 5000])
    else:
        patched(path, at + 9 + (24 if where == "crc" else 1500), b"\x13\x57\x9b")
    out = tmp_path / "out.mcap"
    config = ProcessConfig(navigation={"mode": "attitude"}, input={"salvage": True})
    summary = process(path, out, config).to_json()
    assert summary["lost"]["parts"]
    with out.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        counts = Counter(c.topic for _, c, _ in reader.iter_messages())
        assert sum(counts.values()) == reader.get_summary().statistics.message_count
    with out.open("rb") as stream:
        streamed = sum(
            type(r).__name__ == "Message" for r in StreamReader(stream, validate_crcs=True).records
        )
    assert streamed == sum(counts.values())
    assert counts["/imu"] == summary["lost"]["messages_read"]
    if where != "cut":
        assert summary["lost"]["messages_declared"] == COUNT
    if where == "crc":
        assert counts["/imu"] == COUNT
    with out.open("rb") as stream:
        times = [m.log_time for _, c, m in make_reader(stream).iter_messages(["/imu"])]
    assert set(times) <= set((even_times(COUNT) + 900_000).tolist())
    assert len(np.unique(times)) == len(times)
