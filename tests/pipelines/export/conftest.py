"""Results of every mode, with the solutions that they were written from."""

import pytest

import sinstool


@pytest.fixture(scope="session")
def drive(tmp_path_factory):
    path = tmp_path_factory.mktemp("export") / "drive.mcap"
    sinstool.simulate("drive", path, duration=60.0, still=15.0, rate=50.0, grade="mems")
    return path


@pytest.fixture(scope="session")
def made(drive):
    """By name: the file of a result and what its program had in memory."""
    runs = {
        "ins-gnss": {"mode": "ins-gnss"},
        "ins": {"mode": "ins"},
        "attitude": {"mode": "attitude"},
        "frd": {"mode": "attitude", "body_axes": "frd", "world": "ned"},
        "enu of frd": {"mode": "ins-gnss", "body_axes": "frd"},
        "pose only": {"mode": "ins-gnss", "emit": ("pose", "fix")},
        "euler only": {"mode": "attitude", "emit": ("euler",)},
    }
    results = {}
    for name, options in runs.items():
        path = drive.with_name(f"{name.replace(' ', '_')}.mcap")
        results[name] = (path, sinstool.process(drive, path, **options))
    return results
