"""The page of a certificate: what it states, how texts enter it, and that it prints on two sides."""

import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser

import pytest
from certificates import HOSTILE, certificate, checked_load, expanded_force, largest_certificate, settings

from cbsr_qa.domain.results.certificate import Customer, LeftOutLoad, Replacement
from cbsr_qa.domain.results.expanded_force import GAIN_DRIFT, MonteCarlo
from cbsr_qa.report.certificate import choose_loads, format_with_uncertainty, render_certificate
from cbsr_qa.report.certificate_texts import (
    describe_checked,
    describe_rule,
    describe_traceability,
    describe_use,
    list_remarks,
    name_place,
    state_conformity,
)

_CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")


class _Text(HTMLParser):
    """Text and tags of a page, as a browser reads them."""

    def __init__(self, page):
        super().__init__()
        self.words, self.tags = [], []
        self.feed(page)

    def handle_data(self, data):
        self.words.append(data)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)


def text_of(page):
    return " ".join(" ".join(_Text(page).words).split())


def test_the_page_states_what_a_certificate_must():
    one = certificate()
    text = text_of(render_certificate(one, "9df4-03dd"))
    for stated in (
        "Calibration certificate",
        "Soft Sensor Works Werkstraße 5, 38116 Braunschweig, DE",
        "S-1",
        "Robots plc",
        "Hall 3, line 1, at the laboratory",
        "Date of calibration 2026-11-21",
        "Date of issue 2026-11-22",
        "Validity valid until 2027-11-21",
        f"Recipe short SHA-256 of the recipe {64 * 'd'}",
        f"{one.calibration} SHA-256 of its content {64 * 'c'}",
        "22.4 °C to 23.1 °C",
        "load cell U = 0.2 % (k = 2), certificate K-7 of D-K-1, due 2027-03-31, range not stated,"
        " resolution not stated, drift not stated",
        "indenter not stated",
        "The results relate only to the item named above",
        "may be reproduced only in full",
        "signed electronically (Ed25519) beside it, by the key 9df4-03dd",
        "Ada Otani, head of the laboratory",
    ):
        assert stated in text, stated
    assert text.count(f"Certificate {one.number}") == 2
    assert "page 1 of 2" in text
    assert text.endswith("End of the certificate · page 2 of 2")


def test_what_was_not_stated_is_said_to_be_not_stated():
    bare = certificate(customer=Customer(), temperature_C=None, standards=(), valid_until=None)
    text = text_of(render_certificate(bare, ""))
    for stated in (
        "Customer not stated",
        "Temperature not measured",
        "U is that of the day of calibration, at its temperature, which was not measured.",
        "load cell not stated",
        "Validity not stated",
    ):
        assert stated in text, stated
    assert "not signed electronically" in text
    assert "no traceability of force to the SI is claimed" in text


def test_without_a_certificate_of_the_load_cell_no_conformity_is_stated_of_a_real_sensor():
    """U lacks what the load cell is off by, so that nothing can be decided; a simulated one is not off."""
    why = "No statement of conformity is made: the certificate of the load cell is not stated"
    real = certificate(standards=())
    assert state_conformity(real).startswith(why)
    assert (real.is_judged, describe_rule(real)) == (False, "")
    simulated = replace(real, identity=replace(real.identity, simulated=("bench: seed 7",)))
    assert state_conformity(simulated) == state_conformity(certificate())


def test_the_first_remark_says_what_was_simulated():
    assert list_remarks(certificate())[0] == "Nothing was simulated."
    simulated = certificate(identity=replace(certificate().identity, simulated=("bench: seed 7", "the sheet")))
    assert list_remarks(simulated)[0] == "Simulated: bench: seed 7; the sheet."
    assert describe_traceability(simulated) == "The calibration was simulated: no traceability to the SI is claimed."
    page = render_certificate(simulated, "")
    assert "<ul>\n<li>Simulated: bench: seed 7; the sheet.</li>" in page
    assert "Simulated: no physical sensor was calibrated." in page
    assert "Simulated" not in render_certificate(certificate(), "")


def test_inputs_that_nothing_states_are_named():
    forces = (expanded_force(not_stated=["drift of the load cell"]), expanded_force())
    in_use = (expanded_force(not_stated=["drift of the load cell", "temperature"]), expanded_force())
    errors = (checked_load(not_stated=["scatter of the load cell"]),)
    text = text_of(render_certificate(certificate(forces=forces, forces_in_use=in_use, checked=errors), ""))
    results, _, checked = text.partition("Results: errors at loads")
    assert "U without: drift of the load cell; in use also without: temperature." in results
    assert "U is that of the error, without: scatter of the load cell ." in checked
    alike = certificate(forces=forces, forces_in_use=in_use, checked=(checked_load(not_stated=forces[0].not_stated),))
    assert "U is that of the error, without: the same inputs ." in text_of(render_certificate(alike, ""))


def test_both_uncertainties_of_a_force_are_told_apart():
    forces, drifting = (expanded_force(u_N=0.05),), (expanded_force(u_N=0.07, name=GAIN_DRIFT),)
    page = render_certificate(certificate(forces=forces, forces_in_use=drifting), "")
    assert '<td class="first">0.10</td><td>2.07</td><td>23</td><td>0.14</td><td>2.07</td>' in page
    assert (
        "U in use is that of a later force, until 2027-11-21, with a drift of the readings' gains over 1 year."
        in (text_of(page))
    )
    assert "drift of the readings" not in render_certificate(certificate(), "")


def test_without_a_drift_of_gains_u_in_use_names_no_day_until_which_it_holds():
    said = describe_use(certificate(forces_in_use=(expanded_force(not_stated=[GAIN_DRIFT]),)))
    assert "until when is unknown: no drift of gains is stated" in said
    assert "2027" not in said


def test_no_load_that_was_held_out_disappears():
    outside = [LeftOutLoad("random loads", (30.0, -1.0), "", 5.2, told_N) for told_N in (4.9, 5.3, None)]
    silent = LeftOutLoad("random loads", (0.0, 0.0), "no force was recorded")
    said = describe_checked(certificate(left_out=(*outside, silent)))
    assert said == (
        "2 of 6 held-out loads are checked; 3 lie outside the range, which ends at loads that calibrated or agreed:"
        " largest error −0.3 N at 5.2 N, (30.0, −1.0) mm; of 1 of these the calibration tells no force; of 1 there is"
        " no error: no force was recorded."
    )
    assert said in text_of(render_certificate(certificate(left_out=(*outside, silent)), ""))
    assert "1 lies outside the range" in describe_checked(certificate(left_out=outside[:1]))
    assert describe_checked(certificate()) == "2 of 2 held-out loads are checked."


def test_an_interval_by_random_numbers_says_why_it_was_made():
    wide = replace(expanded_force(), monte_carlo=MonteCarlo(1000, 1.7, 2.3, "x is rectangular"))
    bent = replace(expanded_force(), monte_carlo=MonteCarlo(1000, 1.9, 2.1, "it bends"))
    assert (wide.U_N, wide.k) == pytest.approx((0.3, 6.0))  # of u = 0.05 N
    assert (bent.U_N, bent.k) == pytest.approx((0.10345, 2.069))
    made = certificate(forces=(wide, wide), forces_in_use=(bent, bent))
    (remark,) = [one for one in list_remarks(made) if "JCGM 101" in one]
    assert "where x is rectangular (2 values of U); where it bends (2 values of U): " in remark
    assert remark.endswith("where half of their 95 % interval exceeds k u, it is U (at most 2.90 k u), and k is U/u.")
    (narrow,) = [one for one in list_remarks(certificate(forces=(bent, bent))) if "JCGM 101" in one]
    assert narrow.endswith("nowhere does half of their 95 % interval exceed k u.")


def test_deviations_are_remarks_as_far_as_they_fit_and_the_others_are_counted():
    usual = list_remarks(certificate())
    few = list_remarks(
        certificate(deviations=("gate, disk: 1 GB free; overridden by Zoë: so", "2\x07readings jumped"))
    )
    assert [one for one in few if one not in usual] == [
        "Gate, disk: 1 GB free; overridden by Zoë: so.",
        "2 readings jumped.",
    ]
    many = list_remarks(certificate(deviations=(*(f"{n}{'x' * 359}" for n in range(5)), "short")))
    *whole, counted = [one for one in many if one not in usual]
    assert [one[:1] for one in whole] == ["0", "1", "S"]
    assert counted.endswith(": 3.")
    short = list_remarks(certificate(deviations=tuple(map(str, range(99)))))
    assert [one for one in short if one not in usual][8:] == [counted.replace(": 3.", ": 91.")]


def test_names_with_markup_are_text():
    page = render_certificate(certificate(customer=Customer(HOSTILE, HOSTILE)), "")
    plain = _Text(render_certificate(certificate(), ""))
    assert _Text(page).tags == plain.tags
    assert "".join(_Text(page).words).count(HOSTILE) == 2


def test_a_page_holds_no_script_and_loads_nothing():
    page = render_certificate(certificate(), "")
    assert not re.search(r"<script|https?://|url\(|@import|<img|<link", page)


def test_a_replacement_names_the_certificate_before_it_and_the_reason():
    text = text_of(render_certificate(certificate(replaced=Replacement("SSW-1", "name <corrected>", 64 * "e")), ""))
    assert (
        "This certificate replaces certificate SSW-1, which is no longer valid. Reason of the replacement:"
        " name <corrected>" in text
    )


@pytest.mark.parametrize(
    ("value", "expanded", "shown"),
    [
        (1.23456, 0.0914, ("1.235", "0.091")),
        (1.23456, 0.104, ("1.23", "0.10")),
        (-0.004, 0.11, ("0.00", "0.11")),
        (1.23, 0.0996, ("1.23", "0.10")),
        (123.4, 9.96, ("123", "10")),
        (1234.5, 123.4, ("1230", "120")),
        (12.3456, 1.26, ("12.3", "1.3")),
        (1234.5, 57.0, ("1234", "57")),
    ],
)
def test_values_end_at_the_second_digit_of_their_uncertainty(value, expanded, shown):
    """JCGM 100, 7.2.6."""
    assert format_with_uncertainty(value, expanded) == shown


def test_conformity_is_stated_with_its_risk():
    one = certificate()
    assert state_conformity(one).startswith(
        "The indicated force conforms with the maximum permissible error: of 2 checked loads, 2 conform."
        " Largest specific risk of false acceptance by the inputs that are stated, with nothing known before:"
    )
    assert "T = 0.2 N + 5 % of the force" in describe_rule(one)
    assert "w = U (JCGM 106:2012, 8.3)" in describe_rule(one)


@pytest.mark.parametrize(
    ("errors", "outcome", "said"),
    [
        (
            (0.0, 0.25),
            "conditionalPass",
            "is not decided: of 2 checked loads, 1 conforms, 1 within the limit by less than U (not decided)",
        ),
        (
            (0.0, 0.35),
            "conditionalFail",
            "is not decided: of 2 checked loads, 1 conforms, 1 beyond the limit by less than U (not decided)",
        ),
        (
            (0.0, 0.9),
            "fail",
            "does not conform with the maximum permissible error: of 2 checked loads, 1 conforms, 1 does not conform",
        ),
    ],
)
def test_the_worst_load_decides(errors, outcome, said):
    judged = certificate(checked=tuple(map(checked_load, errors)))
    assert judged.outcome == outcome
    assert said in state_conformity(judged)


def test_nothing_is_stated_without_a_requirement_or_a_load():
    stated = settings(max_error_N=0.0, max_error_percent=0.0, decision="")
    none = certificate(settings=stated, checked=(checked_load(stated=stated),))
    assert none.outcome == ""
    assert "no maximum permissible error was stated" in state_conformity(none)
    assert "learned from" in state_conformity(certificate(checked=()))
    text = text_of(render_certificate(none, ""))
    assert "decision" not in text.partition("Conformity")[0].partition("Results: errors")[2]


def test_simple_acceptance_is_named():
    assert "Simple acceptance" in describe_rule(certificate(settings=settings(decision="simple")))


def test_the_loads_nearest_to_their_limit_are_listed_in_order():
    loads = [checked_load(0.01 * n, 2.0) for n in range(20)]
    assert choose_loads(loads) == loads[12:]


@pytest.fixture(scope="module")
def browser():
    """A real browser; skips, saying so, without one."""
    if _CHROMIUM is None:
        pytest.skip("chromium is not installed")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=_CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        yield launched
        launched.close()


#: Lowest edge of what a side shows, its footer left out, and the footer's upper edge, of each side [pixels].
_EDGES = """sides => sides.map(side => [
    Math.max(...[...side.querySelectorAll(":scope > :not(footer)")].map(one => one.getBoundingClientRect().bottom)),
    side.querySelector("footer").getBoundingClientRect().top,
])"""


#: Texts of fields that reach beyond the block of the authorisation.
_BEYOND = """fields => fields
    .filter(one => one.getBoundingClientRect().right > one.parentElement.getBoundingClientRect().right + 0.5)
    .map(one => one.textContent)"""


def certify_at_a_long_address():
    """Return a certificate whose head and authorisation have the longest texts, without blanks; the rest is usual."""
    long = {"post_code": 80 * "8", "city": 80 * "C", "email": f"{68 * 'e'}@example.org", "signatory": 80 * "S"}
    prefix = 24 * "W"
    return certificate(
        settings=settings(prefix=prefix, **long),
        number=f"{prefix}-01989c3e-6d1f-7a42-b6d0-0e6f5a1f2c3d-R1",
        replaced=Replacement(f"{prefix}-01989c3e-6d1f-7a42-b6d0-0e6f5a1f2c3d", "name", 64 * "e"),
        customer=Customer(20 * "Robot ", 20 * "Ring 1"),
    )


@pytest.mark.rest
@pytest.mark.parametrize("made", [certificate, largest_certificate, certify_at_a_long_address])
def test_a_certificate_prints_on_two_sides_and_nothing_overlaps(browser, made):
    page = browser.new_page()
    page.emulate_media(media="print")
    page.set_content(render_certificate(made(), "9df4-03dd-2b1e-5067-452b-0447-c326-7d0e"))
    edges = page.eval_on_selector_all(".side", _EDGES)
    assert len(edges) == 2
    for lowest, footer in edges:
        assert lowest <= footer
    assert page.eval_on_selector_all(".sign div", _BEYOND) == []
    assert len(re.findall(rb"/Type\s*/Page\b", page.pdf(prefer_css_page_size=True))) == 2
    page.close()


def test_no_place_has_a_negative_zero():
    assert name_place((-0.0, -0.04)) == "(0.0, 0.0)"
    assert name_place((-12.5, 0.04)) == "(−12.5, 0.0)"
