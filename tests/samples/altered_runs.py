"""A database with something in every table of a run, and ways to alter it as one can who may write to it."""

import hashlib
import sqlite3
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime

from calibration_samples import sample_force
from sqlalchemy import JSON, Boolean, DateTime, Double, Integer, LargeBinary, create_engine, select
from stored_runs import SETTING, calibration, short_run

from cbsr_qa.calibration.file.hdf5 import stamp
from cbsr_qa.domain.plan.gate import GateCheck, GatePolicy
from cbsr_qa.domain.plan.limits import Limit, Outcome
from cbsr_qa.domain.results.certificate_records import IssuedCertificate
from cbsr_qa.domain.results.measurement import Measurement, decide
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.domain.run.gate import GateAnswer, GateOutcome
from cbsr_qa.store.chain.check import select_run
from cbsr_qa.store.chain.links import link_digest
from cbsr_qa.store.chain.many_rows import documents_in_columns, keys_of
from cbsr_qa.store.chain.run_documents import KEYS
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.results.reanalyses import Reanalysis
from cbsr_qa.store.tables.runs import Base

LIMIT = Limit("drift", "mm", None, 5.0)
PASSED = (
    Measurement("drift", 4.0, "mm", phase="nine locations").judge(LIMIT),
    Measurement("noise", -0.0, "1", 0.1 + 0.2),
)
FAILED = (Measurement("drift", 6.0, "mm", phase="nine locations").judge(LIMIT), PASSED[1])
ANSWER = GateAnswer(GateCheck.DISK, GatePolicy.REFUSE, GateOutcome.OVERRIDDEN, "1 GB free", "tidy up", "Zoë", "so")


def fill(url):
    """Store two runs of a sensor, and return the second one's name.

    It has a re-analysis that was adopted, an analysis that failed, a calibration, and an override to a pass; its
    recipe is not the one of the first run, which passed. A certificate of it was replaced by another.
    """
    with open_store(url) as store:
        first, second = store.new_id(), store.new_id()
        _journal(store, first, '{"recipe":{"limits":[1]}}')
        store.analyses.save(RunResult(store.runs.load(first), None, PASSED, decide(PASSED), None, ""))
        _journal(store, second, '{"recipe":{"limits":[2]}}', gate=[ANSWER])
        record, software = store.runs.load(second), (("cbsr-qa", "0.2.0"),)
        issued = calibration(store.new_id(), second)
        model = sample_force(int(issued.reconstruction.problem.used.sum()))
        issued = stamp(replace(issued, force=model, digest="", record_digest=""))
        again = Reanalysis(second, 64 * "0", "{}", software, decide(PASSED), PASSED, ("one",), "equal", None, ())
        store.reanalyses.adopt(store.reanalyses.save(again), operator="Zoë", why="corrected")
        store.analyses.save(RunResult(record, None, FAILED, decide(FAILED), issued, "", warnings=("one", "two")))
        store.changes.override_verdict(second, Outcome.PASS, operator="Zoë", why="seen")
        first_certificate = certificate(second, issued.calibration)
        store.certificates.save(first_certificate)
        store.certificates.save(
            replace(first_certificate, number="LAB-2", replaces="LAB-1", why="name corrected", signature="{}")
        )
    return second


def certificate(run, calibration, **changes):
    """Return a certificate of a run, with documents that nobody can read."""
    values = {
        "number": "LAB-1",
        "run": run,
        "calibration": calibration,
        "issued_at": datetime(2026, 11, 22, 9, 30, tzinfo=UTC),
        "signatory": "Zoë Ōtani",
        "valid_until": "2027-11-22",
        "replaces": None,
        "why": "",
        "html": b"<p>page</p>",
        "dcc": b"<dcc/>",
        "signature": None,
    }
    return IssuedCertificate(**(values | changes))


def _journal(store, run, configuration, **options):
    started, *events = short_run(run)
    digest = hashlib.sha256(configuration.encode()).hexdigest()
    started = replace(started, identity=replace(started.identity, configuration_digest=digest))
    journal = store.open_journal(configuration=configuration, **SETTING, **options)
    for event in (started, *events):
        journal(event)


def change(path, statement, *values):
    """Change a SQLite file past the program, references unchecked; something must change."""
    with closing(sqlite3.connect(path)) as database, database:
        assert database.execute(statement, values).rowcount >= 1, statement


def another_value(column):
    """Return SQL for a value that a column can hold, and that it does not hold now."""
    name, table = column.name, column.table
    if (table.name, name) == ("run_states", "end"):
        return "case end when 'aborted' then 'broken' else 'aborted' end"
    if name == "outcome" and table.name != "gate_answers":
        return "case outcome when 'pass' then 'fail' else 'pass' end"
    for kind, other in (
        (Boolean, f"1 - {name}"),
        (JSON, """'[["altered","1"]]'"""),
        (DateTime, "'2020-01-01 00:00:00.000000'"),
        (Double, f"coalesce({name}, 0) + 1"),
        (Integer, f"coalesce({name}, 0) + 1000"),
        (LargeBinary, "zeroblob(32)"),
    ):
        if isinstance(getattr(column.type, "impl", column.type), kind):
            return other
    return f"coalesce({name}, '') || 'x'"


def linked_again(path, run):
    """Compute every digest and link of a run again, as one can who has no key: signatures stay as they were."""
    engine = create_engine(f"sqlite:///{path}")
    with engine.begin() as connection:
        content = {}
        for table in map(Base.metadata.tables.__getitem__, KEYS):
            rows = connection.execute(select(table).where(select_run(table, run))).mappings().all()
            if rows:
                columns = {column.name: [row[column.name] for row in rows] for column in table.columns}
                digests = documents_in_columns(table, columns, keys_of(table, columns))
                content |= {(table.name, key): digest for key, digest in digests.items()}
        links, before = Base.metadata.tables["run_links"], ""
        of_links = select(links).where(links.c.run == run).order_by(links.c.number)
        for link in connection.execute(of_links).mappings().all():
            own = content.get((link["kind"], link["document"]), link["content_sha256"])
            before = link_digest(before, link["kind"], link["document"], own)
            changed = links.update().where(links.c.run == run, links.c.number == link["number"])
            connection.execute(changed.values(content_sha256=own, sha256=before))
    engine.dispose()
