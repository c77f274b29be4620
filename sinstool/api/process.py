"""From a log to a solution: as a file, as columns, or both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sinstool.api.log import Log, frozen, log_path
from sinstool.api.options import PathLike, configured, path_of
from sinstool.core.errors import ConfigurationError
from sinstool.core.finding import Finding
from sinstool.core.streams import Solution, concatenate

if TYPE_CHECKING:
    import numpy as np

    from sinstool.config import ProcessConfig
    from sinstool.core.progress import Progress
    from sinstool.pipelines.export.result import ExportResult
    from sinstool.pipelines.plan import Plan
    from sinstool.pipelines.process.result import ProcessResult
    from sinstool.pipelines.process.summary import FilterCourse, Sink
    from sinstool.report.recorder import Recorder


@dataclass(frozen=True, repr=False)
class Result:
    """The result of `process` or `navigate`.

    Attributes
    ----------
    solution : Solution
        Columns: ``time_ns`` (n,); ``q_nb`` (n, 4), unit quaternions, scalar first, body
        (Forward-Right-Down) to navigation axes (North-East-Down); ``omega_ib_b`` (n, 3) in rad/s
        and ``specific_force_b`` (n, 3) in m/s^2, both corrected. Where the mode computes them also
        ``position`` (n, 3), latitude, longitude in rad and height in m; ``velocity_n`` (n, 3) in
        m/s; ``covariance_attitude_n``, ``covariance_position_n`` and ``covariance_velocity_n``
        (n, 3, 3). ``solution.to_pandas()`` is a table of them.
    summary : ProcessResult
        What the command prints: plan, alignment, filter, final state, errors against a truth.
    """

    solution: Solution
    summary: ProcessResult

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings about the log and the run: kind, severity, text, answer."""
        return self.summary.findings

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings that are more than notes, as the command prints them."""
        return self.summary.warnings

    @property
    def plan(self) -> Plan:
        """The processing: mode, first attitude, coning algorithm, each with its reason."""
        return self.summary.plan

    @property
    def status(self) -> str:
        """``done``, or ``lost`` where part of the log or of the result is missing."""
        return "lost" if self.summary.exit_status else "done"

    def to_json(self) -> dict[str, Any]:
        """The values of ``--json``."""
        return self.summary.to_json()

    def export(
        self, output: PathLike, *, config: PathLike | None = None, **options: Any
    ) -> ExportResult:
        """Write the solution as a table, a trajectory or a track on a map.

        Parameters
        ----------
        output : path-like
            Its suffix is the format: ``.csv``, ``.parquet``, ``.tum``, ``.kml``, ``.gpx`` or
            ``.geojson``.
        config : path-like, optional
            A TOML file, as for ``--config``; keywords override it.
        **options
            Options of ``sinstool export``: ``rate=10``, ``start=5``, ``overwrite=True``.

        Returns
        -------
        ExportResult
            ``output`` has ``rows`` and the names of the ``columns``.

        Raises
        ------
        ConfigurationError
            The suffix is none of these, or an option is unknown or impossible.
        SinstoolError
            The solution has no positions, and the format is made of them; or the output cannot be
            written.

        Examples
        --------
        >>> import sinstool
        >>> result = sinstool.process("sample_data/static.mcap", align="level", mode="attitude")
        >>> result.export("static.csv", rate=1).output.rows  # doctest: +SKIP
        21
        """
        from sinstool.config import EXPORT_OPTIONS
        from sinstool.pipelines.export.run import export_solution

        settings = configured("export", EXPORT_OPTIONS, options, config)
        return export_solution(self.solution, self.summary, path_of(output, "output"), settings)

    def __repr__(self) -> str:
        times = self.solution.time_ns
        span = f"{len(times)} rows over {(times[-1] - times[0]) / 1e9:.3f} s"
        return f"<Result: {self.plan.mode.value}, {self.status}, {span}>"


class _Collected:
    """A sink that keeps every solution, and passes everything on to one beside it."""

    def __init__(self, solutions: list[Solution], beside: Sink | None) -> None:
        self._solutions = solutions
        self._beside = beside

    def push(self, solution: Solution) -> None:
        """Keep the next solutions."""
        if len(solution):
            self._solutions.append(solution)
        if self._beside is not None:
            self._beside.push(solution)

    def refer_height(self, name: str, time_ns: np.ndarray, height: np.ndarray) -> None:
        """Pass on."""
        if self._beside is not None:
            self._beside.refer_height(name, time_ns, height)

    def refer_track(self, latitude: np.ndarray, longitude: np.ndarray) -> None:
        """Pass on."""
        if self._beside is not None:
            self._beside.refer_track(latitude, longitude)

    def free_heading(self) -> None:
        """Pass on."""
        if self._beside is not None:
            self._beside.free_heading()

    def refer_filter(self, course: FilterCourse) -> None:
        """Pass on."""
        if self._beside is not None:
            self._beside.refer_filter(course)


def process(
    log: PathLike | Log,
    output: PathLike | None = None,
    *,
    config: PathLike | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Result:
    """Compute attitude, velocity and position from the IMU of a log, as ``sinstool process`` does.

    Parameters
    ----------
    log : path-like or Log
        An MCAP file, a ROS 1 bag, a ROS 2 bag or a ULog of PX4.
    output : path-like, optional
        MCAP to write, which appears when it is complete. By default no file is written.
    config : path-like, optional
        A TOML file, as for ``--config``; keywords override it.
    progress : callable, optional
        Called with the fraction done, 0 to 1.
    **options
        The command's options: ``--imu-grade`` is ``imu_grade="tactical"``, ``--smooth`` is
        ``smooth=True``, ``--lever-arm`` is ``lever_arm=(0.5, 0, -1.2)``.

    Returns
    -------
    Result

    Raises
    ------
    ConfigurationError
        An option is unknown or impossible.
    SinstoolError
        What is wrong with the log, and what to do. No output is left behind.

    Examples
    --------
    >>> import sinstool
    >>> result = sinstool.process("sample_data/static.mcap", align="level", mode="attitude")
    >>> result.solution.q_nb.shape, result.status
    ((2001, 4), 'done')
    """
    from sinstool.config import PROCESS_OPTIONS

    path, options = log_path(log, options)
    settings = configured("process", PROCESS_OPTIONS, options, config)
    target = None if output is None else path_of(output, "output")
    refuse_output_options(target, options)
    return run(path, target, settings, progress)


# Options of an output, which say nothing where none is written
OF_OUTPUT = ("world", "emit", "only_results", "compression")


def refuse_output_options(output: Path | None, options: Mapping[str, Any]) -> None:
    """Refuse options of an output where there is none.

    Raises
    ------
    ConfigurationError
    """
    vain = [name for name in OF_OUTPUT if options.get(name) is not None]
    if output is None and vain:
        raise ConfigurationError(
            f"{vain[0]} concerns the output, and none is written",
            f"give an output, or leave {vain[0]} out",
        )


def run(log: Path, output: Path | None, config: ProcessConfig, progress: Progress | None) -> Result:
    """Process a log, with its page if the configuration asks for one, and keep the solution."""
    from sinstool.report.page import check_report

    report = None if config.output.report is None else Path(config.output.report)
    check_report(report, inputs=[log], overwrite=config.output.overwrite)
    collected: list[Solution] = []
    summary = process_one(log, output, report, config, progress, collected)
    return Result(frozen(concatenate(collected)), summary)


def process_one(
    log: Path,
    output: Path | None,
    report: Path | None,
    config: ProcessConfig,
    progress: Progress | None,
    collected: list[Solution] | None = None,
    script: Path | None = None,
) -> ProcessResult:
    """Process a log, and write its page if there is to be one.

    Parameters
    ----------
    output : Path or None
        The MCAP; None to write none.
    report : Path or None
        The page.
    progress : callable, optional
        Called with the fraction done.
    collected : list, optional
        Gets all solutions.
    script : Path, optional
        What draws the page's figures, where many pages share it.

    Raises
    ------
    SinstoolError
    """
    from sinstool.core.whole_file import commit_together
    from sinstool.pipelines.process.run import process as run_process

    recorder = _recorder(log, report, config)
    sink: Sink | None = recorder
    if collected is not None:
        sink = _Collected(collected, recorder)
    with commit_together():
        result = run_process(log, output, config, progress, sink)
        if recorder is not None and config.output.truth:
            errors = recorder.errors()
            doubts = () if errors is None else errors.findings
            result = replace(result, truth=errors, findings=(*result.findings, *doubts))
        if report is not None and recorder is not None:
            from sinstool.report.pages.process import write_page

            write_page(report, recorder, result, config, script)
    return result


def _recorder(log: Path, report: Path | None, config: ProcessConfig) -> Recorder | None:
    """Collect figures and errors during the run; None where it needs neither."""
    if report is None and not config.output.truth:
        return None
    from sinstool.io.readers import open_log
    from sinstool.pipelines.process.errors_against_truth import read_references
    from sinstool.report.recorder import Recorder

    if not config.output.truth:
        return Recorder()
    # A rig is described in FRD, and so are its attitudes
    body_axes = config.input.body_axes if config.hse.hse is None else "frd"
    with open_log(log, config.input.salvage) as opened:
        return Recorder(read_references(opened, config.output.truth, body_axes))
