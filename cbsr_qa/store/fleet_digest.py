"""A digest of what a comparison of fleets reads of an analysis: of a million measurements, a block at a time."""

import hashlib
from collections.abc import Iterator, Sequence
from datetime import UTC
from functools import reduce
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, Connection, Row, select

from cbsr_qa.store.documents import canonical
from cbsr_qa.store.result_tables import AnalysisRow, MeasurementRow
from cbsr_qa.store.run_tables import RunRow

#: Stands between words that the database joins: no text has it.
BETWEEN: Final = "\x1f"
#: What is said of a value in words.
JOINED: Final = ("name", "phase", "qualifier", "unit", "location", "outcome", "bound")
#: What is told apart and counted of runs; column → its name in a row.
RUN_COLUMNS: Final = (
    RunRow.run,
    RunRow.serial,
    RunRow.batch,
    RunRow.setting["material"]["name"].as_string().label("material"),
    RunRow.station,
    RunRow.recipe,
    RunRow.operator,
    RunRow.started_at,
    RunRow.simulated,
)
#: (joined words, lower limit, upper limit).
Saying = tuple[str, float | None, float | None]


def words() -> ColumnElement[str]:
    """Join what is said of a value in the database: each column takes its time."""
    first, *others = (getattr(MeasurementRow, name) for name in JOINED)
    return reduce(lambda joined, one: joined.concat(BETWEEN).concat(one), others, first)


def facts(run: Row[*tuple[Any, ...]], analysis: str, outcome: str, software: Sequence[Sequence[str]]) -> str:
    """Return what is compared by as text, from a row with :data:`RUN_COLUMNS` and the run's analysis."""
    of_run = run.run, run.serial, run.batch, run.material, run.station, run.recipe, run.operator
    when = run.started_at.astimezone(UTC).isoformat()
    return canonical([*of_run, when, run.simulated, analysis, outcome, software])


def contents(
    known: Sequence[str],
    place: NDArray[np.int32],
    said: NDArray[np.int32],
    value: NDArray[np.float64],
    sayings: Sequence[Saying],
) -> Iterator[str]:
    """Yield the digest of each analysis, hexadecimal.

    Parameters
    ----------
    known : facts of every analysis.
    place : (n,) which analysis a measurement is of; measurements of one in the order of their numbers.
    said : (n,) index into ``sayings``.
    value : (n,) NaN where there is none.
    """
    if (np.diff(place) < 0).any():
        order = np.argsort(place, kind="stable")
        place, said, value = place[order], said[order], value[order]
    ends = np.searchsorted(place, np.arange(len(known) + 1)).tolist()
    indices, numbers = said.astype("<i4").tobytes(), (value + 0.0).astype("<f8").tobytes()  # SQLite keeps no −0
    texts = [f"{text}{BETWEEN}{lower!r}{BETWEEN}{upper!r}" for text, lower, upper in sayings]
    digests: dict[bytes, bytes] = {}  # most analyses of a recipe say the same of their values
    for one, begin, end in zip(known, ends[:-1], ends[1:], strict=True):
        saying = indices[4 * begin : 4 * end]
        if saying not in digests:
            digests[saying] = _sha256("\n".join(texts[k] for k in said[begin:end])).digest()
        total = _sha256(one)
        total.update(digests[saying])
        total.update(numbers[8 * begin : 8 * end])
        yield total.hexdigest()


def stored_figures(connection: Connection, analysis: str) -> str:
    """Return the digest of one analysis as it is stored."""
    a, m = AnalysisRow, MeasurementRow
    query = select(*RUN_COLUMNS, a.outcome, a.software).join(a, a.run == RunRow.run).where(a.analysis == analysis)
    run = connection.execute(query).one()
    rows = select(m.value, words(), m.lower_limit, m.upper_limit).where(m.analysis == analysis).order_by(m.number)
    found = connection.execute(rows).all()
    value = np.array([one[0] for one in found], dtype=np.float64)
    said = np.arange(len(found), dtype=np.int32)
    known = facts(run, analysis, run.outcome, run.software)
    return next(contents([known], 0 * said, said, value, [(one[1], one[2], one[3]) for one in found]))


def _sha256(text: str) -> Any:
    return hashlib.sha256(text.encode())
