"""A configuration file of one kind that is given as another is told for what it is, in one problem."""

from itertools import permutations

import pytest

from cbsr_qa.config.documents import DocumentKind, list_shipped, open_document
from cbsr_qa.config.limits import LimitsFile
from cbsr_qa.config.material import MaterialFile
from cbsr_qa.config.recipe import RecipeFile
from cbsr_qa.config.scene import SceneFile
from cbsr_qa.config.sensor_type import SensorTypeFile
from cbsr_qa.config.standards import StandardsFile
from cbsr_qa.config.station import CertificateFile, StationFile
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.studies.gauge import references
from cbsr_qa.studies.gauge.request import StudyFile

MODELS = {
    DocumentKind.STATION: StationFile,
    DocumentKind.RECIPE: RecipeFile,
    DocumentKind.SENSOR_TYPE: SensorTypeFile,
    DocumentKind.MATERIAL: MaterialFile,
    DocumentKind.SCENE: SceneFile,
    DocumentKind.LIMITS: LimitsFile,
    DocumentKind.REFERENCES: references._ReferenceFile,
    DocumentKind.GAUGE_STUDY: StudyFile,
    DocumentKind.STANDARDS: StandardsFile,
    DocumentKind.CERTIFICATE: CertificateFile,
}
OWN = {
    DocumentKind.LIMITS: '[limits_version]\nversion = "1"\n[[limits]]\nmeasurement = "drift"\n',
    DocumentKind.REFERENCES: '[[reference]]\nserial = "G-1"\n',
    DocumentKind.STANDARDS: '[standards.load_cell]\nunit = "N"\n',
    DocumentKind.CERTIFICATE: '[certificate]\nprefix = "LAB"\n',
    DocumentKind.GAUGE_STUDY: '[study]\nrecipe = "golden-check"\n[[reference]]\nserial = "G-1"\n',
}


def text_of(kind):
    return OWN[kind] if kind in OWN else open_document(kind, list_shipped(kind)[0]).text


@pytest.mark.parametrize("kind", DocumentKind)
def test_every_kind_is_known_by_a_table_that_its_files_must_have(kind):
    assert MODELS[kind].model_fields[kind.table].is_required()
    assert [other for other in DocumentKind if other.table == kind.table] == [kind]


@pytest.mark.parametrize(("given", "wanted"), list(permutations(DocumentKind, 2)), ids=lambda kind: kind.name)
def test_a_file_of_another_kind_is_one_problem(given, wanted, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(text_of(given))
    with pytest.raises(ConfigError) as refused:
        open_document(wanted, path)
    assert refused.value.reason == f"{path} is a {given.noun} file, not a {wanted.noun} file"


def test_a_table_of_another_kind_in_a_file_leaves_it_what_it_is(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(text_of(DocumentKind.RECIPE) + '\n[limits_version]\nversion = "1"\n[station]\nname = "x"\n')
    assert open_document(DocumentKind.RECIPE, path).data["station"]


def test_a_misspelt_table_is_still_told_as_such(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(text_of(DocumentKind.STATION).replace("[station]", "[statoin]"))
    assert open_document(DocumentKind.STATION, path).data["statoin"]


def test_the_name_of_a_shipped_file_of_another_kind_is_told_as_that():
    with pytest.raises(ConfigError, match="no station named 'nine-locations'") as refused:
        open_document(DocumentKind.STATION, "nine-locations")
    assert refused.value.remedy.startswith("'nine-locations' is a shipped recipe; ")
