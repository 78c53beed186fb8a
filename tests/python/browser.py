"""Debian's Chromium without a display or a graphics card, for tests of the page."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

_ARGUMENTS = [
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"),
    *("--use-fake-ui-for-media-stream", "--use-fake-device-for-media-stream"),
]


@contextmanager
def browser() -> Iterator[Any]:
    """A running browser; skips the test where none is installed."""
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        pytest.skip("no browser: apt install chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="pip install playwright")
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=program, args=_ARGUMENTS)
        yield started
        started.close()


class Visit:
    """A page that is open, with what it asked for and complained about.

    Args:
        browser: of :func:`browser`.
        address: what to open.
        size: (width, height) of the window.
        theme: "dark" or "light".
        settings: of the browser's context.
    """

    def __init__(
        self,
        browser: Any,
        address: str,
        size: tuple[int, int] = (900, 560),
        theme: str = "dark",
        **settings: Any,
    ) -> None:
        width, height = size
        self.context = browser.new_context(
            viewport={"width": width, "height": height},
            color_scheme=theme,
            accept_downloads=True,
            **settings,
        )
        self.page = self.context.new_page()
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", self._listen)
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(address)

    def _listen(self, message: Any) -> None:
        if message.type in ("error", "warning") and "GPU stall" not in message.text:
            self.complaints.append(message.text)

    def status(self) -> dict[str, Any]:
        """What the page says of itself."""
        status: dict[str, Any] = self.page.evaluate("() => freetalk.status()")
        return status

    def until(self, condition: str, timeout_s: float = 30.0) -> dict[str, Any]:
        """Waits until an expression over ``s``, the status, holds.

        The page forbids code from strings, which the driver's own waiting needs.
        """
        for _ in range(int(timeout_s / 0.1)):
            if self.page.evaluate(
                f"() => {{ const s = freetalk.status(); return !!({condition}); }}"
            ):
                return self.status()
            self.page.wait_for_timeout(100)
        raise AssertionError(f"never '{condition}': {self.status()}")

    def close(self) -> None:
        """Closes the page."""
        self.context.close()


#: Colours of text and of what is behind it, of everything on the page that shows text, with the WCAG contrast.
CONTRAST = """() => {
  const rgb = (text) => text.match(/[\\d.]+/g).map(Number);
  const light = (c) => { const [r, g, b] = c.map((v) => { v /= 255; return v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4; });
    return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const found = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode, text = node.textContent.trim(), of = node.parentElement;
    if (!text || !of.checkVisibility() || of.closest("script, style, option")) continue;
    let layer = of, back = null;
    while (layer && !back) {
      const color = rgb(getComputedStyle(layer).backgroundColor.replace(/color\\(srgb ([^)]*)\\)/, (_, v) => v.split(/[ /]+/).map((x, i) => i < 3 ? 255 * x : x).join(" ")));
      if (color.length < 4 || color[3] > 0.8) back = color.slice(0, 3);
      layer = layer.parentElement;
    }
    const front = rgb(getComputedStyle(of).color).slice(0, 3);
    const [a, b] = [light(front), light(back || [255, 255, 255])].sort((x, y) => y - x);
    found.push({ text, ratio: (a + 0.05) / (b + 0.05) });
  }
  return found;
}"""

#: Controls without a name that a screen reader could say.
NAMELESS = """() => [...document.querySelectorAll("button, input, select, canvas[tabindex], [role=slider]")]
  .filter((of) => of.checkVisibility() && !(of.getAttribute("aria-label") || of.textContent.trim() || of.labels?.length || of.title))
  .map((of) => of.outerHTML.slice(0, 120))"""
