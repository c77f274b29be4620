"""Where `--mode ins` begins, and how fast: by fixes of a vehicle in motion."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.trusted_navigation import read_back
from sinstool.cli.main import cli
from sinstool.core.streams import GnssEpochs, Solution
from sinstool.pipelines.process.ins_start import errors_at_fixes
from tests.helpers.unseen_drives import GRADES, LEVER, drive, record, without_fixes, write

OPTIONS = (
    "--mode ins --gyro-kind mean-rate --json -q --emit odometry,fix"
    f" --lever-arm={','.join(map(str, LEVER))}"
).split()


def first_errors(folder, seed, sigma_v, latency=0.0, later=0.0):
    """Largest errors of the first position, m, and velocity, m/s, of a drive without rest."""
    truth = drive(seed, 120.0, 0.0)
    data = record(truth, GRADES["industrial"], seed, sigma=0.1, sigma_v=sigma_v, latency=latency)
    data = without_fixes(data, [(0.0, later)])
    log, out = write(folder / "log.mcap", data), folder / "out.mcap"
    options = [*OPTIONS, "--gnss-latency", str(latency)]
    done = CliRunner().invoke(cli, ["process", str(log), "-o", str(out), *options])
    assert done.exit_code == 0, done.output
    error = read_back(out, truth).error[0]
    return np.abs(error[:3]).max(), np.abs(error[3:6]).max()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "latency", "later"), [(1, 0.0, 0.0), (2, 0.0, 0.0), (2, 0.2, 0.0), (1, 0.0, 8.5)]
)
def test_a_moving_start_has_the_velocity_of_that_instant(tmp_path, seed, latency, later):
    """That of the first fix, a second later, was 1.5 m/s off while a car speeded up.

    Where the first came later, 0 was assumed.
    """
    place, speed = first_errors(tmp_path, seed, 0.05, latency, later)
    assert place < 0.4 + 0.1 * later and speed < 0.15 + 0.02 * later


def test_positions_alone_show_a_velocity_and_a_heading(tmp_path):
    """They were not used: 0 m/s in an unknown direction, and 32 km off after 200 s."""
    place, speed = first_errors(tmp_path, 1, None)
    assert place < 0.6 and speed < 0.5


def test_a_given_velocity_stays(tmp_path):
    truth = drive(1, 120.0, 0.0)
    log = write(tmp_path / "log.mcap", record(truth, GRADES["industrial"], 1, sigma_v=0.05))
    out = tmp_path / "out.mcap"
    given = ["--initial-velocity", "3,4,0"]
    done = CliRunner().invoke(cli, ["process", str(log), "-o", str(out), *OPTIONS, *given])
    assert done.exit_code == 0, done.output
    first = read_back(out, truth)
    np.testing.assert_allclose(truth.velocity_n[0] - first.error[0, 3:6], [3, 4, 0], atol=0.02)


def test_a_vehicle_stays_where_it_rests_with_an_attitude_of_motion(tmp_path):
    """By its accelerometers alone, it was 36 m away when it moved off after a minute."""
    truth = drive(3, 120.0, 60.0)
    data = record(truth, GRADES["industrial"], 3, sigma=0.1, sigma_v=0.05)
    log, out = write(tmp_path / "log.mcap", data), tmp_path / "out.mcap"
    done = CliRunner().invoke(cli, ["process", str(log), "-o", str(out), *OPTIONS])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["alignment"]["method"] == "svd"
    answer = read_back(out, truth)
    error = np.abs(answer.error[np.searchsorted(answer.seconds, 60.0)])
    assert error[:3].max() < 0.5 and error[3:6].max() < 0.1


def test_a_fast_climb_is_no_error_of_height():
    """More than 3 m from one update to the next was taken for a turn of the height."""
    seconds, up = 0.1 * np.arange(21), 80.0
    time_ns, zeros = np.rint(1e9 * seconds).astype(np.int64), np.zeros((21, 3))
    place = np.stack([np.full(21, 0.8), np.full(21, -0.3), 100.0 + up * seconds], axis=1)
    velocity, level = np.tile([0.0, 0.0, -up], (21, 1)), np.tile([1.0, 0.0, 0.0, 0.0], (21, 1))
    run = Solution(time_ns, time_ns, level, zeros, zeros, position=place, velocity_n=velocity)
    rows = slice(5, None, 5)
    fixes = GnssEpochs(
        time_ns[rows], time_ns[rows], *place[rows].T, velocity[rows], zeros[rows], zeros[rows]
    )
    place_off, velocity_off = errors_at_fixes(fixes, seconds[rows], run, np.zeros(3))
    np.testing.assert_allclose(place_off, 0.0, atol=1e-6)
    np.testing.assert_allclose(velocity_off, 0.0, atol=1e-6)
