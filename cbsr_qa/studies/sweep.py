"""Long sweeps: pieces of work on every core, each stored when done, so that a sweep can resume."""

import json
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.report.document import json_document
from cbsr_qa.system.files import writing
from cbsr_qa.system.foreign import LARGEST_FILE, read_foreign
from cbsr_qa.system.json_text import parse_json
from cbsr_qa.system.workers import delay_interrupts, worker_pool

#: Function called with the numbers of pieces done and in total, and the last piece.
Tell = Callable[[int, int, str], None]
Documents = list[dict[str, Any]]
Job = TypeVar("Job")
Result = TypeVar("Result")

_START: Final = b'{"key": "'
#: Longest wait [s]: a Ctrl-C that comes just as a wait begins has its effect when the wait ends.
_HEARD_S: Final = 1.0
_BEGIN_AGAIN: Final = "move it away, or begin again with --fresh, which removes it"


@dataclass(frozen=True, slots=True)
class Work:
    """A piece of a sweep.

    Parameters
    ----------
    key, what : identity of the work and its inputs, the same in every process and sweep; and its description.
    run : returns results that :func:`~cbsr_qa.report.document.json_document` knows; picklable.
    """

    key: str
    what: str
    run: Callable[[], Sequence[Any]]


class Kept:
    """Finished pieces of work in a file, one line of JSON each; without a file nothing is kept.

    A truncated last line is overwritten by the next piece.

    StoreError if the file has other content, or cannot be read.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._cut_at: int | None = None  #: start of a truncated line
        self.found: dict[str, Documents] = {}
        if path is not None and path.exists():
            self._read(path)

    def _read(self, path: Path) -> None:
        try:
            text = read_foreign(path, LARGEST_FILE)
        except OSError as error:
            raise StoreError(f"{path} cannot be read: {error.strerror or error}", remedy=_BEGIN_AGAIN) from error
        *lines, unfinished_line = text.split(b"\n")
        for number, line in enumerate(lines, 1):
            self._take(path, number, line)
        if unfinished_line[: len(_START)] != _START[: len(unfinished_line)]:
            self._take(
                path, len(lines) + 1, unfinished_line
            )  # complete, so it is another file's content and is refused
        elif unfinished_line:
            self._cut_at = len(text) - len(unfinished_line)

    def _take(self, path: Path, number: int, line: bytes) -> None:
        try:
            entry = parse_json(line)
        except ValueError as error:
            raise _piece_error(path, number, str(error)) from error
        if not isinstance(entry, dict) or not isinstance(entry.get("key"), str):
            raise _piece_error(path, number, "an object with a text 'key' is expected")
        documents = entry.get("documents")
        if not isinstance(documents, list) or not all(isinstance(document, dict) for document in documents):
            raise _piece_error(path, number, "'documents' must be a list of objects")
        self.found[entry["key"]] = documents

    def keep(self, key: str, documents: Documents) -> None:
        """Store a finished piece immediately; StoreError if it cannot be written."""
        if self._path is not None:
            line = json.dumps({"key": key, "documents": documents}, allow_nan=False).encode() + b"\n"
            with writing(self._path, refusal=StoreError), self._path.open("ab") as file:
                if self._cut_at is not None:
                    file.truncate(self._cut_at)
                file.write(line)
            self._cut_at = None
        self.found[key] = documents


def _piece_error(path: Path, number: int, why: str) -> StoreError:
    return StoreError(f"{path}: line {number} is no finished piece of a sweep: {why}", remedy=_BEGIN_AGAIN)


def compute_pieces(work: Sequence[Work], kept: Kept, tell: Tell, *, processes: int) -> Mapping[str, Documents]:
    """Compute all pieces that are not stored yet, in order, on the next free process; results by key.

    Results do not depend on the number of processes. If a piece raises, no further one is started, running ones are
    finished and stored, and its error is raised. Ctrl-C stops at once; finished pieces are stored.
    """
    remaining = [piece for piece in work if piece.key not in kept.found]
    done = len(work) - len(remaining)
    tell(done, len(work), "begun" if done == 0 else "resumed")
    with closing(run_jobs(remaining, _compute_piece, processes)) as pieces:
        for piece, documents in pieces:
            kept.keep(piece.key, documents)
            done += 1
            tell(done, len(work), piece.what)
    return {piece.key: kept.found[piece.key] for piece in work}


def _compute_piece(piece: Work) -> Documents:
    return [json_document(result) for result in piece.run()]


def run_jobs(
    jobs: Sequence[Job], run: Callable[[Job], Result], processes: int
) -> Generator[tuple[Job, Result], None, None]:
    """Run jobs in several processes, and yield each with its result as soon as it is done.

    If one raises, no further one is started, running ones are finished, and its error is raised. Ctrl-C stops all
    processes at once and silently.

    Parameters
    ----------
    processes : number in parallel, to which jobs are pickled; 1 uses this process, and errors are raised at once.

    Raises
    ------
    BrokenProcessPool
        If a process was killed.
    """
    if processes <= 1 or len(jobs) <= 1:
        for job in jobs:
            yield job, run(job)
        return
    first_error: BaseException | None = None
    with worker_pool(processes) as pool:
        with delay_interrupts():
            futures = {pool.submit(run, job): job for job in jobs}
        pending = set(futures)
        while pending:
            done, pending = wait(pending, timeout=_HEARD_S, return_when=FIRST_COMPLETED)
            for future in done:
                if future.cancelled():
                    continue
                if (error := future.exception()) is None:
                    yield futures[future], future.result()
                elif first_error is None:
                    first_error = error
                    for other in futures:
                        other.cancel()  # running jobs are finished and stored
    if first_error is not None:
        raise first_error
