"""Attitude and navigation from columns of samples that a program already has."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sinstool.api.log import frozen
from sinstool.api.options import PathLike, configured, path_of
from sinstool.core.arrays import ArrayLike
from sinstool.core.english import counted
from sinstool.core.errors import ConfigurationError
from sinstool.core.streams import Baro, GnssEpochs, Imu, Solution, Stream, concatenate

if TYPE_CHECKING:
    from sinstool.api.process import Result
    from sinstool.core.progress import Progress

# Of the options of the input those that mean something for columns, whose units and axes are known
OF_COLUMNS = ("start", "end", "gyro_kind", "imu_rate", "max_gap")
KINDS = ("rate", "mean-rate", "increment")


def integrate(
    imu: Imu,
    q_nb: ArrayLike = (1.0, 0.0, 0.0, 0.0),
    *,
    coning: str = "previous-3",
    gyro_kind: str = "rate",
    gyro_bias: ArrayLike = (0.0, 0.0, 0.0),
    omega_ie_n: ArrayLike | None = None,
    max_gap_s: float | None = None,
) -> Solution:
    """Attitude by integrating a gyro, and nothing else: no bias is estimated, nothing is judged.

    Parameters
    ----------
    imu : Imu
        In the order of time. ``accel`` is passed through.
    q_nb : array_like, shape (4,), optional
        Attitude at the first sample: unit quaternion, scalar first, body (FRD) to NED.
    coning : str, optional
        Algorithm, one of ``sinstool.coning.names()``.
    gyro_kind : {'rate', 'mean-rate', 'increment'}, optional
        What a sample of the gyro is: the rate at its time, the mean rate over the interval that
        ends there, or the angle turned in that interval (rad).
    gyro_bias : array_like, shape (3,), optional
        rad/s, subtracted.
    omega_ie_n : array_like, shape (3,), optional
        Rate of the Earth in NED in rad/s, to be removed. By default it stays in.
    max_gap_s : float, optional
        Longest interval that is integrated across; the attitude is held over longer ones. By
        default three median intervals.

    Returns
    -------
    Solution
        ``time_ns`` (n,), ``q_nb`` (n, 4), ``omega_ib_b`` (n, 3) in rad/s and ``specific_force_b``
        (n, 3) in m/s^2. There are fewer rows than samples where the algorithm takes several
        samples for each update.

    Raises
    ------
    ConfigurationError
        An argument is impossible.

    References
    ----------
    .. [1] P. G. Savage, "Strapdown inertial navigation integration algorithm design part 1:
       attitude algorithms", J. Guidance, Control, and Dynamics 21(1), 1998, 19-28.

    Examples
    --------
    >>> import numpy as np, sinstool
    >>> time_ns = np.arange(101) * 10_000_000
    >>> gyro = np.tile([0.0, 0.0, np.pi / 2], (101, 1))     # a quarter turn in a second
    >>> imu = sinstool.Imu.of(time_ns, gyro, np.tile([0.0, 0.0, -9.81], (101, 1)))
    >>> solution = sinstool.integrate(imu)
    >>> print(round(float(solution.to_pandas().heading_deg.iloc[-1]), 6))
    90.0
    """
    from sinstool.methods.coning.registry import algorithm
    from sinstool.methods.strapdown.attitude import AttitudeRun, AttitudeSettings

    if gyro_kind not in KINDS:
        raise ConfigurationError(f"gyro_kind is {gyro_kind!r}", f"give one of {', '.join(KINDS)}")
    start = _numbers("q_nb", q_nb, 4)
    if not np.any(start):
        raise ConfigurationError("q_nb is zero", "give a unit quaternion, scalar first")
    _check(imu)
    steps = np.diff(imu.time_ns)
    nominal = float(np.median(steps))
    gap_ns = 3.0 * nominal if max_gap_s is None else 1e9 * float(_numbers("max_gap_s", max_gap_s))
    if gap_ns < nominal:
        raise ConfigurationError(
            f"max_gap_s is {max_gap_s}, and samples are {nominal / 1e9:g} s apart",
            "give a longer one, or nothing would be integrated",
        )
    settings = AttitudeSettings(
        algorithm=algorithm(str(coning)),
        gyro_kind=gyro_kind,
        nominal_ns=nominal,
        max_gap_ns=round(gap_ns),
        gyro_bias=_numbers("gyro_bias", gyro_bias, 3),
        omega_ie_n=None if omega_ie_n is None else _numbers("omega_ie_n", omega_ie_n, 3),
    )
    columns = Imu(imu.time_ns, imu.log_time_ns, imu.gyro, imu.accel)
    blocks = [one for one in AttitudeRun(start, settings).run(iter([columns])) if len(one)]
    return frozen(concatenate(blocks))


def navigate(
    imu: Imu,
    gnss: GnssEpochs,
    barometer: Baro | None = None,
    *,
    output: PathLike | None = None,
    config: PathLike | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Result:
    """Attitude, velocity and position of samples and fixes in columns: ``mode="ins-gnss"``.

    Parameters
    ----------
    imu : Imu
    gnss : GnssEpochs
        As ``log.gnss()`` gives them: positions, velocities, or both.
    barometer : Baro, optional
        Static pressure.
    output : path-like, optional
        MCAP to write. By default no file is written.
    config : path-like, optional
        A TOML file, as for ``--config``; keywords override it.
    progress : callable, optional
        Called with the fraction done, 0 to 1.
    **options
        Options of ``process`` but those that choose topics, units and axes: ``smooth=True``,
        ``imu_grade="mems"``, ``lever_arm=(0.5, 0, -1.2)``, ``align="fixed"`` with
        ``initial_attitude=(roll, pitch, heading)`` in deg.

    Returns
    -------
    Result

    Raises
    ------
    SinstoolError
        As `process`. Messages call the columns ``columns.mcap``: they are processed as a log.

    Examples
    --------
    >>> import sinstool
    >>> drive = sinstool.simulate("drive", duration=120.0, grade="tactical")
    >>> result = sinstool.navigate(drive.imu(), drive.gnss(), imu_grade="tactical")
    >>> result.plan.mode.value, result.solution.position.shape[1]
    ('ins-gnss', 3)
    """
    from sinstool.api.process import refuse_output_options, run
    from sinstool.config import PROCESS_OPTIONS

    if gnss is None:
        raise ConfigurationError("no GNSS is given", "give columns: log.gnss()")
    all_options = {"mode": "ins-gnss", **options}
    settings = configured("navigate", of_columns(PROCESS_OPTIONS), all_options, config)
    target = None if output is None else path_of(output, "output")
    refuse_output_options(target, options)
    with as_log(imu, gnss, barometer) as path:
        return run(path, target, settings, progress)


def of_columns(paths: tuple[str, ...]) -> tuple[str, ...]:
    """Options of a command without those about the topics of a log."""
    own = [path for path in paths if path.partition(".")[0] != "input"]
    return (*own, *(f"input.{name}" for name in OF_COLUMNS))


@contextmanager
def as_log(
    imu: Imu, gnss: GnssEpochs | None = None, barometer: Baro | None = None
) -> Iterator[Path]:
    """Columns as a log, for as long as the context lasts: commands then treat them as any other."""
    from sinstool.simulation.log import write_simulated
    from sinstool.simulation.recorded import recorded_topics

    _check(imu)
    given: tuple[tuple[str, Stream | None, type[Stream]], ...] = (
        ("gnss", gnss, GnssEpochs),
        ("barometer", barometer, Baro),
    )
    for name, column, kind in given:
        if column is not None:
            _check_columns(name, column, kind)
    topics = recorded_topics(imu, gnss, barometer)
    with tempfile.TemporaryDirectory(prefix="sinstool-") as folder:
        path = Path(folder) / "columns.mcap"
        write_simulated(path, topics, {"scenario": "columns"})
        yield path


def _check(imu: Imu) -> None:
    if not isinstance(imu, Imu):
        raise ConfigurationError(
            f"imu is of type {type(imu).__name__}",
            "give columns: log.imu(), or sinstool.Imu.of(...)",
        )
    if len(imu) < 2:
        raise ConfigurationError(f"imu has {counted(len(imu), 'sample')}", "give at least two")
    if not (np.diff(imu.time_ns) > 0).all():
        raise ConfigurationError(
            "the IMU samples are not in time order, or two have the same time",
            "sort them by time_ns, and leave repeated ones out",
        )


def _check_columns(name: str, stream: Stream, kind: type[Stream]) -> None:
    """Refuse what is no stream of a kind, or has columns of several lengths."""
    if not isinstance(stream, kind):
        raise ConfigurationError(
            f"{name} is of type {type(stream).__name__}", f"give columns: log.{name}()"
        )
    for field, values in vars(stream).items():
        if len(values) != len(stream):
            raise ConfigurationError(
                f"{name}.{field} has {len(values)} rows, and {name}.time_ns {len(stream)}",
                "give columns of one length",
            )


def _numbers(name: str, values: ArrayLike, *shape: int) -> np.ndarray:
    number = f"{shape[0]} numbers" if shape else "a number"
    try:
        array = np.array(values, np.float64)
    except (TypeError, ValueError):
        raise ConfigurationError(f"{name} is not made of numbers", f"give {number}") from None
    if array.shape != shape or not np.isfinite(array).all():
        raise ConfigurationError(
            f"{name} has the shape {array.shape}, or a value that is not finite",
            f"give {number}",
        )
    return array
