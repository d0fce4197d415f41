"""Workers that are killed cost time and nothing else; a job that kills them is named."""

import os
import signal
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest

from cbsr_qa.app.reanalyse.workers import Workers, cluster_workers, local_workers
from cbsr_qa.domain.errors import BrokenError, RefusedError


class Pool(Executor):
    """Breaks with all jobs under way where ``kills`` says so, as a process pool does; ``slow`` ones end later."""

    def __init__(self, kills, slow=()):
        self.kills, self.slow, self.broken, self.waiting = kills, slow, False, []

    def submit(self, work, job):
        if self.broken:
            raise BrokenProcessPool
        future = Future()
        if self.kills(job):
            self.broken = True
            for other in (*self.waiting, future):
                other.set_exception(BrokenProcessPool())
        elif job in self.slow:
            self.slow.remove(job)
            self.waiting.append(future)
        else:
            try:
                future.set_result(work(job))
            except ZeroDivisionError as error:
                future.set_exception(error)
        return future


def pools(kills, begun, slow=()):
    @contextmanager
    def begin():
        begun.append(1)
        yield Pool(kills, slow)

    return begin


def test_a_job_that_kills_its_worker_is_named_and_all_others_are_done():
    begun = []
    workers = Workers(pools(lambda job: job == 4, begun), 2, lambda job: 10 * job)
    done = dict(workers.run_jobs([0, 1, 3, 4, 6, 7]))
    assert {job: result for job, result in done.items() if job != 4} == {0: 0, 1: 10, 3: 30, 6: 60, 7: 70}
    assert "killed 2 times" in done[4]
    assert len(begun) <= 4


def test_a_job_under_way_beside_a_killed_worker_is_done_again():
    killed = []

    def kills(job):
        return job == 4 and not killed and not killed.append(job)

    done = dict(Workers(pools(kills, [], [2]), 2, lambda job: 10 * job).run_jobs([2, 4, 6]))
    assert done == {2: 20, 4: 40, 6: 60}
    assert killed == [4]


def test_workers_that_cannot_live_here_end_the_work():
    workers = Workers(pools(lambda job: True, []), 2, lambda job: job)
    done = []
    with pytest.raises(BrokenError, match="workers in a row ended"):
        done.extend(workers.run_jobs(list(range(9))))
    assert all("killed" in why for _, why in done)


def test_what_a_worker_raises_is_the_reason_of_its_job_alone():
    (one, two) = Workers(pools(lambda job: False, []), 2, lambda job: 1 // job).run_jobs([0, 1])
    assert one == (0, "ZeroDivisionError: integer division or modulo by zero")
    assert two == (1, 1)


def tenfold(job, folder):
    """Kill the worker the first time a job is done."""
    seen = Path(folder) / str(job)
    if job == 2 and not seen.exists():
        seen.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 10 * job, os.environ["OPENBLAS_NUM_THREADS"]


def test_a_process_that_is_killed_changes_no_result(tmp_path):
    done = dict(local_workers(2, partial(tenfold, folder=tmp_path)).run_jobs([1, 2, 3, 4]))
    assert done == {job: (10 * job, "1") for job in (1, 2, 3, 4)}
    assert (tmp_path / "2").exists()


def test_a_cluster_does_the_work():
    distributed = pytest.importorskip("distributed")
    options = {"processes": False, "dashboard_address": ":0", "threads_per_worker": 1}
    with distributed.LocalCluster(n_workers=1, **options) as cluster:
        with cluster_workers(cluster.scheduler_address, abs) as workers:
            assert dict(workers.run_jobs([-1, -2, -3])) == {-1: 1, -2: 2, -3: 3}
        cluster.scale(0)


@pytest.mark.parametrize(
    ("workers", "threads", "said"), [(0, 1, "has no workers"), (1, 4, "has 4 threads")], ids=["no worker", "threads"]
)
def test_a_cluster_that_cannot_work_is_refused(workers, threads, said):
    distributed = pytest.importorskip("distributed")
    options = {"processes": False, "dashboard_address": ":0", "threads_per_worker": threads}
    with (
        distributed.LocalCluster(n_workers=workers, **options) as cluster,
        pytest.raises(RefusedError, match=said) as refused,
        cluster_workers(cluster.scheduler_address, abs),
    ):
        pass
    assert "nothing was computed" in refused.value.reason
    assert "dask worker" in refused.value.remedy


def test_a_scheduler_that_is_not_there_is_named(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("cbsr_qa.app.reanalyse.workers._REACHED_S", 0.2)
    with pytest.raises(RefusedError, match=r"no Dask scheduler answers at 'tcp://127\.0\.0\.1:9'"):
        cluster_workers("tcp://127.0.0.1:9", abs).__enter__()
