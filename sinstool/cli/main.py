"""The `sinstool` command. Commands are imported only when they run: the help is fast."""

from __future__ import annotations

import _thread
import atexit
import gc
import io
import os
import re
import shlex
import signal
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn, TextIO, cast

import click

from sinstool.cli.console import Group, warn
from sinstool.core.errors import AGAIN, SinstoolError, UncachedWarning, one_line, visible
from sinstool.core.version import VERSION
from sinstool.core.whole_file import completed_outputs

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

# Name and one line for the list of commands; modules are named after their command
COMMANDS = {
    "info": "Show what a log holds and what is wrong with it.",
    "process": "Compute attitude, velocity and position, written as MCAP.",
    "export": "Export a result as CSV, Parquet, TUM, KML, GPX or GeoJSON.",
    "align": "Find the attitude at the start, at rest or in motion, with sigmas.",
    "allan": "Measure the noise of an IMU where its log rests, for a filter.",
    "compare-coning": "Compare coning algorithms on a log, or re-run the published experiment.",
    "calibrate-hse": "Calibrate the heading-sensitive error from turntable logs.",
    "simulate": "Simulate a log with exact truth.",
    "conventions": "Explain frames, axes, quaternions, units, gravity and time.",
    "completion": "Print shell completion for bash, zsh or fish.",
}
# Most complete files that a message names; of more it gives the number
NAMED = 3


class LazyGroup(Group):
    """A group that knows its commands' names and imports only the one that is run."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order in which a user needs the commands."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """Import a command; unknown names get a suggestion."""
        if name not in COMMANDS:
            return None
        command: click.Command = import_module(f"sinstool.cli.{name.replace('-', '_')}").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Offer the commands without importing them."""
        from click.shell_completion import CompletionItem

        offered = [
            CompletionItem(name, help=line)
            for name, line in COMMANDS.items()
            if name.startswith(incomplete)
        ]
        return offered + click.Command.shell_complete(self, ctx, incomplete)


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(VERSION, prog_name="sinstool")
def cli() -> None:
    """Turn recorded IMU logs into attitude, velocity and position.

    Reads MCAP, ROS 1 bags, ROS 2 bags and PX4's ULog; writes MCAP. See sinstool COMMAND --help.
    """


def main() -> None:
    """Run the command line; every failure a user can cause ends in one line."""
    # Our loops are compiled and our matrices small: threads of BLAS would only spin.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Looking for plugins, pydantic would read the metadata of every installed package.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # Silence numpy's warnings of NaN and infinity: those that matter are counted and reported.
    if not sys.warnoptions:
        warnings.simplefilter("ignore", RuntimeWarning)
    warnings.showwarning = _warn
    _end_well_on_signals()
    _open_standard_streams()
    if type(sys.stdout) is io.TextIOWrapper:
        sys.stdout = cast(TextIO, _StandardOutput(sys.stdout))
    if type(sys.stderr) is io.TextIOWrapper:
        sys.stderr = cast(TextIO, _StandardError(sys.stderr))
    try:
        with completed_outputs() as outputs:
            _run(outputs)
    finally:
        # The operating system frees all memory at once; freeing object by object would take as long
        # as a second of a log.
        gc.freeze()


_show_warning = warnings.showwarning


def _warn(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
    """Print warnings of sinstool as the commands print theirs, others as Python does."""
    if issubclass(category, UncachedWarning):
        warn(str(message))
    else:
        _show_warning(message, category, *where, **more)


def _open_standard_streams() -> None:
    """Discard what goes to standard streams that were closed when the process was started.

    Otherwise files would get their numbers, and words that go there none.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115 - to the end


class _StandardOutput:
    """Standard output without control characters, whose reader may go away at any time.

    Control characters, which the names in a log may hold, are replaced, and characters that the
    encoding lacks are written as escapes. Once the reading end of a pipe is closed, all further
    output is discarded.
    """

    def __init__(self, stream: io.TextIOWrapper) -> None:
        # ASCII mostly means that no encoding was set; click would bypass this class and write UTF-8
        bare = stream.encoding.lower().replace("_", "-") in ("ascii", "us-ascii", "ansi-x3.4-1968")
        encoding = "utf-8" if bare else stream.encoding
        stream.reconfigure(encoding=encoding, errors="backslashreplace")
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        with self._until_closed():
            self._stream.write(visible(text))
        return len(text)

    def flush(self) -> None:
        with self._until_closed():
            self._stream.flush()

    @contextmanager
    def _until_closed(self) -> Iterator[None]:
        try:
            yield
        except BrokenPipeError:
            # Not an error: `head` closes its end once it has read enough.
            self.end()
        except OSError as exc:
            raise OSError(exc.errno, exc.strerror, "standard output") from exc

    def end(self) -> None:
        """Discard all further output, buffered text included."""
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)


class _StandardError(_StandardOutput):
    """Standard error, which discards what it has no room for: results do not depend on it."""

    def write(self, text: str) -> int:
        with self._until_closed():
            self._stream.write(text)
        return len(text)

    @contextmanager
    def _until_closed(self) -> Iterator[None]:
        try:
            yield
        except OSError:
            self.end()


_ENDING = tuple(getattr(signal, n) for n in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, n))


def _send_to_main(number: int) -> None:
    """Send a signal to the main thread, so that it ends a call in which this thread waits."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(cast(int, threading.main_thread().ident), number)
    else:
        _thread.interrupt_main(signal.Signals(number))


def _end_well_on_signals() -> None:
    """Treat a request to terminate, and a closed terminal, like Ctrl-C."""
    last = -1.0
    show = sys.unraisablehook

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal last
        now = time.monotonic()
        # A terminal and the program that runs sinstool often both send one; the second must not
        # stop the cleaning up.
        if last < 0.0 or now - last > 1.0:
            last = now
            raise KeyboardInterrupt(number)

    def interrupt_again(lost: sys.UnraisableHookArgs) -> None:
        # Python swallows what is raised while an object is freed, interrupts too.
        nonlocal last
        if not isinstance(lost.exc_value, KeyboardInterrupt):
            show(lost)
            return
        last = -1.0
        # Not from here: it would be swallowed once more.
        again = threading.Timer(0.01, _send_to_main, lost.exc_value.args)
        again.daemon = True
        again.start()

    sys.unraisablehook = interrupt_again
    for number in _ENDING:
        # What was ignored when we were started (nohup, a job in the background) stays ignored.
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, interrupt)
            # At the end the status is settled; one more signal would replace it.
            atexit.register(signal.signal, number, signal.SIG_IGN)


def _written(outputs: Sequence[Path]) -> str:
    """Say which outputs are complete."""
    paths = [str(path) for path in dict.fromkeys(outputs)]
    if not paths:
        return "nothing was written"
    if len(paths) == 1:
        return f"{paths[0]} was complete by then"
    names = ", ".join(paths) if len(paths) <= NAMED else f"{len(paths)} files"
    return f"{names} were complete by then"


def _fail(error: str, status: int) -> NoReturn:
    """Print what went wrong in one line, with ``--json`` as an object on stdout too, and exit."""
    if "--json" in sys.argv[1:]:
        from sinstool.cli.console import print_json

        failure = {"schema": "sinstool.error/1", "status": "failed", "exit": status}
        # If stdout itself failed, only the line below is printed.
        with suppress(OSError):
            print_json({**failure, "error": error})
    click.echo(f"sinstool: {one_line(error)}", err=True)
    sys.exit(status)


def _usage(exc: click.ClickException) -> str:
    """The message of an error in the arguments, with the command that lists the right ones."""
    message = exc.format_message().rstrip(".")
    ctx = exc.ctx if isinstance(exc, click.UsageError) else None
    if ctx is None:
        return message
    return f"{message}{' See' if message.endswith('?') else '; see'} {ctx.command_path} --help"


def _interrupted(exc: BaseException) -> bool:
    """Whether an exception came about while an interrupt was handled."""
    cause: BaseException | None = exc
    while cause is not None:
        if isinstance(cause, KeyboardInterrupt):
            return True
        cause = cause.__context__
    return False


def _run(outputs: Sequence[Path]) -> None:
    """Run a command and exit with its status."""
    # -v explains choices; only -vv asks for a traceback.
    flags = [a for a in sys.argv[1:] if re.fullmatch(r"--verbose|-v+", a)]
    traceback = sum(1 if a == "--verbose" else len(a) - 1 for a in flags) > 1
    try:
        # https://no-color.org
        plain = False if os.environ.get("NO_COLOR") else None
        status = cli.main(standalone_mode=False, color=plain)
    except SinstoolError as exc:
        if traceback:
            raise
        again = shlex.join(["sinstool", *sys.argv[1:], "--salvage"])
        exc.hint = exc.hint.replace(AGAIN, f"run `{again}`")
        _fail(str(exc), exc.exit_code)
    except click.exceptions.NoArgsIsHelpError as exc:
        exc.show()
        sys.exit(exc.exit_code)
    except click.exceptions.Exit as exc:
        sys.exit(exc.exit_code)
    except click.ClickException as exc:
        _fail(_usage(exc), exc.exit_code)
    except (KeyboardInterrupt, click.Abort):
        _fail(f"interrupted; {_written(outputs)}", 130)
    except MemoryError:
        _fail(f"out of memory; {_written(outputs)}", 1)
    except OSError as exc:
        if traceback:
            raise
        if isinstance(sys.stdout, _StandardOutput):
            sys.stdout.end()
        where = f"{exc.filename}: " if exc.filename else ""
        _fail(f"{where}{exc.strerror}; {_written(outputs)}", 1)
    except Exception as exc:
        # An interrupt inside Python's own locks may surface as another exception
        if not _interrupted(exc):
            raise
        _fail(f"interrupted; {_written(outputs)}", 130)
    sys.exit(status if isinstance(status, int) else 0)
