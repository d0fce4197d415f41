"""The outcome of a run, looked up by whoever needs nothing else of the store."""

from sqlalchemy import select

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.outcome import Outcome
from cbsr_qa.store.engine import open_engine, parsed_url, reading, sqlite_file
from cbsr_qa.store.failures import shown
from cbsr_qa.store.result_tables import AnalysisRow


def latest_outcome(url: str, run: str) -> Outcome | None:
    """Return the outcome of a run's latest analysis; None where there is none.

    Raises
    ------
    StoreError
        If there is no such database, or it cannot be read.
    """
    parsed = parsed_url(url)
    file = sqlite_file(parsed)
    if file is not None and not file.exists():  # SQLite would make an empty one
        raise StoreError(f"{shown(parsed)} is not there")
    engine = open_engine(parsed)
    try:
        with reading(engine) as connection:
            query = select(AnalysisRow.outcome).where(AnalysisRow.run == run)
            found = connection.execute(query.order_by(AnalysisRow.analysis.desc()).limit(1)).scalar()
    finally:
        engine.dispose()
    return None if found is None else Outcome(found)
