"""Checks that workers on other machines see the same files as this one.

A worker must find the same bytes under a path as this machine, and what it writes must appear here.
Both are checked before anything starts: inputs by their size and their first bytes, folders by a
file that each side writes and the other reads.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from sinstool.core.temporary import new_file, remove_file, unlocked_name
from sinstool.io.readers.log import path_size

HEAD_BYTES = 65536


@dataclass(frozen=True)
class Sight:
    """Size and first bytes of an input.

    Attributes
    ----------
    size : int
        Bytes; for a folder, the sum over its files.
    head : str
        SHA-256 of the first 64 KiB; for a folder, of the names and heads of its files.
    """

    size: int
    head: str


def sight(path: Path) -> Sight:
    """Size and first bytes of an input.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    if not path.is_dir():
        with path.open("rb") as stream:
            return Sight(path_size(path), hashlib.sha256(stream.read(HEAD_BYTES)).hexdigest())
    files = sorted(p for p in path.rglob("*") if p.is_file())
    listing = "".join(f"{p.relative_to(path).as_posix()} {sight(p).head}\n" for p in files)
    return Sight(path_size(path), hashlib.sha256(listing.encode()).hexdigest())


def sights(paths: Sequence[Path]) -> list[tuple[Path, Sight]]:
    """Size and first bytes of all inputs that can be read; the jobs report the others."""
    inputs = []
    for path in paths:
        with contextlib.suppress(OSError):
            if path.is_file() or path.is_dir():
                inputs.append((path, sight(path)))
    return inputs


@dataclass(frozen=True)
class Token:
    """A file by which two machines check that they see the same folder.

    Attributes
    ----------
    path : Path
        The file.
    text : str
        Its contents, which are random.
    """

    path: Path
    text: str


@contextmanager
def tokens(folders: Sequence[Path]) -> Iterator[list[Token]]:
    """Put a token into each folder, and remove it at the end.

    Raises
    ------
    OSError
        If a folder cannot be written to.
    """
    made: list[Token] = []
    with contextlib.ExitStack() as stack:
        for folder in folders:
            handle, path = new_file(folder, "token")
            stack.callback(remove_file, path)
            stack.callback(os.close, handle)
            token = Token(path, secrets.token_hex(16))
            os.write(handle, token.text.encode())
            # Workers, maybe of another user, read it while it is still open here.
            os.fsync(handle)
            os.chmod(path, 0o644)
            made.append(token)
        yield made


def what_differs(
    seen: Sequence[tuple[Path, Sight]], folder_tokens: Sequence[Token]
) -> tuple[str, list[Token]]:
    """Compare inputs and folders on a worker, and answer each token with one of its own.

    Parameters
    ----------
    seen : sequence of (Path, Sight)
        Inputs, as the client sees them.
    folder_tokens : sequence of Token
        The client's tokens, one in each folder that jobs write to.

    Returns
    -------
    str
        The first difference; empty if there is none.
    list of Token
        The worker's tokens, which the client must see and remove.
    """
    for path, expected in seen:
        try:
            here = sight(path)
        except OSError as exc:
            return f"does not see {path} ({exc.strerror})", []
        if here != expected:
            return f"sees a different {path} ({here.size} bytes there, {expected.size} here)", []
    answers: list[Token] = []
    for token in folder_tokens:
        try:
            if token.path.read_text() != token.text:
                return f"sees a different folder {token.path.parent}", answers
        except OSError:
            return f"does not see the folder {token.path.parent}", answers
        answer = Token(unlocked_name(token.path.parent, "token"), secrets.token_hex(16))
        try:
            answer.path.write_text(answer.text)
        except OSError as exc:
            return f"cannot write in {token.path.parent} ({exc.strerror})", answers
        answers.append(answer)
    return "", answers


def not_seen(answers: Sequence[Token]) -> Path | None:
    """The folder of the first of a worker's tokens that is missing here; all are removed."""
    missing = None
    for answer in answers:
        try:
            same = answer.path.read_text() == answer.text
        except OSError:
            same = False
        answer.path.unlink(missing_ok=True)
        if not same and missing is None:
            missing = answer.path.parent
    return missing
