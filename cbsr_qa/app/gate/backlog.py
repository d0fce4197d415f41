"""What waits for the central database: not longer than the station allows."""

from cbsr_qa.app.gate.request import Asked, Finding


def backlog_sent(asked: Asked) -> Finding:
    """Compare the age of the oldest item that the central database has not confirmed with the station's limit."""
    limit_h = asked.configuration.station.sync.backlog_hours
    if limit_h is None:
        return Finding(None, "the station states no backlog_hours in [sync]")
    if asked.store is None:
        return Finding(True, "nothing waits")
    backlog = asked.store.backlog()
    words = f"{backlog.words}; the station allows {limit_h:g} h"
    if not backlog.late(limit_h):
        return Finding(True, words)
    return Finding(False, words, "send it to the central database", "cbsr-qa db sync")
