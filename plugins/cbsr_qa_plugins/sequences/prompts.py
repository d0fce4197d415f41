"""A question to the operator between two phases."""

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from cbsr_qa.plugin import PluginOptions, Prompt, SequenceContext, Step, WithOptions


class OperatorPromptSequence(WithOptions):
    """Ask the operator something, and wait for the answer, which is stored with the run.

    Parameters
    ----------
    text : what to do or to answer. There is no default.
    picture : name of an image file next to the recipe, shown by a page (not in a terminal).

    """

    class Options(PluginOptions):
        text: Annotated[str, Field(min_length=1, max_length=1000)]
        picture: Annotated[str, Field(max_length=1000)] = ""

    options: Options

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        yield Prompt(self.options.text, self.options.picture)
