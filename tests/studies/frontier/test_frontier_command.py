"""``frontier`` on trials made by hand: targets, messages, the document, the recipe file, the page and the picture."""

from functools import partial

import pytest

from cbsr_qa.cli.main import run_guarded
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.studies.frontier import study as app
from cbsr_qa.studies.frontier.point import Accuracy, Point, TimeBasis
from cbsr_qa.studies.frontier.report import describe_common_knobs, list_notes
from cbsr_qa.studies.frontier.setting import FARTHEST, Setting
from cbsr_qa.studies.frontier.station import PAPER, Tried
from cbsr_qa.studies.sweep import Work

SHORT = Setting(12, hold_s=15.0, rest_s=5.0, predicted=True)
CHOSEN = Setting(9, rest_s=5.0, choice=FARTHEST)  # no recipe chooses as it goes
FORCES = {PAPER: (0.10, 0.11), SHORT: (0.12, 0.119), Setting(30): (0.08, 0.08), CHOSEN: (0.01, 0.01)}


def trials():
    return [
        Tried("made up", setting, seed, {"force_error": force, "map_error": force / 10})
        for setting, forces in FORCES.items()
        for seed, force in enumerate(forces)
    ]


def new(setting):
    """Trials of a chosen setting on three new sensors."""
    return [Tried("new sensors", setting, seed, {"force_error": FORCES[setting][0]}) for seed in (7, 8, 9)]


def measured():
    return Point(TimeBasis.COMPUTER, "images", {"size_mm": 3.0}, {"E_CoM": Accuracy(0.5, 0.1, "mm")}, 1e-3, None, 3)


@pytest.fixture
def sweeps(monkeypatch, tmp_path):
    """Replace both sweeps by one piece each; return how often they were worked out."""
    worked = []
    station = Work("all", "all of it", lambda: worked.append("station") or trials())
    computer = Work("images", "images", lambda: worked.append("computer") or [measured()])
    monkeypatch.setattr(app, "plan_station_work", lambda quick: [station])
    monkeypatch.setattr(
        app, "plan_confirming_work", lambda setting: [Work(f"new {setting}", "new", partial(new, setting))]
    )
    monkeypatch.setattr(app, "plan_computer_work", lambda quick: [computer])
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))
    return worked


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--clock", "x"), ["--clock is 'x'", "give one of station, computer, both"]),
        (("--budget", "20"), ["--budget is '20'", "with its unit", "20min"]),
        (("--budget", "-20min"), ["--budget is '-20min'"]),
        (("--budget", "0 h"), ["--budget is '0 h'", "above 0"]),
        (("--budget", "20 days"), ["--budget is '20 days'"]),
        (("--force-error", "0.5"), ["--force-error is '0.5'", "with its unit", "0.5N"]),
        (("--force-error", "0N"), ["above 0"]),
        (("--force-error", "1 kg"), ["--force-error is '1 kg'"]),
    ],
)
def test_what_is_misspelt_is_refused_before_anything_is_simulated(sweeps, refusal, arguments, said):
    message = refusal("frontier", *arguments)
    assert all(words in message for words in said), message
    assert sweeps == []


@pytest.mark.parametrize(
    ("arguments", "places"),
    [
        ((), 12),
        (("--budget", "2h"), 30),
        (("--budget", "120 min"), 30),
        (("--budget", "1500s"), 12),
        (("--force-error", "0.2N"), 12),
        (("--force-error", "90mN"), 30),
    ],
)
def test_targets_are_understood(sweeps, printed, arguments, places):
    assert printed("frontier", "--clock", "station", *arguments)["recommended"]["setting"]["places"] == places


def test_the_document_has_every_point_and_what_is_recommended(sweeps, printed):
    document = printed("frontier")
    assert [point["clock"] for point in document["points"]] == ["station"] * len(FORCES) + ["computer"]
    assert all(isinstance(point["pareto"], bool) for point in document["points"])
    recommended = document["recommended"]
    assert recommended["setting"]["transients"] == "predicted"
    assert recommended["station_s"] <= 25 * 60
    assert "times that of the paper's campaign" in recommended["why"]
    assert recommended["recipe"] is None


def test_what_is_finished_is_not_done_again_unless_asked(sweeps, capsys):
    assert run_guarded(["frontier"]) == run_guarded(["frontier", "--force-error", "0.2N"]) == 0
    assert sweeps == ["station", "computer"]
    assert run_guarded(["frontier", "--clock", "station", "--fresh"]) == 0
    assert sweeps == ["station", "computer", "station"]
    assert "12 places at 25 % strain, 1 time, held 15 s" in capsys.readouterr().out


def test_a_target_that_nothing_meets_is_no_recommendation(sweeps, printed, refusal, tmp_path):
    recommended = printed("frontier", "--clock", "station", "--force-error", "1mN")["recommended"]
    assert recommended["setting"] is None
    assert "no setting of 3" in recommended["why"]  # the one that is no recipe is none of them
    recipe = tmp_path / "nothing.toml"
    assert "there is no recipe to write" in refusal("frontier", "--force-error", "1mN", "--recipe", recipe)
    assert not recipe.exists()


def test_from_one_sensor_nothing_is_recommended_and_a_setting_is_named_to_look_at(
    sweeps, monkeypatch, printed, capsys
):
    one_sensor = [trial for trial in trials() if trial.seed == 0]
    monkeypatch.setattr(app, "plan_station_work", lambda quick: [Work("one", "one", lambda: one_sensor)])
    assert run_guarded(["frontier", "--clock", "station", "--quick"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "No setting recommended from one sensor: the only setting within 25 min that was tried" in shown
    assert "setting to look at 12 places" in shown
    assert "One simulated sensor: others may differ." in shown
    assert "±" not in shown
    recommended = printed("frontier", "--clock", "station", "--quick", "--force-error", "0.2N")["recommended"]
    assert recommended["setting"] is None
    assert "one simulated sensor does not show how sensors scatter" in recommended["why"]


def test_the_recipe_is_one_that_run_accepts(sweeps, printed, capsys, tmp_path):
    path = tmp_path / "new folder" / "short.toml"
    assert printed("frontier", "--clock", "station", "--recipe", path)["recommended"]["recipe"] == str(path)
    recipe = load_recipe(str(path)).value
    assert (recipe.name, recipe.analysis.transients) == ("short", "predicted")
    assert "Simulated: mean force error of 3 sensors 0.120 ± 0.000 N, 22 min" in path.read_text()
    asked = ["run", "--station", "simulated", "--recipe", str(path), "--serial", "S-1", "--dry-run"]
    assert run_guarded(asked) == 0
    assert "station time" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--output", "{}"), "{} is a folder"),
        (("--recipe", "{}/short"), "{}/short"),
        (("--recipe", "{}/notes.toml"), "{}/notes.toml"),
        (("--recipe", "{}/notes.toml/r.toml"), "{}/notes.toml"),
        (("--recipe", "{}/new.toml", "--clock", "computer"), "--recipe: there is no recipe to write"),
        (("--output", "{}/notes.toml/page.html"), "{}/notes.toml"),
        (("--output", "{}/one.png", "--png", "{}/one.png"), "--output, --png name the same file"),
        (("--png", "{}/notes.toml/plot.png"), "{}/notes.toml"),
        (("--png", "{}/plot.bmp"), "{}/plot.bmp"),
        (("--png", "{}"), "{}"),
        (("--png", "{}/no.png", "--clock", "computer"), "--png: there is no force error to draw"),
    ],
)
def test_files_are_refused_before_anything_is_simulated(sweeps, refusal, tmp_path, arguments, named):
    (tmp_path / "notes.toml").write_text("# mine\n")
    assert named.format(tmp_path) in refusal("frontier", *(text.format(tmp_path) for text in arguments))
    assert sweeps == []
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("notes.toml", "# mine\n")]


def test_a_recipe_that_was_written_here_is_written_over_and_it_is_said(sweeps, capsys, tmp_path):
    path = tmp_path / "short.toml"
    asked = ["frontier", "--clock", "station", "--recipe", str(path)]
    assert run_guarded(asked) == 0
    assert "in place of" not in capsys.readouterr().err
    assert run_guarded([*asked, "--budget", "2h"]) == 0
    assert f"{path}, in place of the one that was there" in capsys.readouterr().err
    assert "within 120 min" in path.read_text()


def test_one_table_alone_has_nothing_else_to_be_told_from(sweeps, capsys):
    assert run_guarded(["frontier", "--clock", "station"]) == 0
    shown = capsys.readouterr().out
    assert "hold [s]" in shown  # which differs
    assert "Alike in all" not in shown  # there is no other table


def test_knobs_that_one_row_hides_are_those_that_other_tables_set_otherwise():
    def point(series, **knobs):
        return Point(TimeBasis.STATION, series, knobs, {}, None, 60.0, 1)

    rest = [point("rest", places=16, hold_s=15.0, frames=4)]
    hold = [point("hold", places=16, hold_s=60.0, frames=4), point("hold", places=16, hold_s=15.0, frames=4)]
    assert describe_common_knobs(rest, [*rest, *hold]) == "hold 15 s"
    assert describe_common_knobs(hold, [*rest, *hold]) == ""


def test_notes_name_the_row_they_are_on():
    def point(size, note, method="a"):
        knobs = {"method": method, "size_mm": size}
        return Point(TimeBasis.COMPUTER, "mesh", knobs, {}, 1.0, None, 1, note)

    assert list_notes([point(6, "527 elements"), point(3, "2025 elements"), point(2, "")]) == [
        "size 6 mm: 527 elements",
        "size 3 mm: 2025 elements",
    ]
    assert list_notes([point(6, "208 readings"), point(3, "208 readings")]) == ["208 readings"]


def test_kept_pieces_of_somebody_else_are_refused_by_name(sweeps, capsys, tmp_path):
    kept = tmp_path / "var" / "frontier" / "station.jsonl"
    kept.parent.mkdir(parents=True)
    kept.write_text("notes\n")
    assert run_guarded(["frontier", "--clock", "station"]) != 0
    message = capsys.readouterr().err
    assert str(kept) in message
    assert "--fresh" in message
    assert sweeps == []
    assert run_guarded(["frontier", "--clock", "station", "--fresh"]) == 0


def test_page_and_picture_are_written(sweeps, capsys, tmp_path):
    page, picture = tmp_path / "page.html", tmp_path / "plot.png"
    assert run_guarded(["frontier", "--output", str(page), "--png", str(picture)]) == 0
    text = page.read_text()
    assert "What accuracy costs in time" in text
    assert "E_CoM is the distance" in text
    assert "made up" in text
    assert f"Settings of the station</dt><dd><bdi>{len(FORCES)}<" in text
    assert "Settings of the computer</dt><dd><bdi>1<" in text
    assert "<svg" in text
    assert picture.read_bytes().startswith(b"\x89PNG")
