"""The table of many logs: order, sums, links, and its size beside two hundred pages."""

from pathlib import Path, PurePath

import pytest

from sinstool.report.library import share_script
from sinstool.report.page import write_report
from sinstool.report.pages.campaign import Entry, index_page, throughput, write_index
from sinstool.report.sections import Link, Prose
from tests.report.pages import figures, page


def finding(kind, severity="warning", text="something is odd", answer="--mend it"):
    return {"kind": kind, "severity": severity, "text": text, "answer": answer}


def entry(name, status="done", duration=60.0, distance=None, page=None, **more):
    row = {"status": status, "exit": 0, "output": {"path": f"/out/{name}.mcap"}, **more}
    if status not in ("failed", "missing"):
        speed = None if distance is None else distance / duration
        row["travel"] = {
            "duration_s": duration,
            "distance_m": distance,
            "mean_speed_m_s": speed,
            "largest_speed_m_s": speed,
        }
    return Entry(PurePath(f"{name}.mcap"), Path(f"/in/{name}.mcap"), row, page)


def tables(made):
    return {one.title: one for one in made.sections if not isinstance(one, Prose)}


@pytest.fixture
def entries(tmp_path):
    (tmp_path / "b.html").write_text("")
    return [
        entry("a", distance=900.0, findings=[finding("tilt"), finding("tilt"),
                                             finding("hint", "note")]),
        entry("b", page=tmp_path / "b.html", findings=[finding("tilt", text="another")]),
        entry("c", "complete", kinds=["tilt", "gap"]),
        entry("d", "failed", error="it is cut short"),
    ]  # fmt: skip


def test_the_worst_first_with_sums_and_links(entries, tmp_path):
    made = index_page(tmp_path, entries, 10.0)
    shown = tables(made)
    assert list(shown) == ["What failed, and why", "Findings by kind", "Logs"]
    assert shown["What failed, and why"].rows == (("d.mcap", "it is cut short"),)
    logs = shown["Logs"]
    assert [row[0] for row in logs.rows] == [
        "d.mcap", "a.mcap", Link("b.mcap", "b.html"), "c.mcap",
    ]  # fmt: skip
    assert [row[-1] for row in logs.rows] == [None, "tilt", "tilt", "tilt, gap"]
    facts = {one.name: one.value for one in made.sections[0].facts}
    assert facts == {
        "Logs": "4",
        "Duration": "180 s",
        "Distance": "900 m",
        "Logs with findings": "3",
    }


def test_findings_are_counted_by_log(entries, tmp_path):
    by_kind = tables(index_page(tmp_path, entries, 10.0))["Findings by kind"]
    assert by_kind.rows == (
        ("tilt", 3, "a.mcap", "something is odd: --mend it"),
        ("gap", 1, "c.mcap", ""),
    )


def test_columns_without_a_value_are_left_out(tmp_path):
    logs = tables(index_page(tmp_path, [entry("a"), entry("b")], 1.0))["Logs"]
    assert [column.name for column in logs.columns] == ["Log", "status", "duration", "findings"]


def test_throughput(entries):
    assert throughput(entries, 10.0) == (
        "This run took 10 s for 4 logs, of which 2 were computed: 0.2 logs/s, 120 s of data at 12"
        " times the speed at which it was recorded."
    )
    assert throughput(entries[2:3], 0.5).endswith("none of them had to be computed.")
    assert throughput([entry("a", status="failed")], 0.5) == "This run took 0.5 s for 1 log."


def test_two_hundred_pages_stay_below_sixty_megabytes(tmp_path):
    script = share_script(tmp_path)
    drawn = tuple(
        figure
        for k in range(4)
        for figure in (one.__class__(**{**vars(one), "key": f"{one.key}-{k}"}) for one in figures())
    )
    write_report(tmp_path / "one.html", page(drawn), script=script)
    many = [entry(f"log-{k:03}", page=tmp_path / "one.html") for k in range(200)]
    write_index(tmp_path, many, 100.0)
    one, index = (tmp_path / "one.html").stat().st_size, (tmp_path / "index.html").stat().st_size
    shared = script.stat().st_size
    total = 200 * one + index + shared
    print(
        f"a page of {len(drawn)} figures {one / 1e3:.0f} kB, script {shared / 1e6:.2f} MB, index of"
        f" 200 {index / 1e3:.0f} kB, all {total / 1e6:.1f} MB"
    )
    assert index < 200e3
    assert total < 60e6
