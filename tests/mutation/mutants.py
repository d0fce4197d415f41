"""Draw changes of the core, run the tests that reach each, and hold what survives against an older commit's tests.

::

    python tests/mutation/mutants.py draw var/mutants --before COMMIT   # 300, one per function, as many of each part
    python tests/mutation/mutants.py reach var/mutants tests/eit tests/stats   # which tests reach which mutant
    python tests/mutation/mutants.py kill var/mutants       # nearest and fastest tests first, to the first failure
    python tests/mutation/mutants.py kill var/mutants 183 206 --tier rest  # some again, on all examples
    python tests/mutation/mutants.py table var/mutants      # numbers and survivors

With ``--before``, only functions that were the same at that commit are changed. Run by the Python of another
checkout's ``.venv`` and with ``--checkout DIR``, ``reach`` and ``kill`` try what survived here on the tests of that
checkout. No source file is written: processes that a file in ``CBSR_QA_MUTANTS`` names load the changed module
instead, through a line that the script puts into ``.venv`` and removes again.
"""

import argparse
import ast
import importlib
import io
import json
import os
import random
import signal
import subprocess
import sys
import tarfile
import tempfile
import time
import traceback
from collections import Counter, defaultdict
from contextlib import contextmanager, suppress
from pathlib import Path

import mutant_code
from mutant_code import VARIABLE, functions, mutated, sites

HERE = Path(__file__).resolve().parent
TOP = HERE.parents[1]
#: Names the generator.
SEED = "mutants of the core"
#: Packages of the core by the name of their part, and the rooms of tests nearest to them.
PARTS = {
    "forward": ("eit/forward", "eit/mesh", "eit/loads"),
    "reconstruct": ("eit/inverse", "eit/estimate"),
    "imaging": ("eit/imaging",),
    "calibrate": ("calibration",),
    "runner": ("station",),
    "store": ("store",),
    "stats": ("stats",),
}
#: Tests run on a mutant in rounds of so many seconds of their own time; the last takes all that are left.
ROUNDS_S = (8.0, 60.0, float("inf"))
#: A round that takes longer than this and six times what its tests take otherwise has met a mutant that does not end.
PATIENCE_S = 60.0
#: pytest's exit code where a test it is given is not there.
USAGE_ERROR = 4


def core(files):
    """Return functions of modules, ``{path: source}``, by their name and what they do: docstrings do not count."""
    found = defaultdict(list)
    for path, source in sorted(files.items()):
        for name, function in functions(ast.parse(source)):
            if ast.get_docstring(function, clean=False) is not None:
                function.body = function.body[1:] or [ast.Pass()]
            found[name, ast.dump(function)].append(path)
    return {key: paths[0] for key, paths in found.items() if len(paths) == 1}


def sources_at(commit):
    """Return modules of the package at a commit by their path."""
    packed = subprocess.run(["git", "archive", commit, "cbsr_qa"], cwd=TOP, capture_output=True, check=True).stdout
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        names = [name for name in archive.getnames() if name.endswith(".py")]
        return {name: archive.extractfile(name).read().decode() for name in names}


def draw(folder, before, count):
    """Write ``mutants.json``: so many, one a function, of functions that are the same at both commits."""
    now = {str(path.relative_to(TOP)): path.read_text() for path in (TOP / "cbsr_qa").rglob("*.py")}
    then = core(sources_at(before))
    same = sorted((path, key[0], then[key]) for key, path in core(now).items() if key in then)
    chance = random.Random(SEED)
    mutants = []
    for place, (part, rooms) in enumerate(PARTS.items()):
        inside = [one for one in same if one[0].startswith(tuple(f"cbsr_qa/{room}/" for room in rooms))]
        chance.shuffle(inside)
        wanted = count // len(PARTS) + (place < count % len(PARTS))
        for path, name, path_before in inside:
            changes = sites(dict(functions(ast.parse(now[path])))[name])
            if changes and wanted:
                kind = chance.choice(sorted({one.kind for one in changes}))
                number, site = chance.choice([one for one in enumerate(changes) if one[1].kind == kind])
                wanted -= 1
                mutants.append(
                    {
                        "key": len(mutants),
                        "part": part,
                        "path": path,
                        "path_before": path_before,
                        "function": name,
                        "number": number,
                        "line": site.line,
                        "change": f"{site.before} -> {site.after}",
                    }
                )
                mutated(now[path], name, number)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "mutants.json").write_text(json.dumps(mutants, indent=1))


def plan(tree, mutants, **more):
    """Return what :func:`mutant_code.install` is told, of modules in a checkout."""
    modules = defaultdict(list)
    for one in mutants:
        path = one["path"] if tree == TOP else one["path_before"]
        modules[str(tree / path)].append((one["function"], one["number"], one["key"]))
    return json.dumps({"modules": modules, **more})


@contextmanager
def door(tree):
    """Have every process of a checkout's Python ask whether it is to load changed code."""
    (site,) = (tree / ".venv/lib").glob("python3*/site-packages")
    path = site / "cbsr_qa_mutants.pth"
    path.write_text(
        f"import os, runpy; os.environ.get({VARIABLE!r}) and "
        f"runpy.run_path({str(HERE / 'mutant_code.py')!r})['install']()\n"
    )
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def fresh(tree, told, arguments, tier):
    """Run pytest in a process of its own; returns its exit code."""
    with arranged(told, arguments, tier) as (options, environment, _):
        command = [tree / ".venv/bin/python", "-m", "pytest", *options]
        return subprocess.run(command, cwd=tree, env={**os.environ, **environment}, check=False).returncode


@contextmanager
def arranged(told, arguments, tier):
    """Write what a run of pytest needs; yields its options, its environment and a folder."""
    with tempfile.TemporaryDirectory(prefix="mutant") as made:
        (Path(made) / "plan.json").write_text(told)
        (Path(made) / "tests").write_text("\n".join(arguments))
        options = ["-q", "-p", "no:cacheprovider", "-p", "mutant_code", f"--basetemp={made}/work", f"@{made}/tests"]
        options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]  # what a fork has loaded already
        yield options, {VARIABLE: f"{made}/plan.json", "CBSR_QA_TIER": tier}, Path(made)


def warm(tree):
    """Load what tests load, so that forks need not: nothing of the tests, all of the product."""
    for name in ("pytest", "hypothesis", "scipy.stats", "matplotlib.figure", "cbsr_qa_plugins"):
        importlib.import_module(name)
    for path in sorted((tree / "cbsr_qa").rglob("*.py")):
        if path.name not in ("__init__.py", "__main__.py"):
            importlib.import_module(".".join(path.relative_to(tree).with_suffix("").parts))


def forked(tree, told, arguments, tier, limit_s):
    """Run pytest in a fork of this process; returns its exit code, None where it did not end, and what it printed."""
    with arranged(told, arguments, tier) as (options, environment, made):
        child = os.fork()
        if not child:
            code = 70
            try:
                os.setsid()
                os.chdir(tree)
                output = os.open(made / "printed", os.O_CREAT | os.O_WRONLY)
                for stream in (1, 2):
                    os.dup2(output, stream)
                os.environ.update(environment)
                mutant_code.install()
                code = int(importlib.import_module("pytest").main(options))
            except BaseException:  # noqa: BLE001 - printed, and told apart by its exit code
                traceback.print_exc()
            finally:
                sys.stdout.flush()
                os._exit(code)
        end_s = time.monotonic() + limit_s
        while not os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) and time.monotonic() < end_s:
            time.sleep(0.02)
        late = not os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        with suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        return None if late else code, (made / "printed").read_text(errors="replace")


def reach(folder, tree, tests, jobs):
    """Run tests once on the code as it is; writes which reach which mutants, and how long each test takes."""
    mutants = wanted(folder, tree)
    reached = folder / "reached" / tree.name
    reached.mkdir(parents=True, exist_ok=True)
    told = plan(tree, mutants, reached=str(reached.resolve()))
    with door(tree):
        fresh(tree, told, ["-n", str(jobs), "--dist", "worksteal", *tests], "test")


def wanted(folder, tree):
    """Return the mutants to try: all of them in this checkout, in another those that survived here."""
    mutants = json.loads((folder / "mutants.json").read_bytes())
    here = {one["key"]: one["killer"] for one in outcomes(folder, TOP)}
    return [one for one in mutants if tree == TOP or (one["key"] in here and here[one["key"]] is None)]


def reached_by(folder):
    """Return the tests that reach each mutant, ``{key: {tests}}``, and the seconds each test took that passed."""
    seconds, failed, reached = Counter(), set(), defaultdict(set)
    for path in folder.glob("*.tests"):
        for line in path.read_text().splitlines():
            test, outcome, duration = line.split("\t")
            seconds[test] += float(duration)
            if outcome != "passed":
                failed.add(test)
    for path in folder.glob("*.reached"):
        for line in path.read_text().splitlines():
            key, test = line.split("\t")
            reached[int(key)].add(test)
    return reached, {test: took for test, took in seconds.items() if test not in failed}


def rounds(tests, seconds, nearest):
    """Return tests in rounds: nearest rooms first, then the fastest; tests that share a file stay in one round."""
    order = sorted(tests, key=lambda test: (not test.startswith(nearest), seconds[test], test))
    made = [[]]
    for test in order:
        spent = sum(seconds[one] for one in made[-1])
        if made[-1] and spent + seconds[test] > ROUNDS_S[min(len(made), len(ROUNDS_S)) - 1]:
            made.append([])
        made[-1].append(test)
    return [one for one in made if one]


def killed_by(tree, mutant, made, seconds, tier):
    """Return who killed a mutant, or None."""
    for tests in made:
        limit_s = PATIENCE_S + 6 * sum(seconds.get(test, 10.0) for test in tests)
        code, printed = forked(tree, plan(tree, [mutant]), ["-x", *tests], tier, limit_s)
        if code == USAGE_ERROR:  # a test of that name is not collected: its file says why
            files = sorted({test.split("::")[0] for test in tests})
            code, printed = forked(tree, plan(tree, [mutant]), ["-x", *files], tier, 2 * limit_s)
        if code is None:
            return f"not ended after {limit_s:.0f} s"
        if code:
            last = [line for line in printed.splitlines() if line.startswith(("FAILED", "ERROR"))]
            return last[-1] if last else f"exit {code}: {printed[-300:]}"
    return None


def kill(folder, tree, jobs, tier, keys):
    """Run the tests that reach each mutant; writes an outcome of each. Those named by key are tried again."""
    reached, seconds = reached_by(folder / "reached" / tree.name)
    done = {one["key"] for one in outcomes(folder, tree)}
    todo = [one for one in wanted(folder, tree) if (one["key"] in keys if keys else one["key"] not in done)]

    def one(mutant):
        start = time.monotonic()
        tests = reached[mutant["key"]] & seconds.keys()
        nearest = tuple(f"tests/{room}/" for room in PARTS[mutant["part"]])
        killer = killed_by(tree, mutant, rounds(tests, seconds, nearest), seconds, tier)
        took = round(time.monotonic() - start, 1)
        with (folder / f"{tree.name}.jsonl").open("a") as file:
            file.write(json.dumps({"key": mutant["key"], "killer": killer, "tests": len(tests), "s": took}) + "\n")

    with door(tree), tempfile.TemporaryDirectory() as taken:
        warm(tree)
        workers = []
        for _ in range(jobs):
            workers.append(os.fork())
            if not workers[-1]:
                for mutant in todo:
                    with suppress(FileExistsError):
                        (Path(taken) / str(mutant["key"])).touch(exist_ok=False)
                        one(mutant)
                os._exit(0)
        for worker in workers:
            os.waitpid(worker, 0)


def outcomes(folder, tree):
    """Return what became of mutants in a checkout; of one tried again, the last counts."""
    path = folder / f"{tree.name}.jsonl"
    lines = path.read_text().splitlines() if path.exists() else []
    return list({one["key"]: one for one in map(json.loads, lines)}.values())


def table(folder):
    """Print a row a part, then what survived."""
    mutants = json.loads((folder / "mutants.json").read_bytes())
    here = {one["key"]: one for one in outcomes(folder, TOP)}
    elsewhere = {}
    for path in sorted(folder.glob("*.jsonl")):
        if path.stem != TOP.name:
            elsewhere |= {one["key"]: one["killer"] for one in outcomes(folder, path.with_suffix(""))}
    print("| part | mutants | killed | survived | of these killed before |\n| --- | --- | --- | --- | --- |")
    for part in PARTS:
        tried = [here[one["key"]] for one in mutants if one["part"] == part and one["key"] in here]
        alive = [one["key"] for one in tried if one["killer"] is None]
        before = sum(elsewhere.get(key) is not None for key in alive)
        print(f"| {part} | {len(tried)} | {len(tried) - len(alive)} | {len(alive)} | {before} |")
    for one in mutants:
        if one["key"] in here and here[one["key"]]["killer"] is None:
            where = f"{one['path']}:{one['line']} {one['function']}"
            tests = here[one["key"]]["tests"]
            print(f"{one['key']}: {where}: {one['change']} ({tests} tests; before: {elsewhere.get(one['key'])})")


def main():
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("draw", "reach", "kill", "table"))
    parser.add_argument("folder", type=Path, help="where the mutants and what came of them are kept")
    parser.add_argument("tests", nargs="*", help="reach: tests to run; kill: mutants to try again, by their key")
    parser.add_argument("--before", help="draw: a commit; only functions that are the same there are changed")
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--checkout", type=Path, default=TOP)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--tier", default="test", choices=("test", "rest"))
    given = parser.parse_intermixed_args()
    folder, tree = given.folder.resolve(), given.checkout.resolve()
    match given.step:
        case "draw":
            draw(folder, given.before, given.count)
        case "reach":
            reach(folder, tree, given.tests, given.jobs)
        case "kill":
            kill(folder, tree, given.jobs, given.tier, {int(key) for key in given.tests})
        case "table":
            table(folder)


if __name__ == "__main__":
    main()
