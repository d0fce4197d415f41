"""``cbsr-qa stability``: the numerically hard cases, each against truth."""

from typing import Annotated

import typer

from cbsr_qa.cli.command import command
from cbsr_qa.cli.options import AsJson, PageOutput
from cbsr_qa.cli.output import Counting, check_page, show


@command("stability", prints="cbsr_qa.studies.hard_cases.stability:Stability")
def stability(
    area: Annotated[list[str] | None, typer.Option(help="Only cases of this area; repeatable.")] = None,
    only: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Only this case; repeatable.")] = None,
    output: PageOutput = None,
    as_json: AsJson = False,
) -> None:
    """Run the numerically hard cases: error against truth, its bound and the condition number, or the refusal.

    Exit code 1 if a bound is broken.
    """
    from cbsr_qa.studies.hard_cases.report import stability_outcome
    from cbsr_qa.studies.hard_cases.stability import examine_cases

    check_page(output)
    with Counting("cases") as counting:
        counting.stage("numerically hard cases")
        results = examine_cases(areas=tuple(area or ()), names=tuple(only or ()), progress=counting.count)
    raise typer.Exit(show(stability_outcome(results), output=output, as_json=as_json))
