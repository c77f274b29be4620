"""The logs that files, folders and patterns stand for, and the names of their outputs.

A ROS 2 bag is a folder and one log; any other folder stands for the logs in it, even if there is
only one. As when a log is opened, the first bytes of a file decide what it is. A file that has the
suffix of a log but not its first bytes counts as a log too, so that it is reported as failed.
"""

from __future__ import annotations

import glob
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath

from sinstool.core.errors import ConfigurationError, NotALogError, OutputError, no_such_log
from sinstool.io.readers.formats import METADATA, kind_of

OUTPUT_SUFFIX = ".mcap"
# Files with these suffixes are meant as logs, whatever they hold
LOG_SUFFIXES = (".mcap", ".bag", ".db3", ".ulg")
_PART = re.compile(r"(?P<stem>.+)_(?P<number>\d+)\.(db3|mcap)(\.zstd)?")
_MAGIC = re.compile(r"[*?[]")


@dataclass(frozen=True)
class LogInput:
    """A log, and the relative path that its output gets.

    Attributes
    ----------
    path : Path
        The log, as the user named it.
    name : PurePath
        Its file name, or its path relative to the folder, or to the fixed part of the pattern,
        that the user named.
    """

    path: Path
    name: PurePath

    @property
    def output(self) -> PurePath:
        """Path of its result below the folder of outputs."""
        if self.name.suffix == OUTPUT_SUFFIX:
            return self.name
        return self.name.with_name(self.name.name + OUTPUT_SUFFIX)


def is_bag(path: Path) -> bool:
    """Whether a folder is a ROS 2 bag: one log.

    It has ``metadata.yaml``; or, where that is lost, all its files are named as rosbag2 names them:
    after the folder, and numbered from 0.
    """
    if (path / METADATA).is_file():
        return True
    numbers = []
    for file in _files(path):
        match = _PART.fullmatch(file.name)
        if match is None or match["stem"] != path.resolve().name:
            return False
        numbers.append(int(match["number"]))
    return bool(numbers) and sorted(numbers) == list(range(len(numbers)))


def are_many(inputs: Sequence[Path]) -> bool:
    """Whether inputs are (or may be) several logs: more than one, a folder of logs, or a pattern.

    The number of logs that the folder or the pattern happens to hold makes no difference.
    """
    if len(inputs) != 1:
        return len(inputs) > 1
    path = inputs[0]
    if path.is_dir():
        return not is_bag(path)
    return not path.exists() and _is_pattern(path)


def find_logs(inputs: Sequence[Path], without: Path | None = None) -> list[LogInput]:
    """All logs that the inputs name, in their order.

    Parameters
    ----------
    inputs : sequence of Path
        Files, ROS 2 bag folders, folders that hold logs (at any depth), and patterns with ``*``,
        ``?``, ``[...]`` or ``**``, as a shell leaves them when they are quoted.
    without : Path, optional
        A folder that is not searched: that of the outputs, ``-o``.

    Returns
    -------
    list of LogInput
        Each log once.

    Raises
    ------
    NotALogError
        A path does not exist, or a folder or pattern holds no log.
    OutputError
        All that a folder or pattern names lies in the folder of the outputs.
    """
    hidden = None if without is None else without.resolve()
    logs_by_path: dict[Path, LogInput] = {}
    for path in inputs:
        logs = _logs_of(path, hidden)
        for log in logs:
            logs_by_path.setdefault(log.path.resolve(), log)
    return list(logs_by_path.values())


def expand(inputs: Sequence[Path]) -> list[Path]:
    """Inputs, with folders of logs and patterns replaced by their logs.

    Raises
    ------
    NotALogError
        A folder or pattern holds no log.
    """
    paths: list[Path] = []
    for path in inputs:
        paths += [log.path for log in find_logs([path])] if are_many([path]) else [path]
    return paths


def _logs_of(path: Path, hidden: Path | None) -> list[LogInput]:
    if path.is_dir() and not is_bag(path):
        if hidden is not None and _inside(path, hidden):
            raise _among_outputs(path)
        logs = [LogInput(p, p.relative_to(path)) for p in _below(path, hidden)]
        if not logs:
            raise NotALogError(
                path, "the folder holds no log", f"name one with logs, or a bag with its {METADATA}"
            )
        return logs
    if path.exists():
        return [LogInput(path, PurePath(path.resolve().name))]
    if not _is_pattern(path):
        raise no_such_log(path)
    root = Path(*_fixed(path))
    parts = path.parts[len(root.parts) :]
    ways = [(p, _passed(p, root)) for p in sorted(_matches(root, parts))]
    # without paths that pass through one folder twice, by a link
    matches = [p for p, passed in ways if len(set(passed)) == len(passed)]
    free = [p for p in matches if hidden is None or not _inside(p, hidden)]
    bags = {p for p in free if p.is_dir() and is_bag(p)}
    logs = []
    for match in free:
        if not bags.isdisjoint(match.parents):
            continue  # part of a bag that matches as a whole
        if match.is_dir():
            paths = (
                [match]
                if match in bags
                else _below(match, hidden, set(_passed(match.parent, root)))
            )
        else:
            paths = [match] if _is_log(match) else []
        logs += [LogInput(p, p.relative_to(root)) for p in paths]
    if not logs and len(free) < len(matches):
        raise _among_outputs(path)
    if not logs:
        raise NotALogError(path, "the pattern matches no log", "check it, and its quotes")
    return logs


def _among_outputs(path: Path) -> OutputError:
    return OutputError(
        f"{path}: these inputs lie in the folder of the outputs", "choose another folder with -o"
    )


def _below(folder: Path, hidden: Path | None, seen: set[Path] | None = None) -> list[Path]:
    """Logs in a folder and below it, by name; a folder that a link leads to again counts once."""
    seen = set() if seen is None else seen
    seen.add(folder.resolve())
    paths: list[Path] = []
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or (hidden is not None and _inside(path, hidden)):
            continue
        if path.is_dir():
            if is_bag(path):
                paths.append(path)
            elif path.resolve() not in seen:
                paths += _below(path, hidden, seen)
        elif _is_log(path):
            paths.append(path)
    return paths


def _matches(root: Path, parts: Sequence[str]) -> Iterator[Path]:
    """Paths below a folder that match the parts of a pattern."""
    # With `**` the standard library follows links that lead back, endlessly if there are two.
    if "**" not in parts:
        yield from map(Path, glob.glob(str(Path(glob.escape(str(root)), *parts))))
        return
    k = parts.index("**")
    for top in _matches(root, parts[:k]) if k else (root,):
        for folder in _folders(top, set()) if top.is_dir() else ():
            yield from _matches(folder, parts[k + 1 :]) if parts[k + 1 :] else (folder,)


def _folders(top: Path, seen: set[Path]) -> Iterator[Path]:
    """A folder and those below it, each once."""
    if top.resolve() in seen:
        return
    seen.add(top.resolve())
    yield top
    for path in sorted(top.iterdir()):
        if path.is_dir() and not path.name.startswith("."):
            yield from _folders(path, seen)


def _passed(path: Path, root: Path) -> list[Path]:
    """The folders from `root` to a path, both included, with links resolved."""
    return [p.resolve() for p in (path, *path.parents) if p == root or root in p.parents]


def _inside(path: Path, folder: Path) -> bool:
    resolved = path.resolve()
    return resolved == folder or folder in resolved.parents


def _files(path: Path) -> list[Path]:
    try:
        return [p for p in path.iterdir() if p.is_file() and not p.name.startswith(".")]
    except OSError as exc:
        raise NotALogError(path, f"cannot be read ({exc.strerror})") from exc


def _is_log(path: Path) -> bool:
    # A broken link is no log, and opening a pipe would wait for its writer.
    if not path.is_file():
        return False
    try:
        with path.open("rb") as stream:
            return kind_of(stream)[0] != "" or path.suffix.lower() in LOG_SUFFIXES
    except OSError:
        # Counts as a log: opening it will say what is wrong.
        return True


def _is_pattern(path: Path) -> bool:
    return _MAGIC.search(str(path)) is not None


def _fixed(path: Path) -> list[str]:
    """The leading parts of a pattern without wildcards, except its last part."""
    fixed: list[str] = []
    for part in path.parts[:-1]:
        if _MAGIC.search(part):
            break
        fixed.append(part)
    return fixed or ["."]


def output_paths(logs: Sequence[LogInput], folder: Path, suffix: str = "") -> list[Path]:
    """One output for each log, in a folder.

    Parameters
    ----------
    suffix : str
        Replaces ``.mcap`` for other files than results.

    Raises
    ------
    ConfigurationError
        Two logs would have one output.
    OutputError
        An output would be an input, or lie within one.
    """
    taken: dict[PurePath, LogInput] = {}
    paths = []
    for log in logs:
        other = taken.setdefault(log.output, log)
        if other is not log:
            raise ConfigurationError(
                f"{other.path} and {log.path} would both become {folder / log.output}",
                "give the folder that holds both, or a pattern in quotes: outputs are then laid"
                " out as the inputs are",
            )
        output = folder / log.output
        if suffix:
            output = output.with_suffix(suffix)
        source, target = log.path.resolve(), output.resolve()
        if source == target:
            raise OutputError(f"{output} is the input itself", "choose another folder with -o")
        if log.path.is_dir() and source in target.parents:
            raise OutputError(
                f"{output} lies in the input's own folder", "choose another folder with -o"
            )
        paths.append(output)
    return paths
