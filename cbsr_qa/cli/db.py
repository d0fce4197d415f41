"""``cbsr-qa db``: looks after the database."""

from typing import Annotated

import typer

from cbsr_qa.cli.output import again, emit_json, say

app = typer.Typer(help="Look after the database.", no_args_is_help=True)

Database = Annotated[str | None, typer.Option(help="SQLAlchemy URL or SQLite file; by default var/cbsr-qa.db.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]


@app.command()
def upgrade(database: Database = None, as_json: AsJson = False) -> None:
    """Bring a database up to date; make it where there is none."""
    from cbsr_qa.app import upgrade_database

    done = upgrade_database(database)
    if as_json:
        emit_json(done.document())
    elif done.changed:
        say(f"{done.url}: schema {done.before or 'none'} → {done.after}")
    else:
        say(f"{done.url}: schema {done.after} is up to date")


@app.command()
def status(database: Database = None, as_json: AsJson = False) -> None:
    """Say which database is used, its version, how much is in it, and which runs did not finish."""
    from cbsr_qa.app import database_status, state_words

    found = database_status(database)
    if as_json:
        emit_json(found.document())
        return
    say(f"database    {found.url}")
    say(f"schema      {found.schema or 'none'} ({found.state}; this program's is {found.head})")
    if found.remedy:
        say(f"            {found.remedy}")
    for kind, count in found.counts.items():
        say(f"{kind:<11} {count}")
    for kind, runs in (("incomplete", found.incomplete), ("stopped", found.stopped)):
        for run in runs:
            phase = f" in {run.phase!r}" if run.phase else ""
            say(f"{kind:<11} run {run.run} of {run.serial}: {state_words(run)}{phase}; next: {run.next}")
    for name, serial in found.without_result:
        say(f"no result   run {name} of {serial}: finished; next: its result")
    if found.without_result or any(not run.writer for run in (*found.incomplete, *found.stopped)):
        say(f"            cbsr-qa run --resume RUN{again(database)} goes on with one of them")


@app.command()
def changes(database: Database = None, as_json: AsJson = False) -> None:
    """List what people changed: limits, recipes and other files, control charts, verdicts; who, when, why."""
    from cbsr_qa.app import list_changes
    from cbsr_qa.domain.run import NO_REASON

    found = list_changes(database)
    if as_json:
        emit_json(found.document())
        return
    for change in found.files:
        say(f"{change.noted_at:%Y-%m-%d %H:%M}  {change.kind} {change.name}, by {change.operator or 'nobody named'}")
        say(f"    why      {change.why}")
        say(f"    run      {change.run}, before it {change.earlier_run}")
        say(f"    content  {change.old_digest[:12]} → {change.new_digest[:12]}")
        for one in change.differences:
            say(f"    change   {one.words}")
    for chart in found.charts:
        limits = chart.reference
        by = f"on station {limits.station}, by {limits.operator}"
        say(f"{limits.made_at:%Y-%m-%d %H:%M}  limits of {limits.label}, {by}")
        say(f"    why      {limits.why or NO_REASON}")
        say(f"    runs     {limits.runs} of recipe {limits.recipe}, {limits.first_run} to {limits.last_run}")
        for words in chart.words():
            say(f"    {'set     ' if chart.earlier is None else 'change  '} {words}")
    for override in found.overrides:
        say(f"{override.noted_at:%Y-%m-%d %H:%M}  verdict of run {override.run}, by {override.operator}")
        say(f"    why      {override.why}")
        say(f"    change   {override.verdict} overridden to {override.outcome}")
    if not (found.files or found.charts or found.overrides):
        say("no file was changed, no limits of a control chart set, and no verdict overridden")
