"""Decisions of a stored run, made again from its frames."""

from collections.abc import Iterator

from cbsr_qa.config.merging import Configuration
from cbsr_qa.domain.run.run import PressDecided, RunRecord
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.report.tables import plural
from cbsr_qa.station.decisions import PressDecisions
from cbsr_qa.station.setup import plan_of


def compare_decisions(record: RunRecord, configuration: Configuration, plugins: Plugins) -> Iterator[str]:
    """Decide again between the presses of a stored run, and name what differs.

    Parameters
    ----------
    configuration : of the run, whose target and reconstruction its decisions followed.

    Raises
    ------
    ConfigError, PluginError
        If a sequence or the reconstruction is unknown, or refuses its options.
    """
    plan = plan_of(configuration, plugins)
    decisions = PressDecisions.from_configuration(configuration, plan, plugins)
    for stored, again in decisions.decide_again(record):
        if stored != again:
            after = f"after {plural(stored.pressed, 'press', 'presses')} of phase {plan.phases[stored.phase].name!r}"
            yield f"{after} the run decided {_words(stored)}; its stored frames now lead to {_words(again)}"


def _words(made: PressDecided) -> str:
    error = (
        "no known error" if made.expected_N is None else f"{made.expected_N!r} N expected, {made.upper_N!r} N bound"
    )
    return f"{made.label or 'to end'} ({made.why}; {error})"
