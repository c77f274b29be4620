"""What workers of the tests do; they find it by its name."""

import os
import signal
import time
import warnings

from sinstool.core.errors import AlignmentError, UncachedWarning
from sinstool.core.whole_file import WholeFile


def square(number, progress):
    progress(0.5)
    return number * number, os.getpid()


def warns(number, progress):
    warnings.warn("compiled code cannot be cached", UncachedWarning, stacklevel=1)
    return number


def fails(kind, progress):
    if kind == "user":
        error = AlignmentError("rocks: it does not rest", "wait")
        error.exit_code = 3
        raise error
    raise ZeroDivisionError("half\nof nothing")


def dies(folder, times, progress):
    """Die in the middle of writing, as often as is asked for; then finish."""
    with WholeFile(folder / "out") as whole:
        whole.stream.write(b"first half, ")
        whole.stream.flush()
        begun = len(list(folder.glob("begun-*")))
        (folder / f"begun-{begun}").touch()
        if begun < times:
            os.kill(os.getpid(), signal.SIGKILL)
        whole.stream.write(b"second half")
    return begun


def ended_while_cleaning_up(folder, progress):
    """Be told to end after an error, in the middle of removing what is unfinished."""
    whole = WholeFile(folder / "out")

    def close():
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(10.0)

    whole.stream.close = close
    with whole:
        raise OSError("the pipe is broken")


def waits(folder, number, progress):
    """Write, without end."""
    with WholeFile(folder / f"out-{number}") as whole:
        whole.stream.write(b"some")
        whole.stream.flush()
        named = folder / f"unnamed-{number}"
        named.write_text(str(os.getpid()))
        named.rename(folder / f"pid-{number}")
        while True:
            time.sleep(0.02)
            progress(0.5)
