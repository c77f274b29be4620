"""Receiver noise that a filter assumes: as reported, or the usual values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.config import GnssOptions, ProcessConfig
from sinstool.core.arrays import ArrayLike, FloatArray
from sinstool.core.order_statistics import median
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.methods.ins_gnss.fix_velocity import WORSE, split_position_velocity
from sinstool.methods.ins_gnss.returning_fixes import lasting, leaps, unsettled
from sinstool.methods.ins_gnss.settings import GnssModel
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart

# Of the whole error of a fix, what is white and what lasts: of the usual model, 2 of 5.4 m and
# 0.05 of 0.11 m/s.
POSITION_WHITE, POSITION_SLOW = 0.371, 0.928
VELOCITY_WHITE, VELOCITY_SLOW = 0.447, 0.894
USUAL_POSITION = (5.4, 5.4, 8.5)
USUAL_VELOCITY = (0.11, 0.11, 0.17)
USUAL_SIGMA_V = GnssOptions().gnss_sigma_v
# Fixes no noisier than this many times their stated sigma have good stamps too.
AS_CLAIMED = 1.3
# Fixes noisier than this many times their stated sigma: the receiver states too little.
TOO_LITTLE = 1.5
# Least share of the noise that varies slowly: no log is long enough to show that none does.
LEAST_SLOW = 0.1
# Least sigma of a fix, m and m/s: a receiver that states less states its resolution.
LEAST_POSITION, LEAST_VELOCITY = 0.005, 0.005
# The part of a stated sigma beyond `WORSE` times the usual one is an error that lasts so long, s.
WORSE_S = 10.0
# Stamps of receiver and IMU are no better than this, s: the distance moved in this time is white
# noise of a position.
STAMP_S = 0.003
AS_STATED = "as the receiver states"


def inflate_sigmas(gnss: GnssEpochs, config: ProcessConfig, stamp_s: float = STAMP_S) -> GnssEpochs:
    """Fixes with the standard deviations that a filter should assume.

    Those that the receiver states, times ``gnss_noise_scale``; for positions plus the distance
    moved in `stamp_s`. A fix of a centimetre at 15 m/s needs a time to 0.7 ms, which few logs have;
    `stamp_s` is 0 for those whose fixes show that they have it. The first fixes after an outage,
    which a gate cannot judge, are compared with those that follow.

    Parameters
    ----------
    stamp_s : float, optional
        Uncertainty of the stamps, s.
    """
    factor = config.filter.gnss_noise_scale
    square = np.square(gnss.velocity_n)
    moving = np.where(np.isfinite(square), square, 0.0)
    level = moving[:, 0] + moving[:, 1]
    stamp = stamp_s * np.sqrt(np.stack([level, level, moving[:, 2]], axis=1))
    if not gnss.has_velocity.all():
        stamp = np.where(gnss.has_velocity[:, None], stamp, stamp_s * _speed(gnss))
    position = factor * _worse_for_long(gnss)
    velocity = factor * np.maximum(gnss.sigma_velocity_n, LEAST_VELOCITY)
    off = np.maximum(leaps(gnss), lasting(unsettled(gnss)))
    leapt = np.where(off > 0.0, off, np.nan)[:, None]
    position = np.fmax(np.hypot(position, stamp), leapt)
    return replace(gnss, sigma_position_n=position, sigma_velocity_n=velocity)


def _worse_for_long(gnss: GnssEpochs) -> FloatArray:
    """Stated sigmas of positions, m, shape (n, 3), enlarged where they are larger than usual.

    Between houses, or without its corrections, a receiver has errors of the stated size that stay
    the same for seconds, so the next fix does not average them out. As white noise of fixes at
    their rate such an error must be larger by the root of the number of fixes that it lasts.
    """
    sigma = np.maximum(gnss.sigma_position_n, LEAST_POSITION)
    stated = np.isfinite(sigma).all(axis=1)
    if np.count_nonzero(stated) < 2:
        return sigma
    interval = float(median(np.diff(gnss.time_ns[stated]))) / SECOND
    usual = np.square(WORSE * median(sigma[stated], axis=0))
    excess = np.maximum(np.square(sigma) - usual, 0.0)
    return np.sqrt(np.square(sigma) + (max(WORSE_S / interval, 1.0) - 1.0) * excess)


def gnss_model(
    gnss: GnssEpochs,
    config: ProcessConfig,
    stamp_s: float = STAMP_S,
    stated: str = AS_STATED,
) -> tuple[GnssModel, str]:
    """Noise of a receiver's fixes, and its source.

    Parameters
    ----------
    stamp_s : float, optional
        Uncertainty of the stamps, s, as for :func:`inflate_sigmas`.
    stated : str, optional
        Words for a noise of positions that the receiver states.

    Returns
    -------
    GnssModel
        Slow errors have correlation times of 200 s (position) and 60 s (velocity).
    str
        Noise and source in words.
    """
    options = config.filter
    factor = options.gnss_noise_scale
    position, from_fixes = _usual(gnss.sigma_position_n, USUAL_POSITION, LEAST_POSITION, factor)
    if not from_fixes and options.gnss_sigma is not None:
        position = np.array([1.0, 1.0, 1.6]) * options.gnss_sigma * factor
    velocity, from_velocities = _usual(
        gnss.sigma_velocity_n, USUAL_VELOCITY, LEAST_VELOCITY, factor
    )
    if not from_velocities:
        velocity = velocity * (config.gnss.gnss_sigma_v / USUAL_SIGMA_V)
    white = np.hypot(POSITION_WHITE * position, stamp_s * _speed(gnss))
    how = f"position {stated if from_fixes else 'assumed'}, about {position[0]:.3g} m; "
    if gnss.has_velocity.any():
        words = AS_STATED if from_velocities else "assumed"
        how += f"velocity {words}, about {velocity[0]:.3g} m/s"
    else:
        how += "no velocity"
    return (
        GnssModel(
            position_white=_triple(white),
            position_markov=_triple(POSITION_SLOW * position),
            velocity_white=_triple(VELOCITY_WHITE * velocity),
            velocity_markov=_triple(VELOCITY_SLOW * velocity),
        ),
        how,
    )


def with_lasting_share(start: FilterStart, share: float) -> FilterStart:
    """A start with noise of positions of which a configured share varies slowly."""
    model = start.settings.gnss
    noise = np.sqrt(1.0 - share**2) * np.hypot(model.position_white, model.position_markov)
    model = replace(
        model,
        position_white=_triple(noise),
        position_markov=_triple(share / np.sqrt(1.0 - share**2) * noise),
    )
    why = f"{start.gnss_why}; {share:.0%} of it lasts, as configured"
    return replace(start, settings=replace(start.settings, gnss=model), gnss_why=why)


def with_measured_noise(
    start: FilterStart, gnss: GnssEpochs, config: ProcessConfig, measured: tuple[float, float]
) -> FilterStart:
    """A start with the white noise of positions that a log shows.

    The rest of the stated noise varies slowly. The white part is at least the usual share, as a
    receiver that smooths its fixes shows less. If positions are clearly noisier than the receiver
    states, and no option gives their noise, all of it is multiplied by that ratio. If it states
    none, the noise is at least the measured one.

    Parameters
    ----------
    gnss : GnssEpochs
        With the sigmas that the receiver states.
    measured : tuple of float
        White noise, horizontal and vertical, m; the vertical one is NaN without heights.
    """
    options = config.filter
    # The measured share of the stated noise stays the same if an option scales that noise
    white = options.gnss_noise_scale * np.array([measured[0], measured[0], measured[1]])
    noisier = np.ones(3)
    stated = np.isfinite(gnss.sigma_position_n).any(axis=0)
    if options.gnss_noise_scale == 1.0 and options.gnss_sigma is None:
        # Doubted with what wrong stamps add, but multiplied without: they add nothing to a stop
        doubted = white > TOO_LITTLE * _whole(gnss_model(gnss, config)[0])
        ratio = white / _whole(gnss_model(gnss, config, 0.0)[0])
        noisier = np.where(stated & doubted, ratio, 1.0)
    words = AS_STATED
    if (noisier > 1.0).any():
        gnss = replace(gnss, sigma_position_n=noisier * gnss.sigma_position_n)
        words = f"{times_as_noisy(noisier)} what the receiver states"
    exact = white[0] <= AS_CLAIMED * _whole(gnss_model(gnss, config, 0.0)[0])[0]
    stamp_s = 0.0 if exact else STAMP_S
    model, why = gnss_model(gnss, config, stamp_s, words)
    epochs = split_position_velocity(inflate_sigmas(gnss, config, stamp_s), start.lag)
    known = stated | (options.gnss_sigma is not None)
    model = _with_white(model, white, np.where(known, 1.0, np.inf))
    lasts = model.position_markov[0] / _whole(model)[0]
    made = replace(
        start,
        settings=replace(start.settings, gnss=model),
        gnss=epochs,
        gnss_why=f"{why}; {lasts:.0%} of the position noise varies slowly, over minutes",
        noisier=(float(noisier[0]), float(noisier[2])),
    )
    return with_white_velocity(made, gnss, config, start.velocity_noise)


def with_white_velocity(
    start: FilterStart, gnss: GnssEpochs, config: ProcessConfig, measured: tuple[float, float]
) -> FilterStart:
    """A start with the white noise of velocities that a log shows, if it is more than usual.

    The noise that the receiver states, or an option gives, is used unless it is clearly too small;
    its rest beside the white noise varies slowly.

    Parameters
    ----------
    gnss : GnssEpochs
        With the sigmas that the receiver states.
    measured : tuple of float
        White noise, horizontal and vertical, m/s; NaN if the log does not show it.
    """
    if config.filter.gnss_noise_scale != 1.0:
        return start
    before = start.settings.gnss
    usual, whole = np.array(before.velocity_white), _whole_velocity(before)
    white = np.array([measured[0], measured[0], measured[1]])
    stated = np.isfinite(gnss.sigma_velocity_n).any(axis=0)
    known = stated | (config.gnss.gnss_sigma_v != USUAL_SIGMA_V)
    noisier = white > np.where(known, TOO_LITTLE * whole, usual)
    start = replace(start, velocity_noise=measured)
    shown = known & np.isfinite(white) & ~noisier
    share = np.clip(np.where(shown, white, usual), usual, whole)
    lasts = np.maximum(np.sqrt(np.square(whole) - np.square(share)), LEAST_SLOW * whole)
    lasts = np.where(share > usual, lasts, before.velocity_markov)
    usual = np.sqrt(np.square(whole) - np.square(lasts))
    before = replace(before, velocity_white=_triple(usual), velocity_markov=_triple(lasts))
    start = replace(start, settings=replace(start.settings, gnss=before))
    if not noisier.any():
        return start
    white = np.where(noisier, white, usual)
    sigma = np.sqrt(np.square(start.gnss.sigma_velocity_n) + np.square(white) - np.square(usual))
    times = np.where(stated & noisier, np.hypot(white, before.velocity_markov) / whole, 1.0)
    model = replace(before, velocity_white=_triple(white))
    text = f"velocities vary by {white[0]:.3g} m/s (down {white[2]:.3g} m/s) at each epoch"
    return replace(
        start,
        settings=replace(start.settings, gnss=model),
        gnss=replace(start.gnss, sigma_velocity_n=sigma),
        gnss_why=f"{start.gnss_why}; {text}",
        noisier_velocity=(float(times[0]), float(times[2])),
    )


def velocities_noisier(before: FilterStart, after: FilterStart) -> bool:
    """Whether the noise of velocities is clearly more than assumed before."""
    whole = _whole_velocity(before.settings.gnss)
    return bool((np.array(after.settings.gnss.velocity_white) > TOO_LITTLE * whole).any())


def times_as_noisy(noisier: ArrayLike) -> str:
    """Factors on noise, the first horizontal and the last vertical, in words."""
    level, vertical = (f"{factor:.2g}" for factor in np.asarray(noisier)[[0, -1]])
    if level == "1":
        return f"vertically {vertical} times"
    return (
        f"horizontally {level} times"
        if vertical == "1"
        else f"{level} times (vertically {vertical} times)"
    )


def _whole(model: GnssModel) -> np.ndarray:
    """White and slowly varying noise of positions together, m, NED."""
    return np.hypot(model.position_white, model.position_markov)


def _whole_velocity(model: GnssModel) -> np.ndarray:
    """White and slowly varying noise of velocities together, m/s, NED."""
    return np.hypot(model.velocity_white, model.velocity_markov)


def _with_white(model: GnssModel, white: np.ndarray, most: np.ndarray) -> GnssModel:
    """A receiver's noise with a white part, m, NED, which may enlarge it by `most` at most."""
    whole = _whole(model)
    usual = np.array(model.position_white)
    white = np.clip(np.where(np.isfinite(white), white, usual), usual, most * whole)
    whole = np.maximum(whole, white)
    slow = np.maximum(np.sqrt(np.maximum(whole**2 - white**2, 0.0)), LEAST_SLOW * whole)
    return replace(
        model,
        position_white=_triple(np.sqrt(np.maximum(whole**2 - slow**2, 0.0))),
        position_markov=_triple(slow),
    )


def _usual(
    sigma: np.ndarray, assumed: tuple[float, float, float], least: float, factor: float
) -> tuple[np.ndarray, bool]:
    """Median of the fixes' own sigmas by axis, or the usual value."""
    stated = np.isfinite(sigma).any(axis=0)
    if not stated[:2].all():
        return factor * np.array(assumed), False
    known = [column[~np.isnan(column)] for column in sigma.T]
    usual = np.array([median(known[k]) if stated[k] else np.nan for k in range(3)])
    usual[2] = usual[2] if stated[2] else 1.6 * usual[0]
    return factor * np.maximum(usual, least), True


def _speed(gnss: GnssEpochs) -> np.ndarray:
    """Root mean square of horizontal and of vertical velocity, m/s by axis; 0 where unknown."""
    square = np.square(gnss.velocity_n)
    good = np.isfinite(square)
    mean = np.where(good, square, 0.0).sum(axis=0) / np.maximum(good.sum(axis=0), 1)
    level = np.sqrt(mean[0] + mean[1])
    return np.array([level, level, np.sqrt(mean[2])])


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
