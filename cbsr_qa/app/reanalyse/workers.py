"""Workers that do jobs: processes of this computer or a Dask cluster, through the interface of an Executor."""

from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence, Set
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import AbstractContextManager, ExitStack, contextmanager
from importlib import import_module
from typing import Final, Generic, TypeVar

from cbsr_qa.domain.errors import BrokenError, RefusedError
from cbsr_qa.report.tables import plural
from cbsr_qa.system.workers import delay_interrupts, worker_pool

Job = TypeVar("Job")
Result = TypeVar("Result")

#: Number of workers that may die while they do a job alone, before the job is given up.
_DEATHS: Final = 2
#: Number of workers in a row that die before any job is done: then workers cannot run here at all.
_DEATHS_IN_A_ROW: Final = 6
#: Longest time to reach a scheduler, and then to wait until it has a worker [s].
_REACHED_S: Final = 10
_NOTHING: Final = "nothing was computed, and the database is unchanged"


class Workers(Generic[Job, Result]):
    """Jobs on the workers of an executor.

    Parameters
    ----------
    begin : begins workers; called again after one was killed, which makes an executor unusable.
    count : number of workers.
    work : done with each job; picklable.
    """

    def __init__(
        self, begin: Callable[[], AbstractContextManager[Executor]], count: int, work: Callable[[Job], Result]
    ) -> None:
        self._begin, self._count, self._work = begin, count, work

    def run_jobs(self, jobs: Sequence[Job]) -> Iterator[tuple[Job, Result | str]]:
        """Yield each job with its result, or the reason why its worker has none.

        A killed worker costs its job's time: the job is done again. As any job under way may be what kills workers,
        these are then done one at a time; a job that kills two workers alone is given up.

        Raises
        ------
        BrokenError
            If workers die again and again before any job is done, or the connection to them is lost.
        """
        waiting, suspects = deque(jobs), deque[Job]()
        deaths: Counter[int] = Counter()
        number = {id(job): k for k, job in enumerate(jobs)}
        in_a_row = 0
        while waiting or suspects:
            lost_jobs: list[Job] = []
            for job, result in self._run_until_broken(waiting, suspects, lost_jobs):
                in_a_row = 0
                yield job, result
            if not lost_jobs:
                continue
            in_a_row += 1
            if in_a_row >= _DEATHS_IN_A_ROW:
                raise BrokenError(
                    f"{in_a_row} workers in a row ended before a run was analysed",
                    remedy="use fewer --workers if memory is short; what was analysed before is stored",
                )
            if len(lost_jobs) == 1:  # it was alone, or nearly done alone
                deaths[number[id(lost_jobs[0])]] += 1
            for job in lost_jobs:
                if deaths[number[id(job)]] >= _DEATHS:
                    yield job, f"its worker was killed {plural(_DEATHS, 'time')} (out of memory?)"
                else:
                    suspects.append(job)

    def _run_until_broken(
        self, waiting: deque[Job], suspects: deque[Job], lost: list[Job]
    ) -> Iterator[tuple[Job, Result | str]]:
        """Work until all is done or a worker dies; the jobs it took along are then in ``lost``."""
        under_way: dict[Future[Result], Job] = {}
        with self._begin() as executor:
            while not lost:
                queue, room = (suspects, 1) if suspects else (waiting, self._count + 1)
                with delay_interrupts():
                    while queue and len(under_way) < room and not lost:
                        job = queue.popleft()
                        try:
                            under_way[executor.submit(self._work, job)] = job
                        except BrokenExecutor:
                            lost.append(job)
                if not under_way:
                    return
                finished, _ = wait(under_way, return_when=FIRST_COMPLETED)
                yield from self._collect_results(finished, under_way, lost)
                if lost:  # all others are broken too, or done
                    yield from self._collect_results(set(under_way), under_way, lost)

    def _collect_results(
        self, finished: Set[Future[Result]], under_way: dict[Future[Result], Job], lost: list[Job]
    ) -> Iterator[tuple[Job, Result | str]]:
        for future in [job_future for job_future in under_way if job_future in finished]:  # in the order of the jobs
            job = under_way.pop(future)
            try:
                result = future.result()
            except BrokenExecutor:
                lost.append(job)
            except CancelledError as error:
                raise BrokenError(
                    "the connection to the scheduler was lost",
                    remedy="what was analysed so far is stored; the same command continues",
                ) from error
            except Exception as error:  # noqa: BLE001 - of a worker, whatever it is
                yield job, f"{type(error).__name__}: {error}"
            else:
                yield job, result


def local_workers(count: int, work: Callable[[Job], Result]) -> Workers[Job, Result]:
    """Return workers on this computer."""
    return Workers(lambda: worker_pool(count), count, work)


@contextmanager
def cluster_workers(scheduler: str, work: Callable[[Job], Result]) -> Iterator[Workers[Job, Result]]:
    """Reach the workers of a Dask cluster.

    Raises
    ------
    RefusedError
        If distributed is not installed, no scheduler answers, it has no workers, or these have several threads.
    """
    try:
        Client = import_module("distributed").Client
    except ModuleNotFoundError as error:
        raise RefusedError(
            f"--scheduler needs {error.name}, which is not installed; {_NOTHING}",
            remedy="pip install 'cbsr-qa[cluster]'",
        ) from error
    with ExitStack() as stack:
        try:
            client = stack.enter_context(Client(scheduler, timeout=_REACHED_S, set_as_default=False))
        except (OSError, ValueError, TypeError) as error:
            raise RefusedError(
                f"no Dask scheduler answers at {scheduler[:100]!r}: {str(error).partition(chr(10))[0]}; {_NOTHING}",
                remedy="start one with `dask scheduler`, which prints its address, e.g. tcp://10.0.0.5:8786",
            ) from error
        threads = client.nthreads()
        if not threads:
            raise RefusedError(
                f"the scheduler at {scheduler} has no workers; {_NOTHING}",
                remedy=f"start one for each processor: dask worker {scheduler} --nthreads 1 --nworkers auto",
            )
        if several := [(name, count) for name, count in threads.items() if count > 1]:
            raise RefusedError(
                "worker {} has {} threads, which would share one interpreter; ".format(*several[0]) + _NOTHING,
                remedy=f"start workers with one thread each: dask worker {scheduler} --nthreads 1 --nworkers auto",
            )
        yield Workers(lambda: client.get_executor(pure=False), 2 * len(threads), work)
