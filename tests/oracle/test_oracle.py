"""The comparison of two commits: what it masks, what it must not mask, and what its list of differences accepts."""

import sqlite3
import uuid
from contextlib import closing
from pathlib import Path

import pytest

from tests.oracle.accepted import Difference, Meant, WrongListError, differences, judged, put_back, read_meant
from tests.oracle.dumps import dumped
from tests.oracle.masks import masked
from tests.oracle.sides import by_name

_OLD = """Traceback (most recent call last):
  File "/one/checkout/cbsr_qa/calibrate/issue.py", line 33, in issued
    raise KeyError("scale")
warning: cbsr_qa_plugins.metrics.creep failed: no trace
{"module": "cbsr_qa.calibrate.issue", "plugin": "cbsr_qa_plugins.metrics.creep:Creep"}
<td>cbsr_qa/calibrate/issue.py:33</td>
"""
_NEW = """Traceback (most recent call last):
  File "/two/checkout/cbsr_qa/calibration/issue.py", line 8, in issued
    raise KeyError("scale")
warning: cbsr_qa_plugins.metrics.data_sheet failed: no trace
{"module": "cbsr_qa.calibration.issue", "plugin": "cbsr_qa_plugins.metrics.data_sheet:Creep"}
<td>cbsr_qa/calibration/issue.py:8</td>
"""


def test_modules_that_were_moved_do_not_differ() -> None:
    old = masked(_OLD, {"/one/checkout": "<checkout>"})
    new = masked(_NEW, {"/two/checkout": "<checkout>"})
    assert old == new
    assert 'raise KeyError("scale")' in old
    assert "failed: no trace" in old


def test_columns_beside_a_module_move_with_its_length() -> None:
    assert masked("cbsr_qa.forward.mesh      ok    3\n", {}) == masked("cbsr_qa.m  ok    3\n", {})


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("run 01a204f9-99f9-71de-afdf-4f328c017698", "run 01a204fa-5ef1-7684-b295-03d665d2d73e"),
        ("at 2026-11-22 20:37:26.897724", "at 2026-11-22T21:00:00Z"),
        ("8.0 min of station time, 12.8 s of computing", "8.0 min of station time, 9.1 s of computing"),
        ("computing took 1 min 2 s until", "computing took 59.4 s until"),
        ("version 2026-03-02-b6b40338, 3 limits", "version 2026-03-02-f4419b5c, 3 limits"),
        ("cbsr-qa 0.1.0", "cbsr-qa 0.2.0"),
        ('["cbsr-qa", "0.1.0"]', '["cbsr-qa", "0.2.0"]'),
        (
            '"compute_s": {\n  "noise": 0.01,\n  "images": 1.2\n}',
            '"compute_s": {\n  "noise": 2.0,\n  "images": 3.1e-3\n}',
        ),
        ('"compute_s": [["imaging", 1.2]]', '"compute_s": [["imaging", 0.9]]'),
        ("  times     time-skew    0.487 ##     share = 1", "  times     time-skew    0.475 #      share = 1"),
        ("9 wt% strip: 83 s (1 of 4)", "8 wt% strip: 98 s (1 of 4)"),
    ],
)
def test_what_differs_between_two_runs_of_one_commit_is_masked(one: str, other: str) -> None:
    assert masked(one, {}) == masked(other, {})


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("gauge factor error is 1.385 %", "gauge factor error is 1.386 %"),
        ("8.0 min of station time, 12.8 s of computing", "8.1 min of station time, 12.8 s of computing"),
        ('"compute_s": {"noise": 0.01}', '"compute_s": {"images": 0.01}'),
        ("  times     time-skew    0.487 ##     share = 1", "  times     time-skew    0.487 ##     share = 2"),
        ('"exit": 3, "condition": 1.99', '"exit": 3, "condition": 2.99'),
        ("cbsr-qa run", "cbsr-qa report"),
        ("exit 0", "exit 1"),
        ("week of 2026-03-02", "week of 2026-03-03"),
    ],
)
def test_what_a_user_reads_is_not_masked(one: str, other: str) -> None:
    assert masked(one, {}) != masked(other, {})


def test_identities_keep_who_is_who() -> None:
    a, b = uuid.uuid4(), uuid.uuid4()
    assert masked(f"{a} {b} {a}", {}) == masked(f"{b} {a} {b}", {})
    assert masked(f"{a} {b} {a}", {}) != masked(f"{a} {b} {b}", {})


def _stored(path: Path, rows: list[tuple[str, object, bytes]]) -> str:
    with closing(sqlite3.connect(path)) as database:
        database.execute("create table runs (run text, value, frames blob)")
        database.executemany("insert into runs values (?, ?, ?)", rows)
        database.commit()
    text = dumped(path)
    assert text is not None
    return masked(text, {})


def test_databases_differ_in_content_and_not_in_identities(tmp_path: Path) -> None:
    # The second database's identities sort the other way round.
    first, last = "00000000-0000-4000-8000-000000000000", "ffffffff-0000-4000-8000-000000000000"
    one = _stored(tmp_path / "one.db", [(first, 1, b"a"), (last, 2, b"b")])
    assert _stored(tmp_path / "two.db", [(last, 1, b"a"), (first, 2, b"b")]) == one
    assert _stored(tmp_path / "three.db", [(first, 1, b"a"), (last, 2, b"c")]) != one
    assert _stored(tmp_path / "four.db", [(first, "1", b"a"), (last, 2, b"b")]) != one


def _list(folder: Path, text: str) -> Path:
    path = folder / "accepted.toml"
    path.write_text(text)
    return path


def test_accepted_differences_are_counted_by_their_reason_and_the_rest_is_left(tmp_path: Path) -> None:
    listed = _list(tmp_path, '[[accepted]]\nfile = "tries/*"\nline = "^run_links "\nwhy = "the chain"\n')
    old = {"tries/a.db": "run_links 1\nruns 1\n", "strip/a.db": "run_links 1\n"}
    new = {"tries/a.db": "run_links 2\nruns 2\n", "strip/a.db": "run_links 2\n"}
    counts, left = judged(list(differences(old, new)), read_meant(listed).accepted)
    assert counts == {"the chain": 2}
    assert left == [
        Difference("strip/a.db", "-", "run_links 1"),
        Difference("strip/a.db", "+", "run_links 2"),
        Difference("tries/a.db", "-", "runs 1"),
        Difference("tries/a.db", "+", "runs 2"),
    ]


def test_what_is_undone_leaves_all_around_it_to_be_compared(tmp_path: Path) -> None:
    listed = _list(
        tmp_path,
        """[[undone]]\nfile = "*.db"\nnew = "^(runs .*) chained$"\nold = '\\1'\nwhy = "the chain"\n""",
    )
    undone = read_meant(listed).undone
    same, counts = put_back({"a.db": "runs 1 chained\nruns 2 chained\n", "a.html": "runs 1 chained\n"}, undone)
    assert same == {"a.db": "runs 1\nruns 2\n", "a.html": "runs 1 chained\n"}
    assert counts == {"the chain": 2}
    changed, _ = put_back({"a.db": "runs 1\nruns 3 chained\n"}, undone)
    assert [one.line for one in differences({"a.db": "runs 1\nruns 2\n"}, changed)] == ["runs 2", "runs 3"]


def test_lines_that_begin_like_the_head_of_a_comparison_are_compared() -> None:
    assert len(list(differences({"a": "-- x\n"}, {"a": "-- y\n"}))) == 2


def test_a_text_of_one_side_alone_is_a_difference_even_where_it_is_empty() -> None:
    assert [one.sign for one in differences({"a": ""}, {"b": ""})] == ["-", "+"]


def test_an_empty_list_accepts_nothing(tmp_path: Path) -> None:
    assert read_meant(_list(tmp_path, "# none\n")) == Meant()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[[accepted]]\nfile = "*"\nline = "x"\n', "accepted 1: the keys are .*why"),
        ('[[accepted]]\nfile = "*"\nline = "x"\nwhy = ""\n', "not empty"),
        ('[[accepted]]\nfile = "*"\nline = "("\nwhy = "y"\n', "no regular expression"),
        ('[[accepted]]\nfile = "*"\nline = 3\nwhy = "y"\n', "line must be a text that is not empty, found 3"),
        ('[[undone]]\nfile = "*"\nnew = "x"\nwhy = "y"\n', "undone 1: the keys are .*old"),
        ('[[undone]]\nfile = "*"\nnew = ""\nold = "x"\nwhy = "y"\n', "new must be a text"),
        ('[[undone]]\nfile = "*"\nnew = "x"\nold = "\\\\1"\nwhy = "y"\n', "invalid group reference"),
        ('[[acepted]]\nfile = "*"\nline = "x"\nwhy = "y"\n', "'acepted' is unknown"),
    ],
)
def test_a_wrong_list_is_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(WrongListError, match=said):
        read_meant(_list(tmp_path, text))


def test_texts_named_by_digests_are_paired_by_what_they_say_and_runs_by_their_time() -> None:
    runs = ["01a204f9-99f9-71de-afdf-4f328c017698", "01a204fa-5ef1-7684-b295-03d665d2d73e"]
    one = by_name({"p-00000000.html": "a", "p-11111111.html": "b", f"{runs[0]}.h5": "z", f"{runs[1]}.h5": "y"}, {})
    two = by_name({"p-00000000.html": "b", "p-11111111.html": "a", f"{runs[0]}.h5": "z", f"{runs[1]}.h5": "y"}, {})
    assert one == two
    assert list(one.values()) == ["z", "y", "a", "b"]
