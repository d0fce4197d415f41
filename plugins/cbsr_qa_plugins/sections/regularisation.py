"""How much the images are smoothed: the regularisation parameter, what chose it, and what it could have been."""

from typing import Final

from cbsr_qa.domain.load_events import RecordingResult
from cbsr_qa.domain.observation import RunObservation
from cbsr_qa.domain.reconstruction import LinearReconstruction, ParameterChoice, ParameterCurve
from cbsr_qa.domain.report import Block, Figure, Paragraph, RunResult, Section, Table
from cbsr_qa.report.figures_parameter import ParameterMark, parameter_figure, value_text
from cbsr_qa.report.numbers import number
from cbsr_qa.report.select import observed
from cbsr_qa.report.tables import text_table

_TITLES: Final = {
    "noise-figure": "noise figure",
    "gcv": "cross-validation",
    "l-curve": "L-curve",
    "discrepancy": "discrepancy",
}
_APART: Final = 0.005  # noise figures of a sensor and of its type that differ less are told as one


class RegularisationParameter:
    """Section of the regularisation parameter, with its curve where the method chose from one."""

    def render(self, result: RunResult | RecordingResult) -> Section | None:
        """Return the section; None where nothing was imaged."""
        run = observed(result)
        if run is None:
            return None
        return Section("Regularisation", tuple(_blocks(run)))


def _blocks(run: RunObservation) -> list[Block]:
    made = run.reconstruction
    choice, curve = made.choice, made.choice.curve
    words = _in_words(made)
    if curve is None:
        return [Paragraph(words)]
    marks = _marks(choice, curve)
    return [Paragraph(words), _figure(choice, curve, marks), _table(choice, curve, marks)]


def _in_words(made: LinearReconstruction) -> str:
    choice, curve = made.choice, made.choice.curve
    figure = f"Its matrix has noise figure {number(choice.noise_figure)}."
    if choice.criterion == "none":
        return f"{made.method} has no regularisation parameter: {choice.how}. {figure}"
    discrete = curve is not None and curve.discrete
    value = f"{made.method} images with {choice.name} = {value_text(choice.value, discrete=discrete)}"
    if curve is None:
        kept = "" if choice.criterion == "given" else " The method keeps no curve of its search."
        return f"{value}: {choice.how}.{kept} {figure}"
    return f"{value}, chosen by {choice.how}.{_own_figure(made, curve)}"


def _own_figure(made: LinearReconstruction, curve: ParameterCurve) -> str:
    """Say the noise figure of this sensor's matrix where it is not that of the curve."""
    figure, of_type = made.choice.noise_figure, curve.noise_figure_at(made.choice.value)
    if of_type is not None and abs(figure / of_type - 1) <= _APART:
        return ""
    weights = "" if made.problem.noise_variance is None else " weighted by their noise"
    readings = f"{len(made.problem.reference)} readings{weights}"
    return f" The matrix of this sensor, from {readings}, has noise figure {number(figure)}."


def _marks(choice: ParameterChoice, curve: ParameterCurve) -> list[ParameterMark]:
    marks = []
    for answer in curve.answers:
        chosen = answer.criterion == choice.criterion
        # A sensor with readings left out may have to keep another number of components than its type.
        value = choice.value if chosen else answer.value
        figure = None if value is None else curve.noise_figure_at(value)
        figure = choice.noise_figure if chosen and figure is None else figure
        marks.append(ParameterMark(_TITLES.get(answer.criterion, answer.criterion), value, figure, chosen))
    return marks


def _figure(choice: ParameterChoice, curve: ParameterCurve, marks: list[ParameterMark]) -> Figure:
    smoother = "Fewer components smooth more" if curve.discrete else "Larger values smooth more"
    target = "" if curve.target is None else f" Dashed: noise figure {curve.target:g}, what the criterion asks for."
    others = " Open marks: what other criteria would have taken." if len(marks) > 1 else ""
    caption = (
        f"Noise figure (Adler et al. 2009) against {choice.name}. {smoother}: less noise, and what presses closer"
        f" together is no longer told apart. Full mark and line: chosen.{others}{target}"
    )
    said = [
        f"{mark.title} {'chose' if mark.chosen else 'would take'} {value_text(mark.value, discrete=curve.discrete)}"
        for mark in marks
        if mark.value is not None
    ]
    alternative = f"Noise figure over {choice.name}: {', '.join(said)}."
    return parameter_figure(curve, marks, choice.name, caption=caption, alternative=alternative)


def _table(choice: ParameterChoice, curve: ParameterCurve, marks: list[ParameterMark]) -> Table:
    rows = [
        [
            f"{mark.title} (chosen)" if mark.chosen else mark.title,
            "–" if mark.value is None else value_text(mark.value, discrete=curve.discrete),
            "–" if mark.noise_figure is None else number(mark.noise_figure),
            answer.words,
        ]
        for mark, answer in zip(marks, curve.answers, strict=True)
    ]
    name = choice.name[0].upper() + choice.name[1:] if len(choice.name) > 1 else choice.name
    caption = "What each criterion takes for the parameter, the noise figure there, and what it looks at."
    return text_table(caption, ("Criterion", name, "Noise figure", "On"), rows, (1, 2))
