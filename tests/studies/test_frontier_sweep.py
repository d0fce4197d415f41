"""Long sweeps: what is finished is kept and found again, whatever ends them."""

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest

from cbsr_qa.domain.errors import CbsrError, NumericsError, StoreError
from cbsr_qa.studies.sweep import Kept, Work, compute_pieces


def square(number):
    return [{"number": number, "square": number**2, "text": f"{number} ²"}]


def refuse():
    raise NumericsError("no number comes out")


def marked(folder, number):
    time.sleep(0.02)
    (folder / f"worked out {number}").touch(exist_ok=False)
    return square(number)


def wait_for(path):
    """Work until a file appears: a piece that is still at it when another one raises."""
    until = time.monotonic() + 60
    while not path.exists() and time.monotonic() < until:
        time.sleep(0.01)
    return square(0)


def touch_and_refuse(path):
    path.touch()
    refuse()


def never_end(begun):
    begun.touch()
    time.sleep(120)
    begun.with_name("ended").touch()


def pieces(*numbers):
    return [Work(f"square/{number}", f"{number} squared", partial(square, number)) for number in numbers]


def sweep(work, kept, processes=1):
    told = []
    found = compute_pieces(work, kept, lambda *said: told.append(said), processes=processes)
    return found, told


EXPECTED = {f"square/{number}": square(number) for number in range(5)}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "sweep.jsonl"


def test_one_and_two_processes_find_the_same(tmp_path):
    found = [sweep(pieces(*range(5)), Kept(tmp_path / f"{count}.jsonl"), count)[0] for count in (1, 2)]
    assert found[0] == found[1] == EXPECTED
    assert list(found[1]) == list(EXPECTED)  # in the order of the work, whichever came first
    lines = [sorted((tmp_path / f"{count}.jsonl").read_text().splitlines()) for count in (1, 2)]
    assert lines[0] == lines[1]


def test_progress_counts_what_was_found_again(path):
    _, told = sweep(pieces(0, 1), Kept(path))
    assert told == [(0, 2, "begun"), (1, 2, "0 squared"), (2, 2, "1 squared")]
    _, told = sweep(pieces(0, 1, 2), Kept(path))
    assert told == [(2, 3, "resumed"), (3, 3, "2 squared")]


def test_nothing_is_worked_out_twice(tmp_path, path):
    work = [Work(str(number), "", partial(marked, tmp_path, number)) for number in range(4)]
    sweep(work[:2], Kept(path))
    found, _ = sweep(work, Kept(path))  # a piece that is worked out again would raise
    assert found == {str(number): square(number) for number in range(4)}
    assert sweep(work, Kept(path))[0] == found


def test_without_a_file_nothing_is_kept(tmp_path):
    assert sweep(pieces(0, 1), Kept(None))[0] == {key: EXPECTED[key] for key in ("square/0", "square/1")}
    assert list(tmp_path.iterdir()) == []


def test_a_sweep_cut_off_at_any_byte_goes_on_and_leaves_a_file_that_reads(path):
    sweep(pieces(0, 1, 2), Kept(path))
    whole = path.read_bytes()
    for length in range(len(whole) + 1):
        path.write_bytes(whole[:length])
        kept = Kept(path)
        assert len(kept.found) == whole[:length].count(b"\n")
        assert sweep(pieces(0, 1, 2), kept)[0].keys() == {"square/0", "square/1", "square/2"}
        assert path.read_bytes() == whole, length


@pytest.mark.parametrize(
    "content",
    [
        b"phase,time\n1,2\n",
        b"one line that is not ours",
        b"\x89PNG\r\n\x1a\n\xff\xfe",
        b'{"clock": "station"}\n',
        b'{"key": "a", "documents": 3}\n',
        b'{"key": "a", "documents": [3]}\n',
        b'{"key": "a", "documents": [[["b", 1]]]}\n',
        b'{"key": "a", "documents": {"b": {}}}\n',
        b'{"key": 1, "documents": []}\n',
        b"[]",
        b"\n",
    ],
)
def test_a_file_of_somebody_else_is_refused_by_name_and_left_alone(path, content):
    path.write_bytes(content)
    with pytest.raises(StoreError, match=r"sweep.jsonl: line 1 is no finished piece of a sweep") as refused:
        Kept(path)
    assert "--fresh" in refused.value.remedy
    assert path.read_bytes() == content


def test_a_line_in_the_middle_is_named(path):
    sweep(pieces(0, 1, 2), Kept(path))
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], lines[1][:20], lines[2]]) + "\n")
    with pytest.raises(StoreError, match="line 2"):
        Kept(path)


def test_a_folder_in_place_of_the_file_is_refused(path):
    path.mkdir()
    with pytest.raises(StoreError, match="cannot be read: it is a folder, not a file"):
        Kept(path)


def test_a_file_that_cannot_be_written_is_refused(tmp_path):
    with pytest.raises(StoreError, match="cannot be written"):
        sweep(pieces(0), Kept(tmp_path / "no folder" / "sweep.jsonl"))


def test_a_piece_that_raises_leaves_the_finished_ones_kept(path):
    with pytest.raises(NumericsError, match="no number comes out"):
        sweep([*pieces(0, 1), Work("bad", "bad", refuse), *pieces(2)], Kept(path))
    assert list(Kept(path).found) == ["square/0", "square/1"]


@pytest.mark.rest
def test_of_two_processes_the_one_at_work_finishes_when_the_other_raises(tmp_path, path):
    gate = tmp_path / "gate"
    work = [
        Work("slow", "waits for the other", partial(wait_for, gate)),
        Work("bad", "raises", partial(touch_and_refuse, gate)),
        *[Work(f"late {number}", "", partial(marked, tmp_path, number)) for number in range(500)],
    ]
    with pytest.raises(CbsrError, match="no number comes out"):
        sweep(work, Kept(path), 2)
    found = Kept(path).found
    assert found["slow"] == square(0)
    assert "bad" not in found
    assert len(list(tmp_path.glob("worked out *"))) < 500
    assert {key for key in found if key.startswith("late")} == {
        f"late {mark.name.split()[-1]}" for mark in tmp_path.glob("worked out *")
    }


def test_ctrl_c_ends_a_sweep_in_the_middle_of_a_piece(tmp_path, path):
    begun, two_kept = tmp_path / "begun", threading.Event()

    def press_ctrl_c():
        two_kept.wait(60)
        wait_for(begun)
        os.kill(os.getpid(), signal.SIGINT)

    keyboard = threading.Thread(target=press_ctrl_c)
    work = [*pieces(0, 1), *(Work(f"endless {n}", "", partial(never_end, begun)) for n in range(4)), *pieces(2)]
    keyboard.start()
    with pytest.raises(KeyboardInterrupt):
        compute_pieces(work, Kept(path), lambda done, *_: two_kept.set() if done == 2 else None, processes=2)
    keyboard.join()
    assert not begun.with_name("ended").exists()
    assert set(Kept(path).found) == {"square/0", "square/1"}


@pytest.mark.rest
@pytest.mark.parametrize(
    ("command", "at_work_s"),
    [
        pytest.param(["stability"], 1.5, id="while workers work", marks=pytest.mark.rest),
        pytest.param(["reproduce", "paper", "--quick"], 0.0, id="while they start"),
    ],
)
def test_ctrl_c_ends_a_command_with_workers_without_their_tracebacks(tmp_path, command, at_work_s):
    started = subprocess.Popen(
        [sys.executable, "-c", "from cbsr_qa.cli.main import entry; entry()", *command],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        env={**os.environ, "CBSR_QA_VAR": str(tmp_path)},
    )  # fmt: skip
    _until(lambda: _spawned(started.pid) >= 2)
    time.sleep(at_work_s)
    os.killpg(started.pid, signal.SIGINT)  # as a terminal does
    out, err = started.communicate(timeout=60)
    assert started.returncode == 3
    assert out == ""
    assert "Traceback" not in err
    assert "plugin" not in err
    assert err.endswith("cbsr-qa: aborted\n")


def _spawned(group):
    """How many processes of a group were spawned to work."""
    count = 0
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            own = (entry / "stat").read_text().rpartition(")")[2].split()[2] == str(group)
            count += own and b"spawn_main" in (entry / "cmdline").read_bytes()
    return count


def test_numbers_that_json_does_not_know_are_not_kept(path):
    with pytest.raises(ValueError, match="JSON"):
        sweep([Work("nan", "", lambda: [{"value": float("nan")}])], Kept(path))
    assert not path.exists()


# --- a killed sweep --------------------------------------------------------------------------------------

_KILLED = """
import os, sys, time
from functools import partial
from pathlib import Path
from pathlib import Path
from cbsr_qa.studies.sweep import Kept, Work, compute_pieces

def piece(path):
    Path(path).write_text(str(os.getpid()))
    time.sleep(600)
    return []

if __name__ == "__main__":
    folder = Path(sys.argv[1])
    work = [Work(str(k), str(k), partial(piece, str(folder / f"{k}.pid"))) for k in range(2)]
    compute_pieces(work, Kept(None), lambda *told: None, processes=2)
"""


def test_workers_of_a_killed_sweep_end_with_it(tmp_path):
    script = tmp_path / "killed.py"
    script.write_text(_KILLED)
    sweep = subprocess.Popen([sys.executable, str(script), str(tmp_path)], stderr=subprocess.DEVNULL)
    pids = [tmp_path / f"{k}.pid" for k in range(2)]
    _until(lambda: all(path.exists() and path.read_text() for path in pids))
    workers = [int(path.read_text()) for path in pids]
    sweep.kill()
    sweep.wait()
    _until(lambda: not any(_runs(worker) for worker in workers))


def _until(ready):
    deadline = time.monotonic() + 60
    while not ready():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def _runs(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"
