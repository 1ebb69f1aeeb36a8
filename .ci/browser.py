"""Pages in a real browser, with what a person would see there that is wrong."""

import contextlib

from playwright.sync_api import sync_playwright

# Width, height, device pixels to a pixel.
SCREENS = {"laptop": (1280, 900, 1), "telephone": (390, 844, 2)}
# A click shows its result within this time, in milliseconds: much more than on a machine that has nothing else to do.
SHOWN_MS = 60000


@contextlib.contextmanager
def chromium():
    with sync_playwright() as playwright:
        yield playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])


class Page:
    """An opened page. It may fetch only what is below an address, and write nothing to the console."""

    def __init__(self, browser, address, below, screen, scheme="light", script=True):
        width, height, scale = SCREENS[screen]
        self.page = browser.new_page(
            viewport={"width": width, "height": height}, device_scale_factor=scale, color_scheme=scheme,
            java_script_enabled=script, has_touch=screen == "telephone",
        )
        self.wrong = []
        # Lines of the browser's own about refused requests, which the check provokes.
        self.expected_errors = 0
        self.page.set_default_timeout(SHOWN_MS)
        self.page.on("console", self.console_message)
        self.page.on("pageerror", lambda error: self.wrong.append(f"error: {error}"))
        allowed = (below, "data:")
        self.page.on("request", lambda one: self.check(one.url.startswith(allowed), f"fetched {one.url}"))
        self.page.goto(address)

    def console_message(self, message):
        if any(line in message.text for line in ("status of 422", "status of 409")) and self.expected_errors > 0:
            self.expected_errors -= 1
        else:
            self.wrong.append(f"console: {message.text}")

    def check(self, good, what):
        if not good:
            self.wrong.append(what)

    def check_width(self):
        wide = self.page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        self.check(wide <= 0, f"the page is {wide} pixels too wide")
