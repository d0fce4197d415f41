"""How precise the load estimate is, against the Cramér–Rao bound; the trials are in :mod:`benchmarks.load_trials`."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from scipy.stats import binom, norm

from benchmarks.load_bound import load_bound
from benchmarks.load_trials import (
    AGAIN,
    BORDER_D,
    BORDER_SHARE,
    CONTRASTS,
    DECIBELS,
    PLACES,
    REFUSALS,
    TRIALS,
    Cell,
    Judged,
    Score,
    all_cells,
    deviation,
    estimator_of,
    judge,
    truth,
)
from benchmarks.rows import Row
from benchmarks.timing import fastest, shown
from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.eit.estimate.load_estimate import LEAST_DETECTABILITY
from cbsr_qa.eit.estimate.readings import load_model
from cbsr_qa.eit.loads.round_load import RoundLoads

TITLE = "Load estimate"
_PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "load-estimate.md"


def rows() -> Iterator[Row]:
    judged = [judge(cell) for cell in all_cells()]
    _PAGE.write_text(_page(judged))
    grid = f"γ +3 to +50 %, 40 to 80 dB, {len(PLACES)} places from 0 to 40 mm"
    known = [one for one in judged if one.cell.known]
    free = [one for one in judged if not one.cell.known and one.cell.diameter_mm == 13]
    yield _row(f"load estimate, 13 mm indenter given: place and contrast; {grid}", known, ("place", "amplitude"))
    yield _row(f"the same with the size unknown: place and area × contrast; {grid}", free, ("place", "amplitude"))
    for diameter_mm in (8.0, 13.0, 20.0):
        of_size = [one for one in judged if not one.cell.known and one.cell.diameter_mm == diameter_mm]
        yield _row(
            f"diameter of a {diameter_mm:g} mm target, wherever its bound is under a third", of_size, ("diameter",)
        )
    others = [one for one in judged if not one.cell.known and one.cell.diameter_mm != 13]
    yield _row(
        "place and area × contrast of 8 and 20 mm targets, their size expected but not given",
        others,
        ("place", "amplitude"),
    )
    yield _refusals(judged)
    yield _contacts()
    yield from (_bounds(), _nine_sites(), _time())


def _row(what: str, cells: list[Judged], names: tuple[str, ...]) -> Row:
    chosen = [(one, name, one.scores[name]) for one in cells for name in names if name in one.scores]
    scores = [score for *_, score in chosen]
    missed = [(one, name) for one, name, score in chosen if not score.met]
    share = [one.with_radius if name == "diameter" else one.answered for one, name, _ in chosen]
    here = (
        f"{len({id(one) for one, *_ in chosen})} of {len(cells)} cells: {_said(scores)};"
        f" answered in {100 * min(share):.0f} to 100 % of trials, {100 * float(np.mean(share)):.1f} % on average"
    )
    if missed:
        here += "; outside: " + ", ".join(f"{_named(one.cell)} ({name})" for one, name in missed)
    return Row(what, "spread ≤ 1.2 × bound, bias ≤ 0.3, 68 % regions cover 64–72 %", here, met=not missed)


def _said(scores: Iterable[Score]) -> str:
    spread, bias, cover = (
        np.array(values) for values in zip(*((s.spread, s.bias, s.cover) for s in scores), strict=True)
    )
    return (
        f"spread {spread.min():.2f} to {spread.max():.2f} × bound, bias ≤ {bias.max():.2f},"
        f" coverage {100 * cover.min():.1f} to {100 * cover.max():.1f} %"
    )


def _named(cell: Cell) -> str:
    given = "given" if cell.known else "unknown"
    away, direction = cell.place
    what = f"{cell.diameter_mm:g} mm {given}, +{100 * cell.contrast:g} %, {cell.decibels} dB"
    return f"{what}, {away:g} mm at {direction:g}°"


def _refusals(judged: list[Judged]) -> Row:
    """Where no answer is expected there must be none, except by chance.

    The d′ of a frame scatters by one about the load's, so that a load of 5.6 passes a rule at 8 in one frame of 120.
    More than that, in a one-sided binomial test at one in a thousand, is a fault. Cells at the border are apart.
    """
    rest = [one for one in judged if not one.asked and not one.border]
    border = [one for one in judged if one.border]
    some = [one for one in rest if one.answered > 0]
    wrong = [one for one in some if not _by_chance(one)]
    said = ", ".join(f"{100 * one.answered:.1f} % at d′ {one.bound.detectability:.1f}" for one in some)
    here = (
        f"{len(rest)} cells: {len(rest) - len(some)} refused in all of {REFUSALS} trials; of {AGAIN} answered"
        f" {said or 'none'}; {len(border)} at the border (d′ {BORDER_D:g} to 10, place within {BORDER_SHARE:g} × the"
        f" limit) answered in {100 * min(b.answered for b in border):.0f} to"
        f" {100 * max(b.answered for b in border):.0f} %,"
        f" {100 * float(np.mean([b.answered for b in border])):.0f} % on average"
    )
    return Row(
        "everywhere else",
        "“not detected” or “not resolvable”, but where d′, which scatters by one, passes by chance",
        here,
        met=not wrong,
    )


def _by_chance(one: Judged) -> bool:
    """Whether so many answers of 2000 trials are what a d′ that scatters by one lets through."""
    share = float(norm.sf(LEAST_DETECTABILITY - one.bound.detectability))
    return float(binom.sf(round(one.answered * AGAIN) - 1, AGAIN, share)) > 1e-3


def _contacts() -> Row:
    """Contacts are not estimated: what wrong ones do, without noise, and from what noise on that matters."""
    said = []
    for contact_mm in (0.1, 0.3, 2.0):
        place, contrast, worst_dB = 0.0, 0.0, 200.0
        for where in PLACES:
            estimator, readings = estimator_of(13.0, True, 60)
            centre = Cell(13.0, True, 0.5, 60, where).centre_mm
            signal = truth(13.0, where, contact_mm)[0.5][readings.used]
            found = estimator.fit(signal[None]).fits.parameters[0]
            off = float(np.hypot(found[0] - centre[0], found[1] - centre[1]))
            bound = load_bound(
                estimator.model, readings, x_mm=centre[0], y_mm=centre[1], radius_mm=6.5, contrast=0.5, known=True
            )
            strength = found[2] / found[3]
            place, contrast = max(place, off), max(contrast, abs(2 * strength / (1 - strength) / 0.5 - 1))
            worst_dB = min(worst_dB, 60 + 20 * float(np.log10(0.3 * bound.place_mm / off)))
        said.append(f"{contact_mm:g} mm: {1e3 * place:.0f} µm, {100 * contrast:.2f} %, from {worst_dB:.0f} dB on")
    return Row(
        "contacts other than the nominal 0.5 mm, which the estimate takes for granted: largest error of place and of"
        " contrast at +50 % without noise, and the noise from which the place's is over 0.3 of its bound somewhere",
        "",
        "; ".join(said),
    )


def _bounds() -> Row:
    """γ +18 %, 60 dB, one frame, everything unknown."""
    found = []
    readings = estimator_of(13.0, False, 60)[1]
    model = load_model(load_sensor_type("disc-100mm").value)
    for x_mm in (0.0, 21.0, 30.0):
        found.append(load_bound(model, readings, x_mm=x_mm, y_mm=0, radius_mm=6.5, contrast=0.18, known=False))
    place, radius, area = (
        " / ".join(form.format(value) for value in values)
        for form, values in (
            ("{:.3f}", [f.place_mm for f in found]),
            ("{:.2f}", [f.radius_stderr_mm for f in found]),
            ("{:.1f}", [100 * f.plain_area_contrast for f in found]),
        )
    )
    return Row(
        "Cramér–Rao bound at 0 / 21 / 30 mm, γ +18 %, 60 dB, all unknown",
        "0.25 / 0.17 / 0.12 mm, radius 1.8 / 1.0 / 0.6 mm, area × contrast 3.2 / 2.1 / 1.2 %",
        f"{place} mm, radius {radius} mm, area × contrast {area} % (with the load on a mesh of linear elements it is"
        " 3.3 % at the centre for 1.5 mm, 2.9 % for 2.5 mm)",
        "another forward model's",
    )


def _nine_sites() -> Row:
    """γ +50 %, 60 dB per channel, by the readings."""
    estimator, readings = estimator_of(13.0, True, 60)
    errors = []
    for number, (x_mm, y_mm) in enumerate(NINE_LOCATIONS_MM):
        away, direction = float(np.hypot(x_mm, y_mm)), float(np.rad2deg(np.arctan2(y_mm, x_mm)))
        signal = truth(13.0, (away, direction))[0.5][readings.used]
        noise = np.random.default_rng([60, number]).standard_normal((TRIALS, signal.size))
        found = estimator.fit(signal + noise * deviation(60)[readings.used]).fits.parameters
        errors.append(float(np.hypot(found[:, 0] - x_mm, found[:, 1] - y_mm).mean()))
    return Row(
        "nine sites, γ +50 %, 60 dB per channel: error of the estimate",
        "(E_CoM of images: ≤ 0.15 mm)",
        f"mean {np.mean(errors):.3f} mm, worst site {max(errors):.3f} mm",
        "JAC 0.26, GREIT 0.25 mm, tuned on truth (published with the references)",
    )


def _time() -> Row:
    """One frame, from changes to estimates, ready estimator; and many at once."""
    estimators = [estimator_of(13.0, known, 60)[0] for known in (True, False)]
    model = estimators[0].model
    load = RoundLoads.from_contrast(np.array([[12.0, -17.0]]), np.array([6.5]), np.array([0.18]))
    changes = model.readings(load).change[:, estimators[0].readings.used]
    many = np.repeat(changes, 256, axis=0)
    one, batch = (
        [fastest(lambda e=e, c=c: e.estimate(c), repeats) for e in estimators]
        for c, repeats in ((changes, 20), (many, 20))
    )
    here = f"{shown(one[0])} indenter given, {shown(one[1])} size unknown; of 256 at once {shown(batch[0] / 256)} and"
    return Row("estimate of one load", "", f"{here} {shown(batch[1] / 256)} each")


def _page(judged: list[Judged]) -> str:
    lines = [_PAGE_HEAD]
    for diameter_mm, known in dict.fromkeys((one.cell.diameter_mm, one.cell.known) for one in judged):
        lines.append(f"\n## {diameter_mm:g} mm, {'indenter given' if known else 'size unknown'}\n\n{_PAGE_COLUMNS}")
        for contrast in CONTRASTS:
            for decibels in DECIBELS:
                kind = (diameter_mm, known, contrast, decibels)
                cells = [
                    o for o in judged if (o.cell.diameter_mm, o.cell.known, o.cell.contrast, o.cell.decibels) == kind
                ]
                lines.append(_line(contrast, decibels, cells))
    return "".join(lines)


def _line(contrast: float, decibels: int, cells: list[Judged]) -> str:
    asked = [one for one in cells if one.asked]
    seen = [one.bound.detectability for one in cells]
    parts = [
        f"+{100 * contrast:g} %",
        f"{decibels}",
        f"{min(seen):.0f}–{max(seen):.0f}",
        f"{len(asked)} of {len(cells)}",
    ]
    others = [one.answered for one in cells if not one.asked]
    parts.append(f"{100 * np.mean(others):.0f} %" if others else "–")
    for name in ("place", "amplitude", "diameter"):
        scores = [one.scores[name] for one in asked if name in one.scores]
        cover = [100 * s.cover for s in scores]
        parts.append(
            f"{len(scores)}: {max(s.spread for s in scores):.2f}, {max(s.bias for s in scores):.2f},"
            f" {min(cover):.0f}–{max(cover):.0f}"
            if scores
            else "–"
        )
    return "| " + " | ".join(parts) + " |\n"


_PAGE_HEAD = f"""# The load estimate against its bound

This page compares the errors of the load estimate with their theoretical bound. `python -m benchmarks
load_estimate` writes it; [load estimate](../explanation/load-estimate.md) explains what is estimated and how.

A cell is a contrast, a noise and a place (0, 21 mm in two directions, 30 mm in two, 40 mm towards a pin and between
two; 36 mm for 20 mm targets, which would cover a pin at 40 mm). Its truth is a second-order finite-element model on
a mesh that follows the load; the estimator sums multipoles. Both use the nominal contacts; a row of
[performance](performance.md) shows the effect of others. If the size is unknown, the expected size still starts the
fit and decides when an answer is required: where d′ ≥ 10 and the bound of the place is at most a third of the radius
(for the diameter: where its own bound is at most a third). The noise is independent, a share 10^(−dB/20) of each
reading. {TRIALS} frames are estimated in a cell that requires an answer. If its coverage is then outside 64–72 %,
{AGAIN} new frames are estimated, and only these count (with {TRIALS} frames, one cell in twenty would be outside by
chance). In other cells, {REFUSALS} frames show that there is no answer ({AGAIN} if one of them got an answer); "else"
is the share that got one, mostly where d′ is 7 to 10.

Place, amplitude (contrast if the indenter is given, else area × contrast) and diameter: number of cells, largest
spread and bias over the bound, and coverage of the 68 % regions in per cent, from the lowest to the highest cell.
"""
_PAGE_COLUMNS = (
    "| γ | dB | d′ | asked | else | place | amplitude | diameter |\n"
    "| --- | --- | --- | --- | --- | --- | --- | --- |\n"
)
