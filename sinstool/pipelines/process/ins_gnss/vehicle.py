"""Motion constraints of a vehicle and latency of its fixes, by a first pass over the log."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.choices import log_choice
from sinstool.core.finding import Finding
from sinstool.core.rotation import from_dcm, from_euler, to_dcm, to_euler
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.io.readers.topics import NONE
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss.constraints import (
    MOUNT_SIGMA,
    STEP_NS,
    Constraints,
    VehicleEstimate,
)
from sinstool.methods.ins_gnss.filter import FilterSummary, InsGnssFilter
from sinstool.methods.ins_gnss.settings import USUAL_S
from sinstool.methods.ins_gnss.smoother import Smoother
from sinstool.methods.ins_gnss.states import ATTITUDE, VELOCITY
from sinstool.methods.land_vehicle.rest import Rests, find_rests, noise_at_rest
from sinstool.methods.land_vehicle.shaking import beyond, find_shaking
from sinstool.methods.land_vehicle.track import Means, MeansStage, Track
from sinstool.methods.land_vehicle.trust import Trust, find_trust
from sinstool.methods.land_vehicle.wander import AS_STATED, Wander, find_wander
from sinstool.methods.strapdown.joined_updates import JOINED_S, joined_blocks
from sinstool.methods.strapdown.navigation import Q_W, Q_Z, V_DOWN, V_NORTH
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart, measurements
from sinstool.pipelines.process.ins_gnss.wheels import LONGEST_S, WheelsUsed, use_wheels
from sinstool.pipelines.process.ins_gnss.whole_log_latency import (
    WholeLogLatency,
    latency_of_whole_log,
)
from sinstool.pipelines.process.vehicle_used import LandVehicleUsed, VehicleUsed, WheelSpeedUsed
from sinstool.survey.increments import SegmentIncrements
from sinstool.survey.source import Source

# Rests of less than this in total, s, are ignored.
LEAST_REST_S = 1.0
# A rest at the start of a filter shows within so many steps.
FIRST_STEPS = 30
# Limits beyond which a finding tells the user: share of the constraints that did not hold; sigma of
# the mount's yaw, deg; distance of the axle, m.
MOST_SLID = 0.05
VAGUE_YAW = 1.5
LONG_VEHICLE = 8.0
# Of wheels: error of scale; latency, s, and its number of sigmas; share of readings that slip.
MOST_SCALE, LATE_S, LATE_SIGMAS, MOST_SLIPS = 0.01, 0.05, 3.0, 0.01


@dataclass(frozen=True)
class VehicleAssumptions:
    """Assumptions about a vehicle, and the reasons for them.

    Attributes
    ----------
    constraints : Constraints or None
        None without any; with `--vehicle none` at most the noise of an IMU that is shaken.
    rests : Rests or None
        None if they were not looked for.
    trust : Trust or None
        Whether its axle slides, and the mount of the IMU; None if not looked for.
    reason : str
        Why it is, or is not, taken for a land vehicle.
    forced : bool
        Whether the user gave `--vehicle land`.
    mounted : bool
        Whether the user gave the mounting of the IMU.
    denied : tuple of Finding
        About a mounting in the log's transforms that the motion contradicts.
    wheels_named : bool
        Whether the user gave the topic of its wheels.
    wheels : WheelsUsed or None
        Wheels whose speed is used.
    wander : Wander
        Slowly varying error of the fixes while the vehicle stands.
    lasting_given : bool
        Whether the user gave how much of their noise lasts.
    """

    constraints: Constraints | None = None
    rests: Rests | None = None
    trust: Trust | None = None
    reason: str = "as --vehicle is none"
    forced: bool = False
    mounted: bool = False
    denied: tuple[Finding, ...] = ()
    wheels_named: bool = False
    wheels: WheelsUsed | None = None
    wander: Wander = AS_STATED
    lasting_given: bool = False

    def used(self, summary: FilterSummary) -> VehicleUsed:
        """Constraints as a filter used and estimated them."""
        rest_reason = "" if self.rests is None else self.rests.reason
        vehicle, estimate = None, summary.land_vehicle
        if self.constraints is not None and self.constraints.vehicle and estimate is not None:
            held = self.constraints.vehicle
            mount = to_euler(from_dcm(estimate.c_vb)) / DEGREE
            vehicle = LandVehicleUsed(
                mount_deg=tuple(mount.tolist()),
                mount_sigma_deg=tuple((estimate.mount_sigma / DEGREE).tolist()),
                axle_m=estimate.axle[0],
                axle_sigma_m=estimate.axle[1],
                sideslip_rad_s2_m=estimate.sideslip[0],
                squat_rad_s2_m=estimate.squat[0],
                lateral_m_s=held.lateral,
                vertical_m_s=held.vertical,
                used=summary.held,
                slid=summary.slides,
                wheels=self._wheels(summary, estimate),
            )
        kind = "none" if vehicle is None else "land"
        return VehicleUsed(kind, self.reason, self.rest_s, rest_reason, vehicle)

    def _wheels(self, summary: FilterSummary, estimate: VehicleEstimate) -> WheelSpeedUsed | None:
        wheels = self.wheels
        if wheels is None:
            return None
        scale, sigma = estimate.wheel_scale
        return WheelSpeedUsed(
            topic=wheels.topic,
            unit=wheels.unit,
            metres_per_unit=wheels.fit.scale * (1.0 + scale),
            scale_sigma=sigma,
            latency_s=wheels.fit.latency_s,
            latency_sigma_s=wheels.fit.latency_sigma,
            sigma_m_s=wheels.sigma,
            used=summary.wheels,
            slipped=summary.wheel_slips,
            one_slips=wheels.slipping,
        )

    def findings(self, used: VehicleUsed) -> list[Finding]:
        """Findings about the vehicle."""
        land, trust = used.land, self.trust
        findings = []
        if self.lasting_given and not self.wander.ordinary:
            text = f"compared with --gnss-lasting, {self.wander}; they are weighted accordingly"
            findings.append(Finding("fixes-wander", text, answer="leave --gnss-lasting out"))
        if self.wheels_named and (land is None or land.wheels is None):
            text = "the wheels of --wheels are not used, "
            text += "as the vehicle may slide" if land is None else "as they do not fit the motion"
            findings.append(Finding("wheels-unused", text))
        return [*findings, *self._findings(land, trust)]

    def _findings(self, land: LandVehicleUsed | None, trust: Trust | None) -> list[Finding]:
        if self.denied:
            return [*self.denied, *replace(self, denied=())._findings(land, trust)]
        if self.mounted and trust is not None and not trust.holds and not self.forced:
            text = f"with this --mount no constraint is used, as {trust.reason}"
            answer = "check --mount, or leave it out"
            return [Finding("mount", text, answer=answer)]
        if land is None and self.forced:
            text = (
                f"--vehicle is land, but no constraint is used, as {trust.reason if trust else ''}"
            )
            return [
                Finding("vehicle-unknown", text, answer="give the mounting of the IMU with --mount")
            ]
        if land is None:
            return []
        findings = []
        if trust is not None and not trust.holds:
            text = f"--vehicle land keeps the vehicle from sliding, but {trust.reason}"
            findings.append(Finding("vehicle-slides", text, answer="leave --vehicle land out"))
        if land.slid > MOST_SLID * max(land.used, 1):
            text = (
                f"the axle slid in {land.slid / land.used:.0%} of the time in"
                " which the constraint was used"
            )
            answer = "if heading or height look wrong, give --vehicle none"
            findings.append(Finding("vehicle-slides", text, answer=answer))
        if self.wheels is not None and not np.isfinite(self.wheels.speed).any():
            text = (
                f"the wheels of {self.wheels.topic} are not used, as their readings are more than"
                f" {LONGEST_S} s apart"
            )
            findings.append(Finding("wheels-unused", text, topic=self.wheels.topic))
        elif land.wheels is not None:
            findings += _of_wheels(land.wheels)
        if land.mount_sigma_deg[1] > VAGUE_YAW:
            text = (
                "the yaw of the IMU in the vehicle is known to"
                f" {land.mount_sigma_deg[1]:.1f} deg only, as the vehicle hardly turned or"
                " accelerated"
            )
            findings.append(Finding("mount-yaw", text, answer="give it with --mount"))
        if abs(land.axle_m) > LONG_VEHICLE:
            where = "behind" if land.axle_m > 0.0 else "ahead of"
            text = f"the axle that does not slide would be {abs(land.axle_m):.1f} m {where} the IMU"
            answer = "if the vehicle is not that long, give --vehicle none"
            findings.append(Finding("axle", text, answer=answer))
        return findings

    @property
    def mount(self) -> np.ndarray | None:
        """``C_vb`` of the first pass; None without constraints of a land vehicle."""
        held = self.constraints
        return None if held is None or held.vehicle is None else held.vehicle.c_vb

    @property
    def rests_at_first(self) -> bool:
        """Whether the vehicle stands as the filter starts."""
        return self.constraints is not None and bool(self.constraints.rests[:FIRST_STEPS].any())

    @property
    def rest_s(self) -> float:
        """Time at rest, s."""
        return 0.0 if self.rests is None else np.count_nonzero(self.rests.at) * STEP_NS / SECOND


@dataclass(frozen=True)
class FirstPass:
    """Results of a first pass over a log, for the filter that then runs over it.

    Attributes
    ----------
    latency : WholeLogLatency or None
        Of the fixes; None if the first part of the log shows it well enough.
    """

    vehicle: VehicleAssumptions
    latency: WholeLogLatency | None = None

    def started(self, start: FilterStart) -> FilterStart:
        """A filter's start with this latency, and with the slow errors that fixes have at rest."""
        if self.latency is not None:
            start = self.latency.used_by(start)
        wander = self.vehicle.wander
        if self.vehicle.constraints is None or wander.ordinary:
            return start
        # A rest denies that they last longer than usual
        start = start.lasting(USUAL_S)
        return start.with_slow_position(wander.level, wander.vertical, str(wander))


def _of_wheels(wheels: WheelSpeedUsed) -> list[Finding]:
    """Findings about the wheels."""
    findings = []
    if wheels.unit == "m/s" and abs(wheels.metres_per_unit - 1.0) > MOST_SCALE:
        high = 100.0 * (1.0 / wheels.metres_per_unit - 1.0)
        text = (
            f"the speed of {wheels.topic} reads {abs(high):.1f} % too"
            f" {'high' if high > 0.0 else 'low'} compared with the fixes; this is corrected"
        )
        numbers = {"scale_percent": high}
        findings.append(Finding("wheel-scale", text, topic=wheels.topic, numbers=numbers))
    if abs(wheels.latency_s) > max(LATE_S, LATE_SIGMAS * wheels.latency_sigma_s):
        late = 1e3 * wheels.latency_s
        text = (
            f"{wheels.topic} is stamped {abs(late):.0f} ms {'after' if late > 0.0 else 'before'}"
            " the motion that it shows; this is corrected"
        )
        numbers = {"latency_s": wheels.latency_s}
        findings.append(Finding("wheel-latency", text, topic=wheels.topic, numbers=numbers))
    slips = wheels.slipped / max(wheels.used, 1)
    if slips > MOST_SLIPS or wheels.one_slips > MOST_SLIPS:
        text = (
            f"wheels slip: {100.0 * max(slips, wheels.one_slips):.0f} % of the readings of"
            f" {wheels.topic} are left out"
        )
        answer = "if the speed looks wrong, give --wheels none"
        findings.append(Finding("wheels-slip", text, topic=wheels.topic, answer=answer))
    return findings


def first_pass(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    start: FilterStart,
    longest_gap_s: float,
) -> FirstPass:
    """Latency of the fixes by the whole log, and motion constraints that these fixes confirm.

    Parameters
    ----------
    start : FilterStart
        Of the filter; withheld fixes are not used.
    longest_gap_s : float
        The pass ends at the first gap of the IMU that is longer, s.
    """
    if config.filter.feedback == "none":
        return FirstPass(VehicleAssumptions(reason="as --feedback is none"))
    means, joined = _means(source, config, algorithm, start, longest_gap_s)
    latency = latency_of_whole_log(start, config, joined)
    if latency is not None:
        start = latency.used_by(start)
    return FirstPass(_constrained(source, config, start, means, joined), latency)


def _constrained(
    source: Source,
    config: ProcessConfig,
    start: FilterStart,
    means: Means,
    joined: list[Increments],
) -> VehicleAssumptions:
    options, latency_ns = config.filter, start.late_ns
    shaken = find_shaking(means, start.used, latency_ns).constraints(start.settings.imu)
    if options.vehicle == "none":
        return VehicleAssumptions(shaken)
    track = _unconstrained(joined, start, shaken)
    if track is None:
        return VehicleAssumptions(shaken, reason="as the log is too short")
    rests = find_rests(means, track)
    trust, denied = _trust(source, config, means, track)
    forced = options.vehicle == "land"
    vehicle = trust.vehicle if trust.holds or forced else None
    reason = "as --vehicle is land" if vehicle and not trust.holds else f"as {trust.reason}"
    log_choice("vehicle", f"{'land' if vehicle else 'none'}, {reason}")
    log_choice("rest", f"{np.count_nonzero(rests.at) * STEP_NS / SECOND:.1f} s, {rests.reason}")
    chosen = VehicleAssumptions(
        shaken, rests, trust, reason, forced, options.mount is not None, denied
    )
    chosen = replace(chosen, wheels_named=config.input.wheels not in (None, NONE))
    if vehicle is None and chosen.rest_s < LEAST_REST_S:
        return chosen
    wander = find_wander(rests.at, means.start_ns, start.used, latency_ns, start.settings.gnss)
    if not wander.ordinary:
        log_choice("GNSS at rest", str(wander))
    chosen = replace(chosen, wander=wander, lasting_given=options.gnss_lasting is not None)
    wheels = None
    if vehicle is not None:
        wheels = use_wheels(source.aiding.wheels, means, track, vehicle.c_vb)
    speed = np.full(len(means), np.nan)
    if wheels is not None and vehicle is not None:
        speed, vehicle = wheels.speed, replace(vehicle, wheel=wheels.sigma)
        log_choice("wheels", f"{wheels.topic}, {wheels.fit}")
    constraints = Constraints(
        means.start_ns,
        rests.at,
        rests.surely,
        trust.rolls,
        speed,
        vehicle,
        rests.stands,
        beyond(noise_at_rest(means, rests.at), start.settings.imu),
    )
    return replace(chosen, constraints=constraints, wheels=wheels)


def _trust(
    source: Source, config: ProcessConfig, means: Means, track: Track
) -> tuple[Trust, tuple[Finding, ...]]:
    """Whether the axle slides, with the mount of the options, of /tf_static, or of the motion."""
    option, stated = config.filter.mount, source.in_vehicle
    if option is not None:
        return find_trust(means, track, to_dcm(from_euler(np.array(option) * DEGREE))), ()
    if stated is None:
        return find_trust(means, track), ()
    c_vb = mount_of(stated.q, config.input.body_axes)
    roll, pitch, yaw = to_euler(from_dcm(c_vb)) / DEGREE
    angles = f"roll {roll:.1f}, pitch {pitch:.1f}, yaw {yaw:.1f} deg"
    trust = find_trust(means, track, c_vb, MOUNT_SIGMA)
    # Transforms are often written before the sensors are mounted
    by_motion = trust if trust.holds else find_trust(means, track)
    if trust.holds or not by_motion.holds:
        log_choice("mount", f"{angles} in {stated.vehicle}, by /tf_static (--mount)")
        return trust, ()
    text = (
        f"/tf_static has the IMU at {angles} in {stated.vehicle}, but the motion contradicts this,"
        f" as {trust.reason}; the mount is estimated from the motion instead"
    )
    answer = f"correct the transform from {stated.vehicle}, or give --mount"
    return by_motion, (Finding("mount-transform", text, answer=answer),)


def mount_of(q: np.ndarray, body_axes: str) -> np.ndarray:
    """Mount of an IMU, ``C_vb`` between axes forward, right, down, from a transform.

    Parameters
    ----------
    q : ndarray, shape (4,)
        Turns vectors of the IMU's frame into the vehicle's, whose axes are forward, left, up.
    body_axes : {'flu', 'frd'}
        What the IMU's messages call x, y, z.
    """
    flip = np.diag([1.0, -1.0, -1.0])
    c = flip @ to_dcm(q)
    return np.asarray(c @ flip if body_axes == "flu" else c)


def _means(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    start: FilterStart,
    longest_gap_s: float,
) -> tuple[Means, list[Increments]]:
    """Short means of the IMU, and its joined increments, from a start up to a longer gap."""
    stage, steps = MeansStage(start.time_ns), SegmentIncrements(source, config, algorithm)

    def up_to_gap() -> Iterator[Increments]:
        last_ns = start.time_ns
        for increments, _, _ in steps.from_time(start.time_ns):
            begin_ns = int(increments.time_ns[0]) - round(float(increments.interval[0]) * SECOND)
            if begin_ns - last_ns > longest_gap_s * SECOND:
                break
            last_ns = int(increments.time_ns[-1])
            stage.push(increments)
            yield increments

    joined = list(joined_blocks(up_to_gap(), JOINED_S, start.valid_ns))
    return stage.finish(), joined


def _unconstrained(
    joined: list[Increments], start: FilterStart, shaken: Constraints | None
) -> Track | None:
    """Smoothed track without motion constraints; only noise of a shaken IMU is assumed."""
    run = InsGnssFilter(
        start.start,
        start.settings,
        with_baro=start.reference is not None,
        output=False,
        store=True,
        constraints=shaken,
    )
    columns = measurements(start)
    with Smoother(run.kind, outputs=False) as smoother:
        for increments in joined:
            smoother.push(run.push(increments, **columns))
            columns = {}
        if columns:
            return None
        smoothed = smoother.epochs()
        if len(smoothed) < 2:
            return None
        nav = smoother.navigation(smoothed)
        of = np.r_[VELOCITY : VELOCITY + 3, ATTITUDE : ATTITUDE + 3]
        return Track(
            smoothed.time_ns.copy(),
            nav[:, V_NORTH : V_DOWN + 1].copy(),
            to_dcm(nav[:, Q_W : Q_Z + 1]),
            smoother.covariance(smoothed, of),
        )
