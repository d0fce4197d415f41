"""Builds two commits side by side, runs the same cases with both, and compares all that they print, write and store.

``python -m tests.oracle OLD NEW [--case NAME …] [--work FOLDER]``: exit code 1 where something differs that
``accepted.toml`` does not list with its reason. Recordings are those in ``../shared``; cases that need them are left
out, saying so, where it is absent. ``OLD`` and ``NEW`` may be one commit: then nothing at all may differ.
``--exact`` leaves the list out, for a change that must change nothing. With
``--again`` a commit's case is run once and compared as often as one likes, also with another commit.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.oracle.accepted import Difference, Meant, WrongListError, differences, judged, put_back, read_meant
from tests.oracle.cases import CASES
from tests.oracle.sides import HERE, SHARED, Build, Side


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.oracle", description=__doc__)
    parser.add_argument("old")
    parser.add_argument("new")
    parser.add_argument("--case", action="append", choices=CASES, help="only this one; may be repeated")
    parser.add_argument("--work", type=Path, help="where to build and run; kept, and a commit is built once")
    parser.add_argument("--again", action="store_true", help="run only what was not run in --work before")
    parser.add_argument("--exact", action="store_true", help="accept nothing: of a change that must change nothing")
    parser.add_argument("--lines", type=int, default=40, help="how many differences to print of each case")
    return parser.parse_args()


def _compared(name: str, sides: Sequence[Side], meant: Meant, lines: int) -> int:
    """Say what differs in a case; returns how many differences are not accepted."""
    (old, before), (new, after) = (put_back(side.texts(name), meant.undone) for side in sides)
    counts, left = judged(list(differences(old, new)), meant.accepted)
    counts += after - before
    print(f"{name}: {len(new)} texts, {counts.total()} accepted differences, {len(left)} others", flush=True)
    for why, count in sorted(counts.items()):
        print(f"  accepted {count}: {why}")
    for one in left[:lines]:
        print(f"  {one.file[:110]}\n    {one.sign} {_window(one, left)}")
    if len(left) > lines:
        print(f"  … and {len(left) - lines} more")
    sys.stdout.flush()
    return len(left)


def _window(one: Difference, left: Sequence[Difference]) -> str:
    """Return a line as far as it can be read: long ones from where they begin to differ from the other side's."""
    others = [other.line for other in left if other.file == one.file and other.sign != one.sign]
    if len(one.line) <= 300 or not others:
        return one.line[:300]
    start = max(_same_until(one.line, other) for other in others)
    return f"[from {start}] {one.line[max(0, start - 80) : start + 160]}"


def _same_until(one: str, other: str) -> int:
    return next((at for at, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))


def main() -> int:
    options = _options()
    try:
        meant = Meant() if options.exact else read_meant(HERE / "accepted.toml")
    except WrongListError as error:
        print(error, file=sys.stderr)
        return 2
    work = (options.work or Path(tempfile.mkdtemp(prefix="oracle-"))).resolve()
    builds = [Build.of(revision, work) for revision in (options.old, options.new)]
    sides = [Side(builds[0], 1), Side(builds[1], 2 if builds[0] == builds[1] else 1)]
    names = [name for name in options.case or CASES if name != "recordings" or SHARED.is_dir()]
    if not SHARED.is_dir():
        print(f"recordings are left out: {SHARED} is absent")
    left = 0
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(Build.make, set(builds)))
        for name in names:
            began = time.monotonic()
            wanted = [side for side in sides if not (options.again and side.was_run(name))]
            list(pool.map(lambda side, name=name: side.run(name), wanted))
            left += _compared(name, sides, meant, options.lines)
            print(f"  {time.monotonic() - began:.0f} s", flush=True)
    print(f"{left} differences that are not accepted")
    return 1 if left else 0


if __name__ == "__main__":
    sys.exit(main())
