"""The page of every command in a browser: complete, drawn, and readable at any width."""

from __future__ import annotations

import re

import click
import pytest

from sinstool.cli.main import cli
from tests.helpers.hse_rigs import SHORT, edited, sinstool
from tests.report.browser import DARK, WIDTHS, needs_browser, opened

TRUTH = ("--truth", "/truth/imu,/truth/fix")


def simulated(folder, scenario, *options):
    log = folder / "log.mcap"
    status, _, err = sinstool("simulate", scenario, "-o", log, *options)
    assert status == 0, err
    return log


def driven(folder):
    return simulated(folder, "drive", "--duration", 150, "--rate", 50, "--grade", "mems")


def climbed(folder):
    return simulated(folder, "spiral-climb", "--duration", 60, "--rate", 50, "--grade", "tactical")


def attitude(folder):
    log = driven(folder)
    return ("process", log, "-o", folder / "out.mcap", "--mode", "attitude", *TRUTH[:1],
            "/truth/imu", "--salvage")  # fmt: skip


def ins(folder):
    return ("process", climbed(folder), "-o", folder / "out.mcap", "--mode", "ins", *TRUTH,
            "--height-damping", "baro")  # fmt: skip


def ins_gnss(folder):
    return ("process", driven(folder), "-o", folder / "out.mcap", "--mode", "ins-gnss", *TRUTH,
            "--withhold-gnss", "100:110")  # fmt: skip


def rig(folder, name, heading):
    log, table = folder / f"{name}.mcap", folder / f"{name}.toml"
    status, _, err = sinstool(
        "simulate", "hse-rig", "-o", log, "--rig-out", table, "--rates", "60,-60,100", "--plateau",
        "50", "--rate", "40", "--encoder-rate", "20", "--arw", "1e-4", "--heading", heading,
        "--no-truth",
    )  # fmt: skip
    assert status == 0, err
    return log, table


def calibrate(folder):
    (north, table), (south, _) = rig(folder, "north", 40), rig(folder, "south", 220)
    return ("calibrate-hse", north, south, "--config", table, "-o", folder / "hse.json", *SHORT,
            "--azimuth", "north=40,south=220")  # fmt: skip


def corrected(folder):
    sinstool(*calibrate(folder))
    (folder / "again").mkdir()
    log, table = rig(folder / "again", "later", 130)
    rules = edited(table, "rules", calibration={"min_turns": 4, "min_duration": 15.0})
    return ("process", log, "-o", folder / "out.mcap", "--config", rules, "--hse",
            folder / "hse.json", "--force")  # fmt: skip


def coned(folder):
    log = simulated(folder, "coning", "--duration", 12, "--rate", 100, "--grade", "tactical",
                    "--lead-in", "2")  # fmt: skip
    return ("compare-coning", log, "--window", 2, "--passband", 15)


def published(_):
    return ("compare-coning", "--paper", "--algorithms", "optimal-4,singular-perturbation")


def aligned(folder):
    return ("align", driven(folder), "--truth", "/truth/imu")


def aligned_at_rest(folder):
    log = simulated(folder, "static", "--duration", 60, "--rate", 50, "--grade", "navigation")
    return ("align", log, "--method", "gyrocompass")


def looked_at(folder):
    return ("info", driven(folder))


def at_rest(folder):
    return ("allan", simulated(folder, "static", "--duration", 60, "--grade", "mems"))


def simulated_drive(folder):
    return ("simulate", "drive", "-o", folder / "drive.mcap", "--duration", 90, "--rate", 50,
            "--grade", "mems", "--gnss-outage", "70:80")  # fmt: skip


def simulated_coning(folder):
    return ("simulate", "coning", "-o", folder / "cone.mcap", "--duration", 5, "--rate", 200)


def simulated_rig(folder):
    return ("simulate", "hse-rig", "-o", folder / "rig.mcap", "--plateau", 20, "--rate", 50,
            "--encoder-rate", 50)  # fmt: skip


COMMANDS = (
    attitude, ins, ins_gnss, corrected, calibrate, coned, published, aligned, aligned_at_rest,
    at_rest, looked_at, simulated_drive, simulated_coning, simulated_rig,
)  # fmt: skip
MAIN_FIGURES = (ins_gnss, calibrate, coned, aligned, looked_at, simulated_drive)


def written(folder, command, name):
    report = folder / name
    status, _, err = sinstool(*command(folder), "--report", report)
    assert status in (0, 3), err
    return report


def test_none_is_forgotten():
    context = click.Context(cli)
    having = {
        name
        for name in cli.list_commands(context)
        if any("--report" in one.opts for one in _options(cli.get_command(context, name)))
    }
    assert having == {
        "process", "info", "compare-coning", "align", "allan", "calibrate-hse", "simulate"
    }  # fmt: skip
    scenarios = cli.get_command(context, "simulate").commands
    assert all(any("--report" in o.opts for o in one.params) for one in scenarios.values())


def _options(command):
    for one in getattr(command, "commands", {}).values():
        yield from one.params
    yield from command.params


@pytest.mark.slow
@needs_browser
@pytest.mark.parametrize("command", COMMANDS, ids=lambda one: one.__name__)
def test_page_in_a_browser(tmp_path, command):
    page = written(tmp_path, command, "report.html")
    text = page.read_text(encoding="utf-8")
    size = page.stat().st_size
    print(f"{command.__name__}: {size / 1e6:.2f} MB")
    assert size < 1.5e6
    assert_complete(text)
    keys = re.findall(r'<div class="drawing" role="img" data-key="([^"]+)"', text)
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", text)
    assert len(keys) == len(captions) > 0
    complaints = [
        f"{key} has no caption" for key, one in zip(keys, captions, strict=True) if not one
    ]
    # The dark colours are the same on every page: three of all kinds of figures show them
    dark = command in (ins_gnss, coned, calibrate)
    for theme, flags in (("#ffffff", ()), ("#14171b", (DARK,)))[: 1 + dark]:
        state, console = opened(page, *flags)
        complaints += console
        for width in WIDTHS:
            complaints += [
                f"{theme}, {width} px: {one}" for one in faults(state[str(width)], theme, keys)
            ]
    assert complaints == []


def faults(seen, theme, keys):
    """What is wrong with a page at one width."""
    yield from seen["heard"]
    yield from (f"asked for {one}" for one in seen["loaded"])
    yield from (f"{one} sticks out" for one in seen["wide"])
    if seen["scroll"] > seen["inner"]:
        yield f"scrolls sideways, {seen['scroll']} px"
    if [plot["key"] for plot in seen["plots"]] != keys:
        yield f"figures are {[plot['key'] for plot in seen['plots']]}"
    for plot in seen["plots"]:
        for fault, holds in (
            ("not drawn", plot["svg"] < 1 or plot["curves"] < 1),
            (f"{plot['width']} px in {plot['room']}", abs(plot["width"] - plot["room"]) >= 1.0),
            ("narrow", plot["room"] < 250),
            ("its legend lies over it", not plot["apart"]),
            (f"is {plot['page']}", plot["page"] != theme),
            (f"labels are cut: {plot['cut']}", plot["cut"]),
            (f"labels lie over each other: {plot['crowded']}", plot["crowded"]),
        ):
            if holds:
                yield f"{plot['key']}: {fault}"
    printed = {(plot["page"], plot["width"]) for plot in seen["printed"]}
    if printed != {("#ffffff", 660)} or not seen["unfolded"]:
        yield f"printed as {printed}, settings unfolded: {seen['unfolded']}"
    if seen["after"] != seen["plots"]:
        yield "is another after it was printed"


def assert_complete(text):
    """An answer, what was done with which settings, what it was made from and by what."""
    titles = re.findall(r"<h2[^>]*>([^<]*)</h2>", text)
    titles = [one for one in titles if one != "Contents" and "arning" not in one]
    assert titles[0] == "Result" and titles[-2] == "Settings"
    assert titles[-1] in ("Input", "Output")
    assert '<dl class="facts">' in text or "claims reproduce" in text
    assert "at the default</summary>" in text
    assert re.search(r"<th[^>]*>made by</th><td>sinstool \d", text)
    if "--paper" not in text:
        assert re.search(r"\d+ bytes, SHA-256 [0-9a-f]{64}", text)
    # Every figure's axis has a unit but where it counts or names
    for label in re.findall(r'<p class="ylabel">([^<]*)</p>', text):
        assert ", " in label or label in (
            "size over expected size",
            "fraction of the coning rate",
        ), label


@pytest.mark.slow
@pytest.mark.parametrize("command", MAIN_FIGURES, ids=lambda one: one.__name__)
def test_main_figure_for_a_paper(tmp_path, command):
    figure = written(tmp_path, command, "figure.pdf")
    assert figure.read_bytes().startswith(b"%PDF")


def test_all_warnings_are_on_the_page(tmp_path):
    log = climbed(tmp_path)
    status, _, err = sinstool(
        "process", log, "-o", tmp_path / "o.mcap", "--mode", "ins", "--report", tmp_path / "r.html"
    )
    assert status == 3, err  # its heading is unknown
    said = [line.removeprefix("warning: ") for line in err.splitlines() if "warning: " in line]
    shown = re.findall(r"<li>([^<]*)</li>", (tmp_path / "r.html").read_text(encoding="utf-8"))
    assert said and set(said) <= set(shown)
