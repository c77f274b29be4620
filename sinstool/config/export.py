"""Formats of files for other programs, and the options of an export."""

from __future__ import annotations

from typing import Literal

from sinstool.core.options import Group, option

NoiseFormat = Literal[
    "sinstool", "kalibr", "vins-fusion", "openvins", "fast-lio", "robot-localization", "kf-gins"
]
"""Programs whose noise files `allan` writes."""


class ExportOptions(Group):
    """Options of an export: the data and the file format."""

    title = "Export"

    format: Literal["csv", "parquet", "tum", "kml", "gpx", "geojson"] | None = option(
        None, "format of the files, if -o is a folder (default: the suffix of -o says it)"
    )
    rate: float | None = option(
        None,
        "export at most this many rows per second (default: every row; 10 for kml, gpx and"
        " geojson)",
        "HZ",
        gt=0,
        le=1e6,
    )
    geoid_height: float | None = option(
        None,
        "height of the geoid above the ellipsoid, subtracted from heights in kml and gpx, which"
        " count from the geoid (default: gpx has ellipsoidal heights, and kml draws the track on"
        " the ground)",
        "M",
        ge=-200,
        le=200,
    )
