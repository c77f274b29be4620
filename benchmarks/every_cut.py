"""Logs of 20 kB cut at every byte: what --salvage still reads, and how long the slowest cut takes.

For each format and compression one log is written, cut behind every byte, and read with
--salvage. Recovered messages must be the first of the log and must never become fewer as the
cut moves right; nothing but errors of ours may come out. Status 1 where that fails.

    python benchmarks/every_cut.py
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from benchmarks.common import parser
from sinstool.core.errors import SinstoolError
from sinstool.io.readers import open_log
from tests.helpers.logs import read_back
from tests.io.readers.cuts import LOGS, expected


def main() -> int:
    """Cut, read, and print."""
    step = parser(__doc__, step=1).parse_args().step
    failed = False
    print("log                bytes    cuts  messages  falls  wrong  slowest, ms")
    for name, make in LOGS.items():
        with tempfile.TemporaryDirectory() as folder:
            path = make(Path(folder))
            data = path.read_bytes()
            cut_path = path.with_name(f"cut{path.suffix}")
            most = falls = wrong = cuts = 0
            slowest = 0.0
            for cut in range(0, len(data) + 1, step):
                cut_path.write_bytes(data[:cut])
                begin = time.perf_counter()
                messages = []
                try:
                    with open_log(cut_path, salvage=True) as log:
                        messages = read_back(log)
                except SinstoolError:
                    pass
                slowest = max(slowest, time.perf_counter() - begin)
                wrong += messages != expected(name)[: len(messages)]
                falls += len(messages) < most
                most = max(most, len(messages))
                cuts += 1
            failed |= bool(falls or wrong)
            print(
                f"{name:<16} {len(data):>7} {cuts:>7} {most:>9} {falls:>6} {wrong:>6}"
                f" {slowest * 1e3:>12.1f}",
                flush=True,
            )
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
