"""How much faster two workers analyse stored runs again than one, and what memory a worker needs.

    python -m benchmarks.reanalysis DATABASE

Analyses the runs of a database with one worker and with two, and stores each result: use a copy. Other work on the
machine changes the ratio; the load is printed beside it.
"""

import os
import sys

from cbsr_qa.app.reanalyse.reanalysis import reanalyse
from cbsr_qa.app.reanalyse.request import ReanalyseRequest
from cbsr_qa.domain.results.fleet import RunSelection


def main(database: str) -> None:
    """Print times, ratio, memory and load."""
    took_s = {}
    for workers in (1, 2):
        request = ReanalyseRequest(RunSelection(), workers=workers, fresh=True, database=database)
        done = reanalyse(request)
        took_s[workers] = done.elapsed_s
        print(f"{workers} workers: {done.computed} runs in {done.elapsed_s:.1f} s, {done.peak_worker_mb or 0:.0f} MB")
    print(f"two workers are {took_s[1] / took_s[2]:.2f} times as fast; load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main(sys.argv[1])
