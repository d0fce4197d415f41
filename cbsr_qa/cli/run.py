"""``cbsr-qa run``: tests one sensor."""

from typing import TYPE_CHECKING, Annotated

import typer

from cbsr_qa.cli.output import emit_json, note, operator_at_terminal, say
from cbsr_qa.cli.supervised import begun

if TYPE_CHECKING:
    from cbsr_qa.app.run import PlannedRun, RunOutcome

#: What a new run cannot do without, and what may be given with --resume.
_NEEDED = ("station", "recipe", "serial")
_WITH_RESUME = ("resume", "operator", "database", "as_json")


def run(
    context: typer.Context,
    station: Annotated[str, typer.Option(help="Station file, or the name of a shipped one.")] = "",
    recipe: Annotated[str, typer.Option(help="Recipe file, or the name of a shipped one.")] = "",
    serial: Annotated[str, typer.Option(help="Serial number of the sensor.")] = "",
    batch: Annotated[str, typer.Option(help="Material batch of the sensor.")] = "",
    operator: Annotated[str, typer.Option(help="Who stands at the station.")] = "",
    why: Annotated[
        str, typer.Option(metavar="TEXT", help="Why recipe or station file are not as in the runs before, if so.")
    ] = "",
    sensor_type: Annotated[str | None, typer.Option(help="Instead of the station's own.")] = None,
    material: Annotated[str | None, typer.Option(help="Instead of the station's own.")] = None,
    seed: Annotated[
        int | None, typer.Option(help="Of random loads and of anything simulated; by default from serial and try.")
    ] = None,
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL; by default SQLite in var/.")] = None,
    resume: Annotated[
        str | None, typer.Option(metavar="RUN", help="Go on with a run that was interrupted, as it was begun.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only say what would happen; nothing moves.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")] = False,
) -> int:
    """Test one sensor: verdict, stored run, report and, where it passed, its calibration file.

    Needs --station, --recipe and --serial; or --resume alone, with no more than --operator, --database and --json.
    """
    _check_given(context, resuming=resume is not None)
    if resume is not None:
        from cbsr_qa.app.run import resume_run

        begun(resume, database)
        outcome = resume_run(
            resume,
            database=database,
            operator=operator,
            tell=lambda stage: note(f"{stage} …"),
            ask=operator_at_terminal(),
        )
        return _shown(outcome, as_json)
    from cbsr_qa.app.run import RunRequest, plan_run, run_sensor

    request = RunRequest(
        station=station,
        recipe=recipe,
        serial=serial,
        batch=batch,
        operator=operator,
        sensor_type=sensor_type,
        material=material,
        seed=seed,
        database=database,
        why=why,
    )
    if dry_run:
        return _shown_plan(plan_run(request, attended=operator_at_terminal() is not None), as_json)
    outcome = run_sensor(
        request,
        tell=lambda stage: note(f"{stage} …"),
        ask=operator_at_terminal(),
        begun=lambda run: begun(run, database),
    )
    return _shown(outcome, as_json)


def _check_given(context: typer.Context, *, resuming: bool) -> None:
    """Refuse options that a resumed run has from its beginning, and a new run that lacks what it needs.

    Raises
    ------
    typer.BadParameter
        Naming them.
    """
    # A source is an enumeration of click's, which typer brings a copy of: told apart by name.
    sources = {name: context.get_parameter_source(name) for name in context.params}
    given = {name for name, source in sources.items() if source is not None and source.name != "DEFAULT"}
    if resuming:
        extra = [name for name in context.params if name in given and name not in _WITH_RESUME]
        if extra:
            named = ", ".join(f"--{name.replace('_', '-')}" for name in extra)
            raise typer.BadParameter(
                f"a run is resumed as it was begun: {named} cannot be given with --resume"
                " (--operator, --database and --json can)"
            )
        return
    missing = [name for name in _NEEDED if name not in given]
    if missing:
        raise typer.BadParameter(f"Missing option '--{missing[0]}'; or go on with a run: --resume RUN")


def _shown(outcome: "RunOutcome", as_json: bool) -> int:
    if as_json:
        emit_json(outcome.document())
    else:
        _show(outcome)
    return outcome.exit_code


def _show(outcome: "RunOutcome") -> None:
    for warning in outcome.warnings:
        note(f"warning: {warning}")
    say(f"{outcome.headline}: {outcome.reason}")
    if outcome.sensor_history is not None and outcome.sensor_history.words:
        say(f"sensor       {outcome.sensor_history.words}")
    say(f"run          {outcome.run}")
    say(f"report       {outcome.report or 'none'}")
    say(f"calibration  {outcome.calibration or 'none: ' + (outcome.calibration_why or 'not written')}")
    if outcome.material or outcome.material_why:
        say(f"material     {outcome.material or 'none: ' + outcome.material_why}")
    say(f"time         {outcome.station_s / 60:.1f} min of station time, {outcome.compute_s:.1f} s of computing")
    say(f"rows         {outcome.result.record.chain.words}")
    if outcome.resume:
        say(f"go on with   {outcome.resume}")
    if outcome.simulated:
        say(f"simulated    {'; '.join(outcome.simulated)}")


def _shown_plan(planned: "PlannedRun", as_json: bool) -> int:
    if as_json:
        emit_json(planned.document())
    else:
        for line in planned.lines():
            say(line)
    for warning in planned.warnings:
        note(f"warning: {warning}")
    if planned.refused is not None:
        note(f"cbsr-qa: the run would be refused for what is not allowed\n{planned.refused.remedy}")
    return planned.exit_code
