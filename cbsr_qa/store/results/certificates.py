"""Certificates of runs, their replacement and revocation: appended under the chains of their runs, never changed."""

import hashlib
import re
from collections.abc import Callable, Iterable
from datetime import datetime
from typing import Any, Final

from sqlalchemy import Connection, Engine, exists, func, select, true
from sqlalchemy.orm import aliased

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.results.certificate_records import CertificateWithdrawal, IssuedCertificate, StoredCertificate
from cbsr_qa.store.chain.check import check_run, check_unless_checked
from cbsr_qa.store.chain.links import add_rows, match_few_links
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.mapping import convert_row, row_of
from cbsr_qa.store.runs.begun import check_begun_here
from cbsr_qa.store.tables.records import LinkRow
from cbsr_qa.store.tables.results import AnalysisRow, CertificateRow, CertificateWithdrawalRow
from cbsr_qa.store.tables.runs import RunBegunRow, RunRow

#: Documents that say whether a certificate stands; with analyses, a link that is missing after them is noticed.
_KEPT: Final = (CertificateRow.__tablename__, CertificateWithdrawalRow.__tablename__)
_KINDS: Final = frozenset({*_KEPT, AnalysisRow.__tablename__})
#: The run in the number of a certificate.
_RUN: Final = re.compile("[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}")
_LIST: Final = "cbsr-qa certificate list names the certificates of a database"


class Certificates:
    """Certificates of runs."""

    def __init__(self, engine: Engine, new_id: Callable[[], str], wall: Callable[[], datetime]) -> None:
        self._engine = engine
        self._new_id = new_id
        self._wall = wall

    def count(self, run: str) -> int:
        """Return how many certificates were issued of a run, those that were withdrawn too."""
        query = select(func.count()).where(CertificateRow.run == run)
        with reading(self._engine) as connection:
            return connection.scalar(query) or 0

    def check_allowed(self, run: str, replaces: str | None) -> StoredCertificate | None:
        """Check whether a certificate of a run may be issued here; return the one that it replaces, None without.

        Raises
        ------
        StoreError
            If the run, or that of the replaced one, was begun in another database: numbers are counted there; the
            replaced one is not here, was altered or replaced already, or is of another sensor; or the latest
            certificate of the run is not the replaced one, and stands or was revoked.
        """
        with reading(self._engine) as connection:
            return _read_replaced(connection, run, replaces)

    def save(self, issued: IssuedCertificate, *, checked_link: str = "") -> None:
        """Store a certificate, and the withdrawal of the one that it replaces, in one transaction.

        Parameters
        ----------
        checked_link : of its run, as for :func:`~cbsr_qa.store.chain.check.check_unless_checked`.

        Raises
        ------
        StoreError
            If its run or that of the replaced one was altered, or as :meth:`check_allowed`; nothing is stored then.
        """
        certificate, withdrawal = self._new_id(), self._new_id()
        with writing(self._engine) as connection:
            check_unless_checked(connection, issued.run, checked_link)
            replaced = _read_replaced(connection, issued.run, issued.replaces)
            digests = {"html_sha256": _sha256(issued.html), "dcc_sha256": _sha256(issued.dcc)}
            row = row_of(CertificateRow, issued, certificate=certificate, **digests)
            add_rows(connection, issued.run, CertificateRow, [row])
            if replaced is not None:
                self._withdraw(connection, replaced, withdrawal, issued.number, issued.signatory, issued.why)

    def revoke(self, number: str, *, operator: str, why: str) -> StoredCertificate:
        """Revoke a certificate, and return it as it is then; its documents stay.

        Raises
        ------
        StoreError
            If there is no such certificate, it does not stand, or its run was altered or begun in another database.
        """
        withdrawal = self._new_id()
        with writing(self._engine) as connection:
            stored = _load(connection, number)
            check_begun_here(connection, stored.issued.run)
            if stored.withdrawals:
                raise StoreError(f"certificate {number} does not stand: it was {stored.withdrawn}")
            check_run(connection, stored.issued.run)
            self._withdraw(connection, stored, withdrawal, None, operator, why)
        return self.load(number)

    def _withdraw(
        self,
        connection: Connection,
        stored: StoredCertificate,
        withdrawal: str,
        replaced_by: str | None,
        operator: str,
        why: str,
    ) -> None:
        row = {
            "withdrawal": withdrawal,
            "run": stored.issued.run,
            "number": stored.issued.number,
            "replaced_by": replaced_by,
            "operator": operator,
            "why": why,
            "noted_at": self._wall(),
        }
        add_rows(connection, stored.issued.run, CertificateWithdrawalRow, [row])

    def find(self, number: str) -> StoredCertificate | None:
        """Return a certificate, None without one. StoreError if its run, or a document of it, was altered."""
        with reading(self._engine) as connection:
            return _find(connection, number)

    def load(self, number: str) -> StoredCertificate:
        """Return a certificate. StoreError if it is not stored, or was altered."""
        with reading(self._engine) as connection:
            return _load(connection, number)

    def list_all(self, serial: str | None = None) -> tuple[StoredCertificate, ...]:
        """Return the certificates of one sensor, or all, in the order they were issued.

        Runs that have only links of certificates are checked too: their rows were removed.

        Raises
        ------
        StoreError
            If no run is of that sensor; or as :meth:`find`.
        """
        row, link = CertificateRow, LinkRow
        of_sensor = true() if serial is None else RunRow.serial == serial
        linked = exists().where(link.run == RunRow.run, link.kind.in_(_KEPT), match_few_links())
        listed = exists().where(row.run == RunRow.run)
        query = select(row.number).join(RunRow, RunRow.run == row.run).where(of_sensor).order_by(row.certificate)
        with reading(self._engine) as connection:
            if serial is not None and not connection.scalar(select(exists().where(of_sensor))):
                raise StoreError(
                    f"there is no sensor {serial[:64]!r} in this database", remedy="cbsr-qa runs lists them"
                )
            for run in connection.scalars(select(RunRow.run).where(of_sensor, linked, ~listed)).all():
                check_run(connection, run, _KINDS)
            return tuple(_load(connection, number) for number in connection.scalars(query).all())

    def find_continued(self) -> set[str]:
        """Return the certified runs of which more was recorded since: their verdict may be another."""
        row, own, later = CertificateRow, LinkRow, aliased(LinkRow)
        of_certificate = (own.run == row.run) & (own.kind == row.__tablename__) & (own.document == row.certificate)
        followed = (later.run == own.run) & (later.number > own.number) & later.kind.not_in(_KEPT)
        query = select(row.run).join(own, of_certificate).join(later, followed).where(match_few_links())
        never_chained = select(row.run).join(RunRow, RunRow.run == row.run).where(RunRow.chain.is_(None))
        with reading(self._engine) as connection:
            return {*connection.scalars(query), *connection.scalars(never_chained)}

    def is_numbered_here(self, number: str) -> bool:
        """Whether a number names a run that was begun in this database, which then has every certificate of it."""
        begun = RunBegunRow.run
        with reading(self._engine) as connection:
            return (run := _read_run(number)) is not None and bool(
                connection.scalar(select(exists().where(begun == run)))
            )


def check_documents(rows: Iterable[Any]) -> None:
    """Check the documents in rows of certificates. StoreError names the certificate that has another."""
    for row in rows:
        for kind, data, digest in (("page", row.html, row.html_sha256), ("XML", row.dcc, row.dcc_sha256)):
            if data is None or _sha256(data) != digest:
                raise StoreError(
                    f"certificate {row.number}: its {kind} is not what was stored",
                    remedy="restore the database from a copy",
                )


def _read_replaced(connection: Connection, run: str, replaces: str | None) -> StoredCertificate | None:
    check_begun_here(connection, run)
    replaced = None if replaces is None else _load(connection, replaces)
    if replaced is not None:
        check_begun_here(connection, replaced.issued.run)
        if replaced.is_replaced:
            raise StoreError(f"certificate {replaces} does not stand: it was {replaced.withdrawn}")
        serial = connection.scalar(select(RunRow.serial).where(RunRow.run == run))
        if replaced.serial != serial:
            raise StoreError(f"certificate {replaces} is of sensor {replaced.serial}, not of {serial}")
    row = CertificateRow
    newest = connection.scalar(select(row.number).where(row.run == run).order_by(row.certificate.desc()).limit(1))
    if newest is not None and newest != replaces and not (earlier := _load(connection, newest)).is_replaced:
        state = f"was {earlier.withdrawn}" if earlier.withdrawals else "stands"
        raise StoreError(
            f"certificate {newest} of this run {state}",
            remedy="--replaces NUMBER --reason TEXT issues one in its place, which names it;"
            f" `cbsr-qa certificate copy {newest} --to FOLDER` writes its files again",
        )
    return replaced


def _load(connection: Connection, number: str) -> StoredCertificate:
    stored = _find(connection, number)
    if stored is None:
        raise StoreError(f"there is no certificate {number[:96]!r} in this database", remedy=_LIST)
    return stored


def _find(connection: Connection, number: str) -> StoredCertificate | None:
    row, withdrawn = CertificateRow, CertificateWithdrawalRow
    run = connection.scalar(select(row.run).where(row.number == number))
    if run is None:
        named = _read_run(number)
        if named is not None and connection.scalar(select(exists().where(RunRow.run == named))):
            check_run(connection, named, _KINDS)  # names a row that was removed
        return None
    check_run(connection, run, _KINDS)
    query = select(*row.__table__.columns, RunRow.serial).join(RunRow, RunRow.run == row.run)
    stored: Any = connection.execute(query.where(row.number == number)).one()
    check_documents([stored])
    later = select(*withdrawn.__table__.columns).where(withdrawn.number == number).order_by(withdrawn.withdrawal)
    return StoredCertificate(
        convert_row(IssuedCertificate, stored),
        stored.serial,
        tuple(convert_row(CertificateWithdrawal, one) for one in connection.execute(later)),
    )


def _read_run(number: str) -> str | None:
    found = _RUN.search(number)
    return None if found is None else found[0]


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
