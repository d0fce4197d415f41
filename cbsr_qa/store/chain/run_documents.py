"""What the chain of a run covers: rows as canonical text, identical on every database, and their digests.

A document is the rows of one table that share a key. Columns come from the tables themselves, so that later ones are
covered. A column without a value is left out, so that a new nullable one does not change earlier digests.

What a comparison of fleets reads of an analysis has its own digest, computed over a million measurements block by
block.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import UTC
from functools import cache, reduce
from itertools import groupby
from json.encoder import encode_basestring
from numbers import Real
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import (
    JSON,
    Boolean,
    Column,
    ColumnElement,
    Connection,
    LargeBinary,
    RowMapping,
    Table,
    select,
)

from cbsr_qa.domain.numbers import Array
from cbsr_qa.store.tables.records import ConfigurationChangeRow, GateAnswerRow, VerdictOverrideRow
from cbsr_qa.store.tables.results import (
    AdoptionRow,
    AnalysisRow,
    BaselineRow,
    CalibrationRow,
    CertificateRow,
    CertificateWithdrawalRow,
    MeasurementRow,
    ReanalysisRow,
    WarningRow,
)
from cbsr_qa.store.tables.runs import (
    AttendanceRow,
    Base,
    DecisionRow,
    FrameBlockRow,
    InstrumentRow,
    LoadRow,
    PartRow,
    PhaseEndRow,
    PhaseRow,
    RunRow,
    RunStateRow,
    SampleBlockRow,
    StepRow,
    UnloadedMarkRow,
)
from cbsr_qa.store.types import Digest, FiniteDouble, Instant, PlainText, Whole, Word

_JSON: Final = json.JSONEncoder(sort_keys=True, separators=(",", ":"), ensure_ascii=False)

#: Tables under the chain, with the columns whose values name a document; without any, a run has one document there.
KEYS: Final[dict[str, tuple[str, ...]]] = {
    table.__tablename__: columns
    for table, columns in (
        (RunRow, ()),
        (InstrumentRow, ()),
        (PartRow, ()),
        (ConfigurationChangeRow, ()),
        (RunStateRow, ("number",)),
        (GateAnswerRow, ("session",)),
        (PhaseRow, ("phase",)),
        (PhaseEndRow, ("phase",)),
        (StepRow, ("phase", "entry")),
        (FrameBlockRow, ("phase", "block")),
        (SampleBlockRow, ("phase", "block")),
        (LoadRow, ("phase", "load_index")),
        (UnloadedMarkRow, ("phase", "mark")),
        (AttendanceRow, ("phase", "entry")),
        (DecisionRow, ("phase", "pressed")),
        (AnalysisRow, ("analysis",)),
        (WarningRow, ("analysis",)),
        (MeasurementRow, ("analysis",)),
        (CalibrationRow, ("calibration",)),
        (BaselineRow, ("calibration",)),
        (VerdictOverrideRow, ("override_id",)),
        (ReanalysisRow, ("reanalysis",)),
        (AdoptionRow, ("analysis",)),
        (CertificateRow, ("certificate",)),
        (CertificateWithdrawalRow, ("withdrawal",)),
    )
}
#: Columns that no digest covers: the chain that an end of a phase is in says of which run it is.
_LEFT_OUT: Final = {("phase_ends", "run")}
#: What is computed over the other columns.
_SEALS: Final = {("station_checks", "seal")}
#: What a comparison of fleets reads of an analysis, see fleet.py.
FIGURES: Final = "figures"


def canonical(content: Any) -> str:
    """Return canonical JSON."""
    return _JSON.encode(content)


def _replace_foreign(value: Any) -> str:
    """Replace a value of a foreign type, which a reader would round or parse, by one that equals nothing else."""
    return canonical([type(value).__name__, repr(value)])


def double_text(value: Any) -> str:
    """Return a finite number with all of its digits; a foreign value so that it equals nothing else."""
    if type(value) is not float:
        if not isinstance(value, Real):
            return _replace_foreign(value)
        value = float(value)
    # SQLite keeps no −0.
    return float.__repr__(value + 0.0) if value - value == 0 else canonical(value)


def _write_whole(value: Any) -> str:
    if type(value) is int:
        return int.__repr__(value)
    if isinstance(value, Real) and value % 1 == 0:
        whole: Any = value  # a bool, a float or a number of numpy
        return canonical(int(whole))
    return _replace_foreign(value)


#: How a value is written in JSON; the tests compare it with :func:`canonical`, which takes twice as long.
_WRITERS: Final[tuple[tuple[type, Callable[[Any], str]], ...]] = (
    (FiniteDouble, double_text),
    (Whole, _write_whole),
    (PlainText, lambda value: encode_basestring(str(value).replace("\0", "\ufffd"))),
    (Instant, lambda value: encode_basestring(value.astimezone(UTC).isoformat())),
    (Boolean, lambda value: canonical(bool(value)) if value in (0, 1) else _replace_foreign(value)),
    (JSON, canonical),
    (Word, lambda value: encode_basestring(str(value))),
    (Digest, lambda value: encode_basestring(str(value))),
)


def tables() -> Iterator[Table]:
    """Yield the tables covered by the chain."""
    return (Base.metadata.tables[name] for name in KEYS)


@cache
def list_covered(table: Table) -> tuple[Column[Any], ...]:
    """Return the columns a digest covers. Bytes have their own digest in the same row."""
    left_out = _LEFT_OUT | _SEALS
    return tuple(
        column
        for column in table.columns
        if not isinstance(column.type, LargeBinary) and (table.name, column.name) not in left_out
    )


@cache
def list_writers(table: Table) -> tuple[tuple[str, str, Callable[[Any], str]], ...]:
    """Return name, key in JSON and writer of the columns that a digest covers, sorted."""
    return tuple(
        (column.name, f'"{column.name}":', next(how for kind, how in _WRITERS if isinstance(column.type, kind)))
        for column in sorted(list_covered(table), key=lambda column: column.name)
    )


def row_text(table: Table, row: Mapping[str, Any] | RowMapping) -> str:
    """Return a row as canonical JSON: floats to the last bit, instants in UTC, keys sorted."""
    get = row.get
    cells = [key + how(cell) for name, key, how in list_writers(table) if (cell := get(name)) is not None]
    return f"{{{','.join(cells)}}}"


def sha256(*parts: str) -> str:
    """Return the hexadecimal digest of some lines."""
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def document_of(table: Table, row: Mapping[str, Any] | RowMapping) -> str:
    """Return the key of the document that a row belongs to."""
    return "/".join([str(row[name]) for name in KEYS[table.name]])


def documents(table: Table, rows: Iterable[Mapping[str, Any] | RowMapping]) -> Iterator[tuple[str, str]]:
    """Yield key and content digest of every document among rows of a table, in the order of their keys."""
    keyed = sorted([(document_of(table, row), row_text(table, row)) for row in rows])
    for key, group in groupby(keyed, key=lambda pair: pair[0]):
        yield key, sha256(*(text for _, text in group))


def name_document(kind: str, key: str) -> str:
    """Name a document for messages: its table and key columns."""
    names = ("analysis",) if kind == FIGURES else KEYS.get(kind, ("document",))
    key_text = ", ".join(f"{name} {value}" for name, value in zip(names, key.split("/"), strict=False))
    return f"{'run and measurement values' if kind == FIGURES else kind}{f' ({key_text})' if names else ''}"


#: Separates words that the database joins; no text contains it.
BETWEEN: Final = "\x1f"
#: Columns that describe a value in words.
JOINED: Final = ("name", "phase", "qualifier", "unit", "location", "outcome", "bound")
#: Facts of runs that are distinguished and counted; column → its name in a row.
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
#: Description of a measurement: joined words, lower limit, upper limit.
Description = tuple[str, float | None, float | None]


def words() -> ColumnElement[str]:
    """Join texts in the database: each column takes its time."""
    first, *others = (getattr(MeasurementRow, name) for name in JOINED)
    return reduce(lambda joined, column: joined.concat(BETWEEN).concat(column), others, first)


def facts(run: Any, analysis: str, outcome: str, software: Sequence[Sequence[str]]) -> str:
    """Return the identifying facts as text, from something with :data:`RUN_COLUMNS` and the run's analysis."""
    of_run = run.run, run.serial, run.batch, run.material or None, run.station, run.recipe, run.operator
    when = run.started_at.astimezone(UTC).isoformat()
    return canonical([*of_run, when, run.simulated, analysis, outcome, software])


def contents(
    known: Sequence[str],
    place: NDArray[np.int32],
    description_index: NDArray[np.int32],
    value: Array,
    descriptions: Sequence[Description],
) -> Iterator[str]:
    """Yield the digest of each analysis, hexadecimal.

    Parameters
    ----------
    known : facts of every analysis.
    place : (n,) analysis of each measurement; those of one analysis in the order of their numbers.
    description_index : (n,) index into ``descriptions``.
    value : (n,) NaN where not measured.
    """
    if (np.diff(place) < 0).any():
        order = np.argsort(place, kind="stable")
        place, description_index, value = place[order], description_index[order], value[order]
    ends = np.searchsorted(place, np.arange(len(known) + 1)).tolist()
    indices = description_index.astype("<i4").tobytes()
    numbers = (value + 0.0).astype("<f8").tobytes()  # SQLite keeps no −0
    texts = [f"{text}{BETWEEN}{lower!r}{BETWEEN}{upper!r}" for text, lower, upper in descriptions]
    digests: dict[bytes, bytes] = {}  # most analyses of a recipe describe their values in the same words
    for facts_text, begin, end in zip(known, ends[:-1], ends[1:], strict=True):
        own_indices = indices[4 * begin : 4 * end]
        if own_indices not in digests:
            digests[own_indices] = _sha256("\n".join(texts[k] for k in description_index[begin:end])).digest()
        total = _sha256(facts_text)
        total.update(digests[own_indices])
        total.update(numbers[8 * begin : 8 * end])
        yield total.hexdigest()


def figures_digest(connection: Connection, analysis: str) -> str:
    """Return the stored digest of one analysis."""
    a, m = AnalysisRow, MeasurementRow
    query = select(*RUN_COLUMNS, a.outcome, a.software).join(a, a.run == RunRow.run).where(a.analysis == analysis)
    run = connection.execute(query).one()
    rows = select(m.value, words(), m.lower_limit, m.upper_limit).where(m.analysis == analysis).order_by(m.number)
    measurements = connection.execute(rows).all()
    value = np.array([number for number, *_ in measurements], dtype=np.float64)
    description_index = np.arange(len(measurements), dtype=np.int32)
    known = facts(run, analysis, run.outcome, run.software)
    descriptions = [(text, lower, upper) for _, text, lower, upper in measurements]
    return next(contents([known], 0 * description_index, description_index, value, descriptions))


def _sha256(text: str) -> Any:
    return hashlib.sha256(text.encode())
