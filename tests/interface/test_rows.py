"""Rows of readings of any pairs by ``qa.analyse``, ``qa.image`` and ``cbsr-qa analyse``: one answer by three ways."""

import json
from itertools import combinations

import numpy as np
import pytest
from pressed_sheets import SKIN_TOML, adjacent_pairs, readings, round_sensor

import cbsr_qa as qa
from cbsr_qa.cli.main import run_guarded

PAIRS = adjacent_pairs(8)
PLACES = np.array([[20.0, 5.0], [-25.0, 12.0]])


@pytest.fixture(scope="module")
def pressed(tmp_path_factory):
    """Rows pressed and at rest, and a folder with them as tables."""
    folder = tmp_path_factory.mktemp("rows")
    loaded, unloaded = readings(round_sensor(count=8), PAIRS, PLACES, contrast=0.3)
    random = np.random.default_rng(1)
    noise = 0.02 * np.median(np.abs(loaded - unloaded))
    rows = loaded + noise * random.standard_normal(loaded.shape)
    rest = unloaded + noise * random.standard_normal((8, len(unloaded)))
    (folder / "skin.toml").write_text(SKIN_TOML.replace("count = 16", "count = 8"))
    tables = {"frames": rows, "rest": rest, "complex": np.round(rows, 12) + 0.5j * rows[:, ::-1]}
    for name, values in tables.items():
        cells = [[str(value).strip("()") for value in row] for row in values.tolist()]
        lines = [",".join(f"r{k}" for k in range(len(PAIRS))), *map(",".join, cells)]
        (folder / f"{name}.csv").write_text("\n".join(lines))
    pattern = ["source,sink,plus,minus", *(",".join(map(str, pair)) for pair in PAIRS.tolist())]
    (folder / "pairs.csv").write_text("\n".join(pattern))
    return rows, rest, folder


def test_arrays_tables_and_the_command_find_the_same(pressed, monkeypatch, capsys):
    rows, rest, folder = pressed
    monkeypatch.chdir(folder)
    events = qa.analyse(rows, pattern=PAIRS, rest=rest, sensor_type="./skin.toml").result.events
    for event, place in zip(events, PLACES, strict=True):
        assert np.hypot(event.x_mm - place[0], event.y_mm - place[1]) < 4
    tables = qa.analyse("frames.csv", pattern="pairs.csv", rest="rest.csv", sensor_type="./skin.toml")
    assert [e.x_mm for e in tables.result.events] == pytest.approx([e.x_mm for e in events], abs=1e-3)
    options = ["--pattern", "pairs.csv", "--rest", "rest.csv", "--sensor-type", "skin.toml", "--no-report"]
    assert run_guarded(["analyse", "frames.csv", *options, "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert [e["x_mm"] for e in printed["events"]] == pytest.approx([e.x_mm for e in events], abs=1e-3)
    assert (printed["recording"]["format"], printed["recording"]["unit"]) == ("table", "units")
    assert run_guarded(["analyse", "frames.csv", *options]) == 0
    assert "E2       2  electrode" in capsys.readouterr().out


def test_the_pattern_of_the_rows_decides_not_that_of_the_sensor_type(pressed, monkeypatch):
    """Opposite electrodes of 13 do not exist, and five adjacent ones give too few readings."""
    monkeypatch.chdir(pressed[2])
    for count, own_pattern in ((13, "opposite"), (5, "adjacent")):
        pairs = np.array([(a, b, a, b) for a, b in combinations(range(count), 2)])
        loaded, unloaded = readings(round_sensor(count=count), pairs, PLACES[:1], contrast=0.3)
        text = SKIN_TOML.replace("count = 16", f"count = {count}") + f'[pattern]\ndrive = "{own_pattern}"\n'
        (pressed[2] / "odd.toml").write_text(text)
        with pytest.raises(qa.CbsrError):
            qa.analyse(loaded, sensor_type="./odd.toml")
        rest = unloaded * (1 + 1e-6 * np.random.default_rng(3).standard_normal((8, len(unloaded))))
        (event,) = qa.analyse(loaded, pattern=pairs, rest=rest, sensor_type="./odd.toml").result.events
        assert np.hypot(event.x_mm - PLACES[0, 0], event.y_mm - PLACES[0, 1]) < 8
        assert qa.image(loaded, rest, pattern=pairs, sensor_type="./odd.toml").values.shape[0] == 1


def test_each_row_gives_an_image(pressed):
    rows, rest, folder = pressed
    sensor_type = folder / "skin.toml"
    images = qa.image(rows, rest, pattern=PAIRS, sensor_type=sensor_type)
    assert images.values.shape[0] == 2
    for values, place in zip(images.values, PLACES, strict=True):
        assert np.hypot(*(images.mesh.centroids_mm[np.argmax(values)] - place)) < 8
    changes = qa.image(rows - rest.mean(axis=0), pattern=PAIRS, sensor_type=sensor_type, differences=True)
    np.testing.assert_array_equal(np.argmax(changes.values, axis=1), np.argmax(images.values, axis=1))
    assert "unknown scale" in changes.result.warnings[0]
    again = qa.image(
        folder / "frames.csv", folder / "rest.csv", pattern=folder / "pairs.csv", sensor_type=sensor_type
    )
    np.testing.assert_allclose(again.values, images.values)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"frames": np.ones((2, 3))}, r"frames of the shape \(2, 3\), the pattern has 40 pairs"),
        ({"frames": 1j * np.ones((2, 40))}, "frames are complex numbers"),
        ({"frames": np.full((2, 40), np.nan)}, "row 1, column 1: nan, not a finite number"),
        ({"pattern": PAIRS + 1}, "electrodes are numbered from 1 to 8"),
        ({"pattern": PAIRS[:, :3]}, r"a pattern of the shape \(40, 3\)"),
        ({"pattern": np.vstack([PAIRS[:39], PAIRS[3]])}, "row 40 repeats row 4"),
        ({"differences": True}, "both differences and a reference"),
        ({"reference": None}, "neither differences nor a reference"),
        ({"complex_part": "phase"}, "complex_part 'phase' is not known"),
        ({"pattern": None, "complex_part": "real"}, "complex_part without a pattern"),
    ],
)
def test_refusals_name_what_is_wrong(pressed, change, why):
    rows, rest, folder = pressed
    given = {"frames": rows, "reference": rest, "pattern": PAIRS, "sensor_type": folder / "skin.toml", **change}
    with pytest.raises(qa.CbsrError, match=why):
        qa.image(given.pop("frames"), given.pop("reference"), **given)


def test_frames_in_another_unit_are_named(pressed):
    rows, rest, folder = pressed
    given = {"pattern": PAIRS, "sensor_type": str(folder / "skin.toml")}
    with pytest.raises(qa.CbsrError, match="its readings are 1000 times as large as those of"):
        qa.image(1000 * np.repeat(rest, 3, axis=0), rest, **given)
    odd = np.vstack([rest, rest[:1] * 1000])
    with pytest.raises(qa.CbsrError, match="row 9: its readings are 1000 times as large as those of the other rows"):
        qa.analyse(odd, rest=rest, **given)
    frames, unloaded = (np.zeros((len(block), 8, 8)) for block in (rows, rest))
    for block, values in ((frames, rows), (unloaded, rest)):
        block[:, PAIRS[:, 0], PAIRS[:, 2]] = values
    frames[1] *= 1000
    with pytest.raises(qa.CbsrError, match=r"frame 1 \(from 0\) is \d+ times as large .* another unit"):
        qa.image(frames, unloaded, sensor_type=folder / "skin.toml")


def test_parts_of_complex_tables_are_named_options(pressed, monkeypatch, capsys):
    _, _, folder = pressed
    monkeypatch.chdir(folder)
    options = ["--pattern", "pairs.csv", "--sensor-type", "skin.toml", "--no-report", "--json"]
    assert run_guarded(["analyse", "complex.csv", *options, "--rest", "rest.csv", "--complex-part", "real"]) == 0
    assert json.loads(capsys.readouterr().out)["recording"]["notes"][1] == "complex readings: their real parts"
    assert run_guarded(["analyse", "complex.csv", *options]) == 2
    assert "a complex number" in json.loads(capsys.readouterr().out)["refused"]["reason"]
    assert run_guarded(["analyse", "complex.csv", "--complex-part", "real", "--json"]) == 2
