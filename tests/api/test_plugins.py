"""Coning algorithms and readers that another distribution brings along."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import sinstool
from sinstool.core import plugins
from sinstool.io.readers import open as readers
from sinstool.methods.coning import registry
from sinstool.pipelines.provenance import read_record
from tests.docs.examples import blocks
from tests.helpers.paths import ROOT

CONING = ROOT / "sample_data" / "coning.mcap"
# The code of the documentation
AVERAGED, _, COMMAS = (
    text for language, text, _, _ in blocks(ROOT / "docs" / "plug-ins.md") if language == "python"
)
BROKEN = """
class Half(Averaged):
    def _fill(self, x, dt, first, out):
        out[::2] = x[first : first + len(out)][::2]  # nothing of every second one


class Failing(Averaged):
    def _fill(self, x, dt, first, out):
        raise KeyError("half")


def broken():
    raise ValueError("no licence")
"""
ENTRIES = """
[sinstool.coning]
averaged = fake_sinstool_plugin:Averaged
absent = fake_sinstool_plugin:NotThere
broken = fake_sinstool_plugin:broken
odd = builtins:dict
half = fake_sinstool_plugin:Half
failing = fake_sinstool_plugin:Failing
previous-1 = fake_sinstool_plugin:broken

[sinstool.readers]
commas = fake_sinstool_plugin:CommaLog
"""


@pytest.fixture
def distribution(tmp_path, monkeypatch):
    """A distribution as pip would have installed it."""
    site = tmp_path / "site"
    info = site / "fake_sinstool_plugin-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "fake_sinstool_plugin.py").write_text(AVERAGED + COMMAS + BROKEN)
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: fake-sinstool-plugin\nVersion: 1\n"
    )
    (info / "entry_points.txt").write_text(ENTRIES)
    monkeypatch.syspath_prepend(str(site))
    plugins.plugins.cache_clear()
    yield site
    plugins.plugins.cache_clear()
    sys.modules.pop("fake_sinstool_plugin", None)


@pytest.fixture
def registered():
    """Forgets what a test registers."""
    before = dict(registry._registered)
    yield
    registry._registered.clear()
    registry._registered.update(before)


def attitudes(name):
    options = {"mode": "attitude", "attitude": "inertial", "gyro_kind": "mean-rate"}
    return sinstool.process(CONING, coning=name, **options)


def test_an_installed_algorithm_is_found_by_its_name(distribution):
    assert "averaged" in sinstool.coning.names() and "averaged" not in registry.names()
    result, same = attitudes("averaged"), attitudes("previous-1")
    assert result.plan.coning.value == "averaged"
    assert result.solution.q_nb == pytest.approx(same.solution.q_nb, abs=1e-15)
    compared = sinstool.compare_coning(CONING, algorithms=["averaged", "previous-1"], decimate=[1])
    drifts = {one.name: one.drift_dph.slope_rms for one in compared.algs}
    assert drifts["averaged"] == pytest.approx(drifts["previous-1"], rel=1e-6)


def test_the_command_line_finds_it_too(distribution, tmp_path, monkeypatch):
    out = tmp_path / "out.mcap"
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}:{distribution}")
    command = [sys.executable, "-m", "sinstool", "process", str(CONING), "-o", str(out)]
    done = subprocess.run(
        [*command, "--coning", "averaged", "--mode", "attitude", "--attitude", "inertial"],
        capture_output=True, text=True, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "averaged" in done.stdout
    assert read_record(out)["coning_from"] == "fake-sinstool-plugin 1"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("absent", "the plug-in absent of fake-sinstool-plugin cannot be loaded: AttributeError"),
        ("broken", "coning algorithm broken cannot be built: ValueError: no licence"),
        ("odd", "coning algorithm odd is a dict: it must be a subclass of"),
        ("averagd", "did you mean averaged"),
    ],
)
def test_a_plug_in_that_does_not_work_is_named(distribution, name, said):
    with pytest.raises(sinstool.SinstoolError, match=said):
        sinstool.coning.algorithm(name)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("half", "coning algorithm averaged fails: it gives rotations that are no finite numbers"),
        ("failing", "coning algorithm averaged fails: KeyError: 'half'"),
    ],
)
def test_an_algorithm_that_gives_nothing_gives_no_attitude(distribution, tmp_path, name, said):
    """What it left out was whatever the memory held, or NaN: status 0, in every message."""
    options = {"mode": "attitude", "attitude": "inertial", "coning": name}
    with pytest.raises(sinstool.SinstoolError, match=said):
        sinstool.process(CONING, tmp_path / "out.mcap", **options)
    assert not (tmp_path / "out.mcap").exists()


def test_a_reader_that_fails_is_named(distribution, tmp_path):
    """It ended in the traceback of a fault of sinstool."""
    path = tmp_path / "log.csv"
    path.write_text("t,gx,gy,gz\n0,hello")
    with pytest.raises(sinstool.SinstoolError) as caught:
        sinstool.survey(path)
    for part in (str(path), "CommaLog of fake_sinstool_plugin", "ValueError", "hello"):
        assert part in str(caught.value)


def test_sinstools_own_algorithms_cannot_be_replaced(distribution, registered):
    assert sinstool.coning.algorithm("previous-1").name == "previous-1"
    for name in ("previous-3", "previous-7", "savage-4"):
        with pytest.raises(sinstool.SinstoolError, match="one of sinstool's own"):
            sinstool.coning.register(name, dict)
    with pytest.raises(sinstool.SinstoolError, match="cannot name a coning algorithm"):
        sinstool.coning.register("My Algorithm", dict)


def test_a_program_registers_its_own(registered, tmp_path):
    class Half(sinstool.coning.ConingAlgorithm):
        """Half of every increment."""

        name, summary, source = "half", "half of it", "a test"

        def _fill(self, x, dt, first, out):
            out[:] = 0.5 * x[first : first + len(out)]

    sinstool.coning.register("half", Half)
    imu = sinstool.Imu.of(np.arange(11) * 10**8, np.tile([0, 0, 1.0], (11, 1)), np.zeros((11, 3)))
    turned = sinstool.integrate(imu, coning="half", gyro_kind="mean-rate").to_pandas().heading_deg
    assert turned.iloc[-1] == pytest.approx(np.degrees(0.5))
    options = {"mode": "attitude", "attitude": "inertial", "coning": "half"}
    sinstool.process(CONING, tmp_path / "out.mcap", **options)
    record = read_record(tmp_path / "out.mcap")
    assert record["coning_from"] == "registered by the program"
    with pytest.raises(sinstool.SinstoolError, match="half has no option beta"):
        sinstool.coning.algorithm("half", beta=1)


def test_an_installed_reader_opens_its_format(distribution, tmp_path):
    cone = sinstool.simulate("coning", duration=2.0).imu()
    path = tmp_path / "log.csv"
    write_csv(path, cone)
    with sinstool.open_log(path, body_axes="frd") as log:
        imu = log.imu()
        assert log.format == "csv" and np.array_equal(imu.gyro, cone.gyro)
    out = tmp_path / "out.mcap"
    options = {"mode": "attitude", "attitude": "inertial", "body_axes": "frd"}
    result = sinstool.process(path, out, **options)
    assert len(result.solution) == len(cone)
    with sinstool.open_log(out, body_axes="frd") as log:
        assert np.array_equal(log.imu("/imu").gyro, cone.gyro)  # its messages are copied
    with pytest.raises(sinstool.SinstoolError, match="not a log"):
        sinstool.open_log(ROOT / "README.md")


def write_csv(path, imu):
    table = np.column_stack([imu.time_ns / 1e9, imu.gyro, imu.accel])
    np.savetxt(path, table, delimiter=",", header="t,gx,gy,gz,ax,ay,az", comments="", fmt="%.17g")


def test_the_documentation_names_the_entry_points():
    text = (ROOT / "docs" / "plug-ins.md").read_text()
    for group in (registry.GROUP, readers.GROUP):
        assert f'[project.entry-points."{group}"]' in text
