"""Reproduction of the paper's tables: simulation and comparison."""

import tomllib
from collections.abc import Callable, Mapping
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass
from importlib.resources import files
from os import cpu_count
from typing import Any, Final

from cbsr_qa.studies.reproduce.compare import ComparedTable
from cbsr_qa.studies.reproduce.runs import FULL_WORDS, QUICK_WORDS, SEED, Job, all_jobs, reproduction_error, simulate
from cbsr_qa.studies.reproduce.tables import centre_presses, compare_tables
from cbsr_qa.studies.reproduce.values import SheetValues, StripValues
from cbsr_qa.studies.sweep import run_jobs

SOURCE: Final = (
    "Ellingham et al., Algorithms and Metrics Towards an Improved an Electrical Impedance Tomography Based "
    "Artificial Soft Skin Pressure Sensor"
)

#: Origin of our numbers.
SIMULATED: Final = (
    "every number called ours: sensors of 8 and 9 wt% on the simulated bench",
    "uniform sheet: scene base, a sheet that is alike everywhere, responds, relaxes and is read with noise",
    "bench sheet: scene everything, with all of the bench's imperfections as we chose them",
    "strip: scene strip, the material in 1D",
)

Values = SheetValues | StripValues


@dataclass(frozen=True, slots=True)
class About:
    """Simulated sensors, their runs, and the time of the simulated station."""

    source: str
    simulated: tuple[str, ...]
    simulated_words: str
    quick: bool
    seed: int
    station_s: float


@dataclass(frozen=True, slots=True)
class CentreForces:
    """Forces at the centre: (measured, estimated) [N] of the uniform and of the bench sheet, and the paper's ±."""

    group: str
    printed_N: float
    uniform_N: tuple[tuple[float, float], ...]
    bench_N: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Reproduction:
    """The paper's tables and ours; ``presses`` are for the force figure."""

    about: About
    table1: ComparedTable
    table2: ComparedTable
    table3: ComparedTable
    table4: ComparedTable
    table5: ComparedTable
    tableF6: ComparedTable
    settling: ComparedTable
    force: ComparedTable
    presses: tuple[CentreForces, ...]

    @property
    def tables(self) -> tuple[ComparedTable, ...]:
        return (
            self.table1, self.table2, self.table3, self.table4, self.table5, self.tableF6, self.settling, self.force,
        )  # fmt: skip


def read_published() -> dict[str, Any]:
    """Read the paper's printed numbers, which ship with the program."""
    text = files("cbsr_qa._stations").joinpath("published", "ellingham.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def reproduce_paper(
    *, quick: bool = False, tell: Callable[[str], None] = lambda words: None, processes: int | None = None
) -> Reproduction:
    """Simulate the paper's measurements on shipped recipes, and compare; nothing is stored.

    Parameters
    ----------
    quick : True for fewer trials and strains.
    tell : receives the progress in words.
    processes : number in parallel; by default two, or one on a single core.

    Raises
    ------
    NotReproducedError
        If a simulated sensor gave no values; the others are abandoned.
    """
    jobs = all_jobs(quick=quick)
    tell(f"simulating {len(jobs)} sensors with seed {SEED}: {', '.join(job.words for job in jobs)}")
    count = min(2, cpu_count() or 1) if processes is None else processes
    return reproduction(_simulate_all(jobs, count, tell), quick=quick)


def reproduction(simulated: Mapping[Job, Values], *, quick: bool) -> Reproduction:
    """Compare the simulated values with the paper's."""
    sheets = {(job.sheet, job.percent): v for job, v in simulated.items() if isinstance(v, SheetValues)}
    strips = {job.percent: v for job, v in simulated.items() if isinstance(v, StripValues)}
    paper = read_published()
    about = About(
        SOURCE,
        SIMULATED,
        QUICK_WORDS if quick else FULL_WORDS,
        quick,
        SEED,
        sum(values.station_s for values in simulated.values()),
    )
    presses = tuple(
        CentreForces(
            f"{percent} wt%",
            paper["force_error_sd_N_at_L0"][str(percent)],
            _forces_N(sheets["uniform", percent]),
            _forces_N(sheets.get(("bench", percent))),
        )
        for percent in (8, 9)
    )
    return Reproduction(about, **compare_tables(paper, sheets, strips), presses=presses)


def _forces_N(sheet: SheetValues | None) -> tuple[tuple[float, float], ...]:
    presses = () if sheet is None else centre_presses(sheet)
    return tuple((press.measured_N, press.global_N) for press in presses)


def _simulate_all(jobs: tuple[Job, ...], processes: int, tell: Callable[[str], None]) -> dict[Job, Values]:
    simulated: dict[Job, Values] = {}
    try:
        with closing(run_jobs(jobs, simulate, processes)) as results:
            for job, values in results:
                simulated[job] = values
                tell(f"{job.words}: {values.compute_s:.0f} s ({len(simulated)} of {len(jobs)})")
    except BrokenProcessPool as error:
        first = next(job for job in jobs if job not in simulated)
        raise reproduction_error(first, "its process was killed; see whether memory ran out") from error
    return simulated
