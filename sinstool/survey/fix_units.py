"""Refusals of fixes whose numbers cannot be degrees and metres."""

from __future__ import annotations

import numpy as np

from sinstool.core.earth import horizontal_metres
from sinstool.core.errors import DataError
from sinstool.core.order_statistics import median
from sinstool.core.rotation import wrapped
from sinstool.core.streams import Gnss, Velocity
from sinstool.core.units import DEGREE
from sinstool.io.readers.log import Log

PROBE = 100


def check_degrees(log: Log, topic: str, fixes: Gnss, velocity: Velocity | None) -> None:
    """Refuse latitude and longitude that are radians.

    Small numbers alone are no proof: there are places near 0 N, 0 E. Where velocity is known,
    the distance covered decides.
    """
    latitude, longitude = fixes.latitude / DEGREE, fixes.longitude / DEGREE
    if np.abs(latitude).max() > np.pi / 2 or np.abs(longitude).max() > np.pi:
        return
    if velocity is not None and len(velocity) > 1:
        seconds = np.diff(velocity.time_ns) * 1e-9
        speed = np.linalg.norm(velocity.velocity_n[:, :2], axis=1)
        travelled = float(np.sum(0.5 * (speed[1:] + speed[:-1]) * np.minimum(seconds, 5.0)))
        north, east = horizontal_metres(
            np.diff(fixes.latitude), wrapped(np.diff(fixes.longitude)), fixes.latitude[1:]
        )
        # the leap of one bad fix is no way that was covered
        way = np.hypot(north, east)
        covered = float(np.sum(np.minimum(way, 10.0 * max(travelled / len(way), 1.0))))
        if travelled > 20.0 and covered > 0.25 * travelled:
            return
    raise DataError(
        log.path,
        f"topic {topic}: latitudes are about {median(latitude):.4g} and longitudes"
        f" {median(longitude):.4g}, as in radians",
        "add --gnss-unit rad (or --gnss-unit deg if the log is right)",
    )


def check_range(log: Log, topic: str, fixes: Gnss) -> None:
    """Refuse angles that are on no globe, and heights that no vehicle has."""
    latitude = float(median(np.abs(fixes.latitude[:PROBE])) / DEGREE)
    longitude = float(median(np.abs(fixes.longitude[:PROBE])) / DEGREE)
    if latitude > 90.0 or longitude > 360.0:
        raise DataError(
            log.path,
            f"topic {topic}: its latitudes are about {latitude:.6g} and longitudes"
            f" {longitude:.6g}, which cannot be degrees",
            "sensor_msgs/NavSatFix holds degrees (some drivers write 1e-7 degrees): convert it,"
            " or name another topic with --gnss-topic",
        )
    heights = fixes.height[np.isfinite(fixes.height)][:PROBE]
    if len(heights) and not -500.0 <= float(median(heights)) <= 60000.0:
        raise DataError(
            log.path,
            f"topic {topic}: its altitudes are about {median(heights):.6g} m",
            "sensor_msgs/NavSatFix holds metres (some drivers write millimetres): convert it, or"
            " name another topic with --gnss-topic",
        )
