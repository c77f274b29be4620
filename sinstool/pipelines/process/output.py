"""The output of a run: solutions and the input's own messages, whole or not at all."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from threading import Event
from types import TracebackType
from typing import TypeVar

from sinstool.config import ProcessConfig
from sinstool.core import version
from sinstool.core.errors import ConfigurationError, OutputError
from sinstool.core.finding import Finding, exit_status
from sinstool.core.streams import Diagnostics, Solution, Stream
from sinstool.core.threads import executor
from sinstool.core.whole_file import WholeFile, check_mcap_name, check_output
from sinstool.io.readers.clock_steps import NOTHING, recorded
from sinstool.io.readers.log import Log
from sinstool.io.writers.copy import Copier
from sinstool.io.writers.mcap import McapWriter
from sinstool.io.writers.solution import SolutionWriter
from sinstool.io.writers.solution_topics import Frames, topic_of
from sinstool.pipelines.process.summary import InputFile, OutputFile, Place, Sink
from sinstool.pipelines.process.travel import Odometer
from sinstool.pipelines.provenance import RECORD, figures_of, identity, sha256

S = TypeVar("S", bound=Stream)
# Made of the attitude, which every run has
ALWAYS = ("imu", "attitude", "euler", "pose", "tf")


class Output:
    """An MCAP that is being written; it appears under its name when it is complete.

    Without a name nothing is written, and all that is computed goes to the sink alone.

    Parameters
    ----------
    log : Log
        The input, whose messages are copied unless the configuration says otherwise.
    output : Path or None
        None to write no file.
    sink : Sink, optional
        Gets every block of solutions too, for the page of figures.

    Attributes
    ----------
    last : Solution or None
        The block that was pushed last.
    odometer : Odometer
        Through which all blocks went.

    Raises
    ------
    ConfigurationError
        The name of the output promises another format.
    OutputError
        The output exists, is the input, or cannot be written.
    """

    def __init__(
        self, log: Log, output: Path | None, config: ProcessConfig, sink: Sink | None = None
    ) -> None:
        if output is not None:
            check_mcap_name(output)
            check_output(output, [log.path], config.output.overwrite)
        self.log = log
        self.output = output
        self.config = config
        self.sink = sink
        self.last: Solution | None = None
        self.odometer = Odometer()
        self.emits: list[str] = []
        self._pushed = 0
        self._solutions: SolutionWriter | None = None
        self._stack = ExitStack()
        pool = executor(1, "sinstool-hash")
        self._stack.enter_context(pool)
        stop = Event()
        # a run that fails does not have to wait for the hash of a large log
        self._stack.callback(stop.set)
        self._digest = pool.submit(sha256, log.path, stop)

    def __enter__(self) -> Output:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._stack.__exit__(kind, value, traceback)

    def open(
        self,
        encoding: str,
        computed: Sequence[str],
        frames: Frames,
        tf_parent: str | None = None,
        diagnostic_names: Sequence[str] = (),
    ) -> list[Finding]:
        """Begin to write; returns findings about outputs left out or absent from the log.

        Parameters
        ----------
        encoding : {'cdr', 'ros1'}
            Of the input's IMU topic, which the output keeps unless it holds results only.
        computed : sequence of str
            What this kind of run writes unless the configuration says otherwise, of
            :data:`~sinstool.config.logs.EMITS`; beside it there are always Euler angles, poses and
            transforms.
        tf_parent : str, optional
            Parent of the IMU's frame in the log's own transforms.

        Raises
        ------
        ConfigurationError
            This kind of run does not compute what the configuration asks for.
        OutputError
            The log holds such topics already, or the output cannot be written.
        """
        self.frames = frames
        if self.output is None:
            return []
        options = self.config.output
        self.emits = list(computed if options.emit is None else options.emit)
        findings = self._leave_out((*computed, *ALWAYS), frames.body, tf_parent)
        if options.only_results:
            encoding = "cdr"
        whole = self._stack.enter_context(WholeFile(self.output))
        self._writer = McapWriter(
            whole.stream,
            "ros1" if encoding == "ros1" else "ros2",
            f"sinstool/{version.VERSION}",
            options.compression,
        )
        self._stack.callback(self._writer.abort)
        self._copier = None if options.only_results else Copier(self.log, self._writer)
        self._solutions = SolutionWriter(
            self._writer,
            encoding,
            self.emits,
            frames,
            self._copier.advance if self._copier else lambda _: None,
            diagnostic_names,
        )
        return findings + (self._copier.findings if self._copier else [])

    def _leave_out(
        self, possible: Sequence[str], body: str, tf_parent: str | None
    ) -> list[Finding]:
        """Refuse topics that cannot be written, and leave out transforms that the log has."""
        foreign = [name for name in self.emits if name not in possible]
        if foreign:
            raise ConfigurationError(
                f"--emit {foreign[0]}: this run does not compute it",
                "odometry and fix come with --mode ins or ins-gnss, height with --height-damping,"
                " diagnostics with --mode ins-gnss or a smoothed attitude, vehicle with a land"
                " vehicle",
            )
        if self.config.output.only_results:
            return []
        present = {channel.topic for channel in self.log.channels.values()}
        clash = sorted(present & {topic_of(name) for name in self.emits if name != "tf"})
        if clash:
            raise OutputError(
                f"{self.log.path} holds results of sinstool already ({', '.join(clash)})",
                "process the original log, or add --only-results",
            )
        if "tf" not in self.emits or tf_parent is None:
            return []
        self.emits.remove("tf")
        text = (
            f"/tf is not written: in the log {body} has the parent {tf_parent} already, and a frame"
            " can have only one"
        )
        return [Finding("tf-parent", text)]

    def push(self, solution: Solution) -> None:
        """Write solutions, in the order of time."""
        if self._solutions is not None:
            self._solutions.push(self._recorded(solution))
        self._pushed += len(solution)
        if self.sink is not None:
            self.sink.push(solution)
        self.odometer.push(solution)
        self.last = solution

    def note(self, diagnostics: Diagnostics) -> None:
        """Write diagnostics beside the solutions that follow."""
        if self._solutions is not None:
            self._solutions.note(self._recorded(diagnostics))

    def _recorded(self, stream: S) -> S:
        """A stream whose log times are as in the log, also where its recorder's clock was set."""
        steps = self.log.recorder
        if steps is NOTHING:
            return stream
        return replace(stream, log_time_ns=recorded(steps, stream.log_time_ns))

    def complete(self) -> None:
        """Write the remaining solutions and the rest of the input."""
        if self._solutions is not None:
            self._solutions.finish()
            if self._copier:
                self._copier.finish()

    def finish(self, findings: Sequence[Finding]) -> tuple[InputFile, OutputFile]:
        """End the file's contents; its name comes when the context ends well.

        Parameters
        ----------
        findings : sequence of Finding
            Of the run: whether something was lost or withheld is recorded.
        """
        path = self.log.path
        digest = self._digest.result()
        read = InputFile(str(path), self.log.size, digest)
        frames = self.frames
        origin = None if frames.origin is None else Place.of(frames.origin)
        if self._solutions is None:
            return read, OutputFile(None, (), self._pushed, frames.reference_id, origin)
        self._writer.add_metadata(
            RECORD,
            {
                **identity(self.config),
                "input_name": path.name,
                "input_size": str(self.log.size),
                "input_sha256": digest,
                "status": "lost" if exit_status(findings) else "done",
                **figures_of(self.odometer.travel(), findings),
            },
        )
        self._writer.finish()
        topics = tuple(topic_of(name) for name in self.emits)
        count = self._solutions.written
        return read, OutputFile(str(self.output), topics, count, frames.reference_id, origin)
