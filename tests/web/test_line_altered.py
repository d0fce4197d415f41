"""A run that was altered in the database is no pass on the pages of a line."""

import shutil

import pytest
from altered_runs import change
from exported_runs import five_runs

from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.opening import open_store
from cbsr_qa.web.line import Line
from cbsr_qa.web.outcomes import kind_of_result
from cbsr_qa.web.pages import Pages
from cbsr_qa.web.shift import sensor_page
from cbsr_qa.web.state import Mode, mode_of


@pytest.fixture
def forged(tmp_path):
    """A copy of five runs in which the failed one states a pass; yields its address, and that run."""
    url, names = five_runs()
    shutil.copy(url.removeprefix("sqlite:///"), tmp_path / "runs.db")
    change(tmp_path / "runs.db", "update analyses set outcome = 'pass' where run = ?", names["failed"])
    return f"sqlite:///{tmp_path / 'runs.db'}", names["failed"]


def test_a_list_of_runs_marks_it(forged):
    url, _ = forged
    view = sensor_page(url, "S-1")
    (run,) = view["runs"]
    assert (kind_of_result(run, frozenset()), run.verdict, run.outcome) == ("altered", None, None)
    page = Pages(Line((), url)).page("sensor", control=True, here="shift", **view)
    assert "Altered since it was stored" in page
    assert "analyses" in page
    assert "Passed" not in page.partition("<tbody>")[2]


def test_the_look_at_it_has_no_result_and_nothing_is_worked_out(forged):
    url, name = forged
    with open_store(url) as store:
        look = store.live.find_run(name)
    assert (look.verdict, look.outcome, look.end) == (None, None, EndReason.FINISHED)
    assert "was changed" in look.altered
    assert mode_of(None, look, held=True, starting=False) is Mode.HELD


def test_a_run_whose_serial_number_was_changed_is_missed_on_its_sensors_page(tmp_path):
    url, names = five_runs()
    shutil.copy(url.removeprefix("sqlite:///"), tmp_path / "runs.db")
    for count in (0, 1):
        if count:
            change(tmp_path / "runs.db", "update runs set serial = 'S-2' where run = ?", names["aborted"])
        view = sensor_page(f"sqlite:///{tmp_path / 'runs.db'}", "S-1")
        page = Pages(Line((), url)).page("sensor", control=True, here="shift", **view)
        assert view["altered"] == count
        assert ("1 of the latest 500" in page) == bool(count)
