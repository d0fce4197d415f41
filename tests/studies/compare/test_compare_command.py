"""``cbsr-qa compare`` as a command: the document it prints, the page it writes, and their sentences."""

import json

import numpy as np
from compared_fleets import BATCH_MM, ERROR, STATION_MM, compared, metric, moved
from stored_lots import LIMITS, judged, measured, store_run

from cbsr_qa.cli import guarded
from cbsr_qa.store import open_store
from cbsr_qa.studies.compare.page import write_page
from cbsr_qa.studies.compare.wording import headline, sentences


def test_the_command_prints_one_document_and_writes_a_page(two, tmp_path, capsys):
    page = tmp_path / "page.html"
    arguments = ["compare", "--by", "batch", "--database", two, "--metric", ERROR, "--margin", f"{ERROR}=2"]
    assert guarded([*arguments, "--json", "--output", str(page)]) == 0
    printed = capsys.readouterr()
    document = json.loads(printed.out)
    assert document["by"] == "batch"
    assert [(g["name"], g["n"], g["yield"]) for g in document["groups"]] == [("41", 12, 1.0), ("42", 12, 1.0)]
    assert [m["equivalent"] for m in document["metrics"]] == [True]
    assert len(document["metrics"][0]["places"]) == 9
    assert str(page) in printed.err
    html = page.read_text()
    assert "42 and 41 are alike within ± 2.00 mm" in html
    assert html.count("<svg") >= 1
    assert guarded(arguments) == 0
    said = capsys.readouterr().out
    assert "42 − 41" in said
    assert max(map(len, said.splitlines())) <= 100


def test_a_word_that_is_no_way_to_compare_is_refused(capsys):
    assert guarded(["compare", "--by", "bach"]) == 2
    assert "did you mean 'batch'? allowed: batch, material, station, software, period" in capsys.readouterr().err


def test_a_page_says_where_on_the_sheet_groups_differ(two, tmp_path):
    made = compared(two, names=(ERROR,))
    write_page(made.found, tmp_path / "page.html")
    html = (tmp_path / "page.html").read_text()
    assert "Where on the sheet" in html
    assert "station B reads" in html
    assert LIMITS[ERROR].upper == 6.5
    assert "Cpk" in html


def test_sentences_say_on_which_side_and_which_pairs_are_not_shown_to_differ(two):
    random = np.random.default_rng(4)
    with open_store(two, durable=False) as store:
        for number in range(8):
            sensor = random.standard_normal(3)
            for station, mm in (("A", BATCH_MM), ("B", BATCH_MM + STATION_MM)):
                values = judged(moved(measured(random, sensor), mm))
                store_run(store, f"T-{number}", values, batch="43", station=station)
    made = compared(two, groups=("42", "41", "43"))
    found = metric(made, group="41")
    said = sentences(made.found)
    low, high = (f"{-found[end]:.3f}" for end in ("high", "low"))
    assert said[0].startswith(f"{ERROR} (nine locations): 41 lies {-found['difference']:.3f} mm ({low} to {high} mm)")
    assert " below 42, " in said[0]
    assert any(f"Not shown to differ: {ERROR} (nine locations) of 43 − 42, drift, noise_floor." in s for s in said)
    assert headline(made.found) == "42, 41 and 43 differ in 1 of 3 metrics"
