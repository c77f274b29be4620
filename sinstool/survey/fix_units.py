"""What the numbers of fixes tell: that they cannot be degrees and metres, or are rounded.

Drivers keep positions as single-precision floats, which are 0.4 m apart at a latitude of 40 deg, or
print few digits. That is noise of which the receiver does not know.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.earth import horizontal_metres
from sinstool.core.errors import DataError
from sinstool.core.finding import Finding
from sinstool.core.order_statistics import median
from sinstool.core.rotation import wrapped
from sinstool.core.streams import Gnss, Velocity
from sinstool.core.units import DEGREE
from sinstool.io.readers.log import Log

PROBE = 100
# Where values are rounded, differences of so many that are neighbours in size, and not further
# apart than so many of the smallest differences, are multiples of it, to such a share.
LEAST_STEPS, NEAR_STEPS, WHOLE = 20, 50.0, 0.05
# If they are, more than such a share are larger ones, or most values are there several times.
ODD_SHARE = 0.1
# Rounding worth less than this share of the variance that a receiver states goes without saying.
WORTH_SAYING = 0.25


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
        covered = float(np.sum(np.minimum(way, 10.0 * max(travelled / max(len(way), 1), 1.0))))
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


def with_rounding(fixes: Gnss, topic: str) -> tuple[Gnss, list[Finding]]:
    """Fixes whose covariances include that their numbers are rounded.

    Parameters
    ----------
    fixes : Gnss
        In whichever order.
    """
    latitude, longitude = _rounded_to(fixes.latitude), _rounded_to(fixes.longitude)
    north, east = horizontal_metres(latitude, longitude, float(median(fixes.latitude)))
    step = np.array([north, east, _rounded_to(fixes.height)])
    stated = fixes.covariance_type > 0
    if not step.any() or not stated.any():
        return fixes, []
    more = step**2 / 12.0  # errors of rounding are uniform
    variance = np.einsum("nii->ni", fixes.covariance_n)[stated]
    covariance = fixes.covariance_n.copy()
    covariance[stated] += np.diag(more)
    findings = []
    if np.any(more > WORTH_SAYING * median(variance, axis=0)):
        shown = " by ".join(f"{metres:.2g}" for metres in step)
        text = (
            f"topic {topic}: positions are rounded to {shown} m (north, east, down; 0: not), more"
            " than the receiver's covariances tell, perhaps by its driver; they are made larger"
            " accordingly"
        )
        numbers = dict(zip(("north_m", "east_m", "down_m"), step.tolist(), strict=True))
        findings.append(Finding("rounded-fixes", text, topic=topic, numbers=numbers))
    return replace(fixes, covariance_n=covariance), findings


def _rounded_to(values: FloatArray) -> float:
    """The step that all values are multiples of; 0 where there is none."""
    kept, counts = np.unique(values[np.isfinite(values)], return_counts=True)
    apart = np.diff(kept)
    if len(apart) < LEAST_STEPS:
        return 0.0
    step = float(apart.min())
    near = apart[apart < NEAR_STEPS * step] / step
    whole = len(near) >= LEAST_STEPS and np.all(np.abs(near - np.rint(near)) <= WHOLE)
    # All of an even motion are multiples, too: most of one step, and there once
    varied = np.mean(near > 1.5) > ODD_SHARE or median(counts) > 1.0
    return step if whole and varied else 0.0
