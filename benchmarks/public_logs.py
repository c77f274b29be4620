"""Recorded logs that anybody can have: sinstool beside other programs, in one run.

Attitude without GNSS on trials with an optical reference, a drone, cars and multicopters, beside
VQF, its offline variant and imufusion; the same trials with their magnetometers, as they are and
with iron beside the sensor; and a drive whose RTK fixes are withheld in outages of 15 and 60 s.
Where the logs come from is in docs/benchmarks.md.

python benchmarks/public_logs.py --data ../shared/data
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks import attitude_logs, land_vehicles
from benchmarks.common import parser


def main() -> None:
    """Print the tables."""
    p = parser(__doc__, beginnings=5)
    p.add_argument("--data", type=Path, required=True, help="folder with the logs")
    args = p.parse_args()
    attitude_logs.broad(args.data, 0.0)
    for iron in (np.zeros(3), 1e-6 * np.array(attitude_logs.IRON)):
        attitude_logs.with_magnetometer(args.data, 0.0, iron)
    attitude_logs.vehicles(args.data)
    print()
    if (args.data / land_vehicles.LOGS["rtk"]).exists():
        land_vehicles.outages(args.data, "rtk", (15, 60), args.beginnings, ("none", "auto"))


if __name__ == "__main__":
    main()
