"""Ten thousand logs on a hundred workers: the schedule, simulated.

    python benchmarks/schedule.py

prints the table of docs/ten-thousand-logs.md. Events are simulated, not logs: workers start, take
the next log, go through it, reading from and writing to a store that all of them share, and die now
and then. What a log costs is an option, so that figures of your own machines can be put in:
`benchmarks/many_logs.py` prints seconds a log, and bytes.
"""

from __future__ import annotations

import argparse
import heapq
import random
from collections import deque
from dataclasses import dataclass, replace
from itertools import count
from math import exp


@dataclass(frozen=True)
class Farm:
    """What the logs are, and who does them.

    Attributes
    ----------
    minutes, spread : float
        Median length of a log, and the standard deviation of the logarithm of lengths.
    longest : float
        Minutes.
    compute : float
        Seconds of a worker for a minute of log.
    moved_mb : float
        Megabytes read and written for a minute of log.
    store, link : float
        MB/s of the store for all workers together, and of one worker.
    start : float
        Seconds from a worker's start to its first log.
    dispatch : float
        Seconds in which the scheduler gives out one log.
    life : float
        Hours that a worker lives in the mean; 0: for ever.
    replaced : float
        Seconds until another one takes its place.
    deadly : float
        Share of logs that kill every worker that tries them.
    attempts : int
        After so many deaths a log is given up.
    order : {'largest', 'found', 'smallest'}
    """

    logs: int = 10_000
    workers: int = 100
    minutes: float = 10.0
    spread: float = 1.0
    longest: float = 360.0
    compute: float = 0.33
    moved_mb: float = 15.4
    store: float = 5000.0
    link: float = 500.0
    start: float = 3.0
    dispatch: float = 0.002
    life: float = 0.0
    replaced: float = 60.0
    deadly: float = 0.0
    attempts: int = 4
    order: str = "largest"
    seed: int = 1


@dataclass
class Report:
    """How it went.

    Attributes
    ----------
    makespan, bound : float
        Seconds from the first start to the last output, and what no order can beat: all work shared
        evenly, or the longest log.
    used : float
        Share of the workers' time in which a log that was finished was worked on.
    tail : float
        Seconds from the first worker that finds nothing to do to the end.
    done, given_up, deaths : int
    lost : float
        Share of the work that deaths threw away.
    """

    makespan: float
    bound: float
    used: float
    tail: float
    done: int
    given_up: int
    deaths: int
    lost: float


def lengths(farm: Farm) -> list[float]:
    """Minutes of each log, in the order in which they are found."""
    draw = random.Random(farm.seed)
    drawn = [farm.minutes * exp(draw.gauss(0.0, farm.spread)) for _ in range(farm.logs)]
    return [min(max(minutes, 1.0), farm.longest) for minutes in drawn]


class _Work:
    """Logs that are worked on at once: all go on alike, at the speed that the store allows."""

    def __init__(self, farm: Farm) -> None:
        self._farm = farm
        self.left: dict[int, float] = {}  # minutes of log, by worker
        self._now = 0.0

    def speed(self) -> float:
        """Minutes of log a second, of each worker."""
        farm = self._farm
        alone = farm.compute + farm.moved_mb / farm.link
        shared = farm.moved_mb * len(self.left) / farm.store
        return 1.0 / max(alone, shared)

    def pass_to(self, now: float) -> None:
        """Go on until now."""
        gone = self.speed() * (now - self._now)
        for worker in self.left:
            self.left[worker] -= gone
        self._now = now

    def next_end(self) -> tuple[float, int] | None:
        """When the first of them ends, and of which worker; None where nothing is done."""
        if not self.left:
            return None
        worker = min(self.left, key=lambda w: self.left[w])
        return self._now + max(self.left[worker], 0.0) / self.speed(), worker


def simulate(farm: Farm) -> Report:
    """One run of all logs."""
    minutes = lengths(farm)
    draw = random.Random(farm.seed + 1)
    deadly = {log for log in range(farm.logs) if draw.random() < farm.deadly}
    order = list(range(farm.logs))
    if farm.order != "found":
        order.sort(key=lambda log: minutes[log], reverse=farm.order == "largest")
    waiting = deque(order)
    work, tie = _Work(farm), count()
    events: list[tuple[float, int, str, int, int]] = []
    # Of each worker: its log, and when it took it; and which life it leads
    busy: dict[int, tuple[int, float]] = {}
    lives = [0] * farm.workers
    deaths: dict[int, int] = {}
    fallen, done, given_up, useful, wasted = 0, 0, 0, 0.0, 0.0
    free_at, idle_since, now = 0.0, None, 0.0

    def at(time: float, what: str, worker: int) -> None:
        heapq.heappush(events, (time, next(tie), what, worker, lives[worker]))

    def live(worker: int, time: float) -> None:
        at(time + farm.start, "ready", worker)
        if farm.life > 0.0:
            at(time + draw.expovariate(1.0 / (3600.0 * farm.life)), "dies", worker)

    for worker in range(farm.workers):
        live(worker, 0.0)
    while done + given_up < farm.logs:
        ending = work.next_end()
        if ending is not None and (not events or ending[0] <= events[0][0]):
            now, worker = ending
            what, life = "ended", lives[worker]
        else:
            now, _, what, worker, life = heapq.heappop(events)
        work.pass_to(now)
        if life != lives[worker]:
            continue
        if what == "ended" and busy[worker][0] in deadly:
            what = "dies"
        if what == "ready":
            if not waiting:
                idle_since = now if idle_since is None else idle_since
                continue
            busy[worker] = waiting.popleft(), now
            free_at = max(free_at, now) + farm.dispatch
            at(free_at, "given", worker)
        elif what == "given":
            log = busy[worker][0]
            work.left[worker] = minutes[log] * (draw.random() if log in deadly else 1.0)
        elif what == "ended":
            del work.left[worker]
            done, useful = done + 1, useful + now - busy.pop(worker)[1]
            at(now, "ready", worker)
        else:
            fallen += 1
            lives[worker] += 1
            work.left.pop(worker, None)
            if worker in busy:
                log, begun = busy.pop(worker)
                wasted += now - begun
                deaths[log] = deaths.get(log, 0) + 1
                if deaths[log] >= farm.attempts:
                    given_up += 1
                else:
                    waiting.appendleft(log)
                    idle_since = None
            live(worker, now + farm.replaced)
    alone = farm.compute + farm.moved_mb / farm.link
    shared = max(alone / farm.workers, farm.moved_mb / farm.store)
    bound = max(sum(minutes) * shared, max(minutes) * alone) + farm.start
    tail = 0.0 if idle_since is None else now - idle_since
    used = useful / (farm.workers * now)
    lost = wasted / max(useful + wasted, 1e-9)
    return Report(now, bound, used, tail, done, given_up, fallen, lost)


CASES = {
    "largest first": {},
    "in the order found": {"order": "found"},
    "smallest first": {"order": "smallest"},
    "a store of 1 GB/s": {"store": 1000.0},
    "a store of 300 MB/s": {"store": 300.0},
    "a scheduler that takes 50 ms a log": {"dispatch": 0.05},
    "workers that live for 2 h": {"life": 2.0},
    "workers that live for 20 min": {"life": 1.0 / 3.0},
    "one log in a thousand kills its worker": {"deadly": 0.001},
    "logs cut at 60 min": {"longest": 60.0},
}


def main() -> None:
    """Print the table."""
    usual = Farm()
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    for name in ("logs", "workers", "seed"):
        parser.add_argument(f"--{name}", type=int, default=getattr(usual, name))
    for name in ("minutes", "spread", "longest", "compute", "moved_mb", "store", "link"):
        option = f"--{name.replace('_', '-')}"
        parser.add_argument(option, type=float, default=getattr(usual, name))
    farm = Farm(**vars(parser.parse_args()))
    all_hours = sum(lengths(farm)) / 60.0
    print(f"{farm.logs} logs, {all_hours:.0f} h in all, {farm.workers} workers\n")
    head = ("case", "min", "of the bound", "used", "idle at the end, min", "deaths", "thrown away")
    print(f"| {' | '.join((*head, 'given up'))} |")
    print("|---|---|---|---|---|---|---|---|")
    for name, changes in CASES.items():
        r = simulate(replace(farm, **changes))
        print(
            f"| {name} | {r.makespan / 60.0:.1f} | {r.makespan / r.bound:.2f} | {r.used:.0%} |"
            f" {r.tail / 60.0:.1f} | {r.deaths} | {r.lost:.1%} | {r.given_up} |"
        )


if __name__ == "__main__":
    main()
