"""A key that the configuration reference does not name is a failing test, and so is one it promises in vain."""

import re
from pathlib import Path
from typing import get_args

import pytest
from pydantic import BaseModel

from cbsr_qa.config.documents import DocumentKind, list_shipped
from cbsr_qa.config.material import MaterialFile
from cbsr_qa.config.recipe import AnalysisTable, RecipeFile
from cbsr_qa.config.scene import SceneFile
from cbsr_qa.config.sensor_type import SensorTypeFile
from cbsr_qa.config.station import StationFile

PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "configuration.md").read_text()
MODELS = {
    "Station": StationFile,
    "Recipe": RecipeFile,
    "Sensor type": SensorTypeFile,
    "Material": MaterialFile,
    "Scene": SceneFile,
}


def section(title):
    return re.search(rf"^## {title}$(.*?)(?=^## |\Z)", PAGE, re.M | re.S)[1]


def models_in(annotation):
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
        for field in annotation.model_fields.values():
            yield from models_in(field.annotation)
    for argument in get_args(annotation):
        yield from models_in(argument)


@pytest.mark.parametrize("title", MODELS)
def test_every_key_is_documented(title):
    named = set(re.findall(r"[A-Za-z_0-9]+", " ".join(re.findall(r"`([^`]+)`", section(title)))))
    keys = {key for model in models_in(MODELS[title]) for key in model.model_fields}
    assert keys - named == set()


@pytest.mark.parametrize("title", ["Station", "Recipe", "Sensor type", "Scene"])
def test_every_documented_key_exists(title):
    keys = {key for model in models_in(MODELS[title]) for key in model.model_fields}
    first_column = re.findall(r"^\| (`[^|]*?) \|", section(title), re.M)
    named = {key for cell in first_column for key in re.findall(r"`([a-z]\w*)`", cell)}
    assert named - keys == set()


def test_the_defaults_of_the_analysis_are_the_documented_ones():
    rows = dict(re.findall(r"^\| `(\w+)` \| `?([^|`]+)`? \|", section("Recipe"), re.M))
    for key, default in AnalysisTable().model_dump().items():
        if key == "overlap_bands":
            continue
        said = rows[key].strip().replace("1/3", repr(1 / 3)).strip('"')
        written = default if isinstance(default, str) else str(default).replace("False", "false")
        assert re.sub(r"\.0\b", "", written) == said, key


@pytest.mark.parametrize("kind", DocumentKind)
def test_every_shipped_name_is_documented(kind):
    for name in list_shipped(kind):
        assert f"`{name}`" in PAGE, name
