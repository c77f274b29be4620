"""What rest, wheels and an axle that cannot slide are worth on recorded drives.

Fixes are withheld in outages that begin at many places, and the product's own filter and smoother
are scored against them, with everything found from what is left of the log. Printed are the largest
horizontal errors, and errors over sigma: the largest of each outage on any axis, and those of all
axes at all fixes, as root mean squares. Nothing is set by hand but the axes of the log. The logs
are not part of the project; see `--data`.

python benchmarks/land_vehicles.py --data ../shared/data --log rtk --beginnings 15
python benchmarks/land_vehicles.py --data ../shared/data --log stop-go --lengths 15 60
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.methods.ins_gnss.withheld import WithheldScore
from sinstool.pipelines.process.run import process

LOGS = {
    "rtk": "rtk_drive/rtk_drive_mems_100hz.mcap",
    "turn": "vehicle_gnss/yk_urban_short_turn_loop_nominal_002.mcap",
    "stop-go": "vehicle_gnss/yk_urban_stop_go_large_mount_001.mcap",
}
# Between outages, s, by how long they are; and before the first.
APART = {15: 30.0, 30: 60.0, 60: 90.0}
FIRST = {15: 40.0, 30: 60.0, 60: 100.0}


@dataclass(frozen=True)
class Outages:
    """Largest horizontal errors of outages, m, and errors in sigmas: the largest, and all."""

    metres: list[float]
    sigmas: list[float]
    all_sigmas: list[float]

    def add(self, score: WithheldScore) -> None:
        """Those of a run."""
        self.metres.extend(outage.largest_horizontal_m for outage in score.outages)
        self.sigmas.extend(outage.largest_in_sigmas for outage in score.outages)
        self.all_sigmas.extend(outage.rms_in_sigmas for outage in score.outages)

    def __str__(self) -> str:
        metres = np.array(self.metres)
        largest, every = (np.sqrt(np.mean(np.square(x))) for x in (self.sigmas, self.all_sigmas))
        return (
            f"{np.sqrt(np.mean(metres**2)):8.2f} {np.median(metres):8.2f} {metres.max():8.2f}"
            f" {largest:6.2f} {every:6.2f}"
        )


def duration(path: Path) -> float:
    """Of a log, s."""
    from sinstool.io.readers import open_log
    from sinstool.survey.source import prepare

    config = build(ProcessConfig, {"input": {"body_axes": "flu"}})
    with open_log(path) as log:
        return float(prepare(log, config).survey.duration_s)


def outages(
    data: Path, log: str, lengths: Sequence[int], beginnings: int, vehicles: Sequence[str]
) -> None:
    """Print what the outages of one log come to.

    Parameters
    ----------
    data : Path
        Folder with the logs.
    log : str
        One of `LOGS`, or a path in that folder.
    lengths : sequence of int
        Of outages, s.
    beginnings : int
        How many first instants share an interval between outages.
    vehicles : sequence of str
        Values of ``--vehicle``.
    """
    path = data / LOGS.get(log, log)
    end = duration(path) - 5.0
    print(f"{log}: {beginnings} beginnings; largest horizontal error of each outage")
    heads = f"{'rms m':>8s} {'median':>8s} {'largest':>8s} {'/sigma':>6s} {'all':>6s}"
    print(f"{'':12s} {'':9s} {'':5s} {heads}")
    for length in lengths:
        period = length + APART[length]
        firsts = FIRST[length] + period * np.arange(beginnings) / beginnings
        for vehicle in vehicles:
            scores = {name: Outages([], [], []) for name in ("filter", "smoother")}
            for first in firsts:
                begins = np.arange(first, end - length, period)
                if not len(begins):
                    continue
                options = {
                    "input": {"body_axes": "flu"},
                    "navigation": {"mode": "ins-gnss"},
                    "filter": {
                        "smooth": True,
                        "vehicle": vehicle,
                        "withhold_gnss": tuple(f"{b:.3f}:{b + length:.3f}" for b in begins),
                    },
                }
                with tempfile.TemporaryDirectory() as folder:
                    config = build(ProcessConfig, options)
                    result = process(path, Path(folder) / "out.mcap", config)
                assert result.filter is not None and result.filter.withheld is not None
                scores["smoother"].add(result.filter.withheld)
                assert result.filter.withheld.filter is not None
                scores["filter"].add(result.filter.withheld.filter)
            for name, score in scores.items():
                print(f"{length:4d} s {vehicle:5s} {name:9s} {len(score.metres):5d} {score}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder with the logs")
    parser.add_argument("--log", default="rtk", help=f"{', '.join(LOGS)}, or a path in the folder")
    parser.add_argument("--lengths", type=int, nargs="+", choices=APART, default=[15, 30, 60])
    parser.add_argument("--beginnings", type=int, default=15)
    parser.add_argument("--vehicle", nargs="+", default=["none", "auto"])
    args = parser.parse_args()
    outages(args.data, args.log, args.lengths, args.beginnings, args.vehicle)


if __name__ == "__main__":
    main()
