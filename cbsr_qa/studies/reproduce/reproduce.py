"""Reproduction of the paper's tables: simulation, comparison, JSON or page."""

import tomllib
from collections.abc import Callable, Mapping
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass
from importlib.resources import files
from os import cpu_count
from pathlib import Path
from typing import Any, Final

from cbsr_qa.domain.results import Banner, Page
from cbsr_qa.report import render_sections, write_report
from cbsr_qa.studies.reproduce.compare import ComparedTable, Comparison, Ours, Printed
from cbsr_qa.studies.reproduce.draw import CentreForces, reproduction_sections
from cbsr_qa.studies.reproduce.figures import SheetFigures, StripFigures
from cbsr_qa.studies.reproduce.runs import FULL_WORDS, QUICK_WORDS, SEED, Job, all_jobs, not_reproduced, simulate
from cbsr_qa.studies.reproduce.tables import centre_presses, compared_tables
from cbsr_qa.studies.sweep import finished

SOURCE: Final = (
    "Ellingham et al., Algorithms and Metrics Towards an Improved an Electrical Impedance Tomography Based "
    "Artificial Soft Skin Pressure Sensor"
)

#: What every number of ours is of.
SIMULATED: Final = (
    "every number called ours: sensors of 8 and 9 wt% on the simulated bench",
    "uniform sheet: scene base, a sheet that is alike everywhere, responds, relaxes and is read with noise",
    "bench sheet: scene everything, with all of the bench's imperfections as we chose them",
    "strip: scene strip, the material in 1D",
)

Figures = SheetFigures | StripFigures


@dataclass(frozen=True, slots=True)
class Reproduction:
    """The paper's tables beside ours.

    Parameters
    ----------
    quick : fewer trials and strains.
    presses : of the uniform sheet at L0, by percentage: what the force figure shows.
    """

    tables: tuple[ComparedTable, ...]
    quick: bool
    seed: int
    presses: tuple[CentreForces, ...]
    station_s: float

    @property
    def words(self) -> str:
        """Description of the simulated runs."""
        return QUICK_WORDS if self.quick else FULL_WORDS

    def document(self) -> dict[str, Any]:
        """Return what ``--json`` prints."""
        about = {
            "source": SOURCE,
            "simulated": list(SIMULATED),
            "simulated_words": self.words,
            "quick": self.quick,
            "seed": self.seed,
        }
        return {"about": about, **{table.key: _table_document(table) for table in self.tables}}

    def write(self, path: Path) -> None:
        """Write a page that stands by itself.

        Raises
        ------
        RefusedError
            If its folder cannot be written to.
        """
        agreeing, of = (sum(counts) for counts in zip(*(table.counts for table in self.tables), strict=True))
        identity = (
            ("Published", SOURCE),
            ("Ours", self.words),
            ("Seed", str(self.seed)),
            ("Station time", f"{self.station_s / 3600:.0f} h, simulated"),
        )
        reason = f"{agreeing} of {of} numbers that can be compared agree; every row that does not says why"
        banner = Banner("plain", "≈", "Paper and simulation", reason)
        page = Page("Reproduction", "Published tables beside simulated sensors", banner, identity, SIMULATED, ())
        write_report(path, render_sections(page, reproduction_sections(self.tables, self.presses)))


def published() -> dict[str, Any]:
    """Read the paper's printed numbers, which ship with the program."""
    text = files("cbsr_qa._stations").joinpath("published", "ellingham.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def reproduce_paper(
    *, quick: bool = False, tell: Callable[[str], None] = lambda words: None, processes: int | None = None
) -> Reproduction:
    """Simulate the paper's measurements on shipped recipes, and compare.

    Nothing is stored: runs lie in temporary databases, and the user's is not opened.

    Parameters
    ----------
    quick : fewer trials and strains.
    tell : told what is done.
    processes : how many work at once; by default two, or one where there is one core.

    Raises
    ------
    NotReproducedError
        If a simulated sensor gave no figures; the others are given up.
    """
    jobs = all_jobs(quick=quick)
    tell(f"simulating {len(jobs)} sensors with seed {SEED}: {', '.join(job.words for job in jobs)}")
    count = min(2, cpu_count() or 1) if processes is None else processes
    return reproduction(_simulated(jobs, count, tell), quick=quick)


def reproduction(figures: Mapping[Job, Figures], *, quick: bool) -> Reproduction:
    """Compare the simulated values with the paper's."""
    sheets = {(job.sheet, job.percent): one for job, one in figures.items() if isinstance(one, SheetFigures)}
    strips = {job.percent: one for job, one in figures.items() if isinstance(one, StripFigures)}
    paper = published()
    presses = tuple(
        CentreForces(
            f"{percent} wt%",
            paper["force_error_sd_N_at_L0"][str(percent)],
            tuple((one.measured_N, one.global_N) for one in centre_presses(sheets["uniform", percent])),
            tuple(
                (one.measured_N, one.global_N)
                for name, sheet in sheets.items()
                if name == ("bench", percent)
                for one in centre_presses(sheet)
            ),
        )
        for percent in (8, 9)
    )
    station_s = sum(one.station_s for one in figures.values())
    return Reproduction(compared_tables(paper, sheets, strips), quick, SEED, presses, station_s)


def _simulated(jobs: tuple[Job, ...], processes: int, tell: Callable[[str], None]) -> dict[Job, Figures]:
    simulated: dict[Job, Figures] = {}
    try:
        with closing(finished(jobs, simulate, processes)) as results:
            for job, figures in results:
                simulated[job] = figures
                tell(f"{job.words}: {figures.compute_s:.0f} s ({len(simulated)} of {len(jobs)})")
    except BrokenProcessPool as error:
        first = next(job for job in jobs if job not in simulated)
        raise not_reproduced(first, "its process was killed; see whether memory ran out") from error
    return simulated


def _table_document(table: ComparedTable) -> dict[str, Any]:
    agreeing, of = table.counts
    return {
        "title": table.title,
        "notes": list(table.notes),
        "agreeing": agreeing,
        "compared": of,
        "rows": [_row_document(row) for row in table.rows],
    }


def _row_document(row: Comparison) -> dict[str, Any]:
    return {
        "group": row.group,
        "name": row.name,
        "unit": row.unit,
        "kind": str(row.kind),
        "rule": str(row.rule),
        "paper": _printed_document(row.printed, row.bands[0]),
        "ours": _ours_document(row.ours, row.bands[1]),
        "beside": [_ours_document(one, "") for one in row.beside],
        "agrees": row.agrees,
        "reason": row.reason,
    }


def _printed_document(printed: Printed, band: str) -> dict[str, Any]:
    document: dict[str, Any] = {"value": printed.value, "deviation": printed.deviation}
    if printed.ranges:
        document["ranges"] = [{"where": name, "low": low, "high": high} for name, low, high in printed.ranges]
    return {**document, "band": band} if band else document


def _ours_document(ours: Ours, band: str) -> dict[str, Any]:
    document: dict[str, Any] = {
        "simulated_on": ours.sheet,
        "value": ours.value,
        "uncertainty": ours.uncertainty,
        "uncertainty_is": ours.of,
        "at_least": ours.at_least,
    }
    return {**document, "band": band} if band else document
