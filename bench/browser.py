"""The system's Chromium, headless, driven by Playwright: for tests, measurements and pictures of the pages."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

#: What to say where there is no browser.
NO_BROWSER = "no Chromium on PATH; get it with: apt install chromium"

#: Root may not sandbox; and nothing is asked of anybody outside.
_ARGUMENTS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)


def browser_path() -> str | None:
    """The system's Chromium."""
    return shutil.which("chromium") or shutil.which("chromium-browser")


@contextmanager
def chromium(*arguments: str) -> Iterator[Any]:
    """A browser, with more arguments if it needs them."""
    from playwright.sync_api import sync_playwright

    # The ROS wheels' libraries are none of the browser's.
    environment = {key: value for key, value in os.environ.items() if key != "LD_LIBRARY_PATH"}
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=browser_path(), args=[*_ARGUMENTS, *arguments], env=environment, timeout=240_000
        )
        yield browser
        browser.close()
