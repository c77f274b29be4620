"""A Dask cluster of processes of their own, started as the guide says."""

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager

from tests.helpers.paths import ROOT

# `dask` of the guide, whatever PATH is
DASK = [sys.executable, "-m", "dask"]


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextmanager
def started(command, folder, **environment):
    """A program that runs meanwhile, in a folder of its own."""
    paths = [str(ROOT), str(ROOT / "tests"), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), **environment}
    with (folder / f"{command[3]}.log").open("wb") as log:
        process = subprocess.Popen(
            command,
            cwd=folder,
            env=environment,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            yield process
        finally:
            # with all that it started; they have nothing to lose
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@contextmanager
def cluster(folder, workers=2, tls=None):
    """A scheduler and workers, which talk over TCP, or over TLS with an authority, (cert, key).

    Yields
    ------
    str
        Address of the scheduler.
    """
    port = free_port()
    protocol = "tls" if tls else "tcp"
    address = f"{protocol}://127.0.0.1:{port}"
    names = ("--tls-ca-file", "--tls-cert", "--tls-key")
    secure = [str(word) for pair in zip(names, tls or (), strict=False) for word in pair]
    scheduler = [*DASK, "scheduler", "--no-dashboard", "--host", "127.0.0.1", "--port", str(port)]
    scheduler += ["--protocol", protocol, *secure]
    crew = [
        *DASK,
        "worker",
        "--nworkers",
        str(workers),
        "--nthreads",
        "1",
        "--no-dashboard",
        *secure,
    ]
    with started(scheduler, folder, DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES="1") as process:
        until = time.monotonic() + 60.0
        while time.monotonic() < until and process.poll() is None:
            try:
                socket.create_connection(("127.0.0.1", port), 1.0).close()
                break
            except OSError:
                time.sleep(0.05)
        if workers == 0:
            yield address
            return
        with started([*crew, address], folder):
            if not tls:
                wait_for_workers(address, workers)
            yield address


def wait_for_workers(address, count):
    import distributed

    with distributed.Client(address, timeout=60, set_as_default=False) as client:
        client.wait_for_workers(count, timeout=120)
