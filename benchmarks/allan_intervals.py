"""Do the intervals of noise terms hold the truth? Simulated rests with known coefficients.

For each kind of sensor and each length of rest so many runs are simulated, and their terms fitted.
The table says of each term how often it is taken for visible, how often what is said of it is true
(the 95 % interval holds the truth, or the bound where it is not visible), how often the interval
alone. Of terms that are not in the simulation, or below a twentieth of every Allan variance, it
says how often one is reported with an interval that does not hold the truth. With ``--random`` no
two runs are of the same sensor or length: terms and rests are drawn anew for each run, and the
table is over all of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks import common
from sinstool.methods.allan.likelihood import NAMES, NoiseFit, Term
from sinstool.methods.allan.model import allan_terms
from tests.helpers.allan import fit_segments, simulate_terms

RANDOM_HEAD = ("term", "there", "visible", "interval", "bound", "falsely reported")
HEAD = ("sensor", "samples", "term", "truth", "visible", "true", "interval", "falsely reported")
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
        hold = sum(held(t, truth) for t in seen)
        below = sum(truth <= t.high for t in unseen)
        yield (
            case.name,
            "+".join(map(str, rest)),
            name,
            f"{truth:g}",
            f"{len(seen)}",
            f"{100.0 * (hold + below) / len(fits):.1f} %",
            f"{100.0 * hold / len(seen):.1f} %" if seen and there[name] else "-",
            "-" if there[name] else f"{len(seen) - hold} of {len(fits)}",
        )


def random_case(seed: int) -> Case:
    """A sensor and its rests: each term there or not, its size over two or three decades."""
    draw = np.random.default_rng([seed, 1])

    def size(least: float, most: float) -> float:
        return float(np.exp(draw.uniform(np.log(least), np.log(most)))) * (draw.random() < 0.6)

    terms = (size(0.5, 20.0), 1.0, size(3e-3, 0.3), size(3e-5, 1e-2), size(1e-8, 1e-5))
    count = 1 if draw.random() < 0.6 else int(draw.integers(2, 7))
    lengths = np.exp(draw.uniform(np.log(2e3), np.log(7.2e5), count)).astype(int)
    return Case(f"random {seed}", terms, (tuple(lengths.tolist()),))


def held(term: Term, truth: float) -> bool:
    """Whether what is said of a term is true."""
    return term.low <= truth <= term.high


def random_rows(first: int, runs: int, processes: int) -> Iterator[tuple[str, ...]]:
    """A row for each term, over so many sensors, and one for all terms."""

    def one(seed: int) -> tuple[Case, NoiseFit]:
        case = random_case(seed)
        return case, fit_of(case, case.rests[0], seed)

    said = []
    for case, fit in common.over_seeds(one, range(first, first + runs), processes, 10):
        there = visible(case.terms, case.rests[0])
        for name, truth in zip(NAMES, case.terms, strict=True):
            said.append((name, there[name], fit.terms[name], truth))
    for name in (*NAMES, "all"):
        of = [(there, t, truth) for n, there, t, truth in said if name in (n, "all")]
        seen = [(t, truth) for there, t, truth in of if there and t.value is not None]
        unseen = [(t, truth) for _, t, truth in of if t.value is None]
        false = sum(
            not there and t.value is not None and not held(t, truth) for there, t, truth in of
        )
        hold, below = sum(held(*s) for s in seen), sum(held(*s) for s in unseen)
        yield (
            name,
            f"{sum(there for there, _, _ in of)} of {len(of)}",
            f"{len(seen)}",
            f"{100.0 * hold / max(len(seen), 1):.1f} %",
            f"{100.0 * below / max(len(unseen), 1):.1f} % of {len(unseen)}",
            f"{false} of {sum(not there for there, _, _ in of)}",
        )


def main() -> None:
    """Print the table."""
    parser = common.parser(__doc__, runs=500, processes=1, only="", first=0)
    parser.add_argument("--random", action="store_true", help="draw sensors and lengths")
    options = parser.parse_args()
    if options.random:
        print(common.line(RANDOM_HEAD) + "\n" + "|---" * len(RANDOM_HEAD) + "|")
        for cells in random_rows(options.first, options.runs, options.processes):
            print(common.line(cells), flush=True)
        return
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
