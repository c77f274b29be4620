"""One error at a time on a simulated turntable: what it does to heading and to lambda2.

python benchmarks/hse_single_errors.py
python benchmarks/hse_single_errors.py --duration 120

Three logs at 20, 40 and 60 deg/s, lambda2 = -4.2 arcsec, the axis leaning 8e-4 rad to the East;
every row has one error more than that and prints the change it makes. K is the slope of heading
over rate by least squares, lambda2 from it by eq. (16) of Yu et al. 2013. Beside ours stand the
figures of an independent study of the same rig. It does not tell the phases of its encoder
harmonics, the directions of its matrix errors, where its turns begin and what its quanta round:
those rows can agree in size only. Headings are compared with the truth in the middle of the
log, which shifts a base that turns about Down by half an arcsec against a truth at its start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.common import ARCSEC, DEG_H, UG, numbers, parser, print_table
from sinstool.core.earth import EARTH_RATE
from sinstool.methods.hse.encoder import TableAngle, table_angle
from sinstool.methods.hse.rig import Rig
from sinstool.methods.hse.segments import SegmentRules, find_segments, turn_statistics
from sinstool.methods.hse.whole_turn import align_whole_turns
from sinstool.simulation.hse_rig import HseRigErrors, HseRigLog, HseRigSetup, hse_rig
from tests.helpers.hse_exact import lambda2_from_slope

LATITUDE = 0.49
LEAN = 8e-4
RATES = np.radians([20.0, 40.0, 60.0])
XI = (1e-4, 1e-4, 1e-4)
# In the phase that with xi and the heading of the base hurts most, A sqrt(2) xi / (2 w_ie cos L):
# 5.49 arcsec/(rad/s) of K, less what the calibration errors and smoothing make of it.
HARMONIC = (1, 5.0 * ARCSEC, 0.7 + np.pi / 4.0)
TURN_S = 1.0 * ARCSEC / 600.0


def base_setup(heading: float = 0.7) -> HseRigSetup:
    """Leaning to the East, wherever the base points."""
    return HseRigSetup(
        latitude=LATITUDE,
        heading=heading,
        theta=LEAN * np.sin(heading),
        gamma=-LEAN * np.cos(heading),
        epsilon=(2.2 * ARCSEC, 0.8 * ARCSEC, 1.2 * ARCSEC),
    )


@dataclass(frozen=True)
class Row:
    """One error, and the published changes.

    `published` are changes of heading at 20, 40, 60 deg/s in arcsec (None where not given), of
    K in arcsec/(rad/s), of lambda2 by heading and by the axis in arcsec.
    """

    label: str
    errors: HseRigErrors = field(default_factory=HseRigErrors)
    setup: Callable[[HseRigSetup], HseRigSetup] = lambda setup: setup
    latitude: float = LATITUDE
    whole_turns: bool = True
    published: str = ""


def with_xi(setup: HseRigSetup) -> HseRigSetup:
    """The same with the axes of ``b`` misaligned."""
    return replace(setup, xi=XI)


def with_accel_matrix(setup: HseRigSetup) -> HseRigSetup:
    """The same with accelerometers whose matrix the user takes for 1."""
    return replace(setup, K_a=((1.001, 0.0, 0.0), (0.001, 1.0, 0.0), (0.001, -0.001, 0.999)))


DRIFTS = zip(
    ("N", "E", "D"),
    (".04 const; 0; 0; 0", "-25.9 const; 0; 0; 0", ".5 const; 0; 0; -.009"),
    np.eye(3),
    strict=True,
)
ROWS = (
    *(
        Row(f"accel bias 50 ug, {axis}", HseRigErrors(accel_bias=tuple(50 * UG * unit)),
            published="-0.002; 0.0005; 0; 0")
        for axis, unit in zip("xyz", np.eye(3), strict=True)
    ),
    Row("gyro bias 0.003 deg/h, x", HseRigErrors(gyro_bias=(0.003 * DEG_H, 0.0, 0.0)),
        published="0.0215 const; 0; 0; 0.0091"),
    Row('encoder LSB 0.18"', HseRigErrors(encoder_lsb=0.18 * ARCSEC),
        published="-0.058 const; 0; 0; 0"),
    Row('encoder LSB 20"', HseRigErrors(encoder_lsb=20 * ARCSEC),
        published="-0.005..-0.023; -0.025; -0.006; 0"),
    Row('encoder 1N 5"', HseRigErrors(encoder_harmonics=(HARMONIC,)),
        published="-.03/-.05/-.08; -0.076; -0.018; 0"),
    Row('encoder 1N 5", xi 1e-4', HseRigErrors(encoder_harmonics=(HARMONIC,)), with_xi,
        published="1.81/3.63/5.44; 5.20; 1.25; 0"),
    Row('encoder 2N 5", xi 1e-4', HseRigErrors(encoder_harmonics=((2, *HARMONIC[1:]),)), with_xi,
        published="0; 0; 0; 0"),
    *(
        Row(f"stale encoder {us} us", HseRigErrors(encoder_delay=us * 1e-6), published=published)
        for us, published in (
            (10, ".72/1.44/2.16; 2.06; .498; 0"),
            (100, "7.2/14.4/21.6; 20.6; 4.98; 0"),
            (1000, "72/144/216; 206; 49.8; 0"),
        )
    ),
    Row("rate ripple 1e-4, xi 1e-4", HseRigErrors(ripple=1e-4), with_xi, published="0; 0; 0; 0"),
    Row("lever arm 0.1 m", HseRigErrors(lever_arm=(0.1, 0.05, 0.1)), published="0; 0; 0; 0"),
    Row("accel matrix 1e-3", setup=with_accel_matrix, published="-0.12; 0.028; 0; 0"),
    *(
        Row(f'gyro quantum {q}"', HseRigErrors(gyro_quantum=q * ARCSEC), published=published)
        for q, published in (
            (0.01, "<=0.07; .06; .01; <=.002"),
            (0.1, "<=0.9; .9; .2; <=.002"),
            (1.0, "<=10; 1.4; .3; <=.002"),
        )
    ),
    Row("gyro scale +1 ppm", HseRigErrors(gyro_scale=1e-6),
        published="-1.79 @40; -2.56; -0.619; same"),
    Row("gyro scale +20 ppm", HseRigErrors(gyro_scale=20e-6),
        published="-35.8 @40; -51.3; -12.4; same"),
    Row("clock +1 ppm", HseRigErrors(clock=1e-6), published="-1.79 @40; -2.56; -0.619; same"),
    Row("latitude +1e-3 rad", latitude=LATITUDE + 1e-3, published="0; 0; 0.002; 0.070"),
    Row("not whole turns", whole_turns=False, published="-44/-28/0; 63; 15; 0"),
    Row("not whole turns, xi 1e-4", setup=with_xi, whole_turns=False,
        published="657/1280/0; -941; -227; 0"),
    *(
        Row(f'base tilts 1"/600 s about {name}', HseRigErrors(base_drift_n=tuple(TURN_S * unit)),
            published=published)
        for name, published, unit in DRIFTS
    ),
)  # fmt: skip


def aligned(log: HseRigLog, latitude: float, whole_turns: bool) -> tuple[float, float, float]:
    """Heading, lambda2 along the axis and C23 from one log."""
    rig = Rig(log.believed_K_g, log.believed_C_s_to_b, latitude=latitude)
    pieces = table_angle(log.time_ns, log.encoder_time_ns, log.encoder_position, rig.encoder)
    if not whole_turns:
        return averaged(log, rig, pieces[0])
    rules = SegmentRules(settle_s=0.0, min_turns=4, min_duration_s=10.0, align_duration_s=1e9)
    (segment,) = find_segments(pieces, rules).used
    turns = turn_statistics(pieces[segment.piece], segment, log.gyro, log.accel)
    a = align_whole_turns(turns, rig)
    return a.heading, -3.0 * a.c_axial, a.C23


def averaged(log: HseRigLog, rig: Rig, piece: TableAngle) -> tuple[float, float, float]:
    """The same from means over all samples, whole turns or not."""
    rows = slice(piece.first, piece.first + len(piece))
    middle = 0.5 * (piece.alpha[1:] + piece.alpha[:-1])
    means = []
    for samples, matrix in ((log.gyro, rig.gyro_to_b), (log.accel, rig.accel_to_b)):
        x, y, z = (samples[rows] @ matrix.T).T
        cos, sin = np.cos(middle), np.sin(middle)
        means.append(np.array([(cos * x - sin * y).mean(), (sin * x + cos * y).mean(), z.mean()]))
    rate = (piece.alpha[-1] - piece.alpha[0]) / (len(piece) * piece.interval_s)
    w = means[0] - [0.0, 0.0, rate]
    down = -means[1] / np.linalg.norm(means[1])
    east = np.cross(down, w)
    east /= np.linalg.norm(east)
    north = np.cross(east, down)
    u_z = EARTH_RATE * (
        north[2] * np.cos(rig.require_latitude()) - down[2] * np.sin(rig.require_latitude())
    )
    c = (w[2] - u_z) / (rate + u_z)
    return float(np.arctan2(east[0], north[0])), float(-3.0 * c), float(east[2])


def result(row: Row, duration: float) -> tuple[np.ndarray, float, float, float]:
    """Headings, K, lambda2 from K and the mean lambda2 along the axis."""
    setup = row.setup(base_setup())
    heading, axial, lean = [], [], []
    for rate in RATES:
        log = hse_rig([(float(rate), duration)], setup, row.errors)
        psi, lambda2, c23 = aligned(log, row.latitude, row.whole_turns)
        heading.append(np.angle(np.exp(1j * (psi - setup.heading))))
        axial.append(lambda2)
        lean.append(c23)
    psi = np.array(heading)
    slope = float(np.polyfit(RATES, psi, 1)[0])
    lambda2 = lambda2_from_slope(slope, float(np.mean(lean)), row.latitude)
    return psi, slope, lambda2, float(np.mean(axial))


def changes(row: Row, duration: float = 600.0) -> tuple[np.ndarray, float, float, float]:
    """What the row's error changes, in arcsec: headings, K, lambda2 by heading and by the axis.

    Compared are logs that have all but the error: for a misalignment xi, logs with xi.
    """
    clean = Row("", setup=row.setup if row.setup is with_xi else lambda setup: setup)
    ours, base = result(row, duration), result(clean, duration)
    psi = (ours[0] - base[0]) / ARCSEC
    rest = [float(a - b) / ARCSEC for a, b in zip(ours[1:], base[1:], strict=True)]
    return psi, rest[0], rest[1], rest[2]


def main() -> None:
    """Print the table."""
    options = parser(__doc__)
    options.add_argument("--duration", type=float, default=600.0, help="of each log, s")
    duration = options.parse_args().duration
    psi, slope, lambda2, axial = result(Row(""), duration)
    print(
        f'without further errors: heading error {numbers(psi / ARCSEC, ".4f", ", ")}", '
        f'K {slope / ARCSEC:.4f}"/(rad/s), lambda2 {lambda2 / ARCSEC:.5f}" by heading, '
        f'{axial / ARCSEC:.5f}" by the axis\n'
    )

    def cells(row: Row) -> list[str]:
        headings, *others = changes(row, duration)
        shown = (numbers(headings, ".4f", " / "), *(f"{value:.4f}" for value in others))
        return [row.label, *shown, row.published]

    head = ("error", "heading 20 / 40 / 60", "K", "lambda2", "axial", "published")
    print_table(head, map(cells, ROWS))


if __name__ == "__main__":
    main()
