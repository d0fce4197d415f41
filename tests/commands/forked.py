"""One command in a fork of the process that has loaded everything (``warm``), as the installed program runs it."""

import os
import signal
import sys
from contextlib import ExitStack
from pathlib import Path

from cbsr_qa.cli.main import run_and_supervise


def run(folder: Path, arguments: list[str], environment: dict[str, str], out: Path, err: Path) -> None:
    """Run one command as the installed program does, its output in two files."""
    os.chdir(folder)
    os.environ.update(environment)
    sys.path[:0] = filter(None, environment.get("PYTHONPATH", "").split(os.pathsep))
    with ExitStack() as stack:
        for stream, path in ((sys.stdout, out), (sys.stderr, err)):
            target = stack.enter_context(path.open("w"))
            stream.flush()
            os.dup2(target.fileno(), stream.fileno())
        code = run_and_supervise(arguments)
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


def run_as_a_job(ignored: tuple[int, ...], *arguments: object) -> None:
    """Run one command in a process group of its own, as a shell does, with some signals ignored."""
    os.setpgid(0, 0)
    for number in ignored:
        signal.signal(number, signal.SIG_IGN)
    run(*arguments)  # type: ignore[arg-type]
