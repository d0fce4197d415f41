"""Whether a run has its result: by its sessions and analyses together, wherever it is asked."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
import sqlalchemy as sa
from exported_runs import measured
from stored_runs import identity, journalled, short_run
from tiers import REST

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.results.measurement import Verdict, decide
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.domain.run.events import RunEnded, RunStarted
from cbsr_qa.domain.run.states import EndReason, ResultState
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity
from cbsr_qa.store.engine import open_engine, parse_url, writing
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.runs.outcomes import latest_result

_NOON = datetime(2026, 11, 21, 12, tzinfo=UTC)
_FINISHED, _ABORTED = RunEnded(EndReason.FINISHED, "", 10.0, ()), RunEnded(EndReason.ABORTED, "by Zoë", 10.0, ())
_NOT_MEASURED = Verdict(Outcome.NOT_MEASURED, "the run was aborted: by Zoë")


@pytest.fixture
def file_url(tmp_path):
    return f"sqlite:///{tmp_path / 'runs.db'}"


class _Told:
    """Carries out what happened to a run, an hour each, by a clock that may be set."""

    def __init__(self, url):
        self.url, self.now = url, _NOON
        self.store = open_store(url, durable=False, wall=lambda: self.now)
        self.run = self.store.new_id()

    def session(self, end):
        """Begin or resume the run; None leaves the session as a kill does."""
        self.now += timedelta(hours=1)
        begun, *events, _ = short_run(self.run)
        begun = RunStarted(replace(identity(self.run), started_at=self.now))
        first = not self.store.runs.find("S-1")
        journalled(self.store, [begun, *(events if first else ()), *([] if end is None else [end])])

    def analysed(self):
        """Store what is concluded of the run as it is now."""
        self.now += timedelta(hours=1)
        record = self.store.runs.load(self.run)
        finished = record.end is EndReason.FINISHED
        values = measured(5.0, 0.1) if finished else ()
        verdict = decide(values) if finished else _NOT_MEASURED
        self.store.analyses.save(RunResult(record, None, values, verdict, None, "not asked for"))

    def unchain(self):
        """Make the run as one of a database without chains."""
        engine = open_engine(parse_url(self.url))
        with writing(engine) as connection:
            connection.execute(sa.text("DELETE FROM run_links"))
            connection.execute(sa.text("UPDATE runs SET chain = NULL"))
        engine.dispose()


def _set_back(told):
    told.now -= timedelta(hours=9)


#: What happened, in order → what has come of the run, and the outcome that is shown.
_STORIES = {
    "cut off": ([None], ResultState.OPEN, None),
    "cut off before its analysis": ([_FINISHED], ResultState.MISSING, None),
    "finished": ([_FINISHED, "analysed"], ResultState.STORED, Outcome.PASS),
    "analysed twice": ([_FINISHED, "analysed", "analysed"], ResultState.STORED, Outcome.PASS),
    "stopped": ([_ABORTED, "analysed"], ResultState.STOPPED, Outcome.NOT_MEASURED),
    "stopped, and cut off before its analysis": ([_ABORTED], ResultState.STOPPED, None),
    "stopped, resumed and cut off": ([_ABORTED, "analysed", None], ResultState.OPEN, None),
    "stopped, resumed and stopped": ([_ABORTED, "analysed", _ABORTED], ResultState.STOPPED, None),
    "stopped, resumed, cut off before its analysis": (
        [_ABORTED, "analysed", None, _FINISHED],
        ResultState.MISSING,
        None,
    ),
    "stopped, resumed and finished": ([_ABORTED, "analysed", _FINISHED], ResultState.MISSING, None),
    "stopped, resumed and analysed": (
        [_ABORTED, "analysed", _FINISHED, "analysed"],
        ResultState.STORED,
        Outcome.PASS,
    ),
    "cut off, resumed and analysed": ([None, None, _FINISHED, "analysed"], ResultState.STORED, Outcome.PASS),
}
_BY_LINKS = {
    "stopped, clock set back, finished": ([_ABORTED, "analysed", _set_back, _FINISHED], ResultState.MISSING, None),
    "resumed, clock set back, analysed": (
        [_ABORTED, "analysed", _FINISHED, _set_back, "analysed"],
        ResultState.STORED,
        Outcome.PASS,
    ),
}


#: One of each state, and what an unchained run may be taken for.
_FIRST = {
    *(("cut off", True), ("finished", True), ("stopped", True), ("stopped, resumed and finished", True)),
    *(("stopped, resumed and finished", False), ("stopped, resumed and analysed", False)),
}
_ALL = [
    pytest.param(story, chained, id=f"{story}-{way}", marks=() if (story, chained) in _FIRST else REST)
    for story in _STORIES
    for way, chained in {"chained": True, "unchained": False}.items()
]


@pytest.mark.parametrize(("story", "chained"), _ALL)
def test_what_has_come_of_a_run_is_the_same_wherever_it_is_asked(story, chained, file_url):
    _check(*_STORIES[story], file_url, chained=chained)


@pytest.mark.postgres
@pytest.mark.parametrize("chained", [True, pytest.param(False, marks=REST)], ids=["chained", "unchained"])
@pytest.mark.parametrize(
    "story", [pytest.param("stopped, resumed and finished", marks=REST), "stopped, resumed and analysed"]
)
def test_it_is_so_on_a_server(story, chained, postgres_database):
    _check(*_STORIES[story], postgres_database, chained=chained)


@pytest.mark.parametrize("story", _BY_LINKS)
def test_a_clock_that_is_set_back_deceives_no_chained_run(story, file_url):
    _check(*_BY_LINKS[story], file_url, chained=True)


def test_an_unchained_result_with_values_holds_whatever_the_clock_said(file_url):
    _check(*_BY_LINKS["resumed, clock set back, analysed"], file_url, chained=False)


def _check(story, state, outcome, url, *, chained):
    told = _Told(url)
    for happened in story:
        if callable(happened):
            happened(told)
        elif happened == "analysed":
            told.analysed()
        else:
            told.session(happened)
        if not chained:
            told.unchain()
    with told.store as store:
        run, finished = told.run, state in (ResultState.MISSING, ResultState.STORED)
        assert store.runs.read_result_state(run) is state
        assert {one.verdict.outcome for one in store.analyses.load(run)[:1]} == ({outcome} - {None})
        (listed,) = store.lists.read_runs()
        (line,) = store.fleet.read_lines()
        (earlier,) = store.sensors.read_history(SensorIdentity("S-1", "B7", "disc-100mm"), "short").earlier
        shown = (listed, line, earlier, *store.runs.find(), store.live.find_run(run))
        assert [one.outcome for one in shown] == [outcome] * 5
        assert [one.run for one in store.fleet.load_table(RunSelection()).runs] == [run]
        assert (run in store.lists.read_limited_measurements([run])) is (state is ResultState.STORED)
        assert store.live.find_run(run).result is state
        assert latest_result(url, run) == (state, outcome)
        assert [one.run for one in store.unfinished.list_incomplete()] == ([] if finished else [run])
        engine = open_engine(parse_url(url))
        assert store.unfinished.list_without_result() == (((run, "S-1"),) if state is ResultState.MISSING else ())
        with writing(engine) as connection:
            (view,) = connection.execute(sa.text("SELECT verdict, outcome FROM v_runs")).all()
        engine.dispose()
        assert tuple(view) == (str(outcome) if state is ResultState.STORED else None, outcome and str(outcome))
        if state is not ResultState.STORED:
            remedy = "computes it" if finished else "continues it"
            with pytest.raises(StoreError) as refused:
                store.changes.override_verdict(run, Outcome.PASS, operator="Ada", why="as I say")
            assert refused.value.remedy == f"cbsr-qa run --resume {run} {remedy}"
