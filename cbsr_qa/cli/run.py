"""``cbsr-qa run``: tests one sensor."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from cbsr_qa.cli.command import command, document
from cbsr_qa.cli.options import AsJson, Database, Parts, list_given_options, one_of, option_names
from cbsr_qa.cli.output import note, show

#: Options a new run requires, and those allowed with --resume.
_NEEDED = ("station", "recipe", "serial")
_WITH_RESUME = (
    *("resume", "station", "operator", "override", "override_by", "override_why"),
    *("database", "as_json", "prompts"),
)


class Prompts(StrEnum):
    """Where prompts of a run are answered."""

    TERMINAL = "terminal"
    CHANNEL = "channel"


document("dry run", prints="cbsr_qa.app.run.planned:PlannedRun")


@command("run", prints="cbsr_qa.app.run.outcome:RunOutcome")
def run(
    context: typer.Context,
    station: Annotated[str, typer.Option(help="Station file, or the name of a shipped one.")] = "",
    recipe: Annotated[str, typer.Option(help="Recipe file, or the name of a shipped one.")] = "",
    serial: Annotated[str, typer.Option(help="Serial number of the sensor.")] = "",
    batch: Annotated[str, typer.Option(help="Material batch of the sensor.")] = "",
    part: Parts = None,
    operator: Annotated[str, typer.Option(help="Name of the operator.")] = "",
    why: Annotated[str, typer.Option(metavar="TEXT", help="Reason for a changed recipe or station file.")] = "",
    sensor_type: Annotated[str | None, typer.Option(help="Sensor type; by default the station's.")] = None,
    material: Annotated[str | None, typer.Option(help="Material; by default the station's.")] = None,
    batch_model: Annotated[
        Path | None,
        typer.Option(help="Model of the batch, for a recipe with such a prior; by default the newest of the batch."),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=2**31 - 1,
            help="Seed for random loads and simulations; by default from the serial number and how often it was run.",
        ),
    ] = None,
    database: Database = None,
    resume: Annotated[
        str | None, typer.Option(metavar="RUN", help="Resume an interrupted run with its original settings.")
    ] = None,
    override: Annotated[
        list[str] | None,
        typer.Option(metavar="CHECK", help="Gate check that may not refuse this run; may be repeated."),
    ] = None,
    override_by: Annotated[str, typer.Option(metavar="NAME", help="Who overrides.")] = "",
    override_why: Annotated[str, typer.Option(metavar="TEXT", help="Reason for the override.")] = "",
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what the run would do; nothing moves.")] = False,
    prompts: Annotated[
        str, typer.Option(hidden=True, help="Where prompts are answered: terminal, or channel (control channel).")
    ] = Prompts.TERMINAL,
    as_json: AsJson = False,
) -> int:
    """Test one sensor: store the run, give a verdict, write a report and, if it passed, its calibration file.

    Requires --station, --recipe and --serial, or else --resume, which allows only --operator, --database, --json,
    --station and the overrides: a resumed run keeps its settings; the station file is used only for the checks of the
    gate.
    """
    _check_given(context, resuming=resume is not None)
    by_channel = one_of(Prompts, prompts, "--prompts") is Prompts.CHANNEL
    from cbsr_qa.app.gate.request import Override
    from cbsr_qa.app.run.outcome import run_outcome
    from cbsr_qa.app.run.request import RunRequest
    from cbsr_qa.cli.console import PageOfLine, Terminal

    console = PageOfLine(database) if by_channel else Terminal(database)
    overridden = Override(tuple(override or ()), override_by, override_why)
    if resume is not None:
        from cbsr_qa.app.run.resume import resume_run

        outcome = resume_run(
            resume, console, database=database, operator=operator, station=station or None, override=overridden
        )
        return show(run_outcome(outcome), as_json=as_json)

    from cbsr_qa.config.serials import read_parts

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
        override=overridden,
        batch_model=batch_model,
        parts=read_parts(part or ()),
    )
    if dry_run:
        from cbsr_qa.app.run.planned import plan_outcome
        from cbsr_qa.app.run.preview import plan_run

        planned = plan_run(request, attended=console.attended)
        code = show(plan_outcome(planned), as_json=as_json)
        if planned.refused is not None:
            note(f"cbsr-qa: the run would be refused\n{planned.refused.remedy}")
        return code
    from cbsr_qa.app.run.run import run_sensor

    return show(run_outcome(run_sensor(request, console)), as_json=as_json)


def _check_given(context: typer.Context, *, resuming: bool) -> None:
    """Refuse options that cannot change when a run is resumed, and a new run without required ones."""
    given_options = list_given_options(context)
    if resuming:
        extra_options = [name for name in context.params if name in given_options and name not in _WITH_RESUME]
        if extra_options:
            context.fail(
                f"a run is resumed with the options it began with: {option_names(extra_options)} cannot be given with"
                " --resume (--operator, --database, --json, --station and --override can)"
            )
        return
    missing_options = [name for name in _NEEDED if name not in given_options]
    if missing_options:
        context.fail(f"Missing option '--{missing_options[0]}'. To resume a run, give --resume RUN instead.")
