"""Checks of plugins for a person: a table of all, and what to do about each that failed."""

from itertools import groupby

from cbsr_qa.domain.results.report import Banner, CommandOutcome, Page, Section
from cbsr_qa.plugin import Paragraph
from cbsr_qa.report.tables import plural, text_table
from cbsr_qa.testing.kit.conformance import CheckedPlugins, CheckOutcome, describe_check


def checks_outcome(checked: CheckedPlugins) -> CommandOutcome[CheckedPlugins]:
    """Return the outcome of ``plugins check``: exit code 1 if a check failed."""
    failed = [check for check in checked.checks if check.outcome is CheckOutcome.FAILED]
    if failed:
        first = failed[0]
        total = plural(checked.passed + checked.failed, "check")
        banner = Banner("fail", "✗", f"{checked.failed} of {total} failed", f"{first.check}: {first.found}")
    else:
        banner = Banner("pass", "✓", f"{plural(checked.passed, 'check')} passed", "")
    sections: list[Section] = []
    for (kind, name), checks in groupby(checked.checks, lambda check: (check.kind, check.name)):
        rows = [(check.check, check.outcome.value, check.found) for check in checks]
        table = text_table("Checks.", ("check", "outcome", "found"), rows)
        sections.append(Section(f"{kind.capitalize()} {name}", (table,)))
    if failed:
        blocks = tuple(Paragraph(line) for check in failed for line in describe_check(check).splitlines())
        sections.append(Section("What to change", blocks))
    return CommandOutcome(checked, Page("", "", banner, ()), tuple(sections), exit_code=int(bool(failed)))
