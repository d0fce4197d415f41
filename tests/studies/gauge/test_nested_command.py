"""``gauge --nested`` on stored runs: sensors or batches that only one appraiser measured."""

from functools import partial

import numpy as np
import pytest
from filled_databases import filled
from test_gauge_command import LIMIT, measured

from cbsr_qa.stats.gauge.nested import nested_anova, nested_study

STATIONS = ("bench-a", "bench-b", "bench-c")


def runs(seed=5):
    """(serial, batch, station, day, values) of 4 batches a station, of 3 sensors that are tested once each."""
    random = np.random.default_rng(seed)
    for number, station in enumerate(STATIONS):
        for of_station in range(4):
            batch, of_batch = f"{10 * number + of_station}", random.normal()
            for sensor in range(3):
                mean = 10 + 0.2 * number + 0.5 * of_batch + 0.1 * random.standard_normal()
                yield f"S-{batch}-{sensor}", batch, station, sensor, (mean - 0.2, mean + 0.2)


def fill(path, rows):
    lots = [
        (serial, measured(values), {"recipe": "short", "station": station, "day": day, "batch": batch})
        for serial, batch, station, day, values in rows
    ]
    filled(path, lots)


@pytest.fixture(scope="module")
def nested(tmp_path_factory):
    fill(path := tmp_path_factory.mktemp("nested") / "runs.db", runs())
    return path


@pytest.fixture
def command(run_command):
    return partial(run_command, "gauge", "--database")


@pytest.fixture
def refused(refusal):
    return partial(refusal, "gauge", "--database")


@pytest.fixture
def document(printed):
    return partial(printed, "gauge", "--database")


def test_sensors_of_a_batch_stand_for_repeated_runs(nested, document):
    made = document(nested, "--recipe", "short", "--nested", "batch")
    (metric,) = made["metrics"]
    rows = list(runs())
    values = [float(np.mean(row[4])) for row in rows]
    truth = nested_anova(nested_study([row[1] for row in rows], [row[2] for row in rows], values), tolerance=4.0)
    assert LIMIT.upper - LIMIT.lower == 4.0
    for name in ("repeatability", "reproducibility", "gauge", "sensor", "total"):
        part, found = getattr(truth.components, name), metric["anova"]["components"][name]
        assert found["variance"] == pytest.approx(part.variance, rel=1e-9)
        assert found["percent_tolerance"] == pytest.approx(part.percent_tolerance, rel=1e-9)
    assert (made["nested"], metric["trials"], len(metric["sensors"]), metric["average_range"]) == (
        "batch",
        3,
        12,
        None,
    )
    assert [row["source"] for row in metric["anova"]["table"]] == ["station", "batch (station)", "repeated runs"]
    # Sensors of a batch were drawn with a deviation of 0.1, batches with 0.5.
    assert 0.07 < metric["anova"]["components"]["repeatability"]["deviation"] < 0.14


def test_the_page_says_that_the_study_is_nested(nested, command, tmp_path):
    page = tmp_path / "page.html"
    command(nested, "--recipe", "short", "--nested", "batch", "--output", str(page))
    html = page.read_text()
    for words in ("The study is nested: each station", "A batch counts as one part", "Nested analysis of variance"):
        assert words in html
    assert "by ranges" not in html
    assert html.count("<svg") == 1


def test_a_study_that_is_not_nested_is_named(tmp_path, refused):
    rows = list(runs())
    moved = [(s, "0" if batch == "10" else batch, *rest) for s, batch, *rest in rows]
    fill(tmp_path / "moved.db", moved)
    said = refused(tmp_path / "moved.db", "--recipe", "short", "--nested", "batch")
    assert "batch 0 was run on bench-a and bench-b" in said
    fill(tmp_path / "short.db", rows[1:])
    said = refused(tmp_path / "short.db", "--recipe", "short", "--nested", "batch")
    assert "batch 0 on bench-a has 2 runs instead of 3" in said
    assert "a nested study needs two stations" in said


def test_runs_of_one_a_sensor_and_other_words_are_refused(nested, refused):
    said = refused(nested, "--recipe", "short", "--nested", "sensor")
    assert "1 run of a sensor instead of at least 2" in said
    assert "allowed: sensor, batch" in refused(nested, "--recipe", "short", "--nested", "lot")
    said = refused(nested, "--recipe", "short", "--nested", "batch", "--largest-balanced")
    assert "--largest-balanced is for crossed studies" in said


def test_a_file_describes_a_nested_study(nested, document, tmp_path):
    study = tmp_path / "nested.toml"
    study.write_text('[study]\nname = "destructive"\nrecipe = "short"\nnested = "batch"\n')
    assert document(nested, str(study))["metrics"][0]["trials"] == 3
