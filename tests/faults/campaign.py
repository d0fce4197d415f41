"""Every fault at every step of a nine-location run: ``make faults`` writes what becomes of them.

python tests/faults/campaign.py docs/reference/faults.md [--every N] [--role ROLE]
"""

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import asdict, replace
from pathlib import Path

from judgement import Outcome, allowed_s
from short_run import steps_of_a_run
from trial import OF_INSTRUMENTS, OF_THE_COMPUTER, PASSING, Injected, run_with

Result = tuple[Injected, Outcome]
RODE_THROUGH = "rode through"

_TEXT = Path(__file__).with_name("faults.md.in")


def matrix(steps: int, *, every: int = 1, role: str | None = None) -> Iterator[Injected]:
    """Every fault of every role at every n-th step; which ones differs from fault to fault."""
    number = 0
    for name, faults in {**OF_INSTRUMENTS, **OF_THE_COMPUTER}.items():
        for fault in faults if role in (None, name) else ():
            number += 1
            if fault in PASSING and every == 1:
                yield Injected(name, fault, 0, again=True)
                continue
            for step in range(number % every, steps, every):
                yield Injected(name, fault, step)


def struck(case: Injected) -> list[Result]:
    """Strike from a step on; returns what became of each step that was struck.

    A fault that passes strikes one step after the other of the same run, and of another from the step after that in
    which one broke it.
    """
    if case.fault not in PASSING or not case.again:
        return [(case, run_with(case))]
    found: list[Result] = []
    step, steps = case.step, len(steps_of_a_run())
    while step < steps:
        outcome = run_with(replace(case, step=step))
        last = steps - 1 if outcome.kind == RODE_THROUGH else outcome.last_step
        ridden = Outcome(RODE_THROUGH, "", last, 0.0)
        found += [(replace(case, step=one), ridden if one < last else outcome) for one in range(step, last + 1)]
        step = last + 1
    return found


def results(cases: list[Injected], processes: int) -> Iterator[Result]:
    """Strike with all of them; each process has one world after the other."""
    with multiprocessing.get_context("spawn").Pool(processes, maxtasksperchild=200) as pool:
        for found in pool.imap_unordered(struck, cases):
            yield from found


def kept(path: Path | None) -> list[Result]:
    """Read what an earlier campaign of the same version has found."""
    if path is None or not path.exists():
        return []
    read = [json.loads(line) for line in path.read_text().splitlines()]
    return [(Injected(**one["injected"]), Outcome(**one["outcome"])) for one in read]


def keep(path: Path | None, injected: Injected, outcome: Outcome) -> None:
    """Write down one step that was struck."""
    if path is not None:
        with path.open("a") as file:
            file.write(json.dumps({"injected": asdict(injected), "outcome": asdict(outcome)}) + "\n")


def table(found: Iterable[Result]) -> str:
    """Fault × step → outcome, as Markdown: how many ended in which way."""
    steps = list(dict.fromkeys(steps_of_a_run()))
    found = sorted(found, key=_order)
    cells: dict[tuple[str, str], dict[str, Counter[str]]] = defaultdict(lambda: defaultdict(Counter))
    names = steps_of_a_run()
    for injected, outcome in found:
        kind = outcome.kind if not outcome.wrong else "WRONG"
        cells[injected.role, injected.fault][names[injected.step]][kind] += 1
    lines = ["| strikes | fault | " + " | ".join(steps) + " |", "| --- | --- |" + " --- |" * len(steps)]
    for (role, fault), by_step in cells.items():
        told = [", ".join(f"{kind} {count}" for kind, count in by_step[step].items()) or "–" for step in steps]
        lines.append(f"| {role} | {fault} | " + " | ".join(told) + " |")
    return "\n".join(lines)


def _order(result: Result) -> tuple[int, int]:
    names = [(role, fault) for role, faults in {**OF_INSTRUMENTS, **OF_THE_COMPUTER}.items() for fault in faults]
    injected = result[0]
    return names.index((injected.role, injected.fault)), injected.step


def main() -> int:
    """Run the campaign; exit code 1 if anything went wrong that must not."""
    wanted = argparse.ArgumentParser(description=__doc__)
    wanted.add_argument("page", type=Path, nargs="?")
    wanted.add_argument("--every", type=int, default=1)
    wanted.add_argument("--role")
    wanted.add_argument("--keep", type=Path)
    wanted.add_argument("--processes", type=int, default=2 * (os.cpu_count() or 1))
    chosen = wanted.parse_args()
    names = steps_of_a_run()
    cases = list(matrix(len(names), every=chosen.every, role=chosen.role))
    found = kept(chosen.keep)
    known = {(injected.role, injected.fault, injected.step) for injected, _ in found}
    cases = [case for case in cases if (case.role, case.fault, case.step) not in known]
    total = len(found) + sum(len(names) if case.again else 1 for case in cases)
    start = time.monotonic()
    for injected, outcome in results(cases, chosen.processes):
        found.append((injected, outcome))
        keep(chosen.keep, injected, outcome)
        if outcome.wrong:
            where = f"step {injected.step} ({names[injected.step]})"
            print(f"{injected.role} {injected.fault} at {where}: {outcome.kind}: {outcome.wrong}", flush=True)
            print(f"    {outcome.detail}", flush=True)
        if len(found) % 20 == 0:
            took = time.monotonic() - start
            print(f"{len(found)} of {total} steps struck, {took:.0f} s", file=sys.stderr, flush=True)
    wrong = sum(bool(outcome.wrong) for _, outcome in found)
    kinds = Counter(outcome.kind for _, outcome in found)
    slowest = max((outcome.safe_after_s for _, outcome in found if outcome.kind == "broken"), default=0.0)
    said = (
        f"{len(found)} steps struck: "
        f"{', '.join(f'{count} {kind}' for kind, count in kinds.most_common())}; {wrong} wrong."
        f" Slowest to come to rest: {slowest:.1f} s of station time; allowed {allowed_s():.1f} s."
    )
    print(said)
    if chosen.page is not None and not wrong:
        filled = _TEXT.read_text().replace("@table@", table(found)).replace("@said@", said)
        chosen.page.write_text(filled)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
