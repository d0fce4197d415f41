"""Options that reconstructions have in common: how the one parameter of a method is chosen, or what it is."""

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from cbsr_qa.eit.inverse.regularisation import Criterion, Regularisation
from cbsr_qa.plugin import PluginOptions, Problem

Positive = Annotated[float, Field(gt=0)]
#: λ of all methods; its square, and that of an image it leaves, are doubles up to here.
Hyperparameter = Annotated[float, Field(ge=0, le=1e50)]


def find_contradictions(options: PluginOptions, given: str, others: tuple[str, ...]) -> Iterator[Problem]:
    """Yield options that are stated beside one that leaves them no meaning."""
    for name in others if getattr(options, given) is not None else ():
        if getattr(options, name) is not None:
            yield Problem((name,), f"is given, and {given} too", "not both: leave one of them out")


class ParameterOptions(PluginOptions):
    """The parameter by a criterion; subclasses add an option for its value."""

    given_as: ClassVar[str]
    choose: Literal["noise-figure", "gcv", "l-curve", "discrepancy"] | None = None
    noise_figure: Positive | None = None

    def problems(self) -> Iterator[Problem]:
        yield from find_contradictions(self, self.given_as, ("choose", "noise_figure"))
        if self.choose not in (None, "noise-figure"):
            yield from find_contradictions(self, "choose", ("noise_figure",))

    def regularisation(self) -> Regularisation:
        value = getattr(self, self.given_as)
        if value is not None:
            return Regularisation(None, 1.0, float(value), self.given_as)
        return Regularisation(Criterion(self.choose or "noise-figure"), self.noise_figure or 1.0, None, self.given_as)


class RidgeOptions(ParameterOptions):
    """λ by a criterion, or λ itself."""

    given_as = "hyperparameter"
    hyperparameter: Hyperparameter | None = None
