"""The commands that examine logs: `info`, `align`, `compare-coning`, `calibrate-hse`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from sinstool.api.log import Log, log_path
from sinstool.api.options import PathLike, configured, path_of
from sinstool.core.streams import GnssEpochs, Imu

if TYPE_CHECKING:
    from sinstool.core.progress import Progress
    from sinstool.pipelines.align.result import AlignResult
    from sinstool.pipelines.calibrate_hse.result import Calibration
    from sinstool.pipelines.compare_coning.summary import ComparisonResult
    from sinstool.pipelines.info.result import Inspection


def survey(
    log: PathLike | Log,
    *,
    config: PathLike | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Inspection:
    """Contents and anomalies of a log, and the plan of `process`, as in ``sinstool info``.

    Parameters
    ----------
    log : path-like or Log
    config : path-like, optional
        A TOML file, as for ``--config``; keywords override it.
    progress : callable, optional
        Called with the fraction done, 0 to 1.
    **options
        The command's options, such as ``body_axes="frd"`` or ``start=10``.

    Returns
    -------
    Inspection
        ``topics``, ``imu`` (a survey of each IMU topic: rate, gaps, still stretches), ``findings``,
        ``plan`` (mode, first attitude, coning, each with its reason), ``to_json()``.

    Raises
    ------
    SinstoolError
        The log cannot be read. One that `process` would refuse can be surveyed all the same.

    Examples
    --------
    >>> import sinstool
    >>> found = sinstool.survey("sample_data/static.mcap")
    >>> found.imu[0].topic, round(found.imu[0].rate_hz), found.plan.mode.value
    ('/imu/data_raw', 100, 'attitude')
    >>> [finding.kind for finding in found.findings]
    ['no-ins-gnss']
    """
    from sinstool.config import INFO_OPTIONS
    from sinstool.pipelines.info.run import inspect

    path, options = log_path(log, options)
    return inspect(path, configured("survey", INFO_OPTIONS, options, config), progress)


def align(
    log: PathLike | Log | Imu,
    gnss: GnssEpochs | None = None,
    *,
    truth: PathLike | None = None,
    config: PathLike | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> AlignResult:
    """The attitude at the start with its covariance, or why it is not known; ``sinstool align``.

    Parameters
    ----------
    log : path-like or Log or Imu
        A log, or samples in columns.
    gnss : GnssEpochs, optional
        Beside samples in columns: for alignment in motion, and for the latitude.
    truth : path-like, optional
        A topic of the log or a CSV file with reference attitudes, to say how wrong the answer is.
    config : path-like, optional
        A TOML file, as for ``--config``; keywords override it.
    progress : callable, optional
        Called with the fraction done, 0 to 1.
    **options
        The command's options: the method is ``align="gyrocompass"``, ``imu_grade="navigation"``.

    Returns
    -------
    AlignResult
        ``q_nb_wxyz``, ``roll_deg``, ``pitch_deg``, ``heading_deg`` (None where it is not known),
        ``sigma_deg`` about north, east, down, ``status``, ``findings``, ``to_json()``.

    Raises
    ------
    AlignmentError
        The method that is asked for is not possible with this log.
    SinstoolError

    Examples
    --------
    >>> import sinstool
    >>> found = sinstool.align("sample_data/static.mcap", align="level")
    >>> found.method, found.status, found.heading_deg
    ('level', 'level-only', None)
    """
    from sinstool.config import ALIGN_OPTIONS
    from sinstool.pipelines.align.log import align_log

    reference = None if truth is None else str(truth)
    if isinstance(log, Imu):
        from sinstool.api.arrays import as_log, of_columns

        settings = configured("align", of_columns(ALIGN_OPTIONS), options, config)
        with as_log(log, gnss) as path:
            return align_log(path, settings, progress, reference).result
    _only_with_columns(gnss)
    path, options = log_path(log, options)
    settings = configured("align", ALIGN_OPTIONS, options, config)
    return align_log(path, settings, progress, reference).result


def _only_with_columns(gnss: GnssEpochs | None) -> None:
    from sinstool.core.errors import ConfigurationError

    if gnss is not None:
        raise ConfigurationError(
            "GNSS columns can be given with IMU columns only, not with a log", "leave gnss out"
        )


def compare_coning(
    log: PathLike | Log,
    *,
    config: PathLike | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> ComparisonResult:
    """Coning algorithms side by side on a log, as ``sinstool compare-coning`` does.

    Parameters
    ----------
    log : path-like or Log
    config : path-like, optional
        A TOML file, as for ``--config``; keywords override it.
    progress : callable, optional
        Called with the fraction done, 0 to 1.
    **options
        The command's options: ``algorithms=["previous-1", "previous-3"]``, ``decimate=[1, 2]``,
        ``tolerance=0.01``, ``truth="/truth/imu"``.

    Returns
    -------
    ComparisonResult
        ``algs`` (an entry for each algorithm and rate, with its drift in deg/h), ``reference``,
        ``verdict``, ``findings``, ``to_json()``.

    Raises
    ------
    SinstoolError

    Examples
    --------
    >>> import sinstool
    >>> compared = sinstool.compare_coning(
    ...     "sample_data/coning.mcap", algorithms=["previous-1", "previous-3"], decimate=[1]
    ... )
    >>> sorted({one.name for one in compared.algs})
    ['previous-1', 'previous-3']
    """
    from sinstool.config.coning import COMPARISON_OPTIONS, check_comparison
    from sinstool.pipelines.compare_coning.log import compare_log
    from sinstool.pipelines.compare_coning.summary import summarise

    path, options = log_path(log, options)
    # [coning] of a file may name an algorithm of `process`, which these options need not fit.
    settings = configured("compare_coning", COMPARISON_OPTIONS, options, config, check=False)
    check_comparison(settings.comparison, settings.coning)
    return summarise(compare_log(path, settings, progress))


def calibrate_hse(
    logs: PathLike | list[PathLike] | tuple[PathLike, ...],
    rig: PathLike | Mapping[str, Any],
    output: PathLike | None = None,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> Calibration:
    """Heading-sensitive error of a rate-biased system, as ``sinstool calibrate-hse`` finds it.

    Parameters
    ----------
    logs : path-like, or list of path-like
        Recordings on a turntable at constant rates: files, folders, patterns.
    rig : path-like or mapping
        A TOML file with the table ``[rig]``, or that table.
    output : path-like, optional
        JSON file to write, which ``process(..., hse=...)`` takes. By default none is written.
    progress : callable, optional
        Called with the fraction done, 0 to 1.
    **options
        The command's options, such as ``settle=5.0`` or ``exclude=["run-3"]``.

    Returns
    -------
    Calibration
        ``file`` (the calibration), ``fit``, ``runs``, ``findings``, ``to_json()``.

    Raises
    ------
    ConfigurationError
        The rig is not described well, or an option is unknown or impossible.
    SinstoolError
        A log cannot be read, or not one of them has a stretch to align on.

    Examples
    --------
    >>> import sinstool
    >>> calibration = sinstool.calibrate_hse(
    ...     "sample_data/hse/a-*.mcap", "sample_data/hse/rig-a.toml"
    ... )
    >>> calibration.file.method, len(calibration.logs)
    ('joint', 4)
    """
    from sinstool.campaign.inputs import expand
    from sinstool.config.load import build
    from sinstool.config.rig import CALIBRATION_OPTIONS
    from sinstool.core.errors import ConfigurationError
    from sinstool.pipelines.calibrate_hse.run import calibrate

    file = None if isinstance(rig, Mapping) else path_of(rig, "rig")
    settings = configured("calibrate_hse", CALIBRATION_OPTIONS, options, file)
    if isinstance(rig, Mapping):
        table = rig.get("rig", rig)
        read = build(type(settings), {"rig": dict(table)}, check=False)
        settings = settings.model_copy(update={"rig": read.rig})
    if settings.rig is None:
        raise ConfigurationError(f"{file} has no table [rig]", "describe the rig there")
    each = logs if isinstance(logs, (list, tuple)) else [logs]
    paths = expand([path_of(log) for log in each])
    if not paths:
        raise ConfigurationError("no log is given", "give at least one")
    target = None if output is None else path_of(output, "output")
    return calibrate(paths, target, settings, progress)
