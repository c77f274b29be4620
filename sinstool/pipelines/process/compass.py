"""The magnetometer of a smoothed attitude: its field, its north, its findings."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.finding import Finding, Severity
from sinstool.core.rotation import wrapped
from sinstool.core.streams import Solution
from sinstool.core.units import DEGREE
from sinstool.methods.attitude_smoother.correction import Correction
from sinstool.methods.attitude_smoother.earth_field import EarthField, model_field
from sinstool.methods.attitude_smoother.epochs import Epochs
from sinstool.methods.attitude_smoother.field import FieldStage
from sinstool.methods.attitude_smoother.heading_update import FIELD_GATE_SIGMAS
from sinstool.methods.attitude_smoother.magnetometer import (
    LEAST_SIGMA,
    Compass,
    North,
    find_north,
    heading_off,
)
from sinstool.pipelines.process.summary import MagnetometerUsed
from sinstool.survey.magnetometer import MagneticTopic, read_magnetometer
from sinstool.survey.source import Source

# Share of the time with a disturbed field from which a finding is given.
DISTURBED = 0.1
# A given declination that differs by more from that of the model is doubted: local anomalies of
# some degrees are rare.
DECLINATION_OFF = 5.0 * DEGREE
REFUSALS = {
    "short": "it has less than ten seconds of data",
    "size": "its field of {size:.3g} uT is not the Earth's (20 to 70 uT)",
    "disturbed": "strength and dip of its field agree in only {trusted:.0f} % of the time: it is"
    " disturbed, or its axes are not the IMU's",
    "scatter": "its headings scatter by {scatter:.0f} deg about those of the gyros: it may be"
    " disturbed, or its axes are not the IMU's",
    "steep": "its field dips by {dip:.0f} deg: too little of it is horizontal to show north",
    "reversed": "its field points {way} by {dip:.0f} deg, but at this place it should point"
    " {other}: its axes are turned round, or the latitude has the wrong sign",
}


class MagneticHeading:
    """Heading by the magnetometer of a log.

    Parameters
    ----------
    max_gap_ns : int
        Longest interval between solutions that is no gap.

    Attributes
    ----------
    compass : Compass
        What it shows, once it was asked for `north`.
    """

    def __init__(
        self, source: Source, config: ProcessConfig, topic: MagneticTopic, max_gap_ns: int
    ) -> None:
        self._topic = topic.topic
        self._expected = _expected(source)
        self._declination, self._declination_source = None, ""
        if config.navigation.declination is not None:
            self._declination = config.navigation.declination * DEGREE
            self._declination_source = "given"
        elif self._expected is not None:
            self._declination = self._expected.declination
            self._declination_source = "model"
        by_log_time = source.survey.time_source == "log"
        measured, self._odd = read_magnetometer(
            source.log, topic, config.input.body_axes, by_log_time
        )
        self._read = measured is not None
        self._stage = None if measured is None else FieldStage(measured, max_gap_ns)
        self.compass = Compass("short")
        self._off = 0.0

    def push(self, solution: Solution) -> None:
        """Take the next solutions of the integration."""
        if self._stage is not None:
            self._stage.push(solution)

    def north(self, epochs: Epochs, correction: Correction) -> North | None:
        """Headings, from an attitude that was smoothed without them; None where there are none."""
        if self._stage is not None:
            measured = self._stage.means(epochs)
            azimuth = self._declination or 0.0
            attitude = correction.q[:-1]
            self.compass = find_north(epochs, measured, attitude, azimuth, self._expected)
        self._stage = None
        return self.compass.north

    def compare(self, epochs: Epochs, correction: Correction) -> None:
        """Compare the headings with an attitude that was smoothed with them."""
        if self.compass.north is not None:
            attitude = correction.at(epochs.time_ns).q[:-1]
            self._off = heading_off(self.compass.north, attitude)

    @property
    def north_referenced(self) -> bool | None:
        """Heading counts from true north; None where the magnetometer is refused."""
        if self.compass.north is None:
            return None
        return self.compass.verified and self._declination is not None

    def summary(self, correction: Correction) -> MagnetometerUsed:
        """How the magnetometer was used, and the sigma of the smoothed heading."""
        compass, iron = self.compass, self.compass.hard_iron
        used = compass.north is not None
        sigma = np.sqrt(np.median(correction.covariance_n[:, 2, 2])) / DEGREE
        true_or_magnetic = "magnetic" if self._declination is None else "true"
        return MagnetometerUsed(
            topic=self._topic,
            refused=compass.refused,
            north=true_or_magnetic if compass.verified else "none",
            declination_deg=None if self._declination is None else self._declination / DEGREE,
            declination_source=self._declination_source,
            field_T=compass.size,
            dip_deg=compass.dip / DEGREE,
            trusted=compass.trusted,
            scatter_deg=compass.scatter / DEGREE,
            hard_iron_T=None if iron is None else tuple(iron.offset.tolist()),
            hard_iron_removed=iron is not None and iron.applied,
            hard_iron_sigma_T=None if iron is None else iron.sigma,
            heading_sigma_deg=float(sigma) if used else None,
        )

    def findings(self) -> Iterator[Finding]:
        """Findings about the magnetometer."""
        yield from self._odd
        compass, iron, topic = self.compass, self.compass.hard_iron, self._topic
        if not self._read:
            return
        if compass.north is None or iron is None:
            why = REFUSALS[compass.refused].format(
                size=1e6 * compass.size,
                trusted=100.0 * compass.trusted,
                scatter=compass.scatter / DEGREE,
                dip=abs(compass.dip) / DEGREE,
                way="down" if compass.dip > 0.0 else "up",
                other="up" if compass.dip > 0.0 else "down",
            )
            yield Finding(
                "magnetometer-refused",
                f"the magnetometer {topic} is not used, as {why}; heading counts from the start",
                topic=topic,
                answer="choose another with --magnetometer, or none",
            )
            return
        limit = FIELD_GATE_SIGMAS * max(compass.scatter, LEAST_SIGMA)
        if self._off > limit:
            yield Finding(
                "field-denied",
                f"topic {topic}: most of the time the gyros turn differently from the field, by"
                f" {self._off / DEGREE:.0f} deg in the median, so one or the other is wrong: do not"
                " trust the attitude",
                severity=Severity.LOST,
                topic=topic,
                answer="record some seconds at rest, also at the end, or give --gyro-bias X,Y,Z; or"
                " see what --magnetometer none gives",
                numbers={"off_deg": self._off / DEGREE},
            )
        if iron.applied:
            size = float(np.linalg.norm(iron.offset))
            yield Finding(
                "hard-iron",
                f"topic {topic}: a field of {1e6 * size:.1f} uT turns with the body (hard iron); it"
                f" is subtracted, which leaves {1e6 * iron.sigma:.1g} uT (1 sigma)",
                severity=Severity.NOTE,
                topic=topic,
                answer="calibrate the magnetometer",
                numbers={"hard_iron_T": size, "sigma_T": iron.sigma},
            )
        if not iron.seen:
            yield Finding(
                "heading-unverified",
                f"topic {topic}: the body turned too little to show whether iron in it adds to the"
                " field, so the reference to north is not verified",
                topic=topic,
                answer="turn the body through all directions in a log, or calibrate it",
                numbers={"sigma_T": iron.sigma},
            )
        if not compass.of_place and self._expected is not None:
            yield Finding(
                "unlike-the-place",
                f"topic {topic}: the field is {1e6 * compass.size:.1f} uT and dips by"
                f" {compass.dip / DEGREE:.1f} deg, but at this place it should be"
                f" {1e6 * self._expected.size:.1f} uT and {self._expected.dip / DEGREE:.1f} deg:"
                " there is iron nearby, or the tilt is wrong; the reference to north is not"
                " verified",
                topic=topic,
                answer="check latitude and longitude, and calibrate the sensors",
                numbers={"size_T": compass.size, "dip_deg": compass.dip / DEGREE},
            )
        disturbed = 1.0 - compass.trusted
        if disturbed > DISTURBED:
            yield Finding(
                "disturbed-field",
                f"topic {topic}: during {100.0 * disturbed:.0f} % of the time the field is not the"
                " Earth's, and the gyros alone carry heading",
                topic=topic,
                numbers={"share": disturbed},
            )
        yield from _about_declination(self._declination, self._expected)


def _about_declination(declination: float | None, expected: EarthField | None) -> Iterator[Finding]:
    """Whether north is magnetic, or true by a declination, rad, that the place has not."""
    if declination is None:
        yield Finding(
            "magnetic-north",
            "heading counts from magnetic north, as the declination is not known",
            severity=Severity.NOTE,
            answer="give --declination, or --latitude and --longitude where stamps are dates",
        )
    elif (
        expected is not None and abs(wrapped(declination - expected.declination)) > DECLINATION_OFF
    ):
        given, right = declination / DEGREE, expected.declination / DEGREE
        yield Finding(
            "declination",
            f"the declination is given as {given:.1f} deg, but at this place and time it is"
            f" {right:.1f} deg (positive to the east)",
            answer="correct --declination, or leave it out",
            numbers={"given_deg": given, "model_deg": right},
        )


def _expected(source: Source) -> EarthField | None:
    """The Earth's field where and when the log was made, if that is known."""
    latitude, longitude, height = source.position
    if latitude is None or longitude is None:
        return None
    time_ns = source.survey.first_ns
    return model_field(latitude * DEGREE, longitude * DEGREE, height or 0.0, time_ns)
