"""Headless Chromium for tests of pages: Debian's, never a downloaded one. Without it, tests are skipped."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
TIMEOUT_MS = 60_000


@contextmanager
def started_browser() -> Iterator[Any]:
    """A Playwright browser."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("no chromium on this machine; apt-get install chromium")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=list(FLAGS), timeout=TIMEOUT_MS)
        yield browser
        browser.close()


@contextmanager
def opened(browser: Any, path: Path, *, images: bool = False, **options: Any) -> Iterator[Any]:
    """A page on a file. Whatever it says on the console, throws or loads besides itself is an error at the end.

    Args:
        images: pictures that stand in the page itself are no error.
    """
    context = browser.new_context(**{"viewport": {"width": 1400, "height": 900}} | options)
    context.set_default_timeout(TIMEOUT_MS)
    page, trouble = context.new_page(), []
    page.on("console", lambda message: trouble.append(f"console: {message.text}"))
    page.on("pageerror", lambda error: trouble.append(f"error: {error}"))
    page.on("dialog", lambda dialog: (trouble.append(f"dialog: {dialog.message}"), dialog.dismiss()))
    url = path.resolve().as_uri()

    def on_request(request: Any) -> None:
        if request.url != url and not (images and request.url.startswith("data:image/")):
            trouble.append(f"request: {request.url}")

    page.on("request", on_request)
    page.goto(url)
    yield page
    context.close()
    assert trouble == []
