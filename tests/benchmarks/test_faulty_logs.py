"""`process` over logs that are valid but bad: unit quaternions, and no stamp that was not there.

`python benchmarks/process_faulty_logs.py` does it with many more.
"""

import numpy as np
import pytest

from benchmarks import process_faulty_logs as faulty

pytestmark = pytest.mark.slow

COUNT = 12


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return faulty.base(tmp_path_factory.mktemp("drive"))


@pytest.mark.parametrize("number", range(COUNT))
def test_what_is_written_is_attitude_of_the_input(drive, tmp_path, number):
    outcome, details = faulty.one_run(drive, 5, number, tmp_path)
    assert outcome in faulty.FINE, details


def test_the_drive_itself_is_processed_in_every_mode(drive, tmp_path):
    from sinstool.config import ProcessConfig
    from sinstool.pipelines.process.run import process

    for mode in faulty.MODES:
        folder = tmp_path / mode
        folder.mkdir()
        log = faulty.write(drive, "mcap", folder, np.random.default_rng(1))
        options = {"navigation": {"mode": mode}, "output": {"emit": faulty.EMITS[mode].split(",")}}
        if mode == "ins":
            options["align"] = {"align": "level", **faulty.START}
        summary = process(log, folder / "out.mcap", ProcessConfig(**options)).to_json()
        assert faulty.check(log, folder / "out.mcap", summary) == []
        assert summary["output"]["attitudes"] > 2000


def test_a_check_that_sees(drive, tmp_path):
    """Stamps that are none of the input's are found."""
    from sinstool.config import ProcessConfig
    from sinstool.pipelines.process.run import process

    log = faulty.write(drive, "mcap", tmp_path, np.random.default_rng(1))
    summary = process(
        log, tmp_path / "out.mcap", ProcessConfig(navigation={"mode": "attitude"})
    ).to_json()
    (tmp_path / "later").mkdir()
    drive.stamp += 1
    try:
        other = faulty.write(drive, "mcap", tmp_path / "later", np.random.default_rng(1))
    finally:
        drive.stamp -= 1
    wrong = faulty.check(other, tmp_path / "out.mcap", summary)
    assert any("stamps are no IMU's" in text for text in wrong)
