"""What files that somebody damaged, or wrote to do harm, are told: one short message, soon."""

import time

import pytest
from scene_samples import HEAD, PIEZORESISTIVE, checked, load_table, written

from cbsr_qa.config.loader import load_scene_plan
from cbsr_qa.config.text import line_of
from cbsr_qa.domain.errors import ConfigError


def refused(path):
    """The message, which comes soon and fits a terminal."""
    start_s = time.perf_counter()
    with pytest.raises(ConfigError) as caught:
        checked(path)
    assert time.perf_counter() - start_s < 10
    said = str(caught.value)
    assert len(said) < 15_000
    assert all(sign == "\n" or sign.isprintable() for sign in said), said
    return said


def test_a_whole_number_of_thousands_of_digits_is_no_toml(tmp_path):
    said = refused(written(tmp_path, HEAD.replace("seed = 7", "seed = " + "9" * 5000)))
    assert "mine.toml is not valid TOML" in said
    assert "value has 5000 digits" in said


@pytest.mark.parametrize("part", ["a", '"a"', "a "])
def test_a_key_of_thousands_of_parts_is_refused_with_its_line(tmp_path, part):
    said = refused(written(tmp_path, HEAD + ".".join([part] * 100_000) + " = 1\n"))
    assert f"line {HEAD.count(chr(10)) + 1}: a key of more than 50 parts" in said


def test_numbers_and_texts_with_many_points_are_no_keys(tmp_path):
    numbers = ",".join(["0.5"] * 200)
    points = "a." * 40 + " " + "." * 200 + " 1.2.3"
    text = HEAD.replace("[sensor]", f'not_modelled = ["{points}"] # {numbers} {"x" * 100_000}\n[sensor]')
    assert load_scene_plan(written(tmp_path, text)).value.scene.not_modelled == (points,)


@pytest.mark.parametrize("rows", ["k{} = 1\n", "[[loads]]\nx_mm = {}\n"])
def test_of_thousands_of_problems_the_first_are_listed(tmp_path, rows):
    said = refused(written(tmp_path, HEAD + "".join(rows.format(k) for k in range(1000))))
    assert "000 problems, of which these are the first 50:" in said
    assert said.count("\n") == 51


def test_keys_and_names_of_files_are_shown_without_their_control_characters(tmp_path):
    path = written(tmp_path, HEAD + f'"\\u001b[31m" = 1\n{"y" * 5000} = 2\n', "red\x1b[31m.toml")
    said = refused(path)
    assert r"red\x1b[31m.toml" in said
    assert r"recording.'\x1b[31m' is not a known key" in said
    assert f"recording.'{'y' * 60}'… (5000 characters) is not a known key" in said
    path.write_text("x")
    assert r"red\x1b[31m.toml' is not valid TOML" in refused(path)


@pytest.mark.parametrize("name", ["x" * 5000 + ".toml", "ü" * 250 + ".toml", "x/" * 3000, "x" * 300 + "/y.toml"])
def test_a_path_too_long_for_the_file_system_does_not_exist(name):
    with pytest.raises(ConfigError, match="does not exist") as caught:
        load_scene_plan(name)
    assert len(str(caught.value)) < 500


def test_only_line_feeds_end_lines():
    text = '[scene]\nname = "a\u2028b\u0085c\u2029"\ncurrent_mA = 1\n'
    assert line_of(text, ("scene", "current_mA")) == 3


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("frame_period_s = 2.5", "frame_period_s = 601", "scene.frame_period_s is 601; it must be a number"),
        ("frame_period_s = 2.5", "frame_period_s = 1e-7", "scene.frame_period_s is 1e-07; it must be a number"),
        ("duration_s = 100.0", "duration_s = 1e300", "recording.duration_s is 1e+300; it must be a number"),
        ("duration_s = 100.0", "duration_s = 250000.1", "is 250000.1, 100000.04 frames of 2.5 s; at most 100000"),
        ("frame_period_s = 2.5", "frame_period_s = 600.0", "recording.duration_s is 100; one frame takes 600 s"),
        ("current_mA = 0.4", "current_mA = 1e300", "scene.current_mA is 1e+300; it must be a number"),
        ("current_mA = 0.4", "current_mA = 1e-300", "scene.current_mA is 1e-300; it must be a number"),
        ("[sensor]", "[head]\ndiameter_mm = 0.2\n[sensor]", "head.diameter_mm is 0.2; it must be a number"),
        ("[sensor]", "[head]\ndiameter_mm = 1e6\n[sensor]", "head.diameter_mm is 1000000.0; it must be a number"),
        ("size_mm = 8.0", "size_mm = 0.9", "scene.sheet_mesh_size_mm is 0.9; on this sheet it must be at least 1"),
        ('name = "mine"', 'name = "a\\nb"', r"scene.name is 'a\nb'; it must be"),
        ('name = "mine"', 'name = "\\u001b[31m"', r"scene.name is '\x1b[31m'; it must be"),
        ("[sensor]", 'not_modelled = ["\\u001b[31m"]\n[sensor]', r"scene.not_modelled[1] is '\x1b[31m'; it must be"),
    ],
)
def test_what_no_computer_gets_through_or_prints_is_refused_by_its_key(tmp_path, old, new, said):
    assert old in HEAD
    assert said in refused(written(tmp_path, HEAD.replace(old, new, 1)))


def test_a_frame_may_take_ten_minutes_in_a_recording_of_eleven_days(tmp_path):
    slow = HEAD.replace("frame_period_s = 2.5", "frame_period_s = 600.0").replace("= 100.0", "= {}")
    assert checked(written(tmp_path, slow.format("1e6"))).value.frame_count == 1666
    assert "recording.duration_s is 1000001.0; it must be a number" in refused(
        written(tmp_path, slow.format("1000001.0"))
    )


def test_a_load_a_hair_off_the_sheet_is_shown_with_its_digits(tmp_path):
    said = refused(written(tmp_path, HEAD + load_table(x_mm=50.0000001) + PIEZORESISTIVE))
    assert "loads[1].x_mm is 50.0000001 with y_mm = 0, off the sheet" in said
