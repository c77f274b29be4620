"""Tables of the page of a run: each number stands in the column that names it."""

from types import SimpleNamespace

from sinstool.methods.ins_gnss.withheld import Outage
from sinstool.pipelines.process.filter_used import WithheldScores
from sinstool.pipelines.process.hse_used import TurntableStretch
from sinstool.report.pages import process as process_report

T0 = 1_700_000_000_000_000_000
OUTAGE = Outage(
    start_ns=T0 + 12_340_000_000,
    duration_s=10.0,
    epochs=51,
    largest_horizontal_m=3.5,
    largest_vertical_m=2.5,
    largest_in_sigmas=1.5,
    rms_in_sigmas=0.8,
)
STRETCH = TurntableStretch(
    start_ns=T0 + 500_000_000,
    duration_s=48.0,
    turns=8,
    rate_deg_s=-60.0,
    C23_rad=1e-5,
    heading_raw_deg=40.01,
    correction_arcsec=36.0,
    sigma_correction_arcsec=2.0,
    heading_deg=40.0,
    sigma_heading_arcsec=3.0,
    outside_rate=False,
    outside_C23=False,
)
RESULT = SimpleNamespace(
    imu=SimpleNamespace(first_ns=T0),
    filter=SimpleNamespace(withheld=WithheldScores((OUTAGE,), 3.5)),
    hse=SimpleNamespace(segments=(STRETCH,)),
)


def named_cells(table):
    names = [f"{one.name}, {one.unit}" if one.unit else one.name for one in table.columns]
    return [list(zip(names, row, strict=True)) for row in table.rows]


def test_withheld_fixes():
    table = process_report._withheld(RESULT)
    assert named_cells(table) == [
        [
            ("Outage", "from 12.3 s"),
            ("for, s", 10.0),
            ("fixes", 51),
            ("largest horizontal, m", 3.5),
            ("largest vertical, m", 2.5),
            ("largest on an axis, sigma", 1.5),
            ("rms of all axes, sigma", 0.8),
        ]
    ]
    assert process_report._withheld(SimpleNamespace(filter=None)) is None


def test_stretches_at_constant_rate():
    table = process_report._stretches(RESULT)
    assert named_cells(table) == [
        [
            ("Stretch", "from 0.5 s"),
            ("rate, deg/s", -60.0),
            ("turns", 8.0),
            ("heading as aligned, deg", 40.01),
            ("its error, arcsec", 36.0),
            ("sigma, arcsec", 2.0),
            ("heading, deg", 40.0),
            ("sigma, arcsec", 3.0),
        ]
    ]
    assert process_report._stretches(SimpleNamespace(hse=None)) is None
