"""The page on comparing batches: what it names is there, and a sample of its simulation agrees with its table."""

import importlib
import importlib.util
import re
import sys
from math import sqrt
from pathlib import Path

import pytest

TOP = Path(__file__).parents[2]
PAGE = (TOP / "docs" / "explanation" / "comparing-batches.md").read_text(encoding="utf-8")
SEEDS = 150


@pytest.fixture(scope="module")
def benchmark():
    path = TOP / "benchmarks" / "batch_coverage.py"
    spec = importlib.util.spec_from_file_location("batch_coverage", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def test_every_module_it_names_is_there():
    rows = re.findall(r"^\| [^|]+\((`[\w.]+`(?:, `[\w.]+`)*)\) \|", PAGE, re.M)
    names = [name for row in rows for name in re.findall(r"`([\w.]+)`", row)]
    assert len(names) >= 13
    for name in names:
        importlib.import_module(f"cbsr_qa.stats.{name}")


@pytest.mark.rest
@pytest.mark.parametrize("design", ["each sensor on one station", "a third on all stations"])
def test_its_table_is_what_is_measured(benchmark, design):
    counted = benchmark.counted(benchmark.design(benchmark.DESIGNS[design]), SEEDS)
    for method, found in counted.items():
        row = re.search(rf"^\| {design} \| {method} \| ([\d.]+) % \| ([\d.]+) % \| ([\d.]+) % \|$", PAGE, re.M)
        for value, printed in zip(found, map(float, row.groups()), strict=True):
            share = min(max(printed / 100, 0.01), 0.99)
            assert value == pytest.approx(printed, abs=100 * 3.5 * sqrt(share * (1 - share) * (1 / SEEDS + 1 / 1000)))
