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
from sinstool.methods.ins_gnss.returning_fixes import leaps
from sinstool.methods.ins_gnss.settings import GnssModel
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart

# Of the whole error of a fix, what is white and what lasts: of the usual model, 2 of 5.4 m and
# 0.05 of 0.11 m/s.
POSITION_WHITE, POSITION_SLOW = 0.371, 0.928
VELOCITY_WHITE, VELOCITY_SLOW = 0.447, 0.894
USUAL_POSITION = (5.4, 5.4, 8.5)
USUAL_VELOCITY = (0.11, 0.11, 0.17)
USUAL_SIGMA_V = GnssOptions().gnss_sigma_v
# Fixes no noisier than so many times what the receiver says have good stamps too.
AS_CLAIMED = 1.3
# Noisier than so many times that they are not what the receiver says.
TOO_LITTLE = 1.5
# Of the whole, at least so much lasts: no log is long enough to show that nothing does.
LEAST_SLOW = 0.1
# A receiver that claims less than this speaks of its own resolution.
LEAST_POSITION, LEAST_VELOCITY = 0.005, 0.005
# What a receiver says beyond `WORSE` times its usual sigma is an error that lasts so long, s.
WORSE_S = 10.0
# Stamps of receiver and Imu are no better than this, s: what a vehicle moves meanwhile is white
# noise of a position.
STAMP_S = 0.003
AS_STATED = "as the receiver says"


def inflate_sigmas(gnss: GnssEpochs, config: ProcessConfig, stamp_s: float = STAMP_S) -> GnssEpochs:
    """Fixes with the standard deviations that a filter should assume.

    What the receiver says, times ``gnss_noise_scale``; of positions also what the vehicle moves
    while stamps are uncertain. A fix that claims a centimetre at 15 m/s claims to know its time to
    0.7 ms, which hardly a log holds; `stamp_s` is 0 for one whose fixes show that it does. The
    first fixes after an outage, which no filter can judge, are held against those that follow.
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
    off = leaps(gnss)
    leapt = np.where(off > 0.0, off, np.nan)[:, None]
    position = np.fmax(np.hypot(position, stamp), leapt)
    return replace(gnss, sigma_position_n=position, sigma_velocity_n=velocity)


def _worse_for_long(gnss: GnssEpochs) -> FloatArray:
    """What the receiver says of positions, m, shape (n, 3), larger where it is worse than usual.

    Between houses, or without its corrections, a receiver is off by as much as it says, but for
    seconds in the same way: that is not noise of which the next fix takes off a part. As white
    noise of fixes at their rate it has to be larger by the square root of how many fixes it lasts.
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
    """Noise of a receiver's fixes, and where it is from; `stamp_s` as of `inflate_sigmas`.

    Parameters
    ----------
    stated : str, optional
        What the noise of positions is, in words, where the receiver states one.

    Returns
    -------
    GnssModel
        Position errors last 200 s, velocity errors 60 s.
    str
        In words.
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
    """A start with noise of positions of which a configured share lasts."""
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
    """A start with as much white noise of positions as a log shows.

    What is left of the receiver's own figure lasts. A receiver that smooths its fixes shows less
    noise than a filter may believe in: the white part is no less than usual. Where positions are
    clearly noisier than the receiver says, unless options say how noisy they are, all that it says
    of them is taken that many times. Where it says nothing they may be as noisy as they show.

    Parameters
    ----------
    gnss : GnssEpochs
        As the receiver gives them.
    measured : tuple of float
        White noise, horizontal and vertical, m; the vertical one is NaN where there are no heights.
    """
    options = config.filter
    # A share of what the receiver says, whatever the options make of that
    white = options.gnss_noise_scale * np.array([measured[0], measured[0], measured[1]])
    noisier = np.ones(3)
    stated = np.isfinite(gnss.sigma_position_n).any(axis=0)
    if options.gnss_noise_scale == 1.0 and options.gnss_sigma is None:
        ratio = white / _whole(gnss_model(gnss, config)[0])
        noisier = np.where(stated & (ratio > TOO_LITTLE), ratio, 1.0)
    words = AS_STATED
    if (noisier > 1.0).any():
        gnss = replace(gnss, sigma_position_n=noisier * gnss.sigma_position_n)
        words = f"{times_as_noisy(noisier)} what the receiver says"
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
    """A start with the white noise of velocities that a log shows, where that is more than usual.

    What the receiver or an option says holds unless it is clearly too little: what is left of it
    beside the white noise lasts.

    Parameters
    ----------
    gnss : GnssEpochs
        As the receiver gives them.
    measured : tuple of float
        White noise, horizontal and vertical, m/s; NaN where it does not show.
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
    """Whether the noise of velocities has become clearly more than it was thought to be."""
    whole = _whole_velocity(before.settings.gnss)
    return bool((np.array(after.settings.gnss.velocity_white) > TOO_LITTLE * whole).any())


def times_as_noisy(noisier: ArrayLike) -> str:
    """Factors on noise, the first horizontal and the last vertical, in words."""
    factors = np.asarray(noisier)
    return f"{factors[0]:.2g} times (vertically {factors[-1]:.2g} times)"


def _whole(model: GnssModel) -> np.ndarray:
    """White and lasting noise of positions together, m, NED."""
    return np.hypot(model.position_white, model.position_markov)


def _whole_velocity(model: GnssModel) -> np.ndarray:
    """White and lasting noise of velocities together, m/s, NED."""
    return np.hypot(model.velocity_white, model.velocity_markov)


def _with_white(model: GnssModel, white: np.ndarray, most: np.ndarray) -> GnssModel:
    """A receiver's noise, of which so much, m, NED, is white; in all it grows `most` times."""
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
