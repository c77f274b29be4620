"""The 47 error states: their order, their signs, and the filters that leave some out.

========  ==============  ========================================================  ==========
index     name            error                                                     unit
========  ==============  ========================================================  ==========
0 - 2     position        computed - true, north, east, down                        m
3 - 5     velocity        computed - true, NED                                      m/s
6 - 8     attitude        psi, NED: ``C_nb = (I + [psi x]) C_nb computed``          rad
9         correction      A of the damping network less what it ought to be, 0      m/s^2
10        baro            barometric height as used less the true height            m
11 - 13   gyro bias       true less the one taken off already, body axes            rad/s
14 - 16   accel scale     the same, as a fraction, body axes                        1
17 - 19   accel bias      the same, body axes                                       m/s^2
20 - 22   gyro scale      the same, as a fraction                                   1
23 - 28   gyro axes       the same, of their misalignment: see below                rad
29 - 34   accel axes      the same                                                  rad
35 - 37   GNSS position   slow (Markov) error of the fixes, NED                     m
38 - 40   GNSS velocity   the same, NED                                             m/s
41 - 46   land vehicle    true less the one used: see below
========  ==============  ========================================================  ==========

A navigation is corrected by taking its errors off; a sensor's bias by adding. ``psi`` is the
small rotation in NED that takes the attitude computed to the true one. An error of the height is
the negative of one of "down". Position errors are lengths, ``(R_M + h) dlat`` and
``(R_N + h) cos(lat) dlon``: so all numbers in a covariance are of reasonable size, at any
latitude.

What a sensor measures along the other two axes is its misalignment: x of y, x of z, y of x, y of
z, z of x, z of y. Only filters of IMUs whose turns show it have these states:
:attr:`FilterKind.with_axes`. Gyros and accelerometers have them together: in a vehicle that stays
level a gyro that feels its turns acts as the bias of an accelerometer does, but for the upward
force as it gains speed, and a misaligned accelerometer feels that as well.

The states of a vehicle that cannot slide are what its constraints are off by: pitch and yaw of the
mount, rad, of the small rotation in vehicle axes that takes vectors in them as computed to the true
ones; how far the IMU is ahead of the axle that cannot slide, m; sideslip of that axle and squat of
the body per acceleration, rad/(m/s^2); scale of the wheels' speed, as a fraction. Only filters of
such a vehicle have them: :attr:`FilterKind.on_wheels`.

States 0 to 9 drive each other ("moving"); all others only decay, and those up to the
accelerometers' axes drive the moving ones. A filter with fewer states keeps this order and closes
the gaps; everything computed works with its numbers of states.

References
----------
.. [1] Zhang J., Ren S., Tan M., "A study of altitude damping in INS/GNSS integrated navigation
   system", J. Air Force Engineering University 4(6), 2003, 37-39 (in Chinese): the states but for
   the gyro scale, there in ENU.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from sinstool.core.arrays import IntArray
from sinstool.core.errors import ConfigurationError

POSITION = 0
VELOCITY = 3
ATTITUDE = 6
CORRECTION = 9
BARO = 10
GYRO_BIAS = 11
ACCEL_SCALE = 14
ACCEL_BIAS = 17
GYRO_SCALE = 20
GYRO_AXES = 23
ACCEL_AXES = 29
GNSS_POSITION = 35
GNSS_VELOCITY = 38
LAND_VEHICLE = 41
SIZE = 47
MOVING = 10  # of them at most
# Loops of compiled code run over multiples of so many states, made up with zeros: what is left of
# others is gone through one by one. Rows of so many numbers begin where lines of the cache do.
WHOLE, WIDTH = 4, 48
# Within the block of the land vehicle
MOUNT_PITCH, MOUNT_YAW, AXLE, SIDESLIP, SQUAT, WHEEL_SCALE = range(6)

_BLOCKS = {
    POSITION: 3,
    VELOCITY: 3,
    ATTITUDE: 3,
    CORRECTION: 1,
    BARO: 1,
    GYRO_BIAS: 3,
    ACCEL_SCALE: 3,
    ACCEL_BIAS: 3,
    GYRO_SCALE: 3,
    GYRO_AXES: 6,
    ACCEL_AXES: 6,
    GNSS_POSITION: 3,
    GNSS_VELOCITY: 3,
    LAND_VEHICLE: 6,
}

FilterName = Literal[
    "network-29a",
    "network-26a",
    "network-26",
    "baro-24",
    "plain-15",
    "markov-21",
    "markov-24",
    "markov-27",
]

# Of each state of the axes: the sensor, and the axis along which it measures something
AXES_PAIRS = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))

# Where the numbers of an index array are: see FilterKind.index.
I_CORRECTION, I_BARO, I_GYRO_BIAS, I_ACCEL_SCALE, I_ACCEL_BIAS, I_GYRO_SCALE = 0, 1, 2, 3, 4, 5
I_GYRO_AXES, I_ACCEL_AXES, I_GNSS_POSITION, I_GNSS_VELOCITY, I_LAND_VEHICLE = 6, 7, 8, 9, 10
I_MOVING, I_COUPLED, I_STATES, I_WIDTH = 11, 12, 13, 14
INDEX_SIZE = 15


@dataclass(frozen=True)
class FilterKind:
    """States of a filter, and its use of a barometer.

    Attributes
    ----------
    blocks : tuple of int
        First index, among the 47, of each block of states that it has.
    network : bool
        The barometer damps the vertical channel of the mechanisation.
    correction_row : bool
        The network's own correction A, a number the filter can look up, is a measurement.
    baro_row : bool
        The difference of the heights is a measurement.
    """

    name: str
    blocks: tuple[int, ...]
    network: bool = False
    correction_row: bool = False
    baro_row: bool = False

    @cached_property
    def states(self) -> IntArray:
        """Indices, among the 47, of its states in its own order; shape (n,)."""
        return np.concatenate([np.arange(b, b + _BLOCKS[b]) for b in self.blocks])

    @property
    def size(self) -> int:
        """Number of states n."""
        return len(self.states)

    @property
    def needs_baro(self) -> bool:
        """Whether it means anything without a barometer."""
        return BARO in self.blocks

    @property
    def without_baro(self) -> FilterKind:
        """The filter in its place where there is no barometer."""
        if not self.needs_baro:
            return self
        other = FILTERS["markov-27" if GYRO_SCALE in self.blocks else "markov-24"]
        return other.with_axes if GYRO_AXES in self.blocks else other

    @property
    def on_wheels(self) -> FilterKind:
        """The same, with the states of a land vehicle."""
        return replace(self, blocks=(*self.blocks, LAND_VEHICLE))

    @property
    def with_axes(self) -> FilterKind:
        """The same, with the states of misaligned sensors, behind those of the gyros' scale."""
        behind = self.blocks.index(GYRO_SCALE) + 1
        blocks = (*self.blocks[:behind], GYRO_AXES, ACCEL_AXES, *self.blocks[behind:])
        return replace(self, blocks=blocks)

    def first(self, block: int) -> int:
        """Own index of a block's first state; -1 if it has none.

        Parameters
        ----------
        block : int
            POSITION, ..., LAND_VEHICLE.
        """
        if block not in self.blocks:
            return -1
        return sum(_BLOCKS[b] for b in self.blocks[: self.blocks.index(block)])

    @cached_property
    def index(self) -> IntArray:
        """Indices for compiled code; see the numbers ``I_...`` of this module.

        Own indices of the blocks from the correction on (-1: not there), then how many states
        move, how many are coupled to those, how many there are, and how many that makes with zeros.
        """
        first = [
            self.first(block)
            for block in (
                CORRECTION,
                BARO,
                GYRO_BIAS,
                ACCEL_SCALE,
                ACCEL_BIAS,
                GYRO_SCALE,
                GYRO_AXES,
                ACCEL_AXES,
                GNSS_POSITION,
                GNSS_VELOCITY,
                LAND_VEHICLE,
            )
        ]
        moving = int(np.sum(self.states < BARO))
        coupled = int(np.sum(self.states < GNSS_POSITION))
        width = self.size + -self.size % WHOLE
        return np.array([*first, moving, coupled, self.size, width], dtype=np.int64)


_VEHICLE = (POSITION, VELOCITY, ATTITUDE)
_GNSS = (GNSS_POSITION, GNSS_VELOCITY)
_ALL = tuple(b for b in _BLOCKS if b not in (GYRO_AXES, ACCEL_AXES, LAND_VEHICLE))
_PUBLISHED = tuple(b for b in _ALL if b != GYRO_SCALE)

FILTERS: dict[str, FilterKind] = {
    kind.name: kind
    for kind in (
        FilterKind("network-29a", _ALL, network=True, correction_row=True),
        FilterKind("network-26a", _PUBLISHED, network=True, correction_row=True),
        FilterKind("network-26", _PUBLISHED, network=True),
        # 24 states of vehicle, sensors and GNSS, and the barometer's own error beside them
        FilterKind("baro-24", tuple(b for b in _PUBLISHED if b != CORRECTION), baro_row=True),
        FilterKind("markov-27", tuple(b for b in _ALL if b not in (CORRECTION, BARO))),
        FilterKind("markov-24", tuple(b for b in _PUBLISHED if b not in (CORRECTION, BARO))),
        FilterKind("markov-21", (*_VEHICLE, GYRO_BIAS, ACCEL_BIAS, *_GNSS)),
        FilterKind("plain-15", (*_VEHICLE, GYRO_BIAS, ACCEL_BIAS)),
    )
}
"""The filters by name. ``network-26`` is that of [1]_; the others leave parts of it out or tell
it more."""


def filter_kind(name: str) -> FilterKind:
    """Look a filter up.

    Raises
    ------
    ConfigurationError
        If there is none of that name.
    """
    try:
        return FILTERS[name]
    except KeyError:
        raise ConfigurationError(
            f"filter {name!r} is not known", "one of " + ", ".join(FILTERS)
        ) from None
