"""Runs the installed command as a user would."""

import io
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
from contextlib import redirect_stderr, redirect_stdout
from functools import lru_cache
from multiprocessing import forkserver
from pathlib import Path

import forked
import pytest

PROGRAM = Path(sys.executable).with_name("cbsr-qa")
#: Commands with signals, children, instruments or plugins of their own.
_DRIVING = {"run", "serve", "stream", "station", "control", "plugins", "--watch"}


#: Numerical libraries are held to one thread, as the program does before it loads them.
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@lru_cache(maxsize=1)
def _forks():
    """A server whose forks have everything loaded: two to four seconds less for every command."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["warm"])
    # The server looks for modules on this path alone, and says nothing where it is not.
    here = Path(__file__).parent
    environment = {**_ONE_THREAD, "PYTHONPATH": os.pathsep.join(map(str, (here, here.parent / "samples")))}
    with pytest.MonkeyPatch.context() as patch:
        for name, value in environment.items():
            patch.setenv(name, value)
        forkserver.ensure_running()
    return context


def cbsr_qa(folder, *arguments, check=True, fresh=False, limit_s=300, **environment):
    """Run one command in a folder; by default it must succeed.

    What drives instruments or loads plugins runs in a fork of a process that has loaded everything, all else in this
    process, which takes a tenth of the time; ``fresh`` starts the installed program itself.
    """
    arguments = [str(argument) for argument in arguments]
    forked = environment or (_DRIVING & set(arguments) and "--dry-run" not in arguments)
    environment = {"CBSR_QA_VAR": "var", **environment}
    run = _fresh if fresh else _forked if forked else _inside
    done = run(folder, arguments, environment, limit_s)
    if check and done.returncode:
        raise AssertionError(f"{arguments} ended with {done.returncode}:\n{done.stdout}\n{done.stderr}")
    return done


def _inside(folder, arguments, environment, limit_s):
    from cbsr_qa.cli.main import run_guarded

    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.chdir(folder)
        for name, value in environment.items():
            patch.setenv(name, value)
        code = run_guarded(arguments)
    return subprocess.CompletedProcess(arguments, code, out.getvalue(), err.getvalue())


def _fresh(folder, arguments, environment, limit_s):
    return subprocess.run(
        [str(PROGRAM), *arguments],
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=limit_s,
    )


def _forked(folder, arguments, environment, limit_s):
    with tempfile.TemporaryDirectory() as written:
        out, err = Path(written) / "out", Path(written) / "err"
        out.touch()
        err.touch()
        process = _forks().Process(target=forked.run, args=(Path(folder), arguments, environment, out, err))
        process.start()
        process.join(timeout=limit_s)
        assert process.exitcode is not None, f"{arguments} has not ended after {limit_s} s"
        return subprocess.CompletedProcess(arguments, process.exitcode, out.read_text(), err.read_text())


def refused(folder, *arguments, **options):
    """Run a command that must be refused; returns its message on one line."""
    done = cbsr_qa(folder, *arguments, check=False, **options)
    assert done.returncode == 2, (arguments, done.stdout, done.stderr)
    assert "Traceback" not in done.stderr
    return " ".join(done.stderr.split())


def document(done):
    """Return the one JSON document a command printed, refusing NaN."""

    def refuse(constant):
        raise AssertionError(f"{constant} in a JSON document")

    return json.loads(done.stdout, parse_constant=refuse)


#: A report without figures.
FEW_SECTIONS = '\n[report]\nsections = ["limits", "station-check", "traceability"]\n'
#: Metrics that are quickly worked out, for runs whose measurements are not the point.
QUICK = ("centre-of-mass-error", "noise-figure", "channel-noise")


def short_recipe(folder, name="short.toml", *, metrics=None, **replacements):
    """Write the shipped recipe with its first phase alone, one trial and short times; returns the file's name.

    With all of its metrics and a whole report, or with the metrics that are named and a report without figures,
    which take half the time of a short run.
    """
    from cbsr_qa.config.documents import DocumentKind, open_document

    shipped = open_document(DocumentKind.RECIPE, "nine-locations").text
    head, rest = shipped.split("[[phases]]", 1)
    first = rest.split("[[phases]]", 1)[0]
    tail = rest[rest.index("[reconstruction]") : rest.index("[[limits]]")]
    head = head.replace('"nine locations"', '"noise figure"')
    if metrics is not None:
        tail = tail[: tail.index("[metrics]")] + "[metrics]\n" + "".join(f"{one} = {{}}\n" for one in metrics)
        tail += FEW_SECTIONS
    limit = '\n[[limits]]\nmeasurement = "centre_of_mass_error"\nunit = "mm"\nupper = 6.5\n'
    text = head + "[[phases]]" + first.replace("trials = 3", "trials = 1") + tail + limit
    for old, new in replacements.items():
        assert old in text, old
        text = text.replace(old, new)
    (folder / name).write_text(text)
    return name
