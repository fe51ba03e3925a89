"""The replay in a browser: it plays, scrubs and listens to keys, and loads nothing; it is whole without scripts."""

from dataclasses import replace

import pytest

from mrtask.analysis.drawing.replay_page import render_replay
from tests.analysis.drawing.test_replay_content import replay as _replay
from tests.browser import opened, started_browser

replay = _replay


@pytest.fixture(scope="module")
def browser():
    with started_browser() as started:
        yield started


@pytest.fixture(scope="module")
def page_path(replay, tmp_path_factory):
    path = tmp_path_factory.mktemp("replay") / "page.html"
    path.write_text(render_replay(replay, "python -m pipeline.replay trial_id=x"), encoding="utf-8")
    return path


def now(page):
    return float(page.input_value("#time"))


def seek(page, t_s):
    page.evaluate(
        "t => { const e = document.getElementById('time'); e.value = t; e.dispatchEvent(new Event('input')); }", t_s
    )


def place_of(page, robot=0):
    return page.get_attribute(f'[data-run="0"] g.robot[data-robot="{robot}"]', "transform")


def test_plays_to_the_end_and_stops(browser, page_path, replay):
    with opened(browser, page_path) as page:
        start = place_of(page)
        page.select_option("#speed", "0.5")
        page.click("#play")
        assert page.get_attribute("#play", "aria-label") == "Pause"
        page.select_option("#speed", "20")
        page.locator('#play[aria-label="Play"]').wait_for()
        assert now(page) == pytest.approx(replay.end_s, abs=0.01)
        assert place_of(page) != start
        assert page.text_content('[data-run="0"] .doing') == "1done2done"
        assert page.locator('[data-run="0"] .state.present.accepting').count() == 1
        assert page.locator('[data-run="0"] .later').count() == 0


def test_every_moment_agrees_with_the_trace(browser, page_path, replay):
    run = replay.runs[0]
    names = dict(enumerate(replay.names))
    with opened(browser, page_path) as page:
        for find in run.finds:
            seek(page, find.t_s + 0.01)
            shape = page.locator(f'[data-run="0"] polygon[data-container="{find.container}"]')
            assert ("found" if find.objects else "empty") in shape.get_attribute("class")
            assert names[find.container] in shape.locator("title").text_content()
        leg = next(leg for leg in run.trace.robots[0] if leg.kind == "move")
        seek(page, (leg.t0_s + leg.t1_s) / 2)
        place = next(i for i, one in enumerate(replay.home.containers) if one.id == leg.container)
        assert f"drives to {names[place]}" in page.text_content('[data-run="0"] .doing')


def test_keyboard(browser, page_path, replay):
    times = sorted({decision.t_s for run in replay.runs for decision in run.decisions})
    with opened(browser, page_path) as page:
        page.keyboard.press("Shift+ArrowRight")
        assert now(page) == pytest.approx(times[1], abs=0.01)
        shown = page.locator('[data-run="0"] .decision.present')
        assert shown.count() == 1 and shown.is_visible()
        page.keyboard.press("Shift+ArrowLeft")
        assert now(page) == 0
        page.keyboard.press("ArrowRight")
        assert now(page) == pytest.approx(1)
        page.keyboard.press("End")
        assert now(page) == pytest.approx(replay.end_s, abs=0.01)
        page.keyboard.press("Home")
        assert now(page) == 0
        speed = float(page.input_value("#speed"))
        page.keyboard.press("+")
        assert float(page.input_value("#speed")) > speed
        page.keyboard.press("2")
        assert page.get_attribute('[data-object="1"]', "aria-pressed") == "true"
        page.keyboard.press("w")
        assert not page.is_checked("#reveal")
        page.keyboard.press(" ")
        assert page.get_attribute("#play", "aria-label") == "Pause"
        page.keyboard.press(" ")
        assert page.get_attribute("#play", "aria-label") == "Play"


def test_the_belief_is_that_in_the_chosen_object(browser, page_path, replay):
    first = replay.runs[0].decisions[0].belief
    with opened(browser, page_path) as page:
        for obj, name in enumerate(replay.objects):
            page.click(f'[data-object="{obj}"]')
            for container in range(len(replay.names)):
                title = page.locator(f'[data-run="0"] polygon[data-container="{container}"] title').text_content()
                assert title == f"{replay.names[container]}: {name} with {100 * first[container, obj]:.1f} %"


def test_decisions_can_be_listed_and_visited(browser, page_path, replay):
    last = replay.runs[0].decisions[-1]
    with opened(browser, page_path) as page:
        page.click('[data-run="0"] .all')
        cards = page.locator('[data-run="0"] .decision')
        assert cards.count() == len(replay.runs[0].decisions) and cards.last.is_visible()
        cards.last.locator(".seek").click()
        assert now(page) == pytest.approx(last.t_s, abs=0.01)


def test_without_decisions_nothing_offers_a_belief(browser, replay, tmp_path):
    path = tmp_path / "page.html"
    bare = replace(replay, runs=tuple(replace(run, decisions=()) for run in replay.runs))
    path.write_text(render_replay(bare), encoding="utf-8")
    with opened(browser, path) as page:
        assert page.locator("[data-object], .ramp, #back, #next").count() == 0
        assert "elief" not in page.inner_text("body") and "decision" not in page.inner_text("body")
        assert page.locator(".swatch").count() == 3, "what is searched, found and hidden is still explained"
        page.keyboard.press("Shift+ArrowRight")
        assert now(page) == 0
        page.keyboard.press("End")
        assert now(page) == pytest.approx(bare.end_s, abs=0.01)


@pytest.mark.parametrize("width", [1400, 400])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_fits_the_screen(browser, page_path, width, scheme):
    with opened(browser, page_path, viewport={"width": width, "height": 900}, color_scheme=scheme) as page:
        assert page.evaluate("document.documentElement.scrollWidth") == width
        ink, paper = (
            page.evaluate(f"getComputedStyle(document.body).{name}.match(/\\d+/g).slice(0, 3).map(Number)")
            for name in ("color", "backgroundColor")
        )
        assert (sum(paper) > sum(ink)) == (scheme == "light")
        boxes = [page.locator(f'[data-run="{run}"]').bounding_box() for run in (0, 1)]
        assert (boxes[0]["y"] == boxes[1]["y"]) == (width == 1400), "side by side where there is room"


def test_without_scripts_it_shows_paths_and_decisions(browser, page_path, replay):
    with opened(browser, page_path, java_script_enabled=False) as page:
        assert not page.locator(".transport").is_visible()
        for index, run in enumerate(replay.runs):
            article = page.locator(f'[data-run="{index}"]')
            assert article.locator("svg.map .trail polyline").first.is_visible()
            cards = article.locator(".decision")
            assert cards.count() == len(run.decisions) and all(card.is_visible() for card in cards.all())
            assert f"{run.cost_s:.1f} s" in article.inner_text()


def test_names_with_markup_run_nothing(browser, replay, tmp_path):
    evil = '</script><script>alert(1)</script><img src=x onerror="alert(2)">'
    home = replace(replay.home, containers=tuple(replace(one, type=evil) for one in replay.home.containers))
    path = tmp_path / "page.html"
    path.write_text(render_replay(replace(replay, home=home, names=(evil,) * 3, task=evil)), encoding="utf-8")
    with opened(browser, path) as page:
        page.keyboard.press("End")
        assert page.inner_text("h1") == evil
        assert evil in page.locator('[data-run="0"] polygon.container title').first.text_content()


def test_prints(browser, page_path):
    with opened(browser, page_path) as page:
        page.emulate_media(media="print")
        assert not page.locator(".transport").is_visible()
        assert page.locator('[data-run="0"] .decision').last.is_visible()
        assert len(page.pdf(format="A4")) > 10_000
