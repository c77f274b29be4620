"""The error model: how the errors drive each other, and the propagation of covariance.

With ``R_M``, ``R_N`` the radii of curvature plus the height, the mechanisation is

    lat' = v_N/R_M    lon' = v_E/(R_N cos lat)    h' = -v_D
    v'   = C f + g(lat, h) + (0, 0, A) - (2 omega_ie + omega_en) x v
    C'   = C [omega_ib x] - [(omega_ie + omega_en) x] C

and F its derivative, gravity's north component and the change of the radii with latitude
included: nothing is left out, so that F can be tested against differences of the mechanisation.
Errors of the sensors enter as ``dv' = C (K f + bias)`` and ``psi' = -C (K_g omega + gyro bias)``,
where K and K_g hold the misalignments beside their diagonals.

From measurement to measurement ``P <- Phi (P + Q/2) Phi^T + Q/2``, with Phi of which only the rows
of moving states are not trivial, and at each sample of the barometer what the damping network does
to the errors.

References
----------
.. [1] Zhang J., Ren S., Tan M., "A study of altitude damping in INS/GNSS integrated navigation
   system", J. Air Force Engineering University 4(6), 2003, 37-39 (in Chinese), eq. (4).
.. [2] P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
   Systems", 2nd ed., 2013, section 14.2.4: the local-navigation-frame error model, approximate
   where this one is not.
"""

from __future__ import annotations

from math import cos, exp, sin, sqrt

from sinstool.core import earth
from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.parts import part
from sinstool.methods import products
from sinstool.methods.ins_gnss import states

_N, _E, _D = states.POSITION, states.POSITION + 1, states.POSITION + 2
_VN, _VE, _VD = states.VELOCITY, states.VELOCITY + 1, states.VELOCITY + 2
_PN, _PE, _PD = states.ATTITUDE, states.ATTITUDE + 1, states.ATTITUDE + 2


# No sensor's axes are further from square than this, rad.
MOST_ANGLE = 0.2


@part()
def errors_of(
    e: FloatArray, bias: int, scale: int, axes: int, d: float, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """What sensors measured too much over an update.

    They show ``(I + K) true + bias d``, so the bias comes off before the rest: that of a bare chip,
    degrees a second, times K is more than what is left unknown of it.

    Parameters
    ----------
    e : ndarray, shape (24,)
        Sensor errors: see `sensors` of :mod:`~sinstool.methods.ins_gnss.layout`.
    bias, scale, axes : int
        Where in them those of these sensors begin.
    d : float
        s.
    x, y, z : float
        Measured, rad or m/s.
    """
    ux, uy, uz = x - e[bias] * d, y - e[bias + 1] * d, z - e[bias + 2] * d
    sx, sy, sz = 1.0 / (1.0 + e[scale]), 1.0 / (1.0 + e[scale + 1]), 1.0 / (1.0 + e[scale + 2])
    tx, ty, tz = ux * sx, uy * sy, uz * sz
    # To second order in the angles; those of a filter that diverges must not grow by their squares
    most = 0.0
    for k in range(6):
        most = max(most, abs(e[axes + k]))
    for _ in range(2 if most < MOST_ANGLE else 1):
        tx, ty, tz = (
            (ux - e[axes] * ty - e[axes + 1] * tz) * sx,
            (uy - e[axes + 2] * tx - e[axes + 3] * tz) * sy,
            (uz - e[axes + 4] * tx - e[axes + 5] * ty) * sz,
        )
    return x - tx, y - ty, z - tz


@part()
def radii(lat: float, h: float) -> tuple[float, float]:
    """Radii of curvature plus height, m: along the meridian and across."""
    s = sin(lat)
    square = 1.0 - earth.ECCENTRICITY_SQUARED * s * s
    transverse = earth.SEMI_MAJOR_AXIS / sqrt(square)
    return transverse * (1.0 - earth.ECCENTRICITY_SQUARED) / square + h, transverse + h


@part()
def error_rates(
    index: IntArray,
    lat: float,
    h: float,
    vn: float,
    ve: float,
    vd: float,
    mean_c: FloatArray,
    mean_cf: FloatArray,
    mean_cw: FloatArray,
    mean_axes: FloatArray,
    scale: float,
    k1: float,
    k2: float,
    k3: float,
    out: FloatArray,
) -> None:
    """F of the moving states.

    Parameters
    ----------
    index : ndarray of int64
        :attr:`sinstool.methods.ins_gnss.states.FilterKind.index`.
    lat, h : float
        rad, m.
    vn, ve, vd : float
        m/s.
    mean_c, mean_cf, mean_cw : ndarray, shape (3, 3)
        ``C_nb[i, j]``, ``C_nb[i, j] f_b[j]`` and ``C_nb[i, j] omega_b[j]``, integrated over a time.
    mean_axes : ndarray, shape (3, 12)
        The same of ``C_nb[i, j] omega_b[k]``, then of ``C_nb[i, j] f_b[k]``: j and k of
        :data:`states.AXES_PAIRS`.
    scale : float
        One over that time, 1/s.
    k1, k2, k3 : float
        Gains of a damping network that acts all the time; 0 where it acts at samples.
    out : ndarray, shape (m, n)
        Set: row i is the derivative of moving state i.
    """
    s = sin(lat)
    c = cos(lat)
    t = s / c
    sec2 = 1.0 / (c * c)
    square = 1.0 - earth.ECCENTRICITY_SQUARED * s * s
    root = sqrt(square)
    transverse = earth.SEMI_MAJOR_AXIS / root
    meridian = transverse * (1.0 - earth.ECCENTRICITY_SQUARED) / square
    rm = meridian + h
    rn = transverse + h
    bend = earth.ECCENTRICITY_SQUARED * s * c / square
    dm = 3.0 * meridian * bend  # derivatives of the radii by latitude
    dn = transverse * bend
    im = 1.0 / rm
    i_n = 1.0 / rn
    om = earth.EARTH_RATE * c
    os = earth.EARTH_RATE * s
    en = ve * i_n
    nm = vn * im

    # gravity and its derivatives
    fall = earth.GRAVITY_PER_HEIGHT - earth.GRAVITY_PER_HEIGHT_SIN2 * s * s
    relative = h / earth.SEMI_MAJOR_AXIS
    ground = earth.NORMAL_GRAVITY_EQUATOR * (1.0 + earth.SOMIGLIANA * s * s) / root
    ground_lat = ground * (2.0 * earth.SOMIGLIANA * s * c / (1.0 + earth.SOMIGLIANA * s * s) + bend)
    aloft = 1.0 - fall * h + 3.0 * relative * relative
    gd_lat = ground_lat * aloft + ground * 2.0 * earth.GRAVITY_PER_HEIGHT_SIN2 * s * c * h
    gd_h = ground * (-fall + 6.0 * relative / earth.SEMI_MAJOR_AXIS)
    gn_lat = 2.0 * earth.NORTH_GRAVITY_PER_HEIGHT * h * (c * c - s * s)
    gn_h = 2.0 * earth.NORTH_GRAVITY_PER_HEIGHT * s * c

    fn = scale * (mean_cf[0, 0] + mean_cf[0, 1] + mean_cf[0, 2])
    fe = scale * (mean_cf[1, 0] + mean_cf[1, 1] + mean_cf[1, 2])
    fd = scale * (mean_cf[2, 0] + mean_cf[2, 1] + mean_cf[2, 2])

    moving = index[states.I_MOVING]
    for i in range(moving):
        for j in range(index[states.I_STATES]):
            out[i, j] = 0.0

    # Lengths: the radii that they are made with change as the vehicle moves.
    out[_N, _N] = -vd * im
    out[_N, _D] = nm
    out[_N, _VN] = 1.0
    lean = (dn - rn * t) * i_n
    out[_E, _N] = -en * lean * rn * im
    out[_E, _E] = lean * nm - vd * i_n
    out[_E, _D] = en
    out[_E, _VE] = 1.0
    out[_D, _VD] = 1.0

    tan_lat = sec2 * i_n - t * dn * i_n * i_n  # of tan(lat)/R_N
    out[_VN, _N] = im * (gn_lat - nm * vd * dm * im - 2.0 * om * ve - ve * ve * tan_lat)
    out[_VN, _D] = -(gn_h - nm * vd * im + en * en * t)
    out[_VN, _VN] = vd * im
    out[_VN, _VE] = -2.0 * (os + en * t)
    out[_VN, _VD] = nm
    out[_VN, _PE] = -fd
    out[_VN, _PD] = fe

    out[_VE, _N] = im * (2.0 * om * vn - 2.0 * os * vd + ve * vn * tan_lat - en * vd * dn * i_n)
    out[_VE, _D] = en * i_n * (vn * t + vd)
    out[_VE, _VN] = 2.0 * os + en * t
    out[_VE, _VE] = i_n * (vn * t + vd)
    out[_VE, _VD] = 2.0 * om + en
    out[_VE, _PN] = fd
    out[_VE, _PD] = -fn

    out[_VD, _N] = im * (gd_lat + 2.0 * os * ve + en * en * dn + nm * nm * dm)
    out[_VD, _D] = -(gd_h + en * en + nm * nm)
    out[_VD, _VN] = -2.0 * nm
    out[_VD, _VE] = -2.0 * (om + en)
    out[_VD, _PN] = -fe
    out[_VD, _PE] = fn

    wn = om + en
    we = -nm
    wd = -os - en * t
    out[_PN, _N] = im * (-os - en * dn * i_n)
    out[_PN, _D] = en * i_n
    out[_PN, _VE] = i_n
    out[_PN, _PE] = wd
    out[_PN, _PD] = -we
    out[_PE, _N] = im * nm * dm * im
    out[_PE, _D] = -nm * im
    out[_PE, _VN] = -im
    out[_PE, _PN] = -wd
    out[_PE, _PD] = wn
    out[_PD, _N] = im * (-om - ve * tan_lat)
    out[_PD, _D] = -en * t * i_n
    out[_PD, _VE] = -t * i_n
    out[_PD, _PN] = we
    out[_PD, _PE] = -wn

    gyro = index[states.I_GYRO_BIAS]
    factor = index[states.I_ACCEL_SCALE]
    bias = index[states.I_ACCEL_BIAS]
    gyro_factor = index[states.I_GYRO_SCALE]
    for i in range(3):
        for j in range(3):
            out[_PN + i, gyro + j] = -scale * mean_c[i, j]
            out[_VN + i, bias + j] = scale * mean_c[i, j]
            if factor >= 0:
                out[_VN + i, factor + j] = scale * mean_cf[i, j]
            if gyro_factor >= 0:
                out[_PN + i, gyro_factor + j] = -scale * mean_cw[i, j]
    axes = index[states.I_GYRO_AXES]
    if axes >= 0:
        accel_axes = index[states.I_ACCEL_AXES]
        for i in range(3):
            for j in range(6):
                out[_PN + i, axes + j] = -scale * mean_axes[i, j]
                out[_VN + i, accel_axes + j] = scale * mean_axes[i, 6 + j]

    a = index[states.I_CORRECTION]
    if a >= 0:
        # e = dh - dh_B, and dh = -dD
        b = index[states.I_BARO]
        out[_VD, a] = 1.0
        out[_D, _D] -= k1
        out[_D, b] -= k1
        out[_VD, _D] -= k2
        out[_VD, b] -= k2
        out[a, _D] -= k3
        out[a, b] -= k3


@part()
def transition(
    index: IntArray,
    rates: FloatArray,
    decay_rate: FloatArray,
    delta: float,
    phi: FloatArray,
    decay: FloatArray,
) -> None:
    """``I + F delta + (F delta)^2/2`` of the moving states, and the decay of the others.

    Parameters
    ----------
    index : ndarray of int64
        See :func:`error_rates`.
    rates : ndarray, shape (m, w)
        F; the number w of its columns is `I_WIDTH` of the index, of which zeros are the last.
    decay_rate : ndarray, shape (w,)
        1/s, of the states that do not move.
    delta : float
        s.
    phi : ndarray, shape (m, w)
        Set.
    decay : ndarray, shape (n,)
        Set, but for the moving states, to ``exp(-decay_rate delta)``.
    """
    m = index[states.I_MOVING]
    n = index[states.I_STATES]
    width = index[states.I_WIDTH]
    second = 0.5 * delta * delta
    for i in range(m):
        for j in range(width):
            phi[i, j] = (delta - second * decay_rate[j]) * rates[i, j]
        for k in range(m):
            f = second * rates[i, k]
            if f != 0.0:
                for j in range(width):
                    phi[i, j] += f * rates[k, j]
        phi[i, i] += 1.0
    for j in range(m, n):
        decay[j] = 1.0 if decay_rate[j] == 0.0 else exp(-decay_rate[j] * delta)


# Sums may be made in any order, or they would not be made several at a time.
@part(fastmath={"reassoc", "contract"})
def propagate_covariance(
    index: IntArray,
    phi: FloatArray,
    decay: FloatArray,
    noise: FloatArray,
    delta: float,
    p: FloatArray,
    half: FloatArray,
) -> None:
    """Covariance over a substep.

    Parameters
    ----------
    index : ndarray of int64
        :attr:`sinstool.methods.ins_gnss.states.FilterKind.index`.
    phi, decay : ndarray, shape (m, w) and (n,)
        See :func:`transition`.
    noise : ndarray, shape (n,)
        Power densities.
    delta : float
        s.
    p : ndarray, shape (n, w)
        Changed in place; stays symmetric to the last bit.
    half : ndarray, shape (m, w)
        Room to work in.
    """
    m = index[states.I_MOVING]
    coupled = index[states.I_COUPLED]
    n = index[states.I_STATES]
    for i in range(n):
        p[i, i] += 0.5 * delta * noise[i]
    products.product(phi, p, m, coupled, index[states.I_WIDTH], half)
    for i in range(m):
        for j in range(i + 1):
            total = 0.0
            for k in range(coupled):
                total += half[i, k] * phi[j, k]
            p[i, j] = total
            p[j, i] = total
        for j in range(m, n):
            total = half[i, j] * decay[j]
            p[i, j] = total
            p[j, i] = total
    for i in range(m, n):
        if decay[i] != 1.0:
            for j in range(m, n):
                p[i, j] *= decay[i]
                p[j, i] = p[i, j] if j != i else p[j, i] * decay[i]
    for i in range(n):
        p[i, i] += 0.5 * delta * noise[i]


@part()
def propagate_estimate(
    index: IntArray, phi: FloatArray, decay: FloatArray, x: FloatArray, half: FloatArray
) -> None:
    """Estimate over a substep: x, shape (n,), is changed; see :func:`propagate_covariance`."""
    m = index[states.I_MOVING]
    for i in range(m):
        total = 0.0
        for k in range(index[states.I_COUPLED]):
            total += phi[i, k] * x[k]
        half[i, 0] = total
    for i in range(m):
        x[i] = half[i, 0]
    for i in range(m, index[states.I_STATES]):
        x[i] *= decay[i]


@part()
def propagate_product(
    index: IntArray, phi: FloatArray, decay: FloatArray, product: FloatArray, half: FloatArray
) -> None:
    """Product of transitions, shape (n, w), times that of a substep."""
    m = index[states.I_MOVING]
    n = index[states.I_STATES]
    # Of rows of other states there is no more than the diagonal
    products.product(phi, product, m, m, index[states.I_WIDTH], half)
    for i in range(m):
        for j in range(m):
            product[i, j] = half[i, j]
        for j in range(m, n):
            product[i, j] = half[i, j] + phi[i, j] * product[j, j]
    for i in range(m, n):
        product[i, i] *= decay[i]


@part()
def baro_correction(
    index: IntArray,
    l1: float,
    l2: float,
    l3: float,
    offset: float,
    white: float,
    p: FloatArray,
    x: FloatArray,
    product: FloatArray,
    row: FloatArray,
) -> None:
    """Effect of the network's correction at a sample on the errors: ``M = I + L m^T``.

    The sample moves height, velocity and A by gains times
    ``e = dh - dh_B - w + K4 v_up``; in these states, ``m = (-1 at D, -1 at baro)`` and
    ``L = (l1 at D, l2 at v_D, l3 at A)``.

    Parameters
    ----------
    index : ndarray of int64
    l1, l2, l3 : float
        Gains: 1, 1/s, 1/s^2.
    offset : float
        ``K4 v_up``, m.
    white : float
        Variance of the sample's white noise w, m^2.
    p, x, product : ndarray
        Changed: covariance, estimate, product of transitions.
    row : ndarray, shape (n,)
        Room to work in.
    """
    n = index[states.I_STATES]
    a = index[states.I_CORRECTION]
    b = index[states.I_BARO]
    for j in range(n):
        row[j] = -p[_D, j] - p[b, j]
    square = white - row[_D] - row[b]
    for j in range(n):
        p[_D, j] += l1 * row[j]
        p[_VD, j] += l2 * row[j]
        p[a, j] += l3 * row[j]
    for j in range(n):
        p[j, _D] += l1 * row[j]
        p[j, _VD] += l2 * row[j]
        p[j, a] += l3 * row[j]
    p[_D, _D] += l1 * l1 * square
    p[_VD, _VD] += l2 * l2 * square
    p[a, a] += l3 * l3 * square
    p[_D, _VD] += l1 * l2 * square
    p[_D, a] += l1 * l3 * square
    p[_VD, a] += l2 * l3 * square
    p[_VD, _D] = p[_D, _VD]
    p[a, _D] = p[_D, a]
    p[a, _VD] = p[_VD, a]
    e = offset - x[_D] - x[b]
    x[_D] += l1 * e
    x[_VD] += l2 * e
    x[a] += l3 * e
    for j in range(n):
        e = -product[_D, j] - product[b, j]
        product[_D, j] += l1 * e
        product[_VD, j] += l2 * e
        product[a, j] += l3 * e
