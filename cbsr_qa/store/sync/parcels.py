"""Parcels: what is read from a station's database for one transaction at the centre, checked against its digests."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, Final, NamedTuple

from sqlalchemy import Connection, Row, Table, case, func, literal, select

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.archives import ARRAYS, Archives, with_arrays
from cbsr_qa.store.chain.check import digest_documents, unreadable
from cbsr_qa.store.chain.links import OF_A_SESSION, SigningKey, checking_key, link_digest
from cbsr_qa.store.chain.many_rows import documents_in_columns, keys_of
from cbsr_qa.store.chain.run_documents import FIGURES, KEYS, figures_digest, name_document, tables
from cbsr_qa.store.results.calibrations import check_files
from cbsr_qa.store.results.certificates import check_documents
from cbsr_qa.store.runs.codec import frame_block, frame_values
from cbsr_qa.store.runs.many_blocks import check_many_frames, check_many_samples
from cbsr_qa.store.runs.rows import current_state
from cbsr_qa.store.sync.rows import columns_of, counts_of, is_bytes, raw_select, within
from cbsr_qa.store.tables.records import LinkRow, VerdictOverrideRow
from cbsr_qa.store.tables.results import (
    AnalysisRow,
    CalibrationRow,
    CertificateRow,
    CertificateWithdrawalRow,
    ReanalysisRow,
)
from cbsr_qa.store.tables.runs import Base, FrameBlockRow, PhaseEndRow, RunRow, SampleBlockRow, SensorRow

#: Most documents and bytes of blocks in one parcel: a second of work, and memory of a few times the bytes.
MOST_LINKS: Final = 4000
MOST_BYTES: Final = 16_000_000

#: More links than anything that is stored at once has, and the kinds of links with which it begins.
_MAX_LINKS_AT_ONCE: Final = 64
_BEGINS: Final = OF_A_SESSION | {
    *(model.__tablename__ for model in (PhaseEndRow, AnalysisRow, VerdictOverrideRow, ReanalysisRow)),
    *(model.__tablename__ for model in (CertificateRow, CertificateWithdrawalRow)),
}

#: Checks of the bytes of rows, which no digest of its document covers.
_CHECKED: Final[Mapping[str, Any]] = {
    FrameBlockRow.__tablename__: check_many_frames,
    SampleBlockRow.__tablename__: check_many_samples,
    CalibrationRow.__tablename__: check_files,
    CertificateRow.__tablename__: check_documents,
}
_BLOCK_TABLES: Final = (FrameBlockRow.__tablename__, SampleBlockRow.__tablename__)


class Tail(NamedTuple):
    """Where a run stands at the centre: number and digest of its last link."""

    number: int
    sha256: str


#: Tail of a run of which the centre has nothing.
NOTHING: Final = Tail(-1, "")


class AlteredError(StoreError):
    """A run does not match its digests, or not what the centre has of it; with both digests."""

    def __init__(self, reason: str, station_sha256: str = "", centre_sha256: str = "") -> None:
        super().__init__(reason)
        self.digests = station_sha256, centre_sha256


@dataclass(frozen=True, slots=True)
class Parcel:
    """Documents of a run that follow each other in its chain, with their links.

    Parameters
    ----------
    station : of the run.
    version : of the run with these documents: the number of its links.
    rows : by table, in an order in which references hold.
    sensor : row of the sensor, with the row of the run.
    counts : rows of the run by table, once it is whole; else empty.
    whole : whether nothing follows.
    open : whether the run may grow without being announced.
    """

    run: str
    station: str
    version: int
    rows: Mapping[str, Sequence[Sequence[Any]]]
    sensor: Row[Any] | None = None
    counts: Mapping[str, int] = field(default_factory=dict)
    whole: bool = True
    open: bool = False

    @property
    def tail(self) -> Tail:
        """Where the run stands at the centre with this parcel; only of a chained run."""
        last: Any = self.rows[LinkRow.__tablename__][-1]
        return Tail(last.number, last.sha256.hex())

    @property
    def row_count(self) -> int:
        return sum(map(len, self.rows.values()))

    @property
    def size(self) -> int:
        """Bytes of its arrays and files."""
        total = 0
        for name, rows in self.rows.items():
            columns = Base.metadata.tables[name].columns
            for index in (place for place, column in enumerate(columns) if is_bytes(column)):
                total += sum([len(row[index] or b"") for row in rows])
        return total


def read_parcel(connection: Connection, run: str, tail: Tail, archives: Archives) -> Parcel:
    """Read what follows a link in a run's chain.

    Parameters
    ----------
    tail : where the run stands at the centre.
    archives : the same for all parcels of a run.

    Raises
    ------
    AlteredError
        If the station's link of that number is another one, or what follows was altered.
    """
    try:
        return _read_parcel(connection, run, tail, archives)
    except AlteredError:
        raise
    except StoreError as error:
        raise AlteredError(error.reason) from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise AlteredError(unreadable(connection, run, error).reason) from error


def _read_parcel(connection: Connection, run: str, tail: Tail, archives: Archives) -> Parcel:
    number, sha256 = tail
    head = connection.execute(select(RunRow.station, RunRow.serial, RunRow.chain).where(RunRow.run == run)).one()
    own = connection.scalar(select(LinkRow.sha256).where(LinkRow.run == run, LinkRow.number == number)) or ""
    newest, _ = newest_link(connection, run)
    if own != sha256:
        raise AlteredError(f"link {number} of run {run} differs from the centre's", own, sha256)
    links = _links(connection, run, number)
    _check_chain(run, links, number, sha256, checking_key(connection, head.chain))
    digests = defaultdict[str, dict[str, str]](dict)
    for _, _, kind, document, content, *_ in links:
        digests[kind][document] = content.hex()
    rows = dict(_read_rows(connection, run, digests, archives))
    rows[LinkRow.__tablename__] = links
    version = links[-1].number + 1 if links else number + 1
    whole = version == newest + 1
    return Parcel(
        run,
        head.station,
        version,
        {name: rows[name] for name in (*KEYS, LinkRow.__tablename__) if rows.get(name)},
        _sensor(connection, head.serial) if RunRow.__tablename__ in rows else None,
        _counts(connection, run) if whole and links else {},
        whole,
        current_state(connection, run).end == EndReason.RUNNING,
    )


def newest_link(connection: Connection, run: str) -> Tail:
    """Return number and digest of the last link of a run; :data:`NOTHING` without one."""
    query = select(LinkRow.number, LinkRow.sha256).where(LinkRow.run == run)
    newest = connection.execute(query.order_by(LinkRow.number.desc()).limit(1)).one_or_none()
    return NOTHING if newest is None else Tail(newest.number, newest.sha256)


def read_unchained(connection: Connection, run: str, centre: Mapping[tuple[str, str], str]) -> Parcel:
    """Read a run without a chain.

    Parameters
    ----------
    centre : digest of each document that the centre has of it.

    Raises
    ------
    AlteredError
        If the centre has other documents of it.
    """
    head = connection.execute(select(RunRow.station, RunRow.serial).where(RunRow.run == run)).one()
    digests: dict[str, dict[str, str]] = {}
    own = {(kind, key): content for kind, key, content in digest_documents(connection, run)}
    for place, content in centre.items():
        if own.get(place) != content:
            raise AlteredError(
                f"{name_document(*place)} of run {run} differs from the centre's", own.get(place, ""), content
            )
    for (kind, key), content in own.items():
        if (kind, key) not in centre:
            digests.setdefault(kind, {})[key] = content
    rows = dict(_read_rows(connection, run, digests, Archives()))
    return Parcel(
        run,
        head.station,
        1,
        rows,
        _sensor(connection, head.serial) if RunRow.__tablename__ in rows else None,
        _counts(connection, run),
    )


def _links(connection: Connection, run: str, number: int) -> list[Any]:
    """Links that follow a number, as many as make a parcel; what the station stored at once is not divided."""
    query = raw_select(Base.metadata.tables[LinkRow.__tablename__]).where(LinkRow.run == run, LinkRow.number > number)
    links = list(connection.execute(query.order_by(LinkRow.number).limit(MOST_LINKS + _MAX_LINKS_AT_ONCE)).all())
    sizes = _sizes(connection, run, links)
    if not sizes and len(links) <= MOST_LINKS:
        return links
    total, ends = 0, len(links)
    for place, link in enumerate(links):
        if link.kind in _BEGINS and place:
            ends = place
            if place >= MOST_LINKS or total > MOST_BYTES:
                return links[:place]
        total += sizes.get((link.kind, link.document), 0)
    return links if len(links) < MOST_LINKS + _MAX_LINKS_AT_ONCE else links[:ends]


def _sizes(connection: Connection, run: str, links: Sequence[Any]) -> dict[tuple[str, str], int]:
    """Bytes of blocks, by kind and document; empty if all of them are few."""
    sizes: dict[tuple[str, str], int] = {}
    of_kind = defaultdict[str, list[str]](list)
    for _, _, kind, document, *_ in links:
        of_kind[kind].append(document)
    for table in (Base.metadata.tables[name] for name in _BLOCK_TABLES):
        if keys := of_kind[table.name]:
            parts: list[Any] = [func.coalesce(func.length(column), 0) for column in table.columns if is_bytes(column)]
            if table.name == FrameBlockRow.__tablename__:  # an archived one has no bytes here
                row = FrameBlockRow
                parts += [case((func.length(row.voltages) == 0, 8 * row.frames * row.drives * row.measures), else_=0)]
            size = sum(parts, literal(0))
            of_keys = within(table, run, keys)
            if (connection.scalar(select(func.sum(size)).where(of_keys)) or 0) > MOST_BYTES // len(_BLOCK_TABLES):
                query = select(table.c.phase, table.c.block, size).where(of_keys)
                sizes.update(
                    {(table.name, f"{phase}/{block}"): count for phase, block, count in connection.execute(query)}
                )
    return sizes


def _check_chain(run: str, links: Sequence[Any], number: int, before: str, key: SigningKey | None) -> None:
    for expected_number, (_, link_number, kind, document, content, own, mac) in enumerate(links, start=number + 1):
        if link_number != expected_number:
            raise AlteredError(f"run {run}: link {expected_number} in run_links is missing")
        expected = link_digest(before, kind, document, content.hex())
        before = own.hex()
        if before != expected:
            what = f"link {link_number} in run_links, of {name_document(kind, document)},"
            raise AlteredError(f"run {run}: {what} does not follow from the link before it", expected, before)
        if key is not None and (mac is None or not key.verify(run, before, mac.hex())):
            what = f"link {link_number} in run_links, of {name_document(kind, document)},"
            raise AlteredError(f"run {run}: {what} was not signed with key {key.key_id}", before)


def _read_rows(
    connection: Connection, run: str, digests: Mapping[str, Mapping[str, str]], archives: Archives
) -> Iterator[tuple[str, Sequence[Sequence[Any]]]]:
    """Yield table and rows of documents, whose digests match."""
    for table in tables():
        contents = digests.get(table.name)
        if contents:
            yield table.name, _rows(connection, run, table, contents, archives)
    for analysis, content in digests.get(FIGURES, {}).items():
        stored = figures_digest(connection, analysis)
        if stored != content:
            raise _name_alteration(run, FIGURES, analysis, stored, content)


def _rows(
    connection: Connection, run: str, table: Table, contents: Mapping[str, str], archives: Archives
) -> Sequence[Sequence[Any]]:
    rows: Sequence[Any] = connection.execute(raw_select(table).where(within(table, run, contents))).all()
    columns = columns_of(table, rows)
    keys = keys_of(table, columns)
    stored = documents_in_columns(table, columns, keys)
    for key, content in contents.items():
        if stored.get(key) != content:
            raise _name_alteration(run, table.name, key, stored.get(key), content)
    if len(stored) > len(contents):  # of earlier or later parcels
        rows = [row for row, key in zip(rows, keys, strict=True) if key in contents]
    check = _CHECKED.get(table.name)
    if check is not None:
        whole = list(with_arrays(connection, rows, archives) if table.name == FrameBlockRow.__tablename__ else rows)
        check(whole)  # raises where bytes do not match the digest in their row
        rows = [row if isinstance(row, Row) else _restore_row(row, table.columns.keys()) for row in whole]
    return rows


def _restore_row(row: Any, names: Sequence[str]) -> Sequence[Any]:
    """Return the row of a block of archived frames as it was stored before."""
    whole: Any = SimpleNamespace(**(vars(row) | {"sha256": row.sha256.hex()}))
    block = frame_block(whole)
    values = vars(row) | {name: value for name, value in frame_values(block).items() if name in ARRAYS}
    return [values[name] for name in names]


def _name_alteration(run: str, kind: str, key: str, stored: str | None, content: str) -> AlteredError:
    if stored is None:
        what = f"{name_document(kind, key)} was removed: its link is there, the row is not"
    else:
        what = f"{name_document(kind, key)} was changed: it does not match its digest"
    return AlteredError(f"run {run}: {what}", stored or "", content)


def _sensor(connection: Connection, serial: str) -> Row[Any]:
    return connection.execute(select(*SensorRow.__table__.columns).where(SensorRow.serial == serial)).one()


def _counts(connection: Connection, run: str) -> dict[str, int]:
    return counts_of(connection, run, [*KEYS, LinkRow.__tablename__])
