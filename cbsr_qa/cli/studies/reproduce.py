"""``cbsr-qa reproduce``: published results beside simulated sensors."""

from typing import Annotated

import typer

from cbsr_qa.cli.command import command, group
from cbsr_qa.cli.options import AsJson, PageOutput
from cbsr_qa.cli.output import check_page, note, show

group("reproduce", "Compare published results with simulated sensors.")


@command("reproduce paper", prints="cbsr_qa.studies.reproduce.reproduce:Reproduction")
def paper(
    quick: Annotated[bool, typer.Option("--quick", help="Fewer trials and strains, and no bench sheet.")] = False,
    output: PageOutput = None,
    as_json: AsJson = False,
) -> None:
    """Compare tables 1 to 5 and F.6, settling times and force errors of Ellingham et al. with simulated sensors."""
    from cbsr_qa.studies.reproduce.report import reproduction_outcome
    from cbsr_qa.studies.reproduce.reproduce import reproduce_paper

    check_page(output)
    show(reproduction_outcome(reproduce_paper(quick=quick, tell=note)), output=output, as_json=as_json)
