"""Build the fleet of ``make fleet-demo``: ``python -m cbsr_qa.cli.studies.fleet_demo``."""

import sys

from cbsr_qa.cli.output import Counting, note, say
from cbsr_qa.domain.errors import CbsrError


def main() -> int:
    """Build the fleet and print its location; return the exit code."""
    from cbsr_qa.app.demo_batch import RHO, build_batch, demo_folder
    from cbsr_qa.studies.fleet_demo import ONE_STATION, REPEATED, SAID, THIRD_ON_ALL, build_fleet

    try:
        with Counting("runs") as counting:
            counting.stage("building a fleet: 3 batches at 3 stations in two designs, and a gauge study")
            path = build_fleet(counting.count)
            counting.stage("simulating and testing sensors of one batch")
            build_batch(counting.count)
    except CbsrError as error:
        note(f"cbsr-qa: {error}")
        return error.exit_code
    say(f"fleet    {path}")
    say(f"designs  {ONE_STATION}, {THIRD_ON_ALL}, {REPEATED} (the recipes of their runs)")
    say(f"note     {SAID}")
    say(f"batch    {demo_folder()}: simulated sensors that share {RHO:.0%} of the variance of their maps")
    return 0


if __name__ == "__main__":
    sys.exit(main())
