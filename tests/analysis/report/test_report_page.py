"""The report in a browser: a point of the scatter leads to its trial, filters filter, and nothing is loaded."""

import base64
import io
import re
from dataclasses import replace

import matplotlib.image
import pytest

from mrtask.analysis.page import exhibits
from mrtask.analysis.report.report_page import render_report, write_report
from mrtask.execution.trace import Leg, Trace
from tests.analysis.synthetic import make_episodes
from tests.browser import opened, started_browser

EVIL = '</script><script>alert(1)</script><img src=x onerror="alert(2)">'


@pytest.fixture(scope="module")
def browser():
    with started_browser() as started:
        yield started


@pytest.fixture(scope="module")
def page_path(two_room_home, tmp_path_factory):
    home = replace(
        two_room_home, containers=tuple(replace(container, type=EVIL) for container in two_room_home.containers)
    )
    trace = Trace((2.0, 1.0), ((Leg("move", 0, 1, None, None, ((2, 1), (1, 1))),),), ()).to_json()
    planners = ["nonlearned_myopic", "learned_myopic", "pouct"]
    frame = make_episodes(3, planners, ["small", "large"], [1, 2]).assign(home_id=home.id, trace=trace, template=EVIL)
    path = tmp_path_factory.mktemp("report") / "index.html"
    with pytest.MonkeyPatch.context() as patch:
        # Drawing takes most of a report's time and is tested elsewhere.
        patch.setattr(exhibits, "svg_bytes", lambda figure: b"<svg xmlns='http://www.w3.org/2000/svg'/>")
        write_report(render_report(frame, {"output_dir": "outputs/x"}, {home.id: home}), path)
    return path


def test_a_point_leads_to_its_trial(browser, page_path):
    with opened(browser, page_path, images=True) as page:
        page.locator(".filters").wait_for()
        dots = page.locator(".dots circle")
        assert dots.count() == 12
        point = dots.nth(5)
        trial_id = point.locator("title").text_content().split(":")[0]
        point.dispatch_event("click")
        panel = page.locator(".trial")
        assert panel.locator("h3").inner_text() == trial_id
        assert panel.locator("code").first.inner_text() == "F Mug & F Book"
        assert panel.locator(".command").inner_text() == (
            f"python -m pipeline.replay trial_id={trial_id} output_dir=outputs/x"
        )
        assert panel.locator(".small-map polyline:not(.door)").count() == 2, "the planner's path and the baseline's"
        assert panel.locator(".small-map title").first.text_content() == EVIL
        assert panel.locator("tr th").all_inner_texts() == ["nonlearned_myopic", "learned_myopic", "pouct"]
        assert panel.locator(".small-map").first.locator(".door").count() == 1


def test_the_legend_stays_where_it_is_when_a_point_is_chosen(browser, page_path):
    with opened(browser, page_path, images=True, viewport={"width": 400, "height": 900}) as page:
        page.locator(".filters").wait_for()
        before = page.locator(".teams").bounding_box()
        page.locator(".dots circle").first.dispatch_event("click")
        assert page.locator(".trial").bounding_box()["height"] > 300
        assert page.locator(".teams").bounding_box() == before


def test_a_filter_keeps_the_chosen_point(browser, page_path):
    with opened(browser, page_path, images=True) as page:
        page.locator(".filters").wait_for()
        page.locator(".dots circle", has=page.locator("title", has_text="large-2-001")).dispatch_event("click")
        for size_class, marked in (("large", 1), ("small", 0), ("all", 1)):
            page.select_option("select[name=class]", label=size_class)
            assert page.locator(".dots .chosen").count() == marked
            assert page.inner_text(".trial h3") == "large-2-001"
        assert page.locator(".dots .chosen title").text_content().startswith("large-2-001")


def test_points_are_reached_by_keyboard(browser, page_path):
    with opened(browser, page_path, images=True) as page:
        page.locator(".filters").wait_for()
        page.locator("select[name=template]").focus()
        page.keyboard.press("Tab")
        focused = "document.activeElement.querySelector('title').textContent.split(':')[0]"
        first = page.evaluate(focused)
        page.keyboard.press("ArrowRight")
        second = page.evaluate(focused)
        assert second != first
        page.keyboard.press("Enter")
        assert page.inner_text(".trial h3") == second
        page.keyboard.press("ArrowLeft")
        page.keyboard.press(" ")
        assert page.inner_text(".trial h3") == first
        page.keyboard.press("Tab")
        assert not page.evaluate("document.activeElement.matches('.dots circle')"), "one stop for all points"


def test_filters(browser, page_path):
    with opened(browser, page_path, images=True) as page:
        page.locator(".filters").wait_for()
        page.select_option("select[name=class]", label="large")
        page.select_option("select[name=robots]", "2")
        titles = page.locator(".dots title").all_text_contents()
        assert len(titles) == 3 and all(title.startswith("large-2-") for title in titles)
        assert page.inner_text(".shown") == "3 trials"
        before = titles
        page.select_option("select[name=other]", label="nonlearned_myopic")
        assert page.locator(".dots title").all_text_contents() != before
        assert page.text_content(".x-name") == "nonlearned_myopic (cells)"


A4_PX = 210 / 25.4 * 96
MARGINS_PX = 2 * 12 / 25.4 * 96
"""As the page's print style asks for them."""


def test_paper_has_every_column_and_keeps_captions_with_figures(browser, page_path):
    width = int(A4_PX - MARGINS_PX)
    with opened(browser, page_path, images=True, viewport={"width": width, "height": 1000}) as page:
        page.locator(".filters").wait_for()
        page.emulate_media(media="print")
        cells = page.locator("table:visible :is(th, td)").evaluate_all(
            "cells => cells.map(cell => [cell.getBoundingClientRect().right, cell.scrollWidth - cell.clientWidth])"
        )
        assert len(cells) > 300 and max(right for right, _ in cells) <= width + 1, "a column is off the paper"
        assert max(hidden for _, hidden in cells) <= 0, "a value runs into the next column"
        clipped = "all => all.filter(each => getComputedStyle(each).overflowX !== 'visible').length"
        assert page.locator(".scroll").evaluate_all(clipped) == 0
        apart = "all => all.filter(each => getComputedStyle(each).breakInside !== 'avoid').length"
        assert page.locator("figure").count() > 3 and page.locator("figure").evaluate_all(apart) == 0
        assert page.locator("details .scroll").first.is_visible(), "paper cannot be unfolded"
        assert len(page.pdf(format="A4")) > 10_000


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_figures_are_as_light_as_the_page(browser, page_path, scheme, tmp_path):
    white = "<rect width='80' height='40' fill='white'/>"
    svg = f"<svg xmlns='http://www.w3.org/2000/svg' width='80' height='40'>{white}</svg>"
    uri = "data:image/svg+xml;base64," + base64.b64encode(svg.encode()).decode()
    source = page_path.read_text(encoding="utf-8")
    path = tmp_path / "index.html"
    path.write_text(re.sub(r'(?<=<img src=")[^"]+', uri, source), encoding="utf-8")
    with opened(browser, path, images=True, color_scheme=scheme) as page:
        picture = matplotlib.image.imread(io.BytesIO(page.locator("figure img").first.screenshot()))
        assert picture[..., :3].mean() == pytest.approx(1.0 if scheme == "light" else 0.065, abs=0.03)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_fits_a_telephone(browser, page_path, scheme):
    with opened(browser, page_path, images=True, viewport={"width": 400, "height": 900}, color_scheme=scheme) as page:
        page.locator(".filters").wait_for()
        page.locator(".dots circle").first.dispatch_event("click")
        assert page.evaluate("document.documentElement.scrollWidth") == 400


def test_without_scripts_points_are_named_and_notable_trials_listed(browser, page_path):
    with opened(browser, page_path, images=True, java_script_enabled=False) as page:
        assert not page.locator(".filters").is_visible()
        assert page.locator(".dots circle title").count() == 12
        assert page.locator(".notable tbody tr").first.is_visible()
        assert EVIL in page.locator("#templates ~ .scroll tbody th").all_text_contents()
        page.locator(".answer a[href='#claims']").click()
        assert page.url.endswith("#claims") and page.locator(".claims tbody tr").count() == 6
