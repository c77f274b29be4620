"""Do the intervals of noise terms hold the truth? Simulated rests with known coefficients.

For each kind of sensor and each length of rest so many runs are simulated, and their terms fitted.
The table says of each term how often it is taken for visible, how often what is said of it is true
(the 95 % interval holds the truth, or the bound where it is not visible), how often the interval
alone, and how often a term is claimed that is not in the simulation or below a twentieth of every
Allan variance.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks import common
from sinstool.methods.allan.fit import NAMES, NoiseFit, fit_segments
from sinstool.methods.allan.model import allan_terms
from sinstool.simulation.noise_terms import simulate_terms

HEAD = ("sensor", "samples", "term", "truth", "visible", "true", "interval", "claimed")
# A term with a smaller share of the Allan variance at each averaging time cannot be seen.
HIDDEN = 0.05


@dataclass(frozen=True)
class Case:
    """A sensor: roots of the variances of its terms in units of samples, and its rests."""

    name: str
    terms: tuple[float, float, float, float, float]
    rests: tuple[tuple[int, ...], ...]


# At 100 Hz: 20 s, 2 min, 20 min, 2 h; and six pauses of 30 s to 4 min.
PAUSES = (3000, 6000, 9000, 12000, 18000, 24000)
CASES = (
    Case("white only", (0.0, 1.0, 0.0, 0.0, 0.0), ((2000,), (12000,), (120000,), PAUSES)),
    Case("mems", (0.0, 1.0, 0.03, 2e-4, 0.0), ((2000,), (12000,), (120000,), (720000,), PAUSES)),
    Case("walking", (0.0, 1.0, 0.0, 2e-3, 0.0), ((12000,), (120000,), PAUSES)),
    Case("fibre", (4.0, 1.0, 0.01, 0.0, 0.0), ((12000,), (120000,))),
    Case("warming", (0.0, 1.0, 0.0, 0.0, 1e-6), ((120000,),)),
)


def visible(terms: Sequence[float], rest: Sequence[int]) -> dict[str, bool]:
    """Which terms are a fair part of some Allan variance of a rest."""
    longest = max(rest) // 4
    lags = np.unique(np.round(2.0 ** np.arange(0.0, np.log2(longest), 1.0 / 3.0)).astype(np.int64))
    parts = np.column_stack(
        [allan_terms(lags) * np.square(terms[:4]), 0.5 * terms[4] ** 2 * lags.astype(float) ** 2]
    )
    share = (parts / parts.sum(axis=1, keepdims=True)).max(axis=0)
    return dict(zip(NAMES, (share > HIDDEN).tolist(), strict=True))


def fit_of(case: Case, rest: Sequence[int], seed: int) -> NoiseFit:
    """One simulated rest."""
    generator = np.random.default_rng([seed, *rest])
    segments = [simulate_terms(n, *case.terms, generator)[:, None] for n in rest]
    (fit,) = fit_segments(segments)
    assert fit is not None
    return fit


def rows(case: Case, rest: Sequence[int], fits: Sequence[NoiseFit]) -> Iterator[tuple[str, ...]]:
    """A row for each term."""
    there = visible(case.terms, rest)
    for name, truth in zip(NAMES, case.terms, strict=True):
        terms = [fit.terms[name] for fit in fits]
        seen = [t for t in terms if t.value is not None]
        unseen = [t for t in terms if t.value is None]
        held = sum(t.low <= truth <= t.high for t in seen)
        below = sum(truth <= t.high for t in unseen)
        yield (
            case.name,
            "+".join(map(str, rest)),
            name,
            f"{truth:g}",
            f"{len(seen)}",
            f"{100.0 * (held + below) / len(fits):.1f} %",
            f"{100.0 * held / len(seen):.1f} %" if seen and there[name] else "-",
            "-" if there[name] else f"{len(seen)} of {len(fits)}",
        )


def main() -> None:
    """Print the table."""
    options = common.parser(__doc__, runs=500, processes=1, only="").parse_args()
    print(common.line(HEAD) + "\n" + "|---" * len(HEAD) + "|")
    for case in CASES:
        if options.only not in case.name:
            continue
        for rest in case.rests:

            def one(seed: int, case: Case = case, rest: Sequence[int] = rest) -> NoiseFit:
                return fit_of(case, rest, seed)

            fits = common.over_seeds(one, range(options.runs), options.processes, 10)
            for cells in rows(case, rest, fits):
                print(common.line(cells), flush=True)


if __name__ == "__main__":
    main()
