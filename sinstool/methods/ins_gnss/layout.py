"""Data of the compiled loop as arrays, and the index of each number.

numba's cache of a kernel does not notice that a number here changed, nor a kernel that it calls
in another file: after editing, delete ``__pycache__`` of this folder.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.methods.height.layout import STATE_SIZE
from sinstool.methods.strapdown.navigation import SIZE as NAV_SIZE

ROWS = 6  # of a GNSS epoch
# Of a single measurement. A literal 1 would be a type of its own to numba, and every function that
# it is passed to would be compiled twice.
ONE_ROW: Any = np.int64(1)

# --- numbers carried ----------------------------------------------------------------------
N_STARTED = 0  # 1 after the first update
N_NOW = 1  # end of the update before, s
N_FROM = 2  # start of the substep, s, and latitude, height and velocity then
N_LATITUDE = 3
N_HEIGHT = 4
N_VELOCITY = 5  # three
N_GAIN = 8  # sums of the network's gains within the substep, three
N_GAINS = 11  # how many
N_INPUT = 12  # sums of gain times K4 v_up, three
N_OPEN = 15  # 1 while measurements at this instant are being made
N_STEP = 16  # what the channel would have changed the height by on engaging again, m
N_STEP_SET = 17
N_ROW_AT = 18  # time of the latest measurement of the correction
N_BARO_AT = 19  # of the latest baro difference looked at as a measurement
N_SAMPLE = 20  # 1 where a baro sample came with this update; its difference, m, and age, s
N_SAMPLE_DIFFERENCE = 21
N_SAMPLE_AGE = 22
N_SAMPLE_STAMP = 23
N_REJECTED = 24  # epochs with a position rejected one after the other
N_USED_AT = 25  # time of the latest epoch used
N_BEGUN = 26  # 1 if the filter began anew since the latest stored row
N_GAP = 27  # 1 within an IMU gap
N_WINDOW = 28  # innovations in the window so far
N_UPDATES = 29  # IMU updates so far
N_FAR = 30  # 1 after the warning that the navigation is far from the fixes
N_EPOCHS_USED = 31
N_EPOCHS_GATED = 32
N_RESTARTS = 33
N_NIS_SUM = 34
N_NIS_ROWS = 35
N_RATE = 36  # angular rate and specific force of the latest update, three each
N_FORCE = 39
N_DROPPED = 42  # epochs before the start
N_ROW_STREAK = 43  # baro differences rejected one after the other
N_JUMP_AT = 44  # time of the barometer's latest jump
N_DISTRUST = 45  # until when samples of the barometer are turned down
N_INSTANT_AT = 46  # time of the latest instant
N_FAR_SHARE = 47  # of the latest epochs with a position, too far off for the noise given
N_TURN = 48  # rotation within the substep, body axes, three
N_REJECTED_VELOCITIES = 51  # epochs with velocity only rejected one after the other
N_FAR_SHARE_VELOCITIES = 52  # of those with velocity only
N_SEEN_AT = 53  # time of the latest epoch with a position, used or not, s; with velocity only
N_AFTER_OUTAGE = 55  # epochs that have yet to agree after an outage; with velocity only
N_REJECTED_SINCE = 57  # time of the first of the epochs rejected in a row, s; with velocity only
N_RESTART_AT = 59  # time of the latest restart, s
N_FIX = 60  # the latest fix: latitude and longitude, rad
N_DOUBT = 62  # factor on the gate and on the covariances that come out, since restarts did not help
N_CONSTRAINED_AT = 63  # time of the latest constraint, s
N_ROLLING = 64  # rate and force, low-passed, three each
N_TURNED = 70  # rotation since the latest constraint as measured, three, and the time of it, s
N_RESTS = 74  # constraints used: rest, no slip, wheels; and rows of no slip and wheels turned down
N_HELD = 75
N_WHEELS = 76
N_SLIPS = 77
N_WHEEL_SLIPS = 78
NUMBERS = 79

# --- parameters ---------------------------------------------------------------------------
P_SUBSTEP = 0
P_CLOSED = 1  # 1: feedback
P_NETWORK = 2
P_CORRECTION_ROW = 3
P_BARO_ROW = 4
P_ROW_INTERVAL = 5
P_LEVER = 6  # three
P_BARO_DECAY = 9
P_BARO_WHITE = 10  # variance, m^2
P_BARO_SIGMA = 11
P_CORRECTION_VARIANCE = 12
P_K4 = 13
P_ADAPTIVE = 14  # 0 off, 1 fading, 2 window
P_FADING = 15
P_LEAST = 16
P_MOST = 17
P_EPSILON = 18
P_RESTART_AFTER = 19  # s
P_MAX_GAP = 20
P_GAP_ACCELERATION = 21
P_GAP_RATE = 22
P_BARO_GATE = 23
P_GNSS_WHITE = 24  # variances, six
P_GNSS_MARKOV = 30  # variances that have states of their own, six
P_GNSS_ALL = 36  # variances without those states, six
P_GATES = 42  # by number of rows, 0 to 6
P_CHANNEL_GATE = 49  # of the vertical channel at rest, m
P_TURN = 50  # variance of attitude per angle turned, rad
P_ESCALATE = 51  # 1: restarts that do not help admit more
PARAMETERS = 52

# --- parameters of a land vehicle -----------------------------------------------------------
V_ORIGIN = 0  # time of the first point of its grid, s, and between points, s
V_STEP = 1
V_INTERVAL = 2  # between constraints, s
V_REST_VELOCITY = 3  # noise of constraints, power densities
V_REST_RATE = 4
V_LATERAL = 5
V_VERTICAL = 6
V_WHEEL = 7
V_PARAMETERS = 8
# Columns of the grid: whether the vehicle rests (2: surely), whether it may be held not to slide,
# and its wheels' speed, m/s, NaN where unknown
G_REST, G_ROLLS, G_WHEEL = range(3)
# What is known of the vehicle: C_vb by rows, then axle, sideslip, squat, wheel scale
VEHICLE_SIZE = 13

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
O_COVARIANCE = NAV_SIZE + 7  # upper triangles of position, velocity, attitude
OUTPUT = NAV_SIZE + 25

# --- events -------------------------------------------------------------------------------
E_GATED, E_RESTART, E_GAP, E_GAP_RESTART, E_BARO_JUMP, E_BARO_FROZEN, E_FAR, E_NO_COVARIANCE = (
    range(8)
)
EVENT_WIDTH = 3  # kind, time, size


class Memory(NamedTuple):
    """All that the loop carries from block to block, and room to work in.

    n states, of which m move.
    """

    nav: FloatArray  # (10,)
    sensors: FloatArray  # (12,) gyro bias, accelerometer scale and bias, gyro scale taken off
    channel: FloatArray  # of sinstool.methods.height.layout
    numbers: FloatArray  # (NUMBERS,)
    mean_c: FloatArray  # (3, 3) integral of C_nb over the substep
    mean_cf: FloatArray  # (3, 3) integral of C_nb[i, j] f[j]
    mean_cw: FloatArray  # (3, 3) integral of C_nb[i, j] omega[j]
    x: FloatArray  # (n,) estimate of the errors
    dx: FloatArray  # (n,) sum of the updates at this instant
    p: FloatArray  # (n, n)
    product: FloatArray  # (n, n) transition since the latest stored row
    ratio: FloatArray  # (6,) adapted over given measurement variance
    window: FloatArray  # (N, 6) squares of innovations
    changes: FloatArray  # (N or 0, 6) of innovations over their sigma, squared and halved
    changes_seen: FloatArray  # (6,)
    latest: FloatArray  # (6,) innovations over their sigma; NaN where there was none
    rejected: FloatArray  # (6,) innovations of epochs rejected since the row was used last, or 0
    rates: FloatArray  # (m, n) F of the moving states
    phi: FloatArray  # (m, n)
    half: FloatArray  # (m, n)
    decay: FloatArray  # (n,)
    h: FloatArray  # (6, n)
    hp: FloatArray  # (6, n)
    s: FloatArray  # (6, 6)
    root: FloatArray  # (6, 6)
    weight: FloatArray  # (6, 6)
    nu: FloatArray  # (6,)
    r: FloatArray  # (6,)
    gain: FloatArray  # (n, 6)
    pht: FloatArray  # (n, 6)
    old: FloatArray  # (n, n)
    vehicle: FloatArray  # (VEHICLE_SIZE,)
    moved: FloatArray  # (9,) latitude, longitude, height, velocity, rate per second in an update


class Model(NamedTuple):
    """What does not change during a run."""

    where: IntArray  # FilterKind.index
    parameters: FloatArray  # (PARAMETERS,)
    network: FloatArray  # parameters of the vertical channel
    decay_rate: FloatArray  # (n,) 1/s
    noise: FloatArray  # (n,) power densities
    p0: FloatArray  # (n, n)
    vehicle: FloatArray  # (V_PARAMETERS,)
    grid: FloatArray  # (g, 3) by time; without points, the vehicle has no constraints


class Stored(NamedTuple):
    """Rows for a smoother; see StoredEpochs."""

    time: FloatArray
    update: IntArray
    transition: FloatArray
    before: FloatArray
    after: FloatArray
    correction: FloatArray
    estimate: FloatArray
    nav: FloatArray
    sensors: FloatArray
    restart: FloatArray


def new_memory(
    nav: FloatArray,
    sensors: FloatArray,
    p0: FloatArray,
    channel: FloatArray,
    moving: int,
    window: int,
    changes: int,
    vehicle: FloatArray,
) -> Memory:
    """Memory at the start of a run.

    Parameters
    ----------
    nav : ndarray, shape (10,)
    sensors : ndarray, shape (12,)
    p0 : ndarray, shape (n, n)
    channel : ndarray
        State of a vertical channel that has seen nothing.
    moving : int
        m, of the n states.
    window : int
        Epochs of the innovation window.
    changes : int
        Epochs whose noise is measured by the gate; 0: it is not.
    vehicle : ndarray, shape (VEHICLE_SIZE,)
        What is known of a land vehicle.
    """
    n = len(p0)
    assert channel.shape == (STATE_SIZE,)
    return Memory(
        nav=nav.copy(),
        sensors=sensors.copy(),
        channel=channel.copy(),
        numbers=np.zeros(NUMBERS),
        mean_c=np.zeros((3, 3)),
        mean_cf=np.zeros((3, 3)),
        mean_cw=np.zeros((3, 3)),
        x=np.zeros(n),
        dx=np.zeros(n),
        p=p0.copy(),
        product=np.eye(n),
        ratio=np.ones(ROWS),
        window=np.zeros((window, ROWS)),
        changes=np.zeros((changes, ROWS)),
        changes_seen=np.zeros(ROWS),
        latest=np.full(ROWS, np.nan),
        rejected=np.zeros(ROWS),
        rates=np.zeros((moving, n)),
        phi=np.zeros((moving, n)),
        half=np.zeros((moving, n)),
        decay=np.ones(n),
        h=np.zeros((ROWS, n)),
        hp=np.zeros((ROWS, n)),
        s=np.zeros((ROWS, ROWS)),
        root=np.zeros((ROWS, ROWS)),
        weight=np.zeros((ROWS, ROWS)),
        nu=np.zeros(ROWS),
        r=np.zeros(ROWS),
        gain=np.zeros((n, ROWS)),
        pht=np.zeros((n, ROWS)),
        old=np.zeros((n, n)),
        vehicle=vehicle.copy(),
        moved=np.zeros(9),
    )


def new_stored(rows: int, n: int, correction_size: int) -> Stored:
    """Room for so many rows; untouched memory costs nothing.

    Parameters
    ----------
    correction_size : int
        Width of the sensors' estimates.
    """
    return Stored(
        np.empty(rows),
        np.empty(rows, dtype=np.int64),
        np.empty((rows, n, n)),
        np.empty((rows, n, n)),
        np.empty((rows, n, n)),
        np.empty((rows, n)),
        np.empty((rows, n)),
        np.empty((rows, NAV_SIZE)),
        np.empty((rows, correction_size)),
        np.zeros(rows),
    )
