"""Options that select runs, of all commands that list or export them."""

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated, Final

import typer

from cbsr_qa.cli.options import OfParts, Since, Until, to_day

if TYPE_CHECKING:
    from cbsr_qa.app.shift.lists import ListRequest

Checks = Annotated[
    bool, typer.Option("--checks", help="Also runs of golden sensors that checked a station; never counted.")
]


@dataclass(frozen=True, slots=True)
class Selecting:
    """Options that commands on many runs share."""

    today: Annotated[
        bool, typer.Option("--today", help="Runs that began today, by this computer's local time; not with --since.")
    ] = False
    since: Since = None
    until: Until = None
    station: Annotated[
        list[str] | None, typer.Option(metavar="STATION", help="Runs at this station; may be repeated.")
    ] = None
    batch: Annotated[str | None, typer.Option(help="Runs of sensors of this batch.")] = None
    part: OfParts = None
    operator: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Runs by this operator; may be repeated.")
    ] = None
    recipe: Annotated[str | None, typer.Option(help="Runs of the recipe of this name.")] = None
    failed: Annotated[bool, typer.Option("--failed", help="Only what failed.")] = False
    limit: Annotated[
        str, typer.Option(metavar="NAME", help="Only failures of this limit, e.g. centre_of_mass_error.")
    ] = ""

    def is_given(self) -> bool:
        """Whether one of these options was given."""
        return any(asdict(self).values())

    def request(self, *, latest: int | None, checks: bool = False) -> "ListRequest":
        """Return which runs the options select. RefusedError if two of them exclude each other."""
        from cbsr_qa.app.shift.lists import list_request
        from cbsr_qa.config.serials import read_parts

        return list_request(
            today=self.today,
            since=to_day(self.since),
            until=to_day(self.until),
            failed=self.failed,
            limit=self.limit,
            latest=latest,
            checks=checks,
            recipe=self.recipe,
            batch=self.batch,
            parts=read_parts(self.part or ()),
            stations=tuple(self.station or ()),
            operators=tuple(self.operator or ()),
        )


#: Selection without any option: every run.
EVERY_RUN: Final = Selecting()
