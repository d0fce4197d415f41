"""Shipped configuration files, and what a mistake in one's own says."""

import re
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from cbsr_qa.config.documents import DocumentKind, list_shipped, open_document
from cbsr_qa.config.loader import load_material, load_recipe, load_scene, load_sensor_type, load_station
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.plugin.discovery import discover

LOADERS = {
    DocumentKind.STATION: load_station,
    DocumentKind.RECIPE: load_recipe,
    DocumentKind.SENSOR_TYPE: load_sensor_type,
    DocumentKind.MATERIAL: load_material,
    DocumentKind.SCENE: load_scene,
}
SHIPPED = [(kind, name) for kind in DocumentKind for name in list_shipped(kind)]


def shipped_text(kind, name):
    return files("cbsr_qa._stations").joinpath(kind.folder, f"{name}.toml").read_text()


@pytest.fixture
def spoilt(tmp_path):
    """Load a shipped file with replacements made; return the message."""

    def load(kind, name, *replacements):
        text = shipped_text(kind, name)
        for old, new in replacements:
            assert old in text, old
            text = text.replace(old, new, 1)
        path = tmp_path / f"{name}.toml"
        path.write_text(text)
        with pytest.raises(ConfigError) as caught:
            LOADERS[kind](path)
        assert str(path) in str(caught.value)
        return str(caught.value)

    return load


def line_in(kind, name, text):
    return shipped_text(kind, name).splitlines().index(text) + 1


@pytest.mark.parametrize(("kind", "name"), SHIPPED)
def test_every_shipped_file_loads_under_its_own_name(kind, name):
    loaded = LOADERS[kind](name)
    assert loaded.value.name == name
    assert loaded.document.path is None
    assert loaded.document.text == shipped_text(kind, name)


def test_what_is_promised_is_shipped():
    assert {"cbsr-8wt", "cbsr-9wt"} <= set(list_shipped(DocumentKind.MATERIAL))
    assert {"disc-100mm", "disc-150mm"} <= set(list_shipped(DocumentKind.SENSOR_TYPE))
    assert {"none", "base"} <= set(list_shipped(DocumentKind.SCENE))
    assert "simulated" in list_shipped(DocumentKind.STATION)
    assert "nine-locations" in list_shipped(DocumentKind.RECIPE)


def test_shipped_references_are_shipped():
    for name in list_shipped(DocumentKind.STATION):
        station = load_station(name).value
        load_sensor_type(station.sensor_type)
        load_material(station.material)


def test_units_are_converted_at_the_edge():
    station = load_station("simulated").value
    assert station.motion.press_speed_mm_s == pytest.approx(40 / 60)
    # The paper: 40 mm/min on 4 mm is 16.67 % of strain a second.
    thickness_mm = load_sensor_type("disc-100mm").value.thickness_mm
    assert station.motion.press_speed_mm_s / thickness_mm == pytest.approx(0.1667, abs=5e-5)
    assert station.safety.strain == pytest.approx(0.35)
    assert station.safety.duration_s == 12 * 3600
    assert load_scene("base").value.current_A == pytest.approx(4e-4)
    analysis = load_recipe("nine-locations").value.analysis
    assert analysis.masks == (0.25, 0.5, 0.75, 0.85)
    assert analysis.main_mask in analysis.masks
    assert analysis.settling_tolerance == 0.15


def test_the_papers_sensor():
    sensor_type = load_sensor_type("disc-100mm").value
    assert (sensor_type.radius_mm, sensor_type.thickness_mm, sensor_type.electrodes.count) == (50.0, 4.0, 16)
    assert sensor_type.pattern.shape == (16, 16)
    assert sensor_type.pattern.usable().sum() == 208
    np.testing.assert_allclose(sensor_type.electrodes.positions_mm()[4], [0.0, 48.0], atol=1e-12)


def test_keys_that_are_a_plugins_own_are_handed_on():
    recipe = load_recipe("nine-locations").value
    grid = next(phase for phase in recipe.phases if phase.sequence == "location-grid")
    assert grid.options["strains_percent"] == [20.0]
    assert not {"name", "sequence"} & set(grid.options)
    (bench,) = load_station("simulated").value.instruments
    assert bench.options == {"scene": "base"}


def test_analysis_defaults_are_what_the_shipped_recipe_writes_out(tmp_path):
    """A recipe without [analysis] is analysed as the shipped one."""
    text = shipped_text(DocumentKind.RECIPE, "nine-locations")
    without = re.sub(r"\[analysis\].*?(?=\[metrics\])", "", text, flags=re.S)
    assert "masks_percent" not in without
    path = tmp_path / "short.toml"
    path.write_text(without)
    assert load_recipe(path).value.analysis == load_recipe("nine-locations").value.analysis


def test_all_mistakes_are_listed_at_once_each_with_its_line(spoilt):
    message = spoilt(
        DocumentKind.STATION,
        "simulated",
        ('clock = "virtual"', 'clock = "virtula"'),
        ("force_N = 20.0", "force = 20.0"),
        ("strain_percent = 35.0", "strain_percent = 350"),
        ("hover_mm = 25.0", 'hover_mm = "25"'),
        ("stale_s = 2.0", "stale_s = nan"),
        ("provides =", "provids ="),
    )
    assert "7 problems" in message
    at = line_in(DocumentKind.STATION, "simulated", 'clock = "virtual"')
    assert f"line {at}: station.clock is 'virtula'; it must be 'virtual' or 'real'" in message
    assert "safety.force_N is missing; is 'force' a misspelling of it?" in message
    assert "safety.force is not a known key; did you mean 'force_N'?" in message
    assert "safety.strain_percent is 350; it must be a number above 0 and below 100" in message
    assert "motion.hover_mm is '25'; it must be a number" in message
    assert "safety.stale_s is not a finite number" in message
    assert "instruments.bench.provides is missing; is 'provids' a misspelling of it?" in message


def test_an_unknown_key_does_not_hide_what_does_not_fit_together(spoilt):
    message = spoilt(
        DocumentKind.SENSOR_TYPE,
        "disc-100mm",
        ("ring_radius_mm = 48.0", "ring_radius_mm = 49.9"),
        ('response = "auto"', 'response = "auto"\nresponce = "auto"'),
    )
    assert "did you mean 'response'?" in message
    said = "electrodes.ring_radius_mm is 49.9; pins must lie inside the sheet, 5% of their diameter from its edge:"
    assert f"{said} at most 49.6425 mm here" in message


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("diameter_mm = 0.65", "length_mm = 0.65", "length_mm does not apply where kind is 'pin'; use diameter_mm"),
        ("diameter_mm = 0.65", "diameter_mm = 20.0", "must be below the electrodes' spacing of 18.8 mm"),
        ("diameter_mm = 0.65", "diameter_mm = 18.5", "centres are 18.73 mm apart are at most 17.83"),
        ("diameter_mm = 0.65", "diameter_mm = 3.99", "ring_radius_mm is 48; pins must lie inside the sheet, 5%"),
        ("diameter_mm = 0.65", "diameter_mm = 3.9999", "5% of their diameter from its edge: at most 47.8001 mm here"),
        (
            "diameter_mm = 0.65",
            "diameter_mm = 1e-9",
            "diameter_mm is 1e-09; on this sheet it must be at least 0.05 mm",
        ),
        ('kind = "pin"', 'kind = "arc"', "arcs lie on the sheet's edge: it must be 50"),
        ("count = 16", "count = 2", "electrodes.count is 2; it must be a whole number from 3"),
        ("count = 16", "count = 16.0", "electrodes.count is 16.0; it must be a whole number"),
        ("count = 16", "count = true", "electrodes.count is True; it must be a whole number"),
        ("radius_mm = 50.0", "radius = 50.0", "did you mean 'radius_mm'?"),
        ('drive = "adjacent"', 'drive = "oposite"', "drive is 'oposite'; allowed: 'adjacent', 'opposite', 'skip-1'"),
    ],
)
def test_sensor_types_that_cannot_be(spoilt, old, new, said):
    assert said in spoilt(DocumentKind.SENSOR_TYPE, "disc-100mm", (old, new))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("main_mask_percent = 85.0", "main_mask_percent = 80.0", "is 80; allowed: one of masks_percent"),
        ("masks_percent = [25.0,", "masks_percent = [25.0, 25.0,", "a mask is named twice"),
        ("size_ratio = [0.3333333333333333, 3.0]", "size_ratio = [3.0, 0.3]", "the first must be below the second"),
        ("size_ratio = [0.3333333333333333, 3.0]", "size_ratio = [3.0]", "it must have at least 2 items"),
        ("upper_percent = 70.0", "upper_percent = 60.0", "it must rise from 60 %"),
        ("upper_percent = 100.0", "upper_percent = 90.0", "they must reach 100 %"),
        ('perimeter = "length"', 'perimeter = "pixels"', "it must be 'length' or 'nodes'"),
        ('name = "random loads"', 'name = "nine locations"', "which another phase already has"),
        ('calibrate_phases = ["nine', 'calibrate_phases = ["nein', "names 'nein locations'; allowed: noise"),
        ('phase = "nine locations"', 'phase = "nine"', "is 'nine'; allowed: "),
        ("upper = 6.5", "marginal = 0.1", "TOML"),
        ("[reconstruction]", "[reconstructoin]", "did you mean 'reconstruction'?"),
        ('weighting = "equal"', 'weighting = "loud"', "it must be 'equal' or 'measured'"),
        ("noise_floor_frames = 8", "noise_floor_frames = 0", "it must be a whole number of at least 1"),
    ],
)
def test_recipes_that_cannot_be(spoilt, old, new, said):
    assert said in spoilt(DocumentKind.RECIPE, "nine-locations", (old, new))


def test_a_limit_without_a_bound_and_one_upside_down(spoilt):
    limit = '[[limits]]\nmeasurement = "area_overlap"\nunit = "%"\n'
    message = spoilt(
        DocumentKind.RECIPE,
        "nine-locations",
        ("[[limits]]", f"{limit}marginal = 1.0\n\n{limit}lower = 60\nupper = 50\n\n[[limits]]"),
    )
    assert "limits[1] (area_overlap) has neither lower nor upper" in message
    assert "limits[2].lower is 60, above upper = 50" in message


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("time_constants_s = [2.5, 23.1]", "time_constants_s = [-2.5, 23.1]", "time_constants_s[1] is -2.5; it must"),
        ("time_constants_s = [2.5, 23.1]", "time_constants_s = [23.1, 2.5]", "the first must be below the second"),
        ("time_constants_s = [2.5, 23.1]", "time_constants_s = [2.5, 2.5]", "the first must be below the second"),
        ("value = 132.5", "value = 0", "modulus_kPa.value is 0; it must be a number above 0"),
        ("stderr = 9800.0", "stderr = -1.0", "it must be a number of at least 0"),
        ('source = "paper, 3.1.1: gauge factor"', "", "against_strain.slope.source is missing"),
        ("[material.against_strain.slope]", "[material.against_strian.slope]", "did you mean 'against_strain'?"),
    ],
)
def test_materials_that_cannot_be(spoilt, old, new, said):
    assert said in spoilt(DocumentKind.MATERIAL, "cbsr-8wt", (old, new))


def test_an_effect_is_on_once_or_not_at_all(spoilt):
    effect = '[[effects]]\nname = "piezoresistivity"\n\n'
    said = spoilt(DocumentKind.SCENE, "base", ("[[effects]]\n", f"{effect}[[effects]]\n"))
    assert "effects[3].name is 'piezoresistivity', which is already on" in said


def test_roles_are_filled_once(spoilt):
    more = '\n[instruments.second]\ndriver = "x"\nprovides = ["force"]\n'
    said = spoilt(
        DocumentKind.STATION, "simulated", ('scene = "base"', f'scene = "base"\n{more}'), ('"frame_source", ', "")
    )
    assert "instruments.second.provides names 'force', which instruments.bench already provides" in said
    assert "has nothing that provides 'frame_source'" in said


def test_a_role_with_a_bad_name_is_refused(spoilt):
    said = spoilt(DocumentKind.STATION, "simulated", ("[instruments.bench]", '[instruments."a b"]'))
    at = line_in(DocumentKind.STATION, "simulated", "[instruments.bench]")
    assert f"line {at}: instruments.a b is 'a b'; it must be lower-case letters" in said


@pytest.mark.parametrize("due", ["2027-03-31", '"2027-03-31"'])
def test_a_calibration_date_may_be_a_date_or_its_text(tmp_path, due):
    path = tmp_path / "mine.toml"
    path.write_text(shipped_text(DocumentKind.STATION, "simulated") + f"calibration_due = {due}\n")
    assert load_station(path).value.instruments[0].calibration_due == "2027-03-31"


def test_a_calibration_date_that_is_none_is_refused(spoilt):
    said = spoilt(DocumentKind.STATION, "simulated", ('scene = "base"', 'calibration_due = "next spring"'))
    assert "calibration_due is 'next spring'; it must be a date like 2027-03-31" in said


def test_safety_limits_are_converted_at_the_edge_and_have_the_documented_defaults(tmp_path):
    text = shipped_text(DocumentKind.STATION, "simulated")
    safety = load_station("simulated").value.safety
    assert (safety.dwell_s, safety.compliance, safety.heartbeat_s, safety.answer_s) == (3600.0, 0.05, 10.0, 120.0)
    assert safety.temperature_C is None
    keys = ("dwell_s = 90.0", "compliance_percent = 12.0", "heartbeat_s = 3.0", "answer_s = 30.0")
    more = "\n".join((*keys, "temperature_C = [18.0, 26.5]", ""))
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("[safety]\n", f"[safety]\n{more}") + 'model = "2634B"\nserial = "17"\n')
    station = load_station(path).value
    safety = station.safety
    assert (safety.dwell_s, safety.compliance, safety.heartbeat_s, safety.answer_s) == (90.0, 0.12, 3.0, 30.0)
    assert safety.temperature_C == (18.0, 26.5)
    (instrument,) = station.instruments
    assert (instrument.model, instrument.serial, dict(instrument.options)) == ("2634B", "17", {"scene": "base"})


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("dwell_s = 0.0", "safety.dwell_s is 0.0; it must be a number above 0"),
        (
            "compliance_percent = 101.0",
            "safety.compliance_percent is 101.0; it must be a number above 0 and at most 100",
        ),
        ("temperature_C = [26.0, 18.0]", "safety.temperature_C is no range; give the lowest and then the highest"),
        ("temperature_C = [26.0]", "safety.temperature_C is [26.0]; it must have at least 2 items"),
        ("heartbeat_s = -1.0", "safety.heartbeat_s is -1.0; it must be a number above 0"),
        ("answer_s = 0.0", "safety.answer_s is 0.0; it must be a number above 0"),
        ("dwel_s = 10.0", "did you mean 'dwell_s'"),
    ],
)
def test_safety_limits_that_cannot_be(spoilt, given, said):
    assert said in spoilt(DocumentKind.STATION, "simulated", ("[safety]", f"[safety]\n{given}"))


@pytest.mark.parametrize("label", ["L", "H"])
def test_a_label_stands_for_one_place(tmp_path, label):
    def loaded(locations_mm):
        loop = f'[[phases]]\nname = "loops"\nsequence = "hysteresis-loop"\nlabel = "{label}"\n{locations_mm}\n'
        path = tmp_path / "labels.toml"
        path.write_text(open_document(DocumentKind.RECIPE, "golden-check").text + loop)
        return load_recipe(path, discover()).value

    assert len(loaded("").phases) == 2
    if label == "H":
        assert len(loaded("locations_mm = [[5, 5]]").phases) == 2
    else:
        with pytest.raises(ConfigError, match=r"label makes L0 the place \(5.0, 5.0\) mm, and an earlier phase"):
            loaded("locations_mm = [[5, 5]]")


def test_a_decimal_comma_is_named(spoilt):
    said = spoilt(DocumentKind.RECIPE, "nine-locations", ("upper = 6.5", "upper = 6,5  # mm"))
    assert "write 6.5 with a decimal point in 'upper = 6,5'" in said


def test_malformed_toml_is_refused_with_its_line(spoilt):
    said = spoilt(DocumentKind.STATION, "simulated", ("[indenter]", "[indenter"))
    at = line_in(DocumentKind.STATION, "simulated", "[indenter]")
    assert "is not valid TOML" in said
    assert f"line {at}" in said


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00", b"time,voltage\n1,2\n", b"station = 3\n"])
def test_files_that_are_no_station_are_refused(tmp_path, content):
    path = tmp_path / "x.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=re.escape(str(path))):
        load_station(path)


def test_a_huge_file_is_not_read(tmp_path):
    path = tmp_path / "recording.toml"
    with path.open("wb") as file:
        file.truncate(5_000_000_000)
    with pytest.raises(ConfigError, match="at most 1 MB are read"):
        load_station(path)


def test_a_missing_name_lists_what_is_shipped_and_the_nearest():
    with pytest.raises(ConfigError) as caught:
        load_recipe("nine-location")
    assert "did you mean 'nine-locations'?" in caught.value.remedy
    assert "shipped: " in caught.value.remedy


@pytest.mark.parametrize("name", ["", "a" * 5000, "\0", "../../etc/passwd", "x\0.toml", "no/such/file.toml"])
def test_hostile_names_give_one_short_message(name):
    with pytest.raises(ConfigError) as caught:
        load_station(name)
    assert len(str(caught.value)) < 500
    assert "\0" not in str(caught.value)


def test_a_folder_is_no_file(tmp_path):
    with pytest.raises(ConfigError, match="is a folder"):
        load_station(tmp_path)


def test_a_name_of_a_file_in_this_folder_says_how_to_give_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text(shipped_text(DocumentKind.STATION, "simulated"))
    with pytest.raises(ConfigError, match=r"give mine\.toml"):
        load_station("mine")
    assert load_station("mine.toml").value.name == "simulated"


def test_references_are_looked_for_next_to_the_file_first(tmp_path):
    thick = shipped_text(DocumentKind.SENSOR_TYPE, "disc-100mm").replace("thickness_mm = 4.0", "thickness_mm = 6.0")
    (tmp_path / "disc-100mm.toml").write_text(thick)
    (tmp_path / "mine.toml").write_text(shipped_text(DocumentKind.STATION, "simulated"))
    station = load_station(str(tmp_path / "mine.toml"))
    assert load_sensor_type(station.value.sensor_type, near=station.folder).value.thickness_mm == 6.0
    assert load_material(station.value.material, near=station.folder).document.path is None
    assert load_sensor_type(station.value.sensor_type).value.thickness_mm == 4.0
