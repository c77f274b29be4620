"""An INS/GNSS filter over a log: its answers as solutions, smoothed if asked for."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sinstool.before_start import before_start
from sinstool.config import ProcessConfig
from sinstool.filter_start import Prepared
from sinstool.integration.filter import InsGnssFilter
from sinstool.integration.results import FilterBlock, GnssDiagnostics, UpdateColumns
from sinstool.integration.smoother import Smoother
from sinstool.segment_increments import SegmentIncrements
from sinstool.source import Source
from sinstool.streams import Diagnostics, Imu, Solution
from sinstool.timeline import SECOND
from sinstool.vertical import height_summary, height_warnings

DIAGNOSTIC_NAMES = (
    "nis / rows",
    *(
        f"{what} {axis} {unit}"
        for what, unit in (("innovation position", "m"), ("innovation velocity", "m/s"))
        for axis in ("north", "east", "down")
    ),
    *(
        f"{what} {axis} {unit}"
        for what, unit in (("expected position", "m"), ("expected velocity", "m/s"))
        for axis in ("north", "east", "down")
    ),
)


class FilterRun:
    """A filter over a log, its answers as solutions, smoothed if asked for.

    Parameters
    ----------
    source : Source
    config : ProcessConfig
    prepared : Prepared

    Attributes
    ----------
    updates : int
    carried_back : int
        Samples up to the start that got its state carried back.
    gnss : list of GnssDiagnostics
        All so far.
    """

    def __init__(self, source: Source, config: ProcessConfig, prepared: Prepared) -> None:
        self._source, self._config, self._prepared = source, config, prepared
        self._steps = SegmentIncrements(source, config)
        self.algorithm = self._steps.algorithm
        self.updates = 0
        self.carried_back = 0
        self.gnss: list[GnssDiagnostics] = []
        self._unwritten: list[GnssDiagnostics] = []
        self._offset_ns = 0
        self._smooth = config.filter.smooth
        self._filter = InsGnssFilter(
            prepared.beginning.start,
            prepared.settings,
            with_baro=prepared.reference is not None,
            store=self._smooth,
        )

    def solutions(self, progress: Any = None) -> Iterator[Solution]:
        """Filtered, or smoothed, at every update instant, from the log's start on."""
        earlier = before_start(self._source, self._config, self._prepared)
        if earlier is not None:
            self.carried_back = len(earlier)
            yield earlier
        if not self._smooth:
            for block, imu in self._run(progress):
                assert block.updates is not None
                yield self._solution(block.updates, imu)
            return
        log_times: list[np.ndarray] = []
        with Smoother(self._filter.kind) as smoother:
            for block, imu in self._run(progress):
                smoother.push(block)
                log_times.append(imu.log_time_ns)
            log_time = np.concatenate(log_times) if log_times else np.empty(0, np.int64)
            begin = 0
            for updates in smoother.blocks(smoother.epochs()):
                end = begin + len(updates)
                yield self._solution(updates, None, log_time[begin:end])
                begin = end

    def _run(self, progress: Any) -> Iterator[tuple[FilterBlock, Imu]]:
        p = self._prepared
        given = False
        for increments, imu, _ in self._steps.from_time(p.beginning.time_ns, progress=progress):
            measurements: dict[str, Any] = {}
            if not given:
                measurements = {"gnss": p.gnss, "withheld": p.withheld}
                if p.reference is not None:
                    r = p.reference
                    later = r.arrival_ns >= p.beginning.time_ns
                    measurements |= {
                        "baro_time_ns": r.time_ns[later],
                        "baro_height": r.height[later],
                        "baro_reason": r.reason[later],
                    }
                given = True
            block = self._filter.push(increments, **measurements)
            self.updates += len(increments.sample)
            self._offset_ns = int(imu.log_time_ns[-1]) - int(imu.time_ns[-1])
            if len(block.gnss):
                self.gnss.append(block.gnss)
                self._unwritten.append(block.gnss)
            yield block, imu

    def _solution(
        self, u: UpdateColumns, imu: Imu | None, log_time: np.ndarray | None = None
    ) -> Solution:
        vertical = None
        if self._prepared.reference is not None:
            vertical = np.stack([u.height, -u.velocity_n[:, 2], u.correction], axis=1)
        if log_time is None:
            assert imu is not None
            log_time = imu.log_time_ns
        return Solution(
            u.time_ns,
            log_time,
            u.q_nb,
            u.omega_ib_b,
            u.specific_force_b,
            np.stack([u.latitude, u.longitude, u.height], axis=1),
            u.velocity_n,
            vertical,
            u.covariance_position_n,
            u.covariance_velocity_n,
            u.covariance_attitude_n,
        )

    def new_diagnostics(self) -> list[Diagnostics]:
        """Diagnostics since the last call, for writing."""
        out = []
        for g in self._unwritten:
            values = np.concatenate(
                [(g.nis / np.maximum(g.rows, 1))[:, None], g.innovation, g.innovation_sigma], axis=1
            )
            level = np.where(g.restarted, 2, np.where(g.gated, 1, 0))
            out.append(Diagnostics(g.time_ns, g.time_ns + self._offset_ns, level, values))
        self._unwritten = []
        return out

    def diagnostics(self) -> GnssDiagnostics | None:
        """All of them as one."""
        if not self.gnss:
            return None
        names = list(vars(self.gnss[0]))
        return GnssDiagnostics(
            **{n: np.concatenate([getattr(g, n) for g in self.gnss]) for n in names}
        )

    def summary(self) -> dict[str, Any]:
        """``filter`` of the summary."""
        p, s = self._prepared, self._filter.summary
        events: dict[str, int] = {}
        for event in self._filter.events:
            events[event.kind] = events.get(event.kind, 0) + 1
        told: dict[str, Any] = {
            "filter": s.filter,
            "asked": self._config.filter.filter,
            "states": self._filter.kind.size,
            "smoothed": self._smooth,
            "feedback": p.settings.feedback,
            "start": {"time_ns": str(p.beginning.time_ns), "how": p.beginning.how},
            "imu_grade": {"grade": p.grade, "why": p.grade_why},
            "gnss_noise": p.gnss_why,
            "gnss_latency_s": p.settings.gnss_latency,
            "gnss_latency": {"status": "given"}
            if p.latency is None
            else {
                "status": p.latency.status,
                "latency_s": p.latency.latency_s,
                "sigma_s": p.latency.sigma_s,
            },
            "lever_arm_m": list(p.settings.lever_arm_b),
            "updates": s.updates,
            "epochs_used": s.epochs_used,
            "epochs_gated": s.epochs_gated,
            "epochs_before_start": s.epochs_before_start,
            "restarts": s.restarts,
            "mean_nis": s.mean_nis,
            "gyro_bias_rad_s": s.gyro_bias.tolist(),
            "accel_bias_m_s2": s.accel_bias.tolist(),
            "accel_scale": s.accel_scale.tolist(),
            "baro_bias_m": s.baro_bias,
            "events": events,
            "withheld": self._scores(),
        }
        return told

    def _scores(self) -> dict[str, Any] | None:
        """How far the filter was from the fixes that it did not see, by outage."""
        all_of = self.diagnostics()
        if all_of is None or not all_of.withheld.any():
            return None
        rows = np.flatnonzero(all_of.withheld)
        cuts = np.flatnonzero(np.diff(rows) > 1) + 1
        outages = []
        for part in np.split(rows, cuts):
            error = np.linalg.norm(all_of.innovation[part, :2], axis=1)
            sigma = np.linalg.norm(all_of.innovation_sigma[part, :2], axis=1)
            worst = int(np.nanargmax(error)) if np.isfinite(error).any() else 0
            outages.append(
                {
                    "start_ns": str(int(all_of.time_ns[part[0]])),
                    "duration_s": float(all_of.time_ns[part[-1]] - all_of.time_ns[part[0]])
                    / SECOND,
                    "epochs": len(part),
                    "largest_horizontal_m": float(error[worst]),
                    "its_sigma_m": float(sigma[worst]),
                }
            )
        largest = np.array([o["largest_horizontal_m"] for o in outages])
        return {
            "outages": outages,
            "rms_of_largest_horizontal_m": float(np.sqrt(np.mean(largest**2))),
        }

    def height(self, last: Solution) -> dict[str, Any] | None:
        """``height`` of the summary."""
        p, s = self._prepared, self._filter.summary
        if p.reference is None or last.vertical is None or s.gains is None:
            return None
        final = last.vertical[-1]
        told = height_summary(
            p.reference,
            p.settings.damping,
            s.channel,
            self._filter.channel_events,
            p.beginning.time_ns,
            (float(final[0]), float(final[1]), float(final[2])),
        )
        return told | {"imu_grade": {"grade": p.grade, "why": p.grade_why}}

    def warnings(self) -> list[str]:
        """What a user has to know about the run."""
        p, s = self._prepared, self._filter.summary
        notes = [f"lost: {part}" for part in self._source.log.lost]
        if self.algorithm.caveat:
            notes.append(self.algorithm.caveat)
        if s.fell_back:
            notes.append(
                f"the log has no barometer, so {self._config.filter.filter} runs without its"
                f" network, as {s.filter}"
            )
        if p.latency is not None and p.settings.gnss_latency != 0.0:
            notes.append(
                f"fixes were found to be valid {p.settings.gnss_latency:+.3f} s before their stamps"
                f" (sigma {p.latency.sigma_s * 1e3:.1f} ms) and are used so; give --gnss-latency to"
                " say otherwise"
            )
        before = (p.beginning.time_ns - self._source.survey.first_ns) / SECOND
        if before > 0.0 and self.carried_back:
            notes.append(
                f"the first {before:.2f} s lie before the filter's start: the solution there is"
                " that of the start, carried back by the Imu alone"
            )
        elif before > 0.0:
            notes.append(
                f"the first {before:.2f} s lie before the filter's start and have no solution"
            )
        if s.restarts:
            notes.append(
                f"the filter began anew {s.restarts} times: fixes were rejected for too long"
            )
        if s.epochs_gated:
            notes.append(
                f"{s.epochs_gated} of {s.epochs_used + s.epochs_gated} fixes were rejected"
            )
        if p.reference is not None:
            notes += height_warnings(s.channel, self._filter.channel_events)
        return notes
