"""Loads as figures and tables show them, joined with what was measured of them."""

from collections.abc import Sequence

from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa.domain.outcome import Outcome
from cbsr_qa.report.figures_loads import SeenLoad
from cbsr_qa.report.figures_relaxation import SettledLoad
from cbsr_qa.report.select import Measured


def seen_loads(loads: Sequence[LoadObservation], run: RunObservation, measured: Measured) -> tuple[SeenLoad, ...]:
    """Join loads with their centre-of-mass error and overlap of the main mask."""
    several = len({load.record.load.trial for load in run.loads}) > 1
    strains = len({round(load.record.load.strain, 6) for load in run.loads}) > 1
    return tuple(_seen(load, run, measured, titled(load, trials=several, strains=strains)) for load in loads)


def settled_loads(loads: Sequence[LoadObservation]) -> tuple[SettledLoad, ...]:
    """Return the loads that have any relaxation."""
    return tuple(
        SettledLoad(load.record.load.label, load.phase, load.record.load.strain, load.relaxations)
        for load in loads
        if load.relaxations
    )


def titled(load: LoadObservation, *, trials: bool, strains: bool) -> str:
    """Name a load with what tells it from its siblings: ``L3``, ``L3 · 20 %``, ``L3 · 20 % · trial 2``."""
    wanted = load.record.load
    parts = [wanted.label]
    parts += [f"{round(100 * wanted.strain, 1):g} %"] if strains else []
    parts += [f"trial {wanted.trial + 1}"] if trials and wanted.trial else []
    return " · ".join(parts)


def _seen(load: LoadObservation, run: RunObservation, measured: Measured, title: str) -> SeenLoad:
    wanted, view = load.record.load, load.mask(run.main_mask)
    error = measured.of_load("centre_of_mass_error", load)
    overlap = measured.of_load("area_overlap", load)
    return SeenLoad(
        label=wanted.label,
        title=title,
        x_mm=wanted.x_mm,
        y_mm=wanted.y_mm,
        radius_mm=load.indenter.radius_mm,
        pressed=load.indenter.at(wanted.x_mm, wanted.y_mm),
        strain=wanted.strain,
        image=load.image,
        sensed=view.region if view else None,
        error_mm=error.value if error else None,
        overlap_percent=overlap.value if overlap else None,
        outcome=error.outcome if error else Outcome.NOT_JUDGED,
        overlap_outcome=overlap.outcome if overlap else Outcome.NOT_JUDGED,
        group=load.phase,
    )
