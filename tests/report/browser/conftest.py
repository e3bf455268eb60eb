"""A real browser in front of the page of a synthetic campaign.

Playwright drives a Chromium of the system. Where either is absent the tests are skipped with the
reason; with `DPBENCH_BROWSER=required`, as CI sets it, they fail instead.
"""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

import pytest

from dpbench.report.write import write_report

DESK, PHONE = (1400, 900), (390, 844)
AXE = Path(__file__).parent / "axe"
DRAWN = "Promise.all(Object.values(views)).then(() => draw())"
SELECT = """async (fragment) => {
  await Promise.all(Object.values(views));
  document.activeElement.blur();
  scrollTo(0, 0);
  history.pushState(null, "", fragment);
  read();
  await draw();
}"""
SIZES = pytest.mark.parametrize("size", [DESK, PHONE], ids=["desk", "phone"])
SCHEMES = pytest.mark.parametrize("scheme", ["light", "dark"])


def selection(page: Any) -> dict[str, str]:
    """Return the selection that the address holds."""
    fragment = page.evaluate("location.hash.slice(1)")
    return {name: values[0] for name, values in parse_qs(fragment).items()}


def wait_until_ready(page: Any) -> None:
    """Wait for the script of the page."""
    page.wait_for_selector("html[data-ready]", state="attached")


def click_middle(page: Any, locator: Any) -> None:
    """Scroll to a part of a figure and click on its middle."""
    locator.scroll_into_view_if_needed()
    box = locator.bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)


def check_accessible(page: Any, width: int) -> None:
    """Check that axe finds no violation and nothing scrolls sideways, light and dark."""
    page.evaluate((AXE / "axe.min.js").read_text())
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        page.wait_for_timeout(100)
        page.evaluate(DRAWN)
        violations = page.evaluate("axe.run(document).then((result) => result.violations)")
        nodes = [(rule["id"], [n["html"][:200] for n in rule["nodes"]]) for rule in violations]
        assert nodes == [], scheme
        assert page.evaluate("document.documentElement.scrollWidth") <= width


def _absent(reason: str) -> None:
    if os.environ.get("DPBENCH_BROWSER") == "required":
        pytest.fail(reason)
    pytest.skip(reason)  # never in CI, which requires the browser: it fails above


@pytest.fixture(scope="session")
def chromium(request: pytest.FixtureRequest) -> Iterator[Any]:
    """A running browser."""
    if request.config.getoption("--without-extras"):
        pytest.skip("no browser")  # left out on purpose; another job looks at the page
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        _absent("playwright is not installed")
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        _absent("no chromium on the path")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def page_file(campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of the synthetic standard campaign, in a folder of its own."""
    return write_report(shutil.copytree(campaign, tmp_path_factory.mktemp("page") / "standard"))


@dataclass
class Opener:
    """Opens the page and keeps what went wrong and what was asked for."""

    browser: Any
    file: Path
    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
    _contexts: list[Any] = field(default_factory=list)

    def __call__(
        self,
        fragment: str = "",
        *,
        size: tuple[int, int] = DESK,
        scheme: str = "light",
        scripts: bool = True,
    ) -> Any:
        """The page when it says that it is ready; without scripts, when it is loaded."""
        context = self.browser.new_context(
            viewport={"width": size[0], "height": size[1]},
            color_scheme=scheme,
            java_script_enabled=scripts,
        )
        self._contexts.append(context)
        context.set_default_timeout(60_000)
        page = context.new_page()
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on(
            "console",
            lambda output: (
                self.errors.append(output.text) if output.type in ("error", "warning") else 0
            ),
        )
        page.on("request", lambda request: self.requests.append(request.url))
        page.goto(f"{self.file.as_uri()}{fragment}")
        if scripts:
            wait_until_ready(page)
            # Many tests read the table of the runs, which a reader opens with a click.
            page.evaluate("document.querySelector('#rows')?.setAttribute('open', '')")
        return page

    def select(self, fragment: str = "") -> Any:
        """The page in one tab for all calls, with a selection as a link within it leads there."""
        if not self._contexts:
            return self(fragment)
        (page,) = self._contexts[0].pages
        page.mouse.move(0, 0)
        page.evaluate(SELECT, fragment or "#")
        return page

    def close(self) -> None:
        """Close all that was opened."""
        for context in self._contexts:
            context.close()


@contextmanager
def opening(browser: Any, file: Path) -> Iterator[Opener]:
    """Opens a page; what it logged as an error or warning fails the test."""
    opener = Opener(browser, file)
    yield opener
    opener.close()
    assert opener.errors == []


@pytest.fixture
def opened(chromium: Any, page_file: Path) -> Iterator[Opener]:
    """The page of the campaign."""
    with opening(chromium, page_file) as opener:
        yield opener


@pytest.fixture(scope="session")
def tab(chromium: Any, page_file: Path) -> Iterator[Opener]:
    """The page of the campaign in a tab that stays."""
    with opening(chromium, page_file) as opener:
        yield opener


@pytest.fixture
def selected(tab: Opener) -> Iterator[Callable[..., Any]]:
    """The page with a selection, for tests that leave another selection behind and nothing else."""
    yield tab.select
    assert tab.errors == []
