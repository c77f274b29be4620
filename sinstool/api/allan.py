"""Noise of an IMU at rest from logs or columns, as in `sinstool allan`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sinstool.api.log import Log, log_path
from sinstool.api.options import PathLike, configured, path_of
from sinstool.core.streams import Imu

if TYPE_CHECKING:
    from sinstool.config.export import NoiseFormat
    from sinstool.core.progress import Progress
    from sinstool.pipelines.allan.result import AllanResult


def allan(
    log: PathLike | Log | Imu,
    output: PathLike | None = None,
    *,
    format: NoiseFormat = "sinstool",
    overwrite: bool = False,
    config: PathLike | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> AllanResult:
    """Noise of the IMU where it rests, with 95 % intervals, as ``sinstool allan`` measures it.

    Parameters
    ----------
    log : path-like or Log or Imu
        A log, or samples in columns. The stretches at rest are found.
    output : path-like, optional
        File to write, such as one for ``process(..., imu_noise=...)``. By default none is written.
    format : str, optional
        Whose file: ``sinstool``, ``kalibr``, ``vins-fusion``, ``openvins``, ``fast-lio``,
        ``robot-localization`` or ``kf-gins``.
    overwrite : bool, optional
        Replace an existing output.
    config : path-like, optional
        A TOML file, as for ``--config``; keywords override it.
    progress : callable, optional
        Called with the fraction done, 0 to 1.
    **options
        The command's options, such as ``start=600`` or ``gyro_unit="deg/s"``.

    Returns
    -------
    AllanResult
        ``axes`` (of each axis the coefficients in SI units by term, each with ``value``, ``low``
        and ``high``; the value is None where the log only bounds it, and the deviations),
        ``averaging_s``, ``rest``, ``noise``, ``findings``, ``to_json()``.

    Raises
    ------
    SinstoolError
        The log cannot be read, or never rests.

    Examples
    --------
    >>> import sinstool
    >>> measured = sinstool.allan("sample_data/static.mcap")
    >>> white = measured.of("gyro")[0].coefficients["white"]
    >>> f"{white.value:.1e} rad/sqrt(s)", white.low < 1.45e-5 < white.high
    ('1.4e-05 rad/sqrt(s)', True)
    """
    from sinstool.config import ALLAN_OPTIONS
    from sinstool.core.whole_file import check_output
    from sinstool.pipelines.allan.formats import write_noise
    from sinstool.pipelines.allan.run import measure

    target = None if output is None else path_of(output, "output")
    if isinstance(log, Imu):
        from sinstool.api.arrays import as_log, of_columns

        settings = configured("allan", of_columns(ALLAN_OPTIONS), options, config)
        with as_log(log) as path:
            if target is not None:
                check_output(target, [], overwrite)
            result = measure(path, settings, progress).result
    else:
        path, options = log_path(log, options)
        settings = configured("allan", ALLAN_OPTIONS, options, config)
        if target is not None:
            check_output(target, [path], overwrite)
        result = measure(path, settings, progress).result
    return result if target is None else write_noise(result, target, format)
