"""Noise of long rests: time and memory of `sinstool allan` on logs, and of it beside allantools.

The logs are written first, of white noise, flicker noise and a random walk: two hours at 200 Hz and
a day at 100 Hz. `allan` runs as a program, from the log to the JSON; the first run of all may
compile. Then both work on the same samples in memory, at the same averaging times: the overlapping
Allan deviation of six axes, and how far they are apart.

python benchmarks/allan_speed.py
python benchmarks/allan_speed.py --hours 2 --rates 200
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from benchmarks.commands import PROGRAM, folder_for_logs, run_child

BESIDE = "--beside"


def samples(seconds: float, rate: float):
    """Rates and specific forces at rest, shape (n, 6)."""
    import numpy as np

    from tests.helpers.allan import simulate_terms

    random, count = np.random.default_rng(1), round(seconds * rate)
    terms = [(0.0, s, 0.03 * s, 2e-4 * s, 0.0) for s in (2e-3, 2e-3, 2e-3, 2e-2, 2e-2, 2e-2)]
    rows = np.column_stack([simulate_terms(count, *one, random) for one in terms])
    rows[:, 5] -= 9.8
    return rows


def write(path: Path, seconds: float, rate: float) -> None:
    """A log of them."""
    import numpy as np

    from sinstool.core.streams import Imu
    from sinstool.simulation.log import write_simulated
    from sinstool.simulation.recorded import recorded_topics

    rows = samples(seconds, rate)
    time_ns = 1_700_000_000 * 10**9 + np.round(np.arange(len(rows)) * 1e9 / rate).astype(np.int64)
    imu = Imu(time_ns, time_ns, rows[:, :3], rows[:, 3:])
    write_simulated(path, recorded_topics(imu), {"scenario": "rest"})


def beside(seconds: float, rate: float) -> None:
    """Print both CPU times and the largest relative difference, as JSON."""
    import time

    import allantools
    import numpy as np

    from tests.helpers.allan import variances

    rows = samples(seconds, rate)
    variances([rows[:5000]])
    begun = time.process_time()
    ours = variances([rows], hadamard=False)
    mine, begun = time.process_time() - begun, time.process_time()
    taus = ours.lags / rate
    apart = 0.0
    for column in range(6):
        _, theirs, _, _ = allantools.oadev(rows[:, column], rate=rate, data_type="freq", taus=taus)
        apart = max(apart, float(np.max(np.abs(np.sqrt(ours.allan[:, column]) / theirs - 1.0))))
    theirs_s = time.process_time() - begun
    print(json.dumps({"ours": mine, "theirs": theirs_s, "apart": apart, "lags": len(taus)}))


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, nargs="+", default=[2.0, 24.0])
    parser.add_argument("--rates", type=float, nargs="+", default=[200.0, 100.0], help="Hz")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--keep", type=Path, help="folder for the logs")
    parser.add_argument(BESIDE, type=float, nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.beside:
        beside(*args.beside)
        return
    print(f"{'sinstool allan LOG --json':28s}{'wall s':>8s}{'CPU s':>8s}{'MB':>8s}")
    with folder_for_logs(args.keep) as folder:
        for hours, rate in zip(args.hours, args.rates, strict=True):
            log = folder / f"{hours:g}h.mcap"
            if not log.exists():
                run_child([sys.executable, "-c", _WRITE, str(log), str(3600.0 * hours), str(rate)])
            runs = [run_child([*PROGRAM, "allan", str(log), "--json"]) for _ in range(args.repeat)]
            _, wall, cpu, peak = min(runs, key=lambda run: run[2])
            print(
                f"{f'{hours:g} h at {rate:g} Hz':28s}{wall:8.2f}{cpu:8.2f}{peak:8.0f}", flush=True
            )
    print(f"\n{'deviations in memory':28s}{'ours s':>8s}{'theirs':>8s}{'ratio':>8s}  apart")
    hours, rate = min(zip(args.hours, args.rates, strict=True))
    command = [sys.executable, "-m", "benchmarks.allan_speed", BESIDE]
    text, *_ = run_child([*command, str(3600.0 * hours), str(rate)])
    found = json.loads(text)
    name = f"{hours:g} h at {rate:g} Hz, {found['lags']} times"
    ratio = found["theirs"] / found["ours"]
    print(f"{name:28s}{found['ours']:8.2f}{found['theirs']:8.2f}{ratio:8.0f}  {found['apart']:.1e}")


_WRITE = (
    "import sys; from pathlib import Path; from benchmarks.allan_speed import write;"
    " write(Path(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3]))"
)


if __name__ == "__main__":
    main()
