"""The merged configuration: one digest for one content, and enough to go on with a run whose files are gone."""

import hashlib
import json

import pytest

from cbsr_qa.config.documents import DocumentKind
from cbsr_qa.config.loader import load_material, load_recipe, load_scene, load_sensor_type, load_station
from cbsr_qa.config.merging import canonical_json, merge, restore
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.plan import Station


def merged(station="simulated", recipe="nine-locations", seed=5):
    at = load_station(station)
    return merge(
        at,
        load_recipe(recipe),
        load_sensor_type(at.value.sensor_type, near=at.folder),
        load_material(at.value.material, near=at.folder),
        seed=seed,
    )


@pytest.fixture
def own(tmp_path):
    """A folder with a station of one's own and a scene beside it."""
    scene = load_scene("base").document.text.replace("current_mA = 0.4", "current_mA = 0.3")
    (tmp_path / "lively.toml").write_text(scene)
    station = load_station("simulated").document.text.replace('scene = "base"', 'scene = "lively"')
    (tmp_path / "mine.toml").write_text(station)
    return tmp_path


def test_the_digest_is_of_the_canonical_text():
    configuration = merged()
    assert configuration.digest == hashlib.sha256(configuration.canonical.encode()).hexdigest()
    assert json.loads(configuration.canonical)["seed"] == 5


def test_a_restored_configuration_is_the_one_that_was_merged():
    before = merged()
    after = restore(before.canonical)
    assert after.digest == before.digest
    assert (after.station, after.recipe) == (before.station, before.recipe)
    assert (after.sensor_type, after.material, after.seed) == (before.sensor_type, before.material, before.seed)


def test_the_same_content_elsewhere_has_the_same_digest(own, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    for file in own.iterdir():
        (elsewhere / file.name).write_text(file.read_text())
    assert merged(own / "mine.toml").digest == merged(elsewhere / "mine.toml").digest


def test_comments_and_the_order_of_tables_do_not_count(own):
    before = merged(own / "mine.toml").digest
    text = (own / "mine.toml").read_text()
    station, rest = text.split("[indenter]")
    (own / "mine.toml").write_text(f"# mine\n[indenter]{rest}\n{station}")
    assert merged(own / "mine.toml").digest == before


@pytest.mark.parametrize("file", ["mine.toml", "lively.toml"])
def test_any_changed_value_changes_the_digest_also_in_a_scene(own, file):
    before = merged(own / "mine.toml").digest
    text = (own / file).read_text()
    changed = text.replace("stale_s = 2.0", "stale_s = 2.5").replace("current_mA = 0.3", "current_mA = 0.31")
    assert changed != text
    (own / file).write_text(changed)
    assert merged(own / "mine.toml").digest != before


def test_a_seed_changes_the_digest():
    assert merged(seed=1).digest != merged(seed=2).digest


def test_a_run_goes_on_when_its_files_are_gone(own):
    before = merged(own / "mine.toml")
    for file in own.iterdir():
        file.unlink()
    after = restore(before.canonical)
    assert isinstance(after.station, Station)
    (bench,) = after.station.instruments
    assert load_scene(bench.options["scene"]).value.current_A == pytest.approx(3e-4)


def test_a_scene_that_is_not_there_is_refused(own):
    (own / "lively.toml").unlink()
    with pytest.raises(ConfigError, match="no scene named 'lively'"):
        merged(own / "mine.toml")


def test_a_stored_configuration_is_checked_again():
    content = json.loads(merged().canonical)
    content["station"]["station"]["clock"] = "sundial"
    with pytest.raises(ConfigError, match=r"stored station has 1 problem.*\n.*sundial"):
        restore(canonical_json(content))


@pytest.mark.parametrize("text", ["[]", "{}", '{"layout": 99}'])
def test_a_layout_of_another_version_is_refused(text):
    with pytest.raises(ConfigError, match="layout"):
        restore(text)


def test_canonical_json_is_written_in_one_way_and_holds_no_nan():
    assert canonical_json({"b": 1.0, "a": [True, None, "Δ"]}) == '{"a":[true,null,"Δ"],"b":1.0}'
    with pytest.raises(ValueError, match="JSON"):
        canonical_json({"a": float("nan")})


def test_kinds_have_names_for_messages():
    files = ["station", "recipe", "sensor type", "material", "scene"]
    named = [*files, "gauge study", "limits", "reference values", "standards", "certificate settings"]
    assert [kind.noun for kind in DocumentKind] == named


@pytest.mark.parametrize(
    ("range_mA", "is_covered"), [("[0.1, 0.4]", True), ("[0.4, 1.0]", True), ("[50, 100]", False)]
)
def test_the_current_of_a_scene_is_one_that_the_certificate_covers(tmp_path, range_mA, is_covered):
    certificate = 'certificate = "Q-9"\nlaboratory = "L"\ndate = 2026-03-02\ndue = 2027-03-31'
    stated = f'{certificate}\nuncertainty = 0.05\nk = 2\nunit = "%"\nrange_mA = {range_mA}'
    text = load_station("simulated").document.text
    (tmp_path / "mine.toml").write_text(f"{text}\n[standards.source_meter]\n{stated}\n")
    if is_covered:
        assert merged(str(tmp_path / "mine.toml")).station.standards
        return
    with pytest.raises(ConfigError, match=r"range_mA .* is 50 to 100 mA, and the scene of .* drives 0\.4 mA"):
        merged(str(tmp_path / "mine.toml"))
