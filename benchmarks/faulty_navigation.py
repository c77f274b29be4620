"""INS/GNSS after a fault has ended, beside an optimal filter: gaps, wrong settings, bad fixes.

Drives by another program (`pyins.sim`), as in trusted_navigation.py; each fault is in a log of its
own, which goes through `sinstool process --mode ins-gnss` with nothing but the antenna's place.
The optimal filter (tests/helpers/optimal_filter.py) gets the exact noise and a log
without the fault; where the place of the antenna is wrong it gets the same wrong place.

Printed are root mean squares of the horizontal error from five seconds after the fault's end on,
or from --settle on where it lasts, over all draws, the largest error there, the error over its
sigma, and the exit status of each draw. The last column is the largest ratio to the optimal filter
of any draw; beyond 3 it is marked unless the status is 3, which says that the result is not to be
trusted.

python benchmarks/faulty_navigation.py
python benchmarks/faulty_navigation.py --grade tactical --draws 1 --only gap
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from benchmarks.common import parser, print_table
from benchmarks.trusted_navigation import Answer, optimal, process, rms
from tests.helpers.unseen_drives import (
    GRADES,
    LEVER,
    Record,
    drive,
    frozen,
    record,
    with_outliers,
    without_fixes,
    without_samples,
    write,
)

BEGIN = 300.0  # s, of faults that end
AFTER = 5.0  # s, between a fault's end and the first error that counts
BOUND = 3.0
LAST = 240.0  # s, of the drive after the longest fault
OFF = np.array([1.0, 0.0, 0.0])  # m, by which the antenna's place is wrong


@dataclass(frozen=True)
class Fault:
    """What is wrong, and for how long.

    Attributes
    ----------
    spoil : callable
        Makes the faulty record from the sound one and a seed.
    length : float or None
        s; None: it lasts.
    options : tuple of str
        That are wrong.
    late : float
        Seconds by which fixes are older than their stamps.
    lever : ndarray, shape (3,)
        The antenna's place as the optimal filter gets it, m, FRD.
    """

    name: str
    length: float | None = None
    spoil: Callable[[Record, int], Record] = field(default=lambda data, seed: data)
    options: tuple[str, ...] = ()
    late: float = 0.0
    lever: np.ndarray = field(default_factory=lambda: LEVER)


def gap(length: float) -> Fault:
    return Fault(
        f"gap of the IMU, {length:g} s",
        length,
        lambda data, seed: without_samples(data, BEGIN, length),
    )


FAULTS = (
    gap(4.0),
    gap(10.0),
    gap(60.0),
    gap(300.0),
    Fault("outage, 60 s", 60.0, lambda data, seed: without_fixes(data, [(BEGIN, BEGIN + 60.0)])),
    Fault("receiver hangs, 30 s", 30.0, lambda data, seed: frozen(data, BEGIN, 30.0)),
    Fault("1 % of fixes off by 35 m", None, with_outliers),
    Fault("fixes 0.1 s late", late=0.1),
    Fault(
        "antenna's place off by 1 m",
        options=("--lever-arm", ",".join(f"{x:g}" for x in LEVER + OFF)),
        lever=LEVER + OFF,
    ),
    Fault("taken for navigation grade", options=("--imu-grade", "navigation")),
    Fault("taken for MEMS", options=("--imu-grade", "mems")),
)


@dataclass
class Scores:
    """Of one method and one fault, a value for each draw."""

    level: list[float] = field(default_factory=list)
    most: list[float] = field(default_factory=list)
    over_sigma: list[float] = field(default_factory=list)
    status: list[int] = field(default_factory=list)

    def add(self, answer: Answer, begin: float, status: int = 0) -> None:
        """Errors from a time on, s."""
        late = answer.seconds >= begin
        error = np.hypot(answer.error[late, 0], answer.error[late, 1])
        self.level.append(rms(error))
        self.most.append(float(error.max()))
        self.over_sigma.append(rms(answer.error[late, :2] / answer.sigma[late, :2]))
        self.status.append(status)

    def cell(self) -> str:
        return f"{rms(self.level):.3g} (most {max(self.most):.3g}; {rms(self.over_sigma):.2g})"


def row(fault: Fault, grade: str, args, folder: Path) -> list[str]:  # type: ignore[no-untyped-def]
    """A fault in all draws."""
    duration = BEGIN + (fault.length or 0.0) + LAST
    begin = args.settle if fault.length is None else BEGIN + fault.length + AFTER
    best, ours, smoothed = Scores(), Scores(), Scores()
    marks, ratios = [], []
    for seed in range(args.seed, args.seed + args.draws):
        truth = drive(seed, duration)
        faulty = fault.spoil(record(truth, GRADES[grade], seed, latency=fault.late), seed)
        yardstick = replace(record(truth, GRADES[grade], seed), lever=fault.lever)
        best.add(next(iter(optimal(yardstick, grade, seed))), begin)
        log = write(folder / f"{seed}.mcap", faulty)
        for scores, more in ((ours, []), (smoothed, ["--smooth"])):
            answer, status, note = process(log, truth, [*fault.options, *more])
            if answer is None:
                return [fault.name, best.cell(), f"seed {seed}: {note}", "-", "-", "-"]
            scores.add(answer, begin, status)
        log.unlink()
        ratios.append(ours.level[-1] / best.level[-1])
        if ratios[-1] > BOUND and ours.status[-1] != 3:
            marks.append(str(seed))
    return [
        fault.name,
        best.cell(),
        ours.cell(),
        smoothed.cell(),
        " ".join(f"{a}/{b}" for a, b in zip(ours.status, smoothed.status, strict=True)),
        f"{max(ratios):.2g}" + (f" beyond {BOUND:g}: seeds {', '.join(marks)}" if marks else ""),
    ]


def main() -> None:
    options = parser(__doc__, draws=3, seed=1, settle=200.0)
    options.add_argument("--grade", nargs="+", choices=list(GRADES), default=list(GRADES))
    options.add_argument("--only", help="faults whose name holds this")
    args = options.parse_args()
    faults = [f for f in FAULTS if args.only is None or args.only in f.name]
    head = ["fault", "optimal, m (most, m; over sigma)", "filter", "smoother", "status",
            "filter to optimal"]  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        for grade in args.grade:
            rows = (row(fault, grade, args, Path(folder)) for fault in faults)
            print_table(head, rows, f"\n{grade}, {args.draws} draws")


if __name__ == "__main__":
    main()
