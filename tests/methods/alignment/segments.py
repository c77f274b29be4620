"""Segments made without the gate, for tests of what comes after it."""

import numpy as np

from sinstool.methods.alignment.accumulation import accumulate
from sinstool.methods.alignment.solution import Segment


def segment_of(imu, gnss, start_s, end_s=np.inf, sigma=0.1):
    rows = accumulate(
        imu.time_ns, imu.delta_theta, imu.delta_velocity, gnss.time_ns, int(imu.time_ns[0])
    )
    gnss = gnss.rows(slice(len(gnss.time_ns) - len(rows), None))
    mask = (rows.time_s >= start_s) & (rows.time_s <= end_s)
    gnss = gnss.rows(mask)
    count = int(mask.sum())
    return Segment(
        rows.rows(mask),
        gnss.latitude,
        gnss.longitude,
        gnss.height,
        gnss.velocity_n,
        np.full(count, sigma),
        np.full(count, sigma),
        np.zeros(count, dtype=np.int64),
    )
