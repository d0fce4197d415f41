"""Figures in the text of the documentation are those the code computes today; ``make soak`` does the costly ones."""

import re

import numpy as np
import pytest
from force_samples import setting
from pages import TOP, marked_tables
from strip_samples import models

from cbsr_qa.eit.inverse.readings import reading_noise
from cbsr_qa.stats.intervals import count_needed, one_sided_factor
from cbsr_qa.stats.worst_value import worst_of
from cbsr_qa.studies.frontier.computer import forward as computer_forward
from cbsr_qa.studies.frontier.sensors import station_seconds
from cbsr_qa.studies.frontier.setting import Setting
from cbsr_qa.studies.frontier.station import EVEN, PAPER
from cbsr_qa.studies.hard_cases.stability import examine_cases

EXPLAINED = TOP / "docs" / "explanation"
COSTS = (TOP / "docs" / "reference" / "frontier.md").read_text(encoding="utf-8")


def said(page, pattern):
    """Numbers that a sentence of a page states, wherever its lines end."""
    found = re.search(pattern, " ".join((EXPLAINED / page).read_text(encoding="utf-8").split()))
    assert found, pattern
    return [float(number) for number in found.groups()]


def test_the_factors_of_limits():
    factors = said("limits.md", r"the factor on s is ([\d.]+) on one side with ten sensors, ([\d.]+) with thirty,")
    assert factors == [round(one_sided_factor(0.99, 0.95, count, count - 1), 2) for count in (10, 30)]
    beyond = said("limits.md", r"of nine, the 99 % point lies ([\d.]+) deviations above the mean, not (\d\.\d+)")
    assert beyond == [round(worst_of(values).quantile(0.99), 2) for values in (9, 1)]
    needed = said("limits.md", r"From (\d+) sensors on \((\d+) for two bounds\)")
    assert needed == [count_needed(0.99, 0.95, sides) for sides in (1, 2)]


@pytest.mark.parametrize(("order", "size"), [("1", "6"), ("2", "12")])
def test_the_errors_of_coarse_voltages(monkeypatch, order, size):
    monkeypatch.setattr(computer_forward, "fastest_s", lambda run, repeats=1: 1e-3)  # times are of one machine
    rows = marked_tables(COSTS)["forward-model, pins"]
    (row,) = (row for row in rows if (row["order"], row["size [mm]"]) == (order, size))
    point = computer_forward.measure_forward("pin", int(order), float(size))
    assert row["voltage error"] == f"{point.accuracy['voltage_error'].value:.1e}"
    assert row["error of a load's signal"] == f"{point.accuracy['load_signal_error'].value:.1e}"
    assert row["unknowns"] == f"{point.costs['unknowns']:.0f}"
    assert row["memory"] == f"{point.costs['memory_bytes'] / 1e6:.1f} MB"


@pytest.mark.parametrize(
    ("table", "key", "setting"),
    [
        ("strains and trials", {"strains": "6", "trials": "3"}, PAPER),
        ("hold", {"hold [s]": "60"}, EVEN),
        ("places", {"places": "16"}, Setting(16, hold_s=15.0, rest_s=5.0, predicted=True)),
        ("places", {"places": "26"}, Setting(26, hold_s=15.0, rest_s=5.0, predicted=True)),
        ("rest", {"rest [s]": "30"}, Setting(16, hold_s=15.0, rest_s=30.0, predicted=True)),
    ],
)
def test_the_minutes_of_the_station(table, key, setting):
    (row,) = (row for row in marked_tables(COSTS)[table] if key.items() <= row.items())
    assert row["time"] == f"{station_seconds(setting) / 60:.1f} min"


def test_what_the_shipped_strip_shows_of_its_material():
    page, (strip, more_contact) = "characterisation.md", models()
    (share,) = said(page, r"a small change under the head shows as ([\d.]+) % of itself between the pins")
    assert share == round(100 * strip.share)
    contacts = said(page, r"\(([\d.]+) ± ([\d.]+) % of the resistance between the pins\)")
    assert contacts[0] == round(100 * strip.contact_squares / strip.squares)
    assert contacts[1] == round(100 * (more_contact.contact_squares - strip.contact_squares) / strip.squares)


def test_what_variances_of_few_frames_cost_unless_they_are_shrunk():
    """Of equal readings, by weights of estimated variances over the least there is; of 9 frames the tail is long."""
    stated = said("metrics.md", r"(\d+) % more from 20 frames and (\d+) % more from 9\.")
    (shrunk,) = said("metrics.md", r"Of equal readings, that costs ([\d.]+) % from 20 frames")
    assert stated == [round(100 * ((n - 4) / (n - 6) - 1)) for n in (20, 9)]
    own, both = [], []
    for seed in range(60):
        frames, time_s = np.random.default_rng(seed).standard_normal((20, 208)), 2.5 * np.arange(20)
        residuals = np.polynomial.polynomial.polyfit(time_s, frames, 1, full=True)[1][0]
        own.append(_excess(1 / residuals))
        both.append(_excess(1 / reading_noise(frames, time_s).variance))
    assert stated[0] == pytest.approx(100 * np.mean(own), abs=1.5)
    assert shrunk == pytest.approx(100 * np.mean(both), abs=0.06)


def test_what_the_contrast_of_a_head_does_to_its_readings():
    """Readings over strength, 2κ/(2 + κ), against those of a vanishing contrast, all round the sheet."""
    change = [100 * _nonlinear(radius_mm, 0.3) for radius_mm in (36.0, 40.0)]
    stated = said(
        "force.md", r"change by ([\d.]+) % from a vanishing κ to κ = 0.3 at 36 mm .*? and by ([\d.]+) % at 40 mm"
    )
    assert stated == [round(one, 1) for one in change]
    stated = said("greit.md", r"they differ by (\d) % up to 30 mm from the centre and by (\d) % at 40 mm")
    assert stated == [round(100 * _nonlinear(radius_mm, 0.5)) for radius_mm in (30.0, 40.0)]


def _nonlinear(radius_mm, contrast):
    """Largest relative difference of readings over strength at so many places of one radius."""
    angle = np.linspace(0.1, 2 * np.pi + 0.1, 16, endpoint=False)
    places = radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    pressed, least = (setting().rows(places, np.full(16, one)) * (2 + one) / (2 * one) for one in (contrast, 1e-4))
    return (np.linalg.norm(pressed - least, axis=1) / np.linalg.norm(least, axis=1)).max()


_POWER = re.compile(r"(\d+(?:\.\d+)?)(?: × 10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+))?")
_RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


@pytest.mark.rest
def test_the_hard_cases_of_the_page_are_as_hard_as_it_says():
    """Errors are rounding: they stay below what the condition number allows, here and on the page."""
    page = (EXPLAINED / "numerical-stability.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| [^|]+ \| `([\w-]+)` \| ([^|]+) \| ([^|]+) \|", page, re.M)
    assert len(rows) == 12
    cheap = [row for row in rows if not row[0].startswith("smooth-image")]
    examined = examine_cases(names=[name for name, _, _ in cheap], processes=1)
    found = {result.name: result for result in examined.cases}
    for name, condition, error in cheap:
        assert _power(condition) == pytest.approx(found[name].condition, rel=0.05), name
        assert max(_power(error), found[name].error) < found[name].bound, name


def _power(text):
    """A number as pages print it, 4.2 × 10⁵."""
    digits, exponent = _POWER.fullmatch(text).groups()
    return float(f"{digits}e{(exponent or '0').translate(_RAISED)}")


def _excess(weights):
    """Variance that a weighted mean of equal readings has beyond that of a plain one, as a share of it."""
    return len(weights) * (weights**2).sum() / weights.sum() ** 2 - 1


_TRIALS = re.compile(
    r"^\| ([\d.]+) frames/s: .*? \| (\d+) frames: bias ([-+][\d.]+) %, total ([\d.]+) % \(bound ([\d.]+) %\),"
    r" coverage ([\d.]+) and ([\d.]+) %.*? uncompensated: bias ([-+][\d.]+) %, total ([\d.]+) %",
    re.M,
)


def test_the_trials_of_compensation_are_those_of_the_page_on_performance():
    """What the page on compensation shows of the trials is what the page on performance prints."""
    benchmarked = (TOP / "docs" / "reference" / "performance.md").read_text(encoding="utf-8")
    section = benchmarked.partition("## Transient compensation")[2].partition("\n## ")[0]
    trials = [
        [float(number) for number in row] for row in _TRIALS.findall(section) if "readings of runs" not in row[0]
    ]
    page = (EXPLAINED / "transient-compensation.md").read_text(encoding="utf-8").replace("−", "-")
    rows = [line.split("|")[2:-1] for line in page.splitlines() if re.match(r"\| .+ \| (2.5|0.25) \| \d+ \|", line)]
    stated = [[float(number) for cell in row for number in cell.split("/")] for row in rows]
    assert (len(stated), len(trials)) == (12, 27)  # the page shows some of them, in fewer digits
    for period_s, frames, *figures in stated:
        same = [trial for trial in trials if (trial[0], trial[1]) == (1 / period_s, frames)]
        assert any(_rounded(trial, figures) for trial in same), (period_s, frames, figures)


def _rounded(trial, stated):
    """Whether figures (uncompensated, then predicted) are those of a trial, in fewer digits."""
    _, _, bias, total, bound, narrow, wide, uncompensated, its_total = trial
    shown = (uncompensated, its_total, bias, total, bound)
    close = all(abs(one - other) < 0.0501 for one, other in zip(stated[:5], shown, strict=True))
    return close and all(abs(one - other) < 0.501 for one, other in zip(stated[5:], (narrow, wide), strict=True))
