"""Recipe files: which sequences, how their frames become numbers, and the limits that judge them."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from cbsr_qa.config.choices import Choice, check_choice, check_measured, read_choice, tables
from cbsr_qa.config.limits import (
    FailureCodeTable,
    LimitsVersionTable,
    LimitTable,
    failure_code_problems,
    size_problems,
    version_problems,
)
from cbsr_qa.config.tables import FileModel, OpenTable, as_domain
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.imaging import OverlapBand
from cbsr_qa.domain.plan.analysis_settings import AnalysisSettings, CharacterisationSettings
from cbsr_qa.domain.plan.limits import read_failure_codes
from cbsr_qa.domain.plan.plan import NO_RECONSTRUCTION, PhaseSpec, PluginChoice, Recipe
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.results.characterisation import STRIP_MEASURES
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.problems import Problem, Table

Name = Annotated[str, Field(min_length=1, max_length=64)]
Percent = Annotated[float, Field(gt=0, le=100)]
Count = Annotated[int, Field(ge=1)]


class RecipeTable(Table):
    """``[recipe]``. ``calibrate_phases`` are the phases whose loads the calibration is taken from.

    ``limits_from`` is replaced by the content of that file before the recipe is checked.
    """

    name: Name
    calibrate_phases: list[Name]
    limits_from: Name | None = None


class PhaseTable(OpenTable):
    """``[[phases]]``: a name, the sequence plugin, and that plugin's options beside them."""

    name: Name
    sequence: Name


class ReconstructionTable(OpenTable):
    """``[reconstruction]``: the plugin's name, and its options beside it."""

    method: Name


class BandTable(Table):
    """``[[analysis.overlap_bands]]``: [lower, upper) of the area overlap."""

    name: Name
    lower_percent: Annotated[float, Field(ge=0, le=100)]
    upper_percent: Annotated[float, Field(gt=0, le=100)]


def _paper_bands() -> list[BandTable]:
    return [
        BandTable(name="likely poor", lower_percent=0, upper_percent=50),
        BandTable(name="ok", lower_percent=50, upper_percent=70),
        BandTable(name="good", lower_percent=70, upper_percent=100),
    ]


class AnalysisTable(Table):
    """``[analysis]``: every choice the paper leaves open. Defaults are documented in the configuration reference."""

    masks_percent: Annotated[list[Percent], Field(min_length=1)] = Field(
        default_factory=lambda: [25.0, 50.0, 75.0, 85.0]
    )
    main_mask_percent: Percent = 85.0
    noise_floor_frames: Count = 8
    reference: Literal["run", "load"] = "run"
    reference_frames: Count = 4
    steady_frames: Count = 4
    settling_multiple: Annotated[float, Field(ge=1)] = 1.5
    settling_tolerance_percent: Annotated[float, Field(gt=0, lt=100)] = 15.0
    settling_band: Literal["steady", "step"] = "steady"
    r_squared_gate: Annotated[float, Field(ge=0, lt=1)] = 0.85
    overlap_bands: Annotated[list[BandTable], Field(min_length=1)] = Field(default_factory=_paper_bands)
    size_ratio: Annotated[list[Annotated[float, Field(gt=0)]], Field(min_length=2, max_length=2)] = Field(
        default_factory=lambda: [1 / 3, 3.0]
    )
    clipping: Literal["exact", "centroid"] = "exact"
    perimeter: Literal["length", "nodes"] = "length"
    outline: Literal["contour", "elements"] = "contour"
    noise_weighting: Literal["equal", "measured"] = "equal"
    transients: Literal["averaged", "predicted"] = "averaged"
    learn_place: bool = False
    prior: Literal["none", "batch"] = "none"

    def problems(self) -> Iterator[Problem]:
        if self.main_mask_percent not in self.masks_percent:
            yield Problem(
                ("analysis", "main_mask_percent"),
                f"is {self.main_mask_percent:g}; allowed: one of masks_percent {self.masks_percent}",
            )
        if len(set(self.masks_percent)) < len(self.masks_percent):
            yield Problem(("analysis", "masks_percent"), f"is {self.masks_percent}; a mask is named twice")
        if self.size_ratio[0] >= self.size_ratio[1]:
            yield Problem(("analysis", "size_ratio"), f"is {self.size_ratio}; the first must be below the second")
        yield from self._band_problems()
        yield from self._outline_problems()

    def _outline_problems(self) -> Iterator[Problem]:
        """A contour has neither elements nor nodes to count, and none lies at the maximum itself."""
        if self.outline == "elements":
            return
        remedy = 'set outline = "elements", as the paper has it'
        for key, value, counted in (("clipping", self.clipping, "centroid"), ("perimeter", self.perimeter, "nodes")):
            if value == counted:
                yield Problem(("analysis", key), f"is {counted!r}, which counts in whole elements: {remedy}")
        if 100.0 in self.masks_percent:
            yield Problem(("analysis", "masks_percent"), f"hold 100 %, where no contour encloses anything: {remedy}")

    def _band_problems(self) -> Iterator[Problem]:
        end_percent = 0.0
        for index, band in enumerate(self.overlap_bands):
            if band.lower_percent != end_percent or band.upper_percent <= band.lower_percent:
                yield Problem(
                    ("analysis", "overlap_bands", index),
                    f"covers {band.lower_percent:g} to {band.upper_percent:g} %; it must rise from {end_percent:g} %",
                )
            end_percent = band.upper_percent
        if end_percent != 100:
            yield Problem(("analysis", "overlap_bands"), f"end at {end_percent:g} %; they must reach 100 %")

    def to_domain(self) -> AnalysisSettings:
        """Percent become fractions, except the bands of the overlap, which is a percentage itself."""
        bands = tuple(OverlapBand(b.name, b.lower_percent, b.upper_percent) for b in self.overlap_bands)
        return as_domain(AnalysisSettings, self, overlap_bands=bands)


class CharacterisationTable(Table):
    """``[characterisation]``: press cycles on a strip become a material's parameters, and nothing is imaged."""

    contact_length_mm: Annotated[float, Field(gt=0)] = 0.2
    contact_length_stderr_mm: Annotated[float, Field(gt=0)] = 0.1
    settling_tolerance_percent: Annotated[float, Field(gt=0, lt=100)] = 15.0
    settling_band: Literal["steady", "step"] = "steady"
    end_s: Annotated[float, Field(gt=0)] = 10.0

    def to_domain(self) -> CharacterisationSettings:
        return as_domain(CharacterisationSettings, self)


class ReportTable(Table):
    """``[report]``: annexes in order, none named means every installed one; and those of a sensor that passed."""

    sections: list[Name] = Field(default_factory=list)
    annexes_if_passed: list[Name] | None = None


#: Sequence option that names an image file next to the recipe.
_PICTURE = "picture"
#: Media types of such a file by its ending, as a page shows them.
PICTURES: Final = {
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
    ".gif": "image/gif",
    ".webp": "image/webp",
}


def _label_problems(
    choice: Choice, places_mm: dict[str, tuple[float, float]], labelled: dict[str, tuple[float, float]]
) -> Iterator[Problem]:
    """Yield a label that stands for another place in an earlier phase; add the others to ``labelled``."""
    for label, place_mm in places_mm.items():
        if labelled.setdefault(label, place_mm) != place_mm:
            finding = f"makes {label} the place {place_mm} mm, and an earlier phase {labelled[label]} mm"
            yield Problem((*choice.path, "label"), finding, "give another prefix")
            return


def with_picture(phase: PhaseSpec, near: Path | None) -> PhaseSpec:
    """Return a phase with the full path of its picture. ConfigError if there is no such image next to the recipe."""
    name = phase.options.get(_PICTURE)
    if not isinstance(name, str) or not name or near is None:
        return phase
    path = (near / name).resolve()
    if Path(name).name != name or path.suffix.lower() not in PICTURES or not path.is_file():
        raise ConfigError(
            f"phase {phase.name!r}: picture {name[:100]!r} is not an image file next to the recipe",
            remedy=f"put it into the folder {near}; allowed: {', '.join(PICTURES)}",
        )
    return replace(phase, options={**phase.options, _PICTURE: str(path)})


class RecipeFile(FileModel[Recipe]):
    """A recipe file."""

    recipe: RecipeTable
    phases: Annotated[list[PhaseTable], Field(min_length=1)]
    reconstruction: ReconstructionTable | None = None
    characterisation: CharacterisationTable | None = None
    analysis: AnalysisTable = Field(default_factory=AnalysisTable)
    metrics: dict[Name, dict[str, Any]] = Field(default_factory=dict)
    limits_version: LimitsVersionTable | None = None
    limits: list[LimitTable] = Field(default_factory=list)
    failure_codes: dict[str, FailureCodeTable] = Field(default_factory=dict)
    report: ReportTable = Field(default_factory=ReportTable)

    @classmethod
    def choices(cls, data: Any) -> Iterator[Choice]:
        for index, phase in tables(data, "phases"):
            yield from read_choice(Kind.SEQUENCE, phase, ("phases", index), "sequence", ("name",))
        yield from read_choice(Kind.RECONSTRUCTION, data.get("reconstruction"), ("reconstruction",), "method")
        metrics, report = data.get("metrics"), data.get("report")
        for name, options in metrics.items() if isinstance(metrics, Mapping) else ():
            if isinstance(options, Mapping):
                yield Choice(Kind.METRIC, name, ("metrics", name), options)
        for key in ("sections", "annexes_if_passed"):
            names = report.get(key) if isinstance(report, Mapping) else None
            for index, name in enumerate(names if isinstance(names, list) else ()):
                if isinstance(name, str):
                    yield Choice(Kind.SECTION, name, ("report", key, index))

    @classmethod
    def plugin_problems(cls, data: Any, plugins: Plugins) -> Iterator[Problem]:
        """Yield problems of plugins, and limits of quantities they do not measure."""
        unit_by_measurement: dict[str, str] = dict(STRIP_MEASURES) if "characterisation" in data else {}
        all_known, loop_phases = True, set[int]()
        place_mm_by_label: dict[str, tuple[float, float]] = {}
        for choice in cls.choices(data):
            plugin, problems = check_choice(choice, plugins)
            yield from problems
            if getattr(plugin, "role", None) is Role.LOOP:
                loop_phases.add(int(choice.path[1]))
            # Places of a sequence's presses by label, where its options give both a prefix and places.
            options = getattr(plugin, "options", None)
            prefix, places_mm = getattr(options, "label", None), getattr(options, "locations_mm", ())
            places = {} if prefix is None else {f"{prefix}{number}": place for number, place in enumerate(places_mm)}
            yield from _label_problems(choice, places, place_mm_by_label)
            if choice.kind is Kind.METRIC:
                measures = getattr(plugin, "measures", None)
                if not problems and measures is None:
                    finding, rule = "does not say what it measures", "its `measures` must map names to units"
                    yield Problem(choice.path, finding, rule)
                all_known &= measures is not None
                unit_by_measurement |= measures or {}
        yield from check_measured(tables(data, "limits"), unit_by_measurement, all_known=all_known)
        press_phases = [phase.get("name") for index, phase in tables(data, "phases") if index not in loop_phases]
        yield from size_problems(tables(data, "limits"), [name for name in press_phases if isinstance(name, str)])

    def problems(self) -> Iterator[Problem]:
        """Referenced names must exist, and be unique."""
        names = [phase.name for phase in self.phases]
        count_by_name: Counter[str] = Counter()
        for index, name in enumerate(names):
            count_by_name[name] += 1
            if count_by_name[name] == 2:
                yield Problem(("phases", index, "name"), f"is {name!r}, which another phase already has")
        for name in self.recipe.calibrate_phases:
            if name not in names:
                finding = f"names {name!r}; allowed: {', '.join(names)}"
                yield Problem(("recipe", "calibrate_phases"), finding)
        if self.analysis.learn_place and not self.recipe.calibrate_phases:
            yield Problem(("analysis", "learn_place"), "is true, but calibrate_phases names no phase to learn from")
        if self.analysis.prior != "none" and not self.recipe.calibrate_phases:
            yield Problem(("analysis", "prior"), "is 'batch', but calibrate_phases names no phase that calibrates")
        yield from self._purpose_problems()
        yield from self.analysis.problems()
        for index, limit in enumerate(self.limits):
            yield from limit.problems(index, names)
        yield from version_problems(self.limits_version, self.limits)
        yield from failure_code_problems(self.failure_codes, self.limits, names)

    def _purpose_problems(self) -> Iterator[Problem]:
        """A recipe images sensors, or characterises a material on a strip."""
        if self.characterisation is None:
            if self.reconstruction is None:
                finding = "is missing; only a recipe with [characterisation] images nothing"
                yield Problem(("reconstruction",), finding)
            return
        for name in ("reconstruction", "analysis", "metrics"):
            if name in self.model_fields_set:
                yield Problem((name,), "does not apply where [characterisation] is given: nothing is imaged")
        if self.recipe.calibrate_phases:
            finding = "does not apply where [characterisation] is given: a strip gets no calibration; give []"
            yield Problem(("recipe", "calibrate_phases"), finding)

    def to_domain(self) -> Recipe:
        table, annexes_if_passed = self.reconstruction, self.report.annexes_if_passed
        reconstruction = NO_RECONSTRUCTION if table is None else PluginChoice(table.method, table.options)
        return Recipe(
            name=self.recipe.name,
            phases=tuple(PhaseSpec(p.name, p.sequence, p.options) for p in self.phases),
            reconstruction=reconstruction,
            # Tables have no order in TOML: sorted, so that a restored recipe is the one that was read.
            metrics=tuple(PluginChoice(name, options) for name, options in sorted(self.metrics.items())),
            analysis=replace(self.analysis.to_domain(), calibrate_phases=tuple(self.recipe.calibrate_phases)),
            limits=tuple(limit.to_domain() for limit in self.limits),
            calibrate_phases=tuple(self.recipe.calibrate_phases),
            sections=tuple(self.report.sections),
            annexes_if_passed=None if annexes_if_passed is None else tuple(annexes_if_passed),
            limits_version=None if self.limits_version is None else self.limits_version.to_domain(),
            characterisation=None if self.characterisation is None else self.characterisation.to_domain(),
            failure_codes=read_failure_codes({name: code.model_dump() for name, code in self.failure_codes.items()}),
        )
