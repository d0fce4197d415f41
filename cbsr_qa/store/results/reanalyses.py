"""Re-analyses of stored runs: on trial beside the valid analysis, until somebody adopts them."""

import hashlib
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final

from sqlalchemy import Connection, Engine, func, select

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.measurement import Measurement, Verdict
from cbsr_qa.store.chain.check import RESULTS, check_run, data_digest
from cbsr_qa.store.chain.links import add_rows, key_to_continue
from cbsr_qa.store.damage import read_word
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.mapping import convert_row
from cbsr_qa.store.results.analyses import add_analysis, measurement_values, restore_measurement
from cbsr_qa.store.tables.results import AdoptionRow, AnalysisRow, MeasurementRow, ReanalysisRow
from cbsr_qa.store.tables.runs import RunRow

_EMPTY: Final = {column.name: None for column in MeasurementRow.__table__.columns}
_KEY: Final = ("analysis", "number")


@dataclass(frozen=True, slots=True)
class Reanalysis:
    """What a run was found to be by another recipe or other software.

    Parameters
    ----------
    key_sha256 : digest of what it follows from: data, recipe, software.
    recipe : canonical JSON of the file.
    software : (distribution, version) pairs.
    compute_s : (stage, seconds) pairs.
    """

    run: str
    key_sha256: str
    recipe: str
    software: tuple[tuple[str, str], ...]
    verdict: Verdict
    measurements: tuple[Measurement, ...]
    warnings: tuple[str, ...]
    noise_weighting: str
    weight_ratio: float | None
    compute_s: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True)
class AdoptedRuns:
    """Re-analyses that one person adopted for one reason, by one recipe."""

    operator: str
    why: str
    recipe: str
    runs: int
    first_at: datetime
    last_at: datetime


class Reanalyses:
    """Re-analyses of runs, and those that were adopted."""

    def __init__(self, engine: Engine, new_id: Callable[[], str], wall: Callable[[], datetime]) -> None:
        self._engine = engine
        self._new_id = new_id
        self._wall = wall

    def digest_data(self, run: str) -> str:
        """Return the SHA-256 of all that was measured in a run, and check that a re-analysis can be added to it.

        Raises
        ------
        StoreError
            If the run does not exist, or its chain cannot be continued with the signing key that is set.
        """
        with reading(self._engine) as connection:
            row = connection.execute(select(RunRow.chain).where(RunRow.run == run)).one_or_none()
            if row is None:
                raise StoreError(f"there is no run {run[:64]!r} in this database")
            key_to_continue(connection, run, row.chain)
            return data_digest(connection, run)

    def find(self, run: str, key_sha256: str) -> str | None:
        """Return the latest re-analysis with this key, or None."""
        r = ReanalysisRow
        query = select(func.max(r.reanalysis)).where(r.run == run, r.key_sha256 == key_sha256)
        with reading(self._engine) as connection:
            return connection.scalar(query)

    def list_names(self, run: str) -> tuple[str, ...]:
        """Return the names of the re-analyses of a run, latest first."""
        r = ReanalysisRow
        with reading(self._engine) as connection:
            return tuple(connection.scalars(select(r.reanalysis).where(r.run == run).order_by(r.reanalysis.desc())))

    def save(self, made: Reanalysis) -> str:
        """Store a re-analysis beside the valid analysis of its run, and return its identifier.

        StoreError if its run is altered; nothing is stored then.
        """
        reanalysis = self._new_id()
        values = {
            "reanalysis": reanalysis,
            "run": made.run,
            "key_sha256": made.key_sha256,
            "recipe": made.recipe,
            "analysed_at": self._wall(),
            "software": [list(pair) for pair in made.software],
            "outcome": str(made.verdict.outcome),
            "reason": made.verdict.reason,
            "noise_weighting": made.noise_weighting,
            "weight_ratio": made.weight_ratio,
            "compute_s": [[stage, float(seconds)] for stage, seconds in made.compute_s],
            "warnings": list(made.warnings),
            "measurements": [
                {name: value for name, value in measurement_values(measurement).items() if value is not None}
                for measurement in made.measurements
            ],
        }
        with writing(self._engine) as connection:
            add_rows(connection, made.run, ReanalysisRow, [values])
        return reanalysis

    def load(self, reanalysis: str) -> Reanalysis:
        """Return a re-analysis. StoreError if it does not exist or was altered."""
        with reading(self._engine) as connection:
            row = _row(connection, reanalysis)
            return convert_row(
                Reanalysis,
                row,
                verdict=Verdict(
                    read_word(Outcome, row.outcome, "reanalyses.outcome", _name_reanalysis(reanalysis)), row.reason
                ),
                measurements=tuple(
                    restore_measurement(_EMPTY | cells, f"{_name_reanalysis(reanalysis)}, measurement {number},")
                    for number, cells in enumerate(row.measurements)
                ),
            )

    def adopt(self, reanalysis: str, *, operator: str, why: str) -> str:
        """Make a re-analysis the valid analysis of its run, in one transaction, and return that analysis.

        Earlier analyses stay. No calibration is issued or withdrawn.

        Raises
        ------
        StoreError
            If the re-analysis does not exist, or its run was altered; nothing is stored then.
        """
        analysis, adopted_at = self._new_id(), self._wall()
        with writing(self._engine) as connection:
            row = _row(connection, reanalysis)
            check_run(connection, row.run, RESULTS)
            names = (column.name for column in AnalysisRow.__table__.columns)
            shared = {name: getattr(row, name) for name in names if hasattr(row, name)}
            why_none = f"the analysis was adopted from a re-analysis by {operator}: {why}; that issues no calibration"
            values = {**shared, "analysis": analysis, "calibration_why": why_none}
            bare = {name: None for name in _EMPTY if name not in _KEY}
            add_analysis(connection, values, row.warnings, (bare | cells for cells in row.measurements))
            adopted = {"reanalysis": reanalysis, "operator": operator, "why": why, "adopted_at": adopted_at}
            add_rows(connection, row.run, AdoptionRow, [{"analysis": analysis, **adopted}])
        return analysis

    def list_adoptions(self, without: Collection[str] = ()) -> tuple[AdoptedRuns, ...]:
        """Return who adopted how many re-analyses, when and why, oldest first; ``without`` some runs."""
        a, r = AdoptionRow, ReanalysisRow
        first, last = func.min(a.adopted_at), func.max(a.adopted_at)
        query = select(a.operator, a.why, r.recipe, func.count(), first, last).join(r, r.reanalysis == a.reanalysis)
        grouped = query.where(r.run.not_in(without)).group_by(a.operator, a.why, r.recipe).order_by(first)
        with reading(self._engine) as connection:
            return tuple(AdoptedRuns(*row) for row in connection.execute(grouped))


def key_of(data: str, recipe: str, software: Sequence[tuple[str, str]]) -> str:
    """Return the key of a re-analysis: SHA-256 of data digest, recipe and versions."""
    versions = (f"{name} {version}" for name, version in software)
    return hashlib.sha256("\n".join((data, recipe, *versions)).encode()).hexdigest()


def _row(connection: Connection, reanalysis: str) -> Any:
    query = select(*ReanalysisRow.__table__.columns).where(ReanalysisRow.reanalysis == reanalysis)
    row = connection.execute(query).one_or_none()
    if row is None:
        raise StoreError(f"there is no re-analysis {reanalysis[:64]!r} in this database")
    check_run(connection, row.run, (ReanalysisRow.__tablename__,))
    return row


def _name_reanalysis(reanalysis: str) -> str:
    return f"re-analysis {reanalysis}"
