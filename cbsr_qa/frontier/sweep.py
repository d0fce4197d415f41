"""Long sweeps: pieces of work on every core, each kept as soon as it is done: a sweep resumes where it stopped."""

import json
import multiprocessing
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cbsr_qa.domain.errors import StoreError

#: Told how many pieces of how many are done, and which was the last.
Tell = Callable[[int, int, str], None]
Documents = list[dict[str, Any]]


@dataclass(frozen=True, slots=True)
class Work:
    """A piece of a sweep.

    Parameters
    ----------
    key : says what is worked out and with what; the same in every process and every sweep.
    what : the same for people.
    run : gives documents of plain numbers and text; can be pickled.
    """

    key: str
    what: str
    run: Callable[[], Documents]


class Kept:
    """Finished pieces of work in a file, a line of JSON each.

    Parameters
    ----------
    path : of the file; None keeps nothing.

    Raises
    ------
    StoreError
        If the file is there and is none of ours.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self.found: dict[str, Documents] = {}
        if path is not None and path.exists():
            self._read(path)

    def _read(self, path: Path) -> None:
        lines = path.read_text(encoding="utf-8").splitlines()
        for number, line in enumerate(lines, 1):
            try:
                entry = json.loads(line)
                key, documents = str(entry["key"]), list(entry["documents"])
            except (ValueError, KeyError, TypeError) as error:
                if number == len(lines):
                    return  # cut off while it was written: that piece is worked out again
                raise StoreError(
                    f"{path}: line {number} is no finished piece of a sweep ({type(error).__name__})",
                    remedy="name another file with --resume, or remove this one to begin again",
                ) from error
            self.found[key] = documents

    def keep(self, key: str, documents: Documents) -> None:
        """Keep a finished piece, on the disk before anything else is done."""
        self.found[key] = documents
        if self._path is None:
            return
        text = json.dumps({"key": key, "documents": documents}, allow_nan=False)
        whole = self._path.exists() and self._path.stat().st_size > 0 and not _ends_whole(self._path)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(("\n" if whole else "") + text + "\n")


def _ends_whole(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-1, 2)
        return file.read(1) == b"\n"


def worked_out(work: Sequence[Work], kept: Kept, tell: Tell, *, processes: int) -> Mapping[str, Documents]:
    """Work everything out that is not kept yet, the pieces in order handed to whichever process is free.

    What comes out does not depend on the number of processes.

    Parameters
    ----------
    processes : at once; 1 works in this one.

    Returns
    -------
    Documents by key.
    """
    left = [piece for piece in work if piece.key not in kept.found]
    done = len(work) - len(left)
    tell(done, len(work), "begun" if done == 0 else "resumed")
    for piece, documents in _finished(left, processes):
        kept.keep(piece.key, documents)
        done += 1
        tell(done, len(work), piece.what)
    return {piece.key: kept.found[piece.key] for piece in work}


def _finished(work: Sequence[Work], processes: int) -> Any:
    if processes <= 1 or len(work) <= 1:
        for piece in work:
            yield piece, piece.run()
        return
    # Spawned: threads of numerical libraries do not survive a fork.
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        try:
            futures = {pool.submit(piece.run): piece for piece in work}
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
