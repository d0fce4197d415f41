"""The sensor: its serial number, how often it may be tested, and its parts."""

from cbsr_qa.app.gate.request import Asked, Finding
from cbsr_qa.config.serials import fits_pattern
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.run.states import EndReason

_PASSED = (Outcome.PASS, Outcome.MARGINAL)


def serial_fits(asked: Asked) -> Finding:
    """Match the whole serial number with the pattern of the sensor type."""
    pattern, sensor = asked.configuration.serial_pattern, asked.sensor
    if not pattern:
        return Finding(None, f"sensor type {sensor.sensor_type} states no serial_pattern")
    if fits_pattern(pattern, sensor.serial):
        return Finding(True, f"{sensor.serial} fits {pattern!r}")
    remedy = "scan the sensor again, or choose the sensor type it is of"
    return Finding(
        False, f"{sensor.serial} does not fit {pattern!r}, the serial_pattern of {sensor.sensor_type}", remedy
    )


def retest_allowed(asked: Asked) -> Finding:
    """Count finished runs of this sensor and recipe; those of station checks, aborted and broken ones do not count.

    An altered run of the sensor counts, as its content is not known. A recent run of another sensor
    that was altered refuses: it may have been given that serial number.
    """
    recipe, serial = asked.configuration.recipe.name, asked.request.serial
    if asked.request.tested_by:
        clause = f"{serial} is being tested with {recipe} now, by {asked.request.tested_by}"
        return Finding(False, clause, "wait for the verdict of that run")
    tries = () if asked.store is None else asked.store.sensors.read_history(asked.sensor, recipe).tries
    elsewhere = {} if asked.store is None else asked.store.sensors.find_altered_elsewhere(serial)
    for problem in elsewhere.values():
        clause = f"{problem}; it may be a run of {serial}"
        return Finding(False, clause, "restore the database from a copy; cbsr-qa db check names what was altered")
    finished_tries = [attempt for attempt in tries if attempt.changed or attempt.end is EndReason.FINISHED]
    passed = [attempt for attempt in finished_tries if attempt.final_outcome in _PASSED]
    if passed:
        latest = passed[-1]
        clause = f"{serial} already passed {recipe} on {latest.day} (run {latest.run})"
        return Finding(False, clause, "take the next sensor")
    most_runs = asked.settings.retest_runs
    count = f"{len(finished_tries)} finished run{'' if len(finished_tries) == 1 else 's'} of {serial} with {recipe}"
    if without_result := [
        attempt.run for attempt in finished_tries if not attempt.changed and attempt.final_outcome is None
    ]:
        count += (
            f", run {without_result[-1]} without a result yet (cbsr-qa run --resume {without_result[-1]} computes it)"
        )
    if most_runs is None:
        return Finding(True, f"{count}, none of them passed" if finished_tries else count)
    if len(finished_tries) < most_runs:
        return Finding(True, f"{count}, at most {most_runs} allowed")
    return Finding(
        False,
        f"{count}; no more than {most_runs} allowed, so it may not be tested again",
        "set the sensor aside: it has failed as often as allowed",
    )


def parts_unused(asked: Asked) -> Finding:
    """Look for another sensor with a part that the sensor type calls unique; a revision makes no other part."""
    unique_parts = [part for part in asked.request.parts if part.name in asked.configuration.unique_parts]
    if not unique_parts:
        return Finding(None, "no part of this sensor is unique by its sensor type")
    for part in unique_parts if asked.store is not None else ():
        assert asked.store is not None
        runs = asked.store.sensors.find_runs_of_part(part)
        others = [(run, serial) for run, serial in runs if serial != asked.request.serial]
        if others:
            run, serial = others[-1]
            return Finding(False, f"{part} is of sensor {serial} too (run {run})", "scan sensor and part again")
    return Finding(True, f"{', '.join(map(str, unique_parts))} of no other sensor")
