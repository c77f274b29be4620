"""Tracks for maps: KML with its times, GPX 1.1 and GeoJSON (RFC 7946)."""

from __future__ import annotations

import json
from typing import BinaryIO
from xml.sax.saxutils import escape

import numpy as np

from sinstool.core.units import DEGREE
from sinstool.core.version import VERSION
from sinstool.io.readers.results import ResultBlock
from sinstool.io.writers.export.rows import Value, text_rows
from sinstool.io.writers.export.target import Described, Writer

# 0.1 mm on the ground, and 1 mm up
PLACE, HEIGHT = 9, 3


class MapWriter(Writer):
    """Base of the map formats: collects positions with times."""

    needs_position = True

    def __init__(self, stream: BinaryIO, about: Described) -> None:
        super().__init__(stream, about)
        self._blocks: list[tuple[np.ndarray, np.ndarray]] = []

    def push(self, block: ResultBlock) -> None:
        """Keep places and times: formats have them apart, or need the last before the first."""
        assert block.solution.position is not None
        finite = np.isfinite(block.solution.position).all(axis=1)
        place = block.solution.position[finite] / np.array([DEGREE, DEGREE, 1.0])
        # Due west of the date line and east of it is one place, and GPX knows only one of the two.
        place[:, 1] = (place[:, 1] + 180.0) % 360.0 - 180.0
        self._blocks.append((block.solution.time_ns[finite], place))

    def track(self) -> tuple[np.ndarray, np.ndarray]:
        """Times (n,), and latitude, longitude in deg and ellipsoidal height in m (n, 3)."""
        times, places = zip(*self._blocks, strict=True)
        return np.concatenate(times), np.concatenate(places)

    def write(self, text: str) -> None:
        """Write text."""
        self.stream.write(text.encode())

    def write_rows(self, *parts: str | Value) -> None:
        """Write the same for each point."""
        for text in text_rows(parts):
            self.stream.write(text)

    def above_sea(self, height: np.ndarray) -> np.ndarray:
        """Heights above the geoid where its own height is known, else above the ellipsoid."""
        return height - (self.about.geoid_height or 0.0)


def iso_times(time_ns: np.ndarray) -> np.ndarray:
    """Times as ISO 8601 in UTC, to the microsecond; bytes."""
    text = np.datetime_as_string(time_ns.astype("datetime64[ns]"), unit="us")
    return np.char.add(text.astype("S26"), b"Z")


class KmlWriter(MapWriter):
    """KML 2.2 with a gx:Track: a line that Google Earth can play."""

    def finish(self) -> None:
        """Write the track."""
        time_ns, place = self.track()
        mode = "clampToGround" if self.about.geoid_height is None else "absolute"
        self.write(
            '<?xml version="1.0" encoding="UTF-8"?>\n'
            '<kml xmlns="http://www.opengis.net/kml/2.2"'
            ' xmlns:gx="http://www.google.com/kml/ext/2.2">\n'
            f"<Document>\n<name>{escape(self.about.name)}</name>\n"
            '<Style id="track"><LineStyle><color>ff2b6bff</color><width>3</width></LineStyle>'
            f"</Style>\n<Placemark>\n<name>{escape(self.about.name)}</name>\n"
            f"<description>sinstool {VERSION}</description>\n<styleUrl>#track</styleUrl>\n"
            f"<gx:Track>\n<altitudeMode>{mode}</altitudeMode>\n"
        )
        self.write_rows("<when>", Value(iso_times(time_ns)), "</when>\n")
        self.write_rows(
            "<gx:coord>",
            Value(place[:, 1], PLACE),
            " ",
            Value(place[:, 0], PLACE),
            " ",
            Value(self.above_sea(place[:, 2]), HEIGHT),
            "</gx:coord>\n",
        )
        self.write("</gx:Track>\n</Placemark>\n</Document>\n</kml>\n")


class GpxWriter(MapWriter):
    """GPX 1.1 with one track of one segment."""

    def finish(self) -> None:
        """Write the track."""
        time_ns, place = self.track()
        geoid = self.about.geoid_height
        self.write(
            '<?xml version="1.0" encoding="UTF-8"?>\n'
            f'<gpx version="1.1" creator="sinstool {VERSION}"'
            ' xmlns="http://www.topografix.com/GPX/1/1">\n'
            f"<trk>\n<name>{escape(self.about.name)}</name>\n<trkseg>\n"
        )
        self.write_rows(
            '<trkpt lat="',
            Value(place[:, 0], PLACE),
            '" lon="',
            Value(place[:, 1], PLACE),
            '"><ele>',
            Value(self.above_sea(place[:, 2]), HEIGHT),
            "</ele><time>",
            Value(iso_times(time_ns)),
            "</time>",
            "" if geoid is None else f"<geoidheight>{geoid}</geoidheight>",
            "</trkpt>\n",
        )
        self.write("</trkseg>\n</trk>\n</gpx>\n")


class GeoJsonWriter(MapWriter):
    """A GeoJSON feature: a line in longitude, latitude and ellipsoidal height, with its times.

    It is cut where it crosses the date line, as the format demands.
    """

    def finish(self) -> None:
        """Write the track."""
        time_ns, place = self.track()
        times = iso_times(time_ns)
        cuts = np.flatnonzero(np.abs(np.diff(place[:, 1])) > 180.0) + 1
        # A line has two points at least; where a cut leaves one alone, it stands there twice.
        pieces = [
            p if len(p) > 1 else np.repeat(p, 2) for p in np.split(np.arange(len(times)), cuts)
        ]
        whole = len(pieces) == 1
        properties = {
            "name": self.about.name,
            "creator": f"sinstool {VERSION}",
            "startTime": times[0].decode(),
            "endTime": times[-1].decode(),
        }
        head = json.dumps(properties, indent=1)[:-2]
        self.write(
            '{"type": "FeatureCollection", "features": [{"type": "Feature",\n'
            f'"properties": {head},\n "coordTimes": '
        )
        self._pieces(whole, [['"', Value(times[rows]), '"'] for rows in pieces])
        kind = "LineString" if whole else "MultiLineString"
        self.write(f'}},\n"geometry": {{"type": "{kind}", "coordinates": ')
        self._pieces(
            whole,
            [
                [
                    "[",
                    Value(place[rows, 1], PLACE),
                    ",",
                    Value(place[rows, 0], PLACE),
                    ",",
                    Value(place[rows, 2], HEIGHT),
                    "]",
                ]
                for rows in pieces
            ],
        )
        self.write("}}]}\n")

    def _pieces(self, whole: bool, pieces: list[list[str | Value]]) -> None:
        """The geometry of the parts: nested lists where there are several."""
        self.write("" if whole else "[")
        for number, parts in enumerate(pieces):
            text = b"".join(bytes(rows) for rows in text_rows([*parts, ",\n"]))
            self.stream.write((b"[" if number == 0 else b",\n[") + text[:-2] + b"]")
        self.write("" if whole else "]")
