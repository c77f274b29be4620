"""Data of the compiled loop: two records, and the index of each number in the arrays beside them.

Compiled code takes a record as one pointer, however many fields it has. Tuples of arrays would be
taken apart at each call, and functions that call each other with them took most of a minute to
compile. Arrays of a record are as large as the largest filter needs; a filter of n states uses the
first n rows and columns.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from sinstool.core.arrays import LINE, FloatArray, IntArray, zeros_on_lines
from sinstool.methods.height.layout import PARAMETERS as NETWORK_PARAMETERS
from sinstool.methods.height.layout import STATE_SIZE
from sinstool.methods.ins_gnss.states import INDEX_SIZE, MOVING, SIZE, WHOLE, WIDTH
from sinstool.methods.strapdown.navigation import SIZE as NAV_SIZE

ROWS = 6  # of a GNSS epoch
# One row: a single measurement. A literal 1 would be a type of its own to numba, and every function
# that it is passed to would be compiled twice.
ONE_ROW: Any = np.int64(1)
# What is known of a land vehicle: C_vb by rows, then axle, sideslip, squat, wheel scale
VEHICLE_SIZE = 13

# --- parameters of a land vehicle -----------------------------------------------------------
V_ORIGIN = 0  # time of the first point of its grid, s, and between points, s
V_STEP = 1
V_INTERVAL = 2  # between constraints, s
V_REST_VELOCITY = 3  # noise of constraints, power densities
V_REST_RATE = 4
V_LATERAL = 5
V_VERTICAL = 6
V_WHEEL = 7
V_SHAKEN_FORCE = 8  # vibration at rest beyond the noise of the IMU, power densities
V_SHAKEN_RATE = 9
V_PARAMETERS = 10
# Columns of the grid: whether the vehicle rests (2: surely), whether it is assumed not to slide,
# its wheels' speed, m/s, NaN where unknown, and whether it stands, including the ends of rests
G_REST, G_ROLLS, G_WHEEL, G_STANDS = range(4)

# --- a row of diagnostics -----------------------------------------------------------------
D_INNOVATION = 0
D_SIGMA = 6
D_MEASUREMENT = 12
D_NIS = 18
D_ROWS = 19
D_USED = 20
D_GATED = 21
D_RESTARTED = 22
D_WITHHELD = 23
D_RATIO = 24
DIAGNOSTICS = 30

# --- a row of output ----------------------------------------------------------------------
O_RATE = NAV_SIZE
O_FORCE = NAV_SIZE + 3
O_CORRECTION = NAV_SIZE + 6
O_COVARIANCE = NAV_SIZE + 7  # of position, velocity, attitude
OUTPUT = NAV_SIZE + 34

# --- a row for a smoother -----------------------------------------------------------------
SENSORS = 26  # columns of StoredEpochs.sensors
R_TIME, R_UPDATE, R_RESTART = range(3)
R_NAV = 3
R_SENSORS = R_NAV + NAV_SIZE
R_STATES = R_SENSORS + SENSORS  # correction and estimate, n each; transition, before, after, n^2

# --- events -------------------------------------------------------------------------------
E_GATED, E_RESTART, E_GAP, E_GAP_RESTART, E_BARO_JUMP, E_BARO_FROZEN, E_FAR, E_NO_COVARIANCE = (
    range(8)
)
EVENT_WIDTH = 3  # kind, time, size

# Names of fields, with the shapes of those that are arrays
_MEMORY: tuple[tuple[Any, ...], ...] = (
    # All that the loop carries from block to block
    ("n", np.int64),  # states, of which the first so many move
    ("width", np.int64),  # of rows: made up with zeros
    ("nav", (NAV_SIZE,)),
    # Removed: gyro bias, accelerometer scale and bias, gyro scale, misalignment of both
    ("sensors", (24,)),
    ("channel", (STATE_SIZE,)),  # of sinstool.methods.height.layout
    ("mean_c", (3, 3)),  # integral of C_nb over the substep
    ("mean_cf", (3, 3)),  # integral of C_nb[i, j] f[j]
    ("mean_cw", (3, 3)),  # integral of C_nb[i, j] omega[j]
    # the same of C_nb[i, j] omega[k], then of C_nb[i, j] f[k]: j and k of states.AXES_PAIRS
    ("mean_axes", (3, 12)),
    ("x", (WIDTH,)),  # estimate of the errors
    ("dx", (WIDTH,)),  # sum of the updates at this instant
    ("p", (SIZE, WIDTH)),
    ("product", (SIZE, WIDTH)),  # transition since the latest stored row
    ("ratio", (ROWS,)),  # adapted over given measurement variance
    ("changes_seen", (ROWS,)),
    ("latest", (ROWS,)),  # innovations over their sigma; NaN where there was none
    ("rejected", (ROWS,)),  # innovations of epochs rejected since the row was used last, or 0
    ("vehicle", (VEHICLE_SIZE,)),
    ("moved", (9,)),  # changes per second: latitude, longitude, height, velocity, rate
    # Times are in s, flags 0 or 1. Pairs: of epochs with a position; with velocity only
    ("started",),  # 1 after the first update
    ("now",),  # end of the update before
    ("from_time",),  # start of the substep, and latitude, height and velocity then
    ("from_latitude",),
    ("from_height",),
    ("from_velocity", (3,)),
    ("gains", (3,)),  # sums of the network's gains within the substep
    ("gain_count",),  # how many
    ("inputs", (3,)),  # sums of gain times K4 v_up
    ("rate", (3,)),  # angular rate and specific force of the latest update
    ("swing", (3,)),  # the rate that swings the antenna, at its end
    ("force", (3,)),
    ("recent", (6,)),  # rate and force, means of the latest half second or so
    ("bridge", (6,)),  # rate and force assumed within an IMU gap
    ("open",),  # 1 while measurements at this instant are being made
    ("instant_at",),  # time of the latest instant
    ("step",),  # what the channel would have changed the height by on engaging again, m
    ("step_set",),
    ("row_at",),  # time of the latest measurement of the correction
    ("baro_at",),  # time of the latest baro difference used as a measurement
    ("sample",),  # 1 where a baro sample came with this update; its difference, m, and age
    ("sample_difference",),
    ("sample_age",),
    ("sample_stamp",),
    ("row_streak",),  # consecutive baro differences that were rejected
    ("jump_at",),  # time of the barometer's latest jump
    ("distrust",),  # until when samples of the barometer are rejected
    ("used_at",),  # time of the latest epoch used
    ("begun",),  # 1 if the filter began anew since the latest stored row
    ("leaning",),  # 1: in a gap the vehicle may have tilted by a large angle
    ("in_gap",),  # 1 within an IMU gap
    ("level_until",),  # until when a tilt that was unknown may still be so
    ("window_seen",),  # epochs in the window so far
    ("far",),  # 1 after the warning that the navigation is far from the fixes
    ("streak", (2,)),  # consecutive epochs that were rejected, pair
    ("far_share", (2,)),  # share of the latest epochs beyond the gate with the noise given, pair
    ("seen_at", (2,)),  # time of the latest epoch, used or not, pair
    ("after_outage", (2,)),  # epochs that have yet to agree after an outage, pair
    ("rejected_since", (2,)),  # time of the first of the epochs rejected in a row, pair
    ("latest_fix", (2,)),  # latitude and longitude, rad
    ("restart_at",),  # time of the latest restart
    ("doubt",),  # factor on the gate and on the covariances put out, where restarts did not help
    ("constrained_at",),  # time of the latest constraint
    ("shaken",),  # 1 where the vehicle stands by the grid
    ("rolling", (6,)),  # rate and force, low-passed
    ("turned", (4,)),  # measured rotation since the latest constraint, and its duration
    # Counts: updates and epochs; constraints used, and rows of no slip and of wheels rejected
    ("updates",),
    ("epochs_used",),
    ("epochs_gated",),
    ("dropped",),  # epochs before the start
    ("restarts",),
    ("nis_sum",),
    ("nis_rows",),
    ("rests",),
    ("held",),
    ("wheels",),
    ("slips",),
    ("wheel_slips",),
    # Of this block
    ("keep", np.int64),  # 1: set rows for a smoother
    ("row", np.int64),  # the next of them
    ("events", np.int64),
    # Room to work in
    ("rates", (MOVING, WIDTH)),  # F of the moving states
    ("phi", (MOVING, WIDTH)),
    ("half", (MOVING, WIDTH)),
    ("decay", (WIDTH,)),
    ("h", (ROWS, WIDTH)),
    ("hp", (ROWS, WIDTH)),
    ("s", (ROWS, ROWS)),
    ("root", (ROWS, ROWS)),
    ("weight", (ROWS, ROWS)),
    ("nu", (ROWS,)),
    ("r", (ROWS,)),
    ("work", (ROWS,)),
    ("gain", (ROWS, WIDTH)),  # transposed, as is P H^T
    ("pht", (ROWS, WIDTH)),
    ("old", (SIZE, WIDTH)),
    ("axes", (3, 3)),  # of a land vehicle in NED, by rows; velocity, rate and force along them
    ("along", (3,)),
    ("about", (3,)),
    ("pull", (3,)),
)
# What does not change during a run
_MODEL: tuple[tuple[Any, ...], ...] = (
    ("where", np.int64, (INDEX_SIZE,)),  # FilterKind.index
    ("network", (NETWORK_PARAMETERS,)),  # of the vertical channel
    ("decay_rate", (WIDTH,)),  # 1/s
    ("noise", (WIDTH,)),  # power densities
    ("p0", (SIZE, WIDTH)),
    ("vehicle", (V_PARAMETERS,)),
    ("substep",),  # s
    ("closed",),  # 1: feedback
    ("has_network",),
    ("correction_row",),
    ("baro_row",),
    ("row_interval",),  # s
    ("lever", (3,)),
    ("baro_decay",),
    ("baro_white",),  # variance, m^2
    ("baro_sigma",),
    ("correction_variance",),
    ("k4",),
    ("adaptive",),  # 0 off, 1 fading, 2 window
    ("fading",),
    ("least",),
    ("most",),
    ("epsilon",),
    ("restart_after",),  # s
    ("max_gap",),
    ("gap_acceleration",),
    ("gap_tilt_rate",),
    ("gap_rate",),
    ("baro_gate",),
    ("measured",),  # 1: the gate measures the noise of fixes
    ("gnss_white", (ROWS,)),  # variances
    ("gnss_markov", (ROWS,)),  # variances of coloured noise, which has states of its own
    ("gnss_all", (ROWS,)),  # variances of all noise, for a filter without those states
    ("gates", (ROWS + 1,)),  # by number of rows
    ("channel_gate",),  # of the vertical channel at rest, m
    ("turn_variance",),  # of attitude about any axis per angle turned, rad
    ("across_variance",),  # and across the axis of the turn
    ("escalate",),  # 1: a restart soon after another has larger sigmas
)


def _record(fields: tuple[tuple[Any, ...], ...]) -> np.dtype[Any]:
    """Type of a record: float64, unless a field names another; arrays begin at lines."""
    names, formats, offsets, end = [], [], [], 0
    for name, *rest in fields:
        kind, shape = np.float64, ()
        for part in rest:
            if isinstance(part, tuple):
                shape = part
            else:
                kind = part
        one = np.dtype((kind, shape))
        end += -end % LINE if shape else 0
        names.append(name)
        formats.append(one)
        offsets.append(end)
        end += one.itemsize
    whole = {"names": names, "formats": formats, "offsets": offsets, "itemsize": end}
    return np.dtype((np.record, whole))


MEMORY, MODEL = _record(_MEMORY), _record(_MODEL)
Memory = np.record
"""Of the type MEMORY: what the loop carries from block to block, and room to work in."""
Model = np.record
"""Of the type MODEL."""


def new_memory(
    nav: FloatArray,
    sensors: FloatArray,
    p0: FloatArray,
    channel: FloatArray,
    vehicle: FloatArray,
) -> Memory:
    """Memory at the start of a run.

    Parameters
    ----------
    nav : ndarray, shape (10,)
    sensors : ndarray, shape (24,)
    p0 : ndarray, shape (n, n)
    channel : ndarray
        State of a vertical channel that has seen nothing.
    vehicle : ndarray, shape (VEHICLE_SIZE,)
        What is known of a land vehicle.
    """
    n = len(p0)
    m: Memory = zeros_on_lines((1,), MEMORY)[0]
    m.n, m.width = n, n + -n % WHOLE
    m.nav[:] = nav
    m.sensors[:] = sensors
    m.channel[:] = channel
    m.p[:n, :n] = p0
    np.fill_diagonal(m.product, 1.0)
    m.ratio[:] = 1.0
    m.latest[:] = np.nan
    m.decay[:] = 1.0
    m.vehicle[:] = vehicle
    return m


def new_model(
    where: IntArray,
    network: FloatArray,
    decay_rate: FloatArray,
    noise: FloatArray,
    p0: FloatArray,
    vehicle: FloatArray,
    parameters: Mapping[str, Any],
) -> Model:
    """Model of a filter.

    Parameters
    ----------
    where : ndarray of int64
        :attr:`~sinstool.methods.ins_gnss.states.FilterKind.index`.
    network : ndarray
        Parameters of the vertical channel.
    decay_rate, noise : ndarray, shape (n,)
        1/s, and power densities.
    p0 : ndarray, shape (n, n)
    vehicle : ndarray, shape (V_PARAMETERS,)
    parameters : Mapping
        All other fields.
    """
    n = len(p0)
    model: Model = zeros_on_lines((1,), MODEL)[0]
    model.where[:] = where
    model.network[:] = network
    model.decay_rate[:n] = decay_rate
    model.noise[:n] = noise
    model.p0[:n, :n] = p0
    model.vehicle[:] = vehicle
    for name, value in parameters.items():
        model[name] = value
    return model


def new_stored(rows: int, n: int) -> FloatArray:
    """Room for so many rows for a smoother; untouched memory costs nothing."""
    return np.empty((rows, R_STATES + 2 * n + 3 * n * n))
