"""A page with one of everything, for the tests of the report."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sinstool.report.figure import Figure, Series
from sinstool.report.sections import (
    Column,
    Fact,
    Page,
    Prose,
    Rows,
    Setting,
    Settings,
    Table,
)

NASTY = """<script>alert("1")</script> & </script> <!-- %{x} $5 'b'"""


def figures(n: int = 5000) -> tuple[Figure, ...]:
    rng = np.random.default_rng(3)
    t = np.arange(n) / 100.0
    holed = np.cumsum(rng.normal(size=n))
    holed[n // 3 : n // 2] = np.nan
    f = np.geomspace(0.01, 200.0, n)
    noise = np.linspace(0.0, 1000.0, 1001)
    return (
        Figure(
            "walk",
            "Divergence",
            t,
            (Series("previous-3", np.sin(t)), Series("optimal-4", holed)),
            "time, s",
            "difference, arcsec",
            notes=("Windows that touch a gap are left out.",),
            levels=(("resolution", 0.5),),
            marks=(("take-off", 10.0),),
        ),
        Figure(
            "spectrum",
            "Spectrum",
            f,
            (
                Series("roll", 1e-6 / f),
                Series("white", np.full(n, 1e-8), style="dashed"),
            ),
            "frequency, Hz",
            "density, (rad/s)²/Hz",
            log_x=True,
            log_y=True,
            x_range=(0.1, 100.0),
            levels=(("floor", 1e-9), ("ceiling", 1e-3)),
            marks=(("half the rate", 100.0), ("low", 0.1)),
        ),
        Figure(
            "sweep",
            "Sweep",
            noise,
            tuple(
                Series(f"curve {k}", 1e-3 * (k + 1) + rng.random(1001), shown=k < 11)
                for k in range(13)
            ),
            "frequency of the noise, Hz",
            "error after 10 s, deg",
            log_y=True,
        ),
        Figure(
            "means",
            "Means",
            ("consistent, cheb:6", "literal, cheb:6"),
            (
                Series("a", np.array([1e-3, -2e-3]), style="bars"),
                Series("b", np.array([2e-3, np.nan]), style="bars"),
            ),
            "reading, gyro",
            "mean, deg",
            y_range=(-0.01, 0.01),
            levels=(("printed", -0.0038),),
        ),
        Figure(
            "cost",
            "Cost",
            np.array([10.0, 20.0, 80.0]),
            (
                Series("this log", np.array([1e-2, 1e-3, 1e-5]), style="points"),
                Series("other", np.array([1.0, 2.0]), x=np.array([15.0, 40.0]), style="points"),
            ),
            "cost, ns",
            "drift, deg/h",
            log_x=True,
            log_y=True,
        ),
        Figure(
            "nasty",
            f"Title {NASTY}",
            np.arange(3.0),
            (Series(f"name {NASTY}", np.arange(3.0)), Series("nothing", np.full(3, np.nan))),
            f"x {NASTY}, s",
            f"y {NASTY}, m",
            notes=(f"note {NASTY}",),
            levels=((f"level {NASTY}", 1.0),),
            marks=((f"mark {NASTY}", 1.0),),
        ),
    )


def page(drawn: Sequence[Figure] | None = None) -> Page:
    return Page(
        f"Coning on a log {NASTY}",
        f"subtitle {NASTY}",
        (
            Prose(
                ("First.", f"second {NASTY}"),
                "Verdict",
                (Fact("Drift", "1.2 deg/h", f"note {NASTY}"), Fact(f"fact {NASTY}", NASTY)),
            ),
            Table(
                f"Drift {NASTY}",
                (Column("Algorithm"), Column("Drift", "deg/h", ".3g"), Column("Samples")),
                (("previous-3", 1.2e-5, 1440000), ("none", None, 2), (NASTY, float("nan"), 3)),
                (f"table note {NASTY}",),
            ),
            *(figures() if drawn is None else drawn),
            Table("Long", (Column("k"),), tuple((k,) for k in range(30)), folded=True),
            Rows("What was done", (("log", NASTY), (f"what {NASTY}", "how" * 60))),
            Settings(
                (
                    Setting("input", NASTY),
                    Setting("coning.algorithms", ["a", "b"]),
                    Setting("coning.n", 2),
                    Setting("none", None),
                    Setting("kept", 0.5, False, f"meaning {NASTY}, s"),
                )
            ),
        ),
        ("late warning", f"warning {NASTY}", "late warning"),
    )
