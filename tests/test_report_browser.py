"""The page in a real browser, from disk: what is drawn when something is pressed."""

from __future__ import annotations

import os
import re
import shutil
from io import BytesIO
from itertools import pairwise

import campaigns
import numpy as np
import pytest
from matplotlib.image import imread
from reported import NASTY, compared

from ekfslam.experiments import run_campaign
from ekfslam.report import write_report

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed")

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
CHROMIUM = next(filter(None, map(shutil.which, NAMES)), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason=f"there is no {', '.join(NAMES)} here")

DESKTOP, PHONE = {"width": 1200, "height": 900}, {"width": 360, "height": 740}


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Addresses of the page of a comparison and of a campaign, by name."""
    place = tmp_path_factory.mktemp("pages")
    compared().save(place / "comparison", figures=False)
    source = campaigns.SMALL | {"estimators": ["ekf", "dead-reckoning"], "name": NASTY}
    run_campaign(source | {"seeds": 7}, place / "campaign")
    return {name: write_report(place / name).as_uri() for name in ("comparison", "campaign")}


@pytest.fixture(scope="module")
def browser():
    root = hasattr(os, "geteuid") and os.geteuid() == 0
    with playwright.sync_playwright() as engine:
        launched = engine.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox"] if root else []
        )
        yield launched
        launched.close()


@pytest.fixture
def shown(browser, pages):
    """Open a page; in the end there must have been no word on the console and no request."""
    said, asked, contexts = [], [], []

    def show(name="comparison", **settings):
        context = browser.new_context(**({"viewport": DESKTOP} | settings))
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(10_000)
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("dialog", lambda dialog: said.append(dialog.message))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(pages[name])
        return page

    yield show
    for context in contexts:
        context.close()
    assert said == []
    assert set(asked) <= set(pages.values())
    assert len(asked) == len(contexts)


def outline(page, selector):
    """What paths draw."""
    return page.eval_on_selector_all(selector, "nodes => nodes.map(n => n.getAttribute('d'))")


def column(page, table, number):
    return page.eval_on_selector_all(
        f"{table} tbody tr", f"rows => rows.map(row => row.cells[{number}].textContent)"
    )


def set_slider(page, value):
    slider = page.locator("#map-0 input[type=range]")
    slider.evaluate(
        "(s, value) => { s.value = value; s.dispatchEvent(new Event('input')); }", value
    )
    return slider


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", ["comparison", "campaign"])
def test_nobody_is_shut_out(shown, name, scheme):
    page = shown(name, color_scheme=scheme)
    page.evaluate("for (const part of document.querySelectorAll('details')) part.open = true")
    found = axe.Axe().run(page).response["violations"]
    assert [(each["id"], each["nodes"][0]["html"]) for each in found] == []


@pytest.mark.parametrize("name", ["comparison", "campaign"])
def test_captions_are_read_without_moving_their_tables(shown, name):
    page = shown(name, viewport=PHONE)
    for place in page.query_selector_all(".scroll:has(.sorts)"):
        for left in (0, 500):
            place.evaluate(f"node => node.scrollLeft = {left}")
            box = place.query_selector("caption span").bounding_box()
            assert 0 <= box["x"] < box["x"] + box["width"] <= PHONE["width"]


@pytest.mark.parametrize("name", ["comparison", "campaign"])
@pytest.mark.parametrize("viewport", [PHONE, DESKTOP], ids=["phone", "desktop"])
def test_the_page_is_no_wider_than_its_window(shown, name, viewport):
    page = shown(name, viewport=viewport)
    page.evaluate("for (const part of document.querySelectorAll('details')) part.open = true")
    assert page.evaluate("document.documentElement.scrollWidth") == viewport["width"]
    assert (
        page.evaluate(
            "[...document.querySelectorAll('main *')]"
            ".filter(n => !n.closest('.scroll, .stage'))"
            ".filter(n => n.getBoundingClientRect().right > innerWidth + 1)"
            ".map(n => n.outerHTML.slice(0, 99))"
        )
        == []
    )


def test_the_slider_steps_through_time(shown):
    page = shown()
    path, ellipse = "#map-0 .travelled[data-series]", "#map-0 .ellipse"
    whole = outline(page, path)
    slider = set_slider(page, 10)
    assert "Step 10 of 60" in page.inner_text("#map-0 .readout")
    assert slider.get_attribute("aria-valuetext").startswith("step 10 of 60")
    tenth = outline(page, path)
    for part, all_of_it in zip(tenth, whole, strict=True):
        assert all_of_it.startswith(part)
        assert part.count("L") == 10
        assert all_of_it.count("L") == 60
    first = outline(page, ellipse)
    assert any(first)
    slider.focus()
    page.keyboard.press("ArrowRight")
    assert "Step 11 of 60" in page.inner_text("#map-0 .readout")
    assert outline(page, ellipse) != first
    page.keyboard.press("Home")
    assert [part.count("L") for part in outline(page, path)] == [0] * len(whole)
    page.keyboard.press("End")
    assert outline(page, path) == whole


def picture(page, selector="#map-0 .stage"):
    """Pixels of a part of a page, (height, width, 3)."""
    return imread(BytesIO(page.locator(selector).first.screenshot()))[..., :3]


def changed(before, after):
    """How many pixels are plainly different."""
    return int((np.abs(before - after).max(axis=-1) > 0.2).sum())


def test_layers_can_be_switched(shown):
    """Each box changes what is seen, and what it says and draws comes back."""
    page = shown()
    set_slider(page, 30)
    boxes = page.locator("#map-0 fieldset input")
    labels = page.eval_on_selector_all(
        "#map-0 fieldset label", "all => all.map(n => n.textContent)"
    )
    assert labels[-5:] == ["truth", "landmarks", "landmark ellipses", "pose ellipses", "sightings"]
    before, text = picture(page), page.inner_text("#map-0 .readout")
    for number, label in enumerate(labels):
        box = boxes.nth(number)
        box.click()
        assert changed(before, picture(page)) > 5, label
        assert (page.inner_text("#map-0 .readout") != text) == (
            "line)" in label or "thed)" in label
        )
        box.click()
    assert changed(before, picture(page)) == 0


def test_an_estimator_that_is_switched_off_is_not_drawn(shown):
    page = shown()
    page.get_by_label("ekf (online)", exact=True).first.focus()
    page.keyboard.press("Space")
    of_it = page.locator('#map-0 [data-series="0"]')
    assert of_it.count() > 4
    assert [of_it.nth(i).is_visible() for i in range(of_it.count())] == [False] * of_it.count()
    assert page.locator('#map-0 .travelled[data-series="1"]').is_visible()
    assert "ekf" not in page.inner_text("#map-0 .readout")


@pytest.mark.parametrize("motion", ["no-preference", "reduce"])
def test_playing_respects_who_wants_less_motion(shown, motion):
    page = shown(reduced_motion=motion)
    page.clock.install(time=0)
    page.clock.pause_at(1000)
    play = page.locator("#map-0").get_by_role("button", name="Play")
    play.click()
    values = []
    for _ in range(10):
        page.clock.run_for(100)
        values.append(int(page.locator("#map-0 input[type=range]").input_value()))
    # Two steps of the run in that time, or one of ten still pictures.
    assert values == ([0] * 9 + [6] if motion == "reduce" else [*range(2, 22, 2)])
    page.locator("#map-0").get_by_role("button", name="Pause").click()
    page.clock.run_for(5000)
    assert int(page.locator("#map-0 input[type=range]").input_value()) == values[-1]
    play.click()
    page.clock.run_for(20_000)
    assert page.locator("#map-0 input[type=range]").input_value() == "60"
    assert play.inner_text() == "Play"


def view(page):
    return [float(x) for x in page.get_attribute("#map-0 .stage svg", "viewBox").split()]


def test_the_map_can_be_looked_at_closely(shown):
    page = shown()
    whole = view(page)
    page.get_by_role("button", name="Zoom in").first.click()
    near = view(page)
    assert near[2] == pytest.approx(whole[2] / 2)
    page.locator("#map-0 .stage").focus()
    page.keyboard.press("ArrowRight")
    moved = view(page)
    assert moved[0] > near[0]
    assert moved[1:] == pytest.approx(near[1:])
    page.get_by_label("Follow").first.check()
    set_slider(page, 20)
    x, y = re.findall(r"translate\((\S+) (\S+)\)", page.get_attribute("#map-0 .pose", "transform"))[
        0
    ]
    left, top, width, height = view(page)
    assert (left + width / 2, top + height / 2) == pytest.approx((float(x), float(y)))
    page.get_by_role("button", name="Whole map").first.click()
    assert view(page) == pytest.approx(whole)


def test_tables_sort_by_pointer_and_keyboard(shown):
    page = shown()
    table = "#tables ~ .scroll table >> nth=0"
    rows = page.locator(table)
    heading = rows.locator("th", has_text="ATE [m]")
    at = heading.evaluate("cell => cell.cellIndex")

    def values():
        return rows.evaluate(
            f"t => [...t.tBodies[0].rows].map(row => row.cells[{at}].dataset.value)"
        )

    before = values()
    known = sorted((v for v in before if v), key=float)
    missing = [v for v in before if not v]
    assert missing
    assert before != known + missing
    assert heading.get_attribute("aria-sort") is None
    heading.get_by_role("button").click()
    assert (values(), heading.get_attribute("aria-sort")) == (known + missing, "ascending")
    page.keyboard.press("Enter")
    assert (values(), heading.get_attribute("aria-sort")) == (known[::-1] + missing, "descending")
    other = rows.locator("th", has_text="estimator")
    other.get_by_role("button").focus()
    page.keyboard.press("Space")
    assert heading.get_attribute("aria-sort") is None
    assert other.get_attribute("aria-sort") == "ascending"
    names = rows.evaluate("t => [...t.tBodies[0].rows].map(row => row.cells[0].textContent)")
    assert names[1:] == sorted(names[1:])
    assert not values()[0]  # whose name is not of letters has no number, which stays last
    heading.get_by_role("button").click()
    assert values() == known + missing


def test_everything_is_reached_by_the_keyboard(shown):
    """Every control has focus at some time, which is seen, and the first is a way past the rest."""
    page = shown()
    wanted = page.evaluate(
        "[...document.querySelectorAll('a, button, input, summary, [tabindex=\"0\"]')]"
        ".filter(n => n.checkVisibility()).length"
    )
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "Skip to the content"
    reached, unseen = 1, []
    while reached < wanted:
        page.keyboard.press("Tab")
        style = page.evaluate(
            "(n => [n.tagName, getComputedStyle(n).outlineStyle])(document.activeElement)"
        )
        assert style[0] != "BODY"
        unseen += [style] if style[1] == "none" else []
        reached += 1
    assert unseen == []


def test_in_print_everything_is_open_and_nothing_moves(shown):
    page = shown(color_scheme="dark")
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor")
    page.emulate_media(media="print")
    assert dark == "rgb(22, 24, 29)"
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    parts = page.locator("details").count()
    playwright.expect(page.locator("details[open]")).to_have_count(parts)
    assert not page.locator("nav, .controls, #map-0 input").locator("visible=true").count()
    assert page.locator("#map-0 .stage").is_visible()
    assert page.evaluate("document.documentElement.scrollWidth") <= DESKTOP["width"]
    page.emulate_media(media="screen")
    playwright.expect(page.locator("details[open]")).to_have_count(0)


def test_headings_are_in_order(shown):
    for name in ("comparison", "campaign"):
        levels = shown(name).eval_on_selector_all(
            "h1, h2, h3, h4", "all => all.map(heading => Number(heading.tagName[1]))"
        )
        assert levels[0] == 1
        assert levels.count(1) == 1
        assert all(below - above <= 1 for above, below in pairwise(levels))


@pytest.mark.parametrize(
    ("scheme", "viewport"), [("light", DESKTOP), ("dark", DESKTOP), ("light", PHONE)]
)
def test_pictures_are_not_blank(shown, scheme, viewport):
    """There is ink on the page, on the map and on a figure, and dark is dark."""
    page = shown(color_scheme=scheme, viewport=viewport)
    for selector in ("body", "#map-0 .stage", "figure svg"):
        seen = picture(page, selector)
        assert (seen.mean() < 0.5) == (scheme == "dark"), selector
        assert seen.std() > 0.02, selector


def test_without_scripts_the_words_and_tables_are_there(shown):
    page = shown(java_script_enabled=False)
    assert "switched off" in page.inner_text("#maps ~ noscript")
    assert page.locator("table").first.is_visible()
