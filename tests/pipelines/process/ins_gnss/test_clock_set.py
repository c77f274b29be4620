"""A computer that sets its clock while it records: the solution goes on as if it had not."""

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from sinstool.config import ProcessConfig
from sinstool.core.finding import exit_status
from sinstool.pipelines.process.run import process
from tests.helpers.filter_logs import Capture, run
from tests.helpers.stepped_clocks import TOGETHER, nanoseconds, write_stepped
from tests.helpers.unseen_drives import GRADES, T0, drive, record

AT = 90.35


@pytest.fixture(scope="module")
def road():
    return record(drive(5, 160.0, 20.0), GRADES["industrial"], 5, sigma=0.5)


def worst(truth, solution, ahead_s):
    """Largest horizontal error in sigmas, of each sample by the clock as it was last."""
    seconds = (solution.time_ns - T0) * 1e-9 - ahead_s
    error = truth.errors_of(seconds, *solution.position.T, solution.velocity_n, np.eye(3)[None])
    variance = np.einsum("nii->ni", solution.covariance_position_n)[:, :2]
    return float(np.abs(error[:, :2] / np.sqrt(variance)).max())


# What of a clock that steps forward alone is moved is what lies behind: it was right before
@pytest.mark.slow
@pytest.mark.parametrize(
    ("size", "who", "ahead_s"),
    [(-2.0, TOGETHER, -2.0), (0.3, ("imu", "recorder"), 0.0), (-0.3, ("gnss",), 0.0)],
)
def test_a_step_changes_nothing(tmp_path, road, size, who, ahead_s):
    """With the steps in it the errors were up to 60 sigmas, at status 0."""
    write_stepped(tmp_path / "log.mcap", road, [(AT, size)], who)
    summary, solution = run(tmp_path / "log.mcap", input={"gyro_kind": "mean-rate"})
    steps = [f["numbers"]["step_s"] for f in summary["findings"] if f["kind"] == "clock-step"]
    assert steps and np.allclose(steps, size, atol=1e-3)
    assert all(f["severity"] in ("note", "warning") for f in summary["findings"])
    assert len(solution) > 0.99 * len(road.seconds) and (np.diff(solution.time_ns) > 0).all()
    assert worst(road.truth, solution, ahead_s) < 4.5


@pytest.mark.slow
def test_solutions_are_written_beside_the_messages_of_their_samples(tmp_path, road):
    """By log times of the file, and with stamps that go on evenly."""
    write_stepped(tmp_path / "log.mcap", road, [(AT, -2.0)])
    config = ProcessConfig(input={"gyro_kind": "mean-rate"})
    out = tmp_path / "out.mcap"
    result = process(tmp_path / "log.mcap", out, config, None, Capture())
    assert exit_status(result.findings) == 0
    logged = {"/imu": [], "/sinstool/imu": []}
    with out.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(topics=list(logged)):
            stamp = int.from_bytes(message.data[4:8], "little") * 10**9
            stamp += int.from_bytes(message.data[8:12], "little")
            logged[channel.topic].append((message.log_time, stamp))
    copied, made = (np.array(sorted(rows)) for rows in logged.values())
    first = len(copied) - len(made)
    assert 0 <= first < 1000 and len(copied) == len(road.seconds)
    assert set(made[:, 0]) <= set(copied[:, 0])
    # copied as they were recorded, the clock set back
    assert set(copied[:, 1]) == set(nanoseconds(road.seconds - 2.0 * (road.seconds >= AT)))
    np.testing.assert_array_equal(np.sort(made[:, 1]), nanoseconds(road.seconds - 2.0)[first:])


@pytest.mark.slow
def test_times_of_recording_that_no_signed_number_holds_are_passed_on(tmp_path, road):
    """As of a recorder whose clock is damaged: MCAP has 64 bits without a sign."""
    write_stepped(tmp_path / "log.mcap", road, [])
    late = tmp_path / "late.mcap"
    shift = 2**63 - T0 - 60 * 10**9
    with (tmp_path / "log.mcap").open("rb") as old, late.open("wb") as new:
        writer, numbers = Writer(new, chunk_size=65536), {}
        writer.start("ros2")
        for schema, channel, message in make_reader(old).iter_messages():
            if channel.id not in numbers:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                numbers[channel.id] = writer.register_channel(channel.topic, "cdr", number)
            writer.add_message(numbers[channel.id], message.log_time + shift, message.data, 0)
        writer.finish()
    out = tmp_path / "out.mcap"
    process(late, out, ProcessConfig(input={"gyro_kind": "mean-rate"}), None, Capture())
    times = {"/imu": [], "/sinstool/imu": [], "/sinstool/diagnostics": []}
    with out.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(topics=list(times)):
            times[channel.topic].append(message.log_time)
    assert len(times["/imu"]) == len(road.seconds)
    begin, end = min(times["/imu"]), max(times["/imu"])
    assert begin < 2**63 < end
    for topic in ("/sinstool/imu", "/sinstool/diagnostics"):
        assert times[topic] and begin <= min(times[topic]) and max(times[topic]) <= end + 10**9
