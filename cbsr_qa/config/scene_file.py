"""Scene files: what the simulated world contains."""

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from cbsr_qa.config.tables import FileModel, OpenTable, Problem, Table
from cbsr_qa.domain.plan import PluginChoice, Scene

Positive = Annotated[float, Field(gt=0)]
Name = Annotated[str, Field(min_length=1, max_length=64)]


class SceneTable(Table):
    """``[scene]``."""

    name: Name
    current_mA: Positive
    frame_period_s: Positive
    sheet_mesh_size_mm: Positive
    not_modelled: list[str] = Field(default_factory=list)


class EffectTable(OpenTable):
    """``[[effects]]``: an effect that is on, and its parameters beside its name."""

    name: Name


class SceneFile(FileModel[Scene]):
    """A scene file."""

    scene: SceneTable
    effects: list[EffectTable] = Field(default_factory=list)

    def problems(self) -> Iterator[Problem]:
        """An effect is on once or not at all."""
        seen: set[str] = set()
        for index, effect in enumerate(self.effects):
            if effect.name in seen:
                yield Problem(("effects", index, "name"), f"is {effect.name!r}, which is already on")
            seen.add(effect.name)

    def to_domain(self) -> Scene:
        """Milliampere become ampere."""
        return Scene(
            name=self.scene.name,
            effects=tuple(PluginChoice(e.name, e.options) for e in self.effects),
            current_A=self.scene.current_mA / 1000,
            frame_period_s=self.scene.frame_period_s,
            sheet_mesh_size_mm=self.scene.sheet_mesh_size_mm,
            not_modelled=tuple(self.scene.not_modelled),
        )
