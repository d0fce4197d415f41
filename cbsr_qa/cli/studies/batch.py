"""``cbsr-qa batch``: what the sensors of a batch have in common."""

from pathlib import Path
from typing import Annotated

import typer

from cbsr_qa.cli.command import command, group
from cbsr_qa.cli.options import AsJson, Database, OfParts, PageOutput, Since, Until, to_day
from cbsr_qa.cli.output import Counting, check_page, note, show

group("batch", "Learn what the sensors of a batch have in common.")


@command("batch model", prints="cbsr_qa.studies.batch.study:BatchStudy")
def model(
    batch: Annotated[str, typer.Option(help="Batch to learn from: at least five sensors that passed.")],
    sensor_type: Annotated[
        str | None, typer.Option(help="Only sensors of this type, if the batch holds several.")
    ] = None,
    material: Annotated[str | None, typer.Option(help="Only this material, if the batch holds several.")] = None,
    recipe: Annotated[str | None, typer.Option(help="Runs of the recipe of this name.")] = None,
    part: OfParts = None,
    since: Since = None,
    until: Until = None,
    without: Annotated[
        list[str] | None, typer.Option(metavar="SERIAL", help="Leave this sensor out; may be repeated.")
    ] = None,
    to: Annotated[
        Path | None,
        typer.Option(help="File of the model; by default in var/batches, where runs of the batch find it."),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show the model without keeping it.")] = False,
    output: PageOutput = None,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Learn how alike the sensors of a batch are: their common map, what stands out, scatter and drift.

    It rests on the latest run of each sensor that passed and is under a chain.
    """
    from cbsr_qa.config.serials import read_parts
    from cbsr_qa.domain.results.fleet import RunSelection
    from cbsr_qa.studies.batch.choice import BatchChoice
    from cbsr_qa.studies.batch.file import check_new, write_model
    from cbsr_qa.studies.batch.report import batch_outcome
    from cbsr_qa.studies.batch.study import study_batch

    check_page(output)  # before anything is computed
    if to is not None:
        check_new(to)
    choice = BatchChoice(
        runs=RunSelection(
            batch=batch, recipe=recipe, since=to_day(since), until=to_day(until), parts=read_parts(part or ())
        ),
        sensor_type=sensor_type,
        material=material,
        without=tuple(without or ()),
    )
    with Counting("runs") as progress:
        study = study_batch(choice, database=database, stage=progress.stage, count=progress.count)
    file = None if dry_run else write_model(study, to)
    show(batch_outcome(study), output=output, as_json=as_json)
    if file is not None:
        note(f"model        {file}")
