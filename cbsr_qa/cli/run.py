"""``cbsr-qa run``: tests one sensor."""

from typing import TYPE_CHECKING, Annotated

import typer

from cbsr_qa.cli.asking import operator_at_terminal
from cbsr_qa.cli.output import emit_json, note, say

if TYPE_CHECKING:
    from cbsr_qa.app.outputs import RunOutcome
    from cbsr_qa.runner.dry_run import DryRun


def run(
    station: Annotated[str, typer.Option(help="Station file, or the name of a shipped one.")],
    recipe: Annotated[str, typer.Option(help="Recipe file, or the name of a shipped one.")],
    serial: Annotated[str, typer.Option(help="Serial number of the sensor.")],
    batch: Annotated[str, typer.Option(help="Material batch of the sensor.")] = "",
    operator: Annotated[str, typer.Option(help="Who stands at the station.")] = "",
    sensor_type: Annotated[str | None, typer.Option(help="Instead of the station's own.")] = None,
    material: Annotated[str | None, typer.Option(help="Instead of the station's own.")] = None,
    seed: Annotated[
        int | None, typer.Option(help="Of random loads and of anything simulated; by default from serial and try.")
    ] = None,
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL; by default SQLite in var/.")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only say what would happen; nothing moves.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")] = False,
) -> int:
    """Test one sensor: verdict, stored run, report and, where it passed, its calibration file."""
    from cbsr_qa.app.run_sensor import RunRequest, plan_run, run_sensor

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
    )
    if dry_run:
        _show_dry_run(plan_run(request), as_json)
        return 0
    outcome = run_sensor(request, tell=lambda stage: note(f"{stage} …"), ask=operator_at_terminal())
    if as_json:
        emit_json(outcome.document())
    else:
        _show(outcome)
    return outcome.exit_code


def _show(outcome: "RunOutcome") -> None:
    for warning in outcome.warnings:
        note(f"warning: {warning}")
    say(f"{outcome.headline}: {outcome.reason}")
    say(f"run          {outcome.run}")
    say(f"report       {outcome.report or 'none'}")
    say(f"calibration  {outcome.calibration or 'none: ' + (outcome.calibration_why or 'not written')}")
    if outcome.material or outcome.material_why:
        say(f"material     {outcome.material or 'none: ' + outcome.material_why}")
    say(f"time         {outcome.station_s / 60:.1f} min of station time, {outcome.compute_s:.1f} s of computing")
    if outcome.simulated:
        say(f"simulated    {'; '.join(outcome.simulated)}")


def _show_dry_run(dry: "DryRun", as_json: bool) -> None:
    if as_json:
        emit_json(dry.document())
        return
    for line in dry.lines():
        say(line)
