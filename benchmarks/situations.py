"""Situations in which sinstool once chose wrongly for the user and said nothing, one by one.

Each is made as random logs by another program (`situation_logs.py`: drives, sensors and receivers
of all kinds, by the seed) and processed with the options that a user would give. Printed for every
log are the exit status, the largest and the root mean square horizontal error, those of tilt and
heading, and errors over their sigmas (root mean squares of position, height, tilt, heading), what
was said of it, and a verdict:

right   errors are within 3 of their sigmas, and nothing is missing
said    they are not, or there is no result, but a finding names the cause, or the status is 3
WRONG   neither, or something is said that is not so

python benchmarks/situations.py
python benchmarks/situations.py --seeds 10 --first 100 --only barometer
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

import sinstool
from benchmarks.common import FloatArray, numbers, over_seeds, parser, print_table
from benchmarks.situation_logs import SITUATIONS, Made, Situation
from sinstool.core.errors import SinstoolError
from sinstool.core.rotation import to_dcm
from sinstool.core.streams import Solution
from sinstool.core.units import DEGREE
from tests.helpers.imulogs import T0
from tests.helpers.unseen_drives import RATE, Motion

MOST_SIGMAS = 3.0
MOST_DEG = 3.0  # of tilt, where there is no sigma
STEP = 20  # of rows that are scored
HEAD = ["situation", "before", "seed", "log", "status", "position m", "tilt deg", "heading deg",
        "over sigma", "said", "verdict"]  # fmt: skip


def main() -> None:
    options = parser(__doc__, seeds=3, first=1, jobs=1)
    options.add_argument("--only", default="", help="situations whose name holds this")
    args = options.parse_args()
    verdicts: Counter[str] = Counter()

    def rows() -> Iterator[list[str]]:
        for situation in SITUATIONS:
            if args.only in situation.name:
                seeds = range(args.first, args.first + args.seeds)
                for row in over_seeds(partial(outcome, situation), seeds, args.jobs):
                    verdicts[row[-1].split(":")[0]] += 1
                    yield row

    print_table(HEAD, rows())
    print(f"\n{', '.join(f'{count} {name}' for name, count in sorted(verdicts.items()))}")


def outcome(situation: Situation, seed: int) -> list[str]:
    """A row of the table."""
    number = [kind.name for kind in SITUATIONS].index(situation.name)
    random = np.random.default_rng([seed, number])
    with tempfile.TemporaryDirectory() as folder:
        made = situation.make(random, Path(folder))
        before = [situation.name, situation.before, str(seed), made.what]
        try:
            result = sinstool.process(made.path, **made.options)
        except SinstoolError as exc:
            named = any(option in str(exc) for option in situation.says)
            verdict = "said" if named else "WRONG: refused"
            text = str(exc).removeprefix(f"{made.path}: ")
            return [*before, str(exc.exit_code), "-", "-", "-", "-", text, verdict]
        kinds = {finding.kind for finding in result.findings if finding.severity}
        error, ratio = scores(result, made.truth)
        status = result.summary.exit_status
        verdict = judged(situation, made, result, error, ratio, kinds)
    return [
        *before,
        str(status),
        *(numbers(error[name]) for name in ("position", "tilt", "heading")),
        numbers(ratio.values(), ".2f"),
        " ".join(sorted(kinds)),
        verdict,
    ]


def judged(
    situation: Situation,
    made: Made,
    result: sinstool.Result,
    error: dict[str, list[float]],
    ratio: dict[str, float],
    kinds: set[str],
) -> str:
    """Whether the result is right, or says that it is not."""
    false, lacking = kinds & set(situation.never), made.wants(result)
    if false:
        return f"WRONG: {', '.join(sorted(false))} is not so"
    if lacking:
        return f"WRONG: {lacking}"
    far = [name for name, value in ratio.items() if value > MOST_SIGMAS]
    if not np.isfinite(ratio["tilt"]) and error["tilt"][-1] > MOST_DEG:
        far = ["tilt without a sigma"]
    if not far:
        return "right"
    if result.summary.exit_status == 3 or kinds & set(situation.says):
        return "said"
    return f"WRONG: {', '.join(far)} beyond {MOST_SIGMAS:g} sigmas"


def scores(
    result: sinstool.Result, truth: Motion
) -> tuple[dict[str, list[float]], dict[str, float]]:
    """Largest and root mean square errors, m and deg, and root mean squares over their sigmas."""
    solution = at_samples(result.solution)
    seconds = (solution.time_ns - T0) * 1e-9
    place = np.zeros((3, len(seconds))) if solution.position is None else solution.position.T
    at = np.searchsorted(truth.seconds, seconds - 1e-6)
    off = truth.c_nb[np.minimum(at, len(truth.c_nb) - 1)] @ np.swapaxes(to_dcm(solution.q_nb), 1, 2)
    heading = np.arctan2(off[:, 1, 0], off[:, 0, 0])
    if not result.summary.alignment.north_referenced:
        heading = np.angle(np.exp(1j * (heading - heading[0])))
    tilt = np.stack([off[:, 2, 1], off[:, 0, 2]], axis=1)
    position = truth.errors_of(seconds, *place, np.zeros((len(seconds), 3)), truth.c_nb[at])[:, :3]
    covariance = solution.covariance_position_n, solution.covariance_attitude_n
    of_place, of_turn = (
        np.full((len(seconds), 3), np.nan)
        if block is None
        else np.sqrt(np.diagonal(block, axis1=1, axis2=2))
        for block in covariance
    )
    there = solution.position is not None
    level, tilted = np.hypot(*position[:, :2].T), np.hypot(*tilt.T) / DEGREE
    error = {
        "position": [level.max(), rms(level)] if there else [None],
        "tilt": [tilted.max(), rms(tilted)],
        "heading": [np.abs(heading).max() / DEGREE, rms(heading) / DEGREE],
    }
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = {
            "position": rms(position[:, :2] / of_place[:, :2]),
            "height": rms(position[:, 2] / of_place[:, 2]),
            "tilt": rms(tilt / of_turn[:, :2]),
            "heading": rms(heading / of_turn[:, 2]),
        }
    return error, ratio


def at_samples(solution: Solution) -> Solution:
    """Some of the rows whose times are those of the simulation."""
    steps = (solution.time_ns - T0) * 1e-9 * RATE
    even = np.flatnonzero(np.abs(steps - np.round(steps)) < 1e-3)
    return solution.rows(even[::STEP])


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(np.square(values)))) if np.isfinite(values).any() else np.nan


if __name__ == "__main__":
    main()
