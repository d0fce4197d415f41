"""``cbsr-qa compare`` as a command: the document it prints, the page it writes, and their sentences."""

import json

import numpy as np
from compared_fleets import BATCH_MM, ERROR, STATION_MM, compared, metric, moved
from stored_lots import judged, measured, store_run

from cbsr_qa.cli.main import run_guarded
from cbsr_qa.report.tables import number
from cbsr_qa.store.opening import open_store


def test_the_command_prints_one_document_and_writes_a_page(two, tmp_path, capsys):
    page = tmp_path / "page.html"
    arguments = ["compare", "--by", "batch", "--database", two, "--metric", ERROR, "--margin", f"{ERROR}=2"]
    assert run_guarded([*arguments, "--json", "--output", str(page)]) == 0
    printed = capsys.readouterr()
    document = json.loads(printed.out)
    assert document["by"] == "batch"
    assert [(g["name"], g["n"], g["yield"]) for g in document["groups"]] == [("41", 12, 1.0), ("42", 12, 1.0)]
    assert [m["equivalent"] for m in document["metrics"]] == [True]
    assert len(document["metrics"][0]["places"]) == 9
    assert str(page) in printed.err
    html = page.read_text()
    assert "42 − 41: alike within a margin?" in html
    assert "Where on the sheet" in html
    assert html.count("<svg") >= 1
    assert run_guarded(arguments) == 0
    said = capsys.readouterr().out
    assert "42 − 41" in said
    assert max(map(len, said.splitlines())) <= 110


def test_a_word_that_is_no_way_to_compare_is_refused(capsys):
    assert run_guarded(["compare", "--by", "bach"]) == 2
    assert "did you mean 'batch'? allowed: batch, material, station, software, period" in capsys.readouterr().err


def test_the_headline_says_how_much_better_or_worse_a_group_reads_and_which_ones_are_not_shown_to_differ(two):
    random = np.random.default_rng(4)
    with open_store(two, durable=False) as store:
        for place in range(8):
            sensor = random.standard_normal(3)
            for station, mm in (("A", BATCH_MM), ("B", BATCH_MM + STATION_MM)):
                values = judged(moved(measured(random, sensor), mm))
                store_run(store, f"T-{place}", values, batch="43", station=station)
    made = compared(two, groups=("42", "41", "43"))
    found = metric(made, group="41")
    size, low, high = (number(-found[key], 2) for key in ("difference", "high", "low"))
    of_groups, of_stations = made.result.headline.split(". ")
    reads = f"Batch 41 reads {size} mm ({low} to {high}) better than 42 in centre of mass error at the same stations"
    assert of_groups.split("; ") == [reads, "43: no difference from 42 shown"]
    assert of_stations.startswith("Station B reads ")
    assert of_stations.endswith(" higher than A in centre of mass error in the same batches.")
