#!/usr/bin/env python3
"""A report in a real browser: usage check_report.py PAGE FOLDER

Wide and narrow, light and dark, with and without its script: nothing is fetched, nothing is said on the
console, each panel is there and drawn, the page does not scroll sideways, and its controls work.
Leaves screenshots in a folder of the page's name in FOLDER.
"""

import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

# Width, height, device pixels to a pixel.
SCREENS = {"laptop": (1280, 900, 1), "telephone": (390, 844, 2)}
# Each must be there with a size; those of DRAWN with lines or areas in a plot.
PANELS = ["header", "#findings", "#scale", "#errors", "#overlay", "#histograms", "#located", "#map", "#worst", "#origin"]
DRAWN = ["#scale", "#errors", "#overlay", "#histograms", "#located", "#map"]
# The sections of a diagnosis, where the page holds one; those of DIAGNOSIS_DRAWN where they are there.
DIAGNOSIS = ["#diagnosis", "#staircase"]
DIAGNOSIS_DRAWN = ["#staircase", "#found"]
# A page that shows no recordings has none of these panels: its own sections count, and all of its plots.
RECORDINGS = "#overlay"
SHAPES = "path, polyline, polygon, rect, circle, line"
# A page that is shown in less time than a person waits, in milliseconds.
LOADED_MS = 3000


class Page:
    """An opened report, with all that went wrong in it."""

    def __init__(self, browser, path, size, scheme, script=True):
        width, height, scale = size
        context = browser.new_context(
            viewport={"width": width, "height": height},
            device_scale_factor=scale,
            color_scheme=scheme,
            java_script_enabled=script,
            has_touch=width < 500,
        )
        self.address = path.as_uri()
        self.wrong = []
        self.page = context.new_page()
        self.page.set_default_timeout(60000)
        self.page.on("console", lambda message: self.wrong.append(f"console: {message.text}"))
        self.page.on("pageerror", lambda error: self.wrong.append(f"error: {error}"))
        self.page.on("request", self.requested)
        self.page.goto(self.address)

    def requested(self, request):
        if request.url != self.address and not request.url.startswith("data:"):
            self.wrong.append(f"fetched {request.url}")

    def check(self, good, what):
        if not good:
            self.wrong.append(what)

    def has_recordings(self):
        return self.page.locator(RECORDINGS).count() > 0

    def drawn(self):
        """Waits until what was asked for is drawn."""
        self.page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def window(self):
        """Seconds that the overlay shows, from and to."""
        self.drawn()
        words = self.page.inner_text("#window").split()
        return float(words[0]), float(words[2])

    def labels(self):
        """Numbers at the first time axis, as a person reads them."""
        words = self.page.locator("#plots svg").first.locator("text.time").all_text_contents()
        return [float(word.replace("\u2212", "-")) for word in words]


def panels(opened):
    page = opened.page
    diagnosed = page.locator("#diagnosis").count() > 0
    wanted, drawn = PANELS + DIAGNOSIS * diagnosed, DRAWN + DIAGNOSIS_DRAWN * diagnosed
    if not opened.has_recordings():
        ids = page.locator("section").evaluate_all("sections => sections.map(one => '#' + one.id)")
        opened.check(ids, "a page without sections")
        wanted, drawn = ["h1"] + ids, [one for one in ids if page.locator(f"{one} figure").count()]
        opened.check(drawn, "a page without plots")
    for panel in wanted:
        there = page.locator(panel)
        box = there.bounding_box() if there.count() else None
        opened.check(box and box["width"] > 100 and box["height"] > 15, f"{panel} has no size")
    for panel in drawn:
        if panel in DIAGNOSIS_DRAWN and not page.locator(panel).count():
            continue
        plots = page.locator(f"{panel} svg[role=img]")
        shapes = plots.first.locator(SHAPES).count() if plots.count() else 0
        opened.check(shapes > 3, f"{panel} draws nothing")
    unlabelled = page.locator("svg[role=img]").evaluate_all("plots => plots.filter(plot => !plot.ariaLabel).length")
    opened.check(not unlabelled, f"{unlabelled} plots without a label")
    wide = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    opened.check(wide <= 0, f"the page is {wide} pixels too wide")


def small_letters(opened):
    """Letters in plots stay readable: at least 8.5 pixels high on the screen."""
    smallest = opened.page.evaluate("""() => Math.min(...[...document.querySelectorAll('svg[role=img] text')]
        .filter(t => t.getClientRects().length && t.ownerSVGElement.getScreenCTM())
        .map(t => parseFloat(getComputedStyle(t).fontSize) * t.ownerSVGElement.getScreenCTM().a))""")
    opened.check(smallest >= 8.5, f"letters of {smallest:.1f} pixels")


def cut_letters(opened):
    """No label is cut off at the edge of its plot, or of the page."""
    cut = opened.page.evaluate("""() => [...document.querySelectorAll('svg[role=img]')].flatMap(svg => {
        const box = svg.getBoundingClientRect();
        return [...svg.querySelectorAll('text')].filter(t => {
            const own = t.getBoundingClientRect();
            return own.width && (own.left < box.left - 1 || own.right > box.right + 1);
        }).map(t => t.textContent);
    })""")
    opened.check(not cut, f"labels are cut off: {cut}")


def zooms(opened):
    page = opened.page
    first = whole = opened.window()
    before = page.locator("#plots svg path.curve").first.get_attribute("d")
    page.click("[data-zoom=in]")
    inner = opened.window()
    opened.check(inner[1] - inner[0] < 0.8 * (whole[1] - whole[0]), f"the button zooms {whole} to {inner}")
    after = page.locator("#plots svg path.curve").first.get_attribute("d")
    opened.check(before != after, "the curve stays as it was")
    labels = opened.labels()
    inside = all(inner[0] - 0.01 <= label <= inner[1] + 0.01 for label in labels)
    opened.check(len(labels) >= 2 and inside, f"time labels {labels} in {inner}")
    page.focus("#plots")
    page.keyboard.press("ArrowRight")
    opened.check(opened.window()[0] > inner[0], "the arrow does not move it")
    page.keyboard.press("+")
    opened.check(opened.window()[1] - opened.window()[0] < inner[1] - inner[0], "plus does not zoom")
    page.keyboard.press("0")
    opened.check(opened.window() == whole, "0 does not show all")

    page.locator("#plots svg").first.scroll_into_view_if_needed()
    box = page.locator("#plots svg").first.bounding_box()
    middle = box["y"] + 60
    drag = lambda a, b: (  # noqa: E731
        page.mouse.move(box["x"] + a * box["width"], middle), page.mouse.down(),
        page.mouse.move(box["x"] + b * box["width"], middle, steps=4), page.mouse.up())
    page.mouse.move(box["x"] + 0.5 * box["width"], middle)
    opened.check(" s: measured " in page.text_content("#value"), "the curve under the mouse is not read")
    drag(0.5, 0.7)
    chosen = opened.window()
    share = (chosen[1] - chosen[0]) / (whole[1] - whole[0])
    opened.check(0.15 < share < 0.35, f"dragging over a fifth shows {share:.2f} of it")
    drag(0.7, 0.5)
    moved = opened.window()
    opened.check(moved[0] > chosen[0], f"dragging moves {chosen} to {moved}")
    page.mouse.wheel(0, -200)
    opened.check(opened.window()[1] - opened.window()[0] < moved[1] - moved[0], "the wheel does not zoom")
    page.click("[data-zoom=all]")
    opened.check(opened.window() == first, "Show all does not")


def pinches(opened):
    """Two fingers, through the browser's own touch input."""
    page = opened.page
    page.locator("#plots").scroll_into_view_if_needed()
    whole = opened.window()
    box = page.locator("#plots svg").first.bounding_box()
    devtools = page.context.new_cdp_session(page)
    y = box["y"] + 60

    def touch(kind, *places):
        points = [{"x": box["x"] + x * box["width"], "y": y, "id": i} for i, x in enumerate(places)]
        devtools.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    touch("touchStart", 0.5, 0.6)
    for spread in (0.02, 0.05, 0.1, 0.15):
        touch("touchMove", 0.5 - spread, 0.6 + spread)
    touch("touchEnd")
    inner = opened.window()
    opened.check(inner[1] - inner[0] < 0.6 * (whole[1] - whole[0]), f"pinching shows {inner} of {whole}")
    page.click("[data-zoom=all]")


def switches(opened):
    page = opened.page
    curve = lambda: page.locator("#plots svg path.curve").first.get_attribute("d")  # noqa: E731
    for select in ("#sensor", "#recording"):
        options = page.locator(f"{select} option").all_inner_texts()
        if len(options) > 1:
            before, now = curve(), page.input_value(select)
            other = next(o.get_attribute("value") for o in page.locator(f"{select} option").all()
                         if o.get_attribute("value") != now)
            page.select_option(select, other)
            opened.drawn()
            opened.check(curve() != before, f"{select} changes nothing")
    options = page.locator("#located-sensor option")
    if options.count() > 1:
        shown = lambda: page.locator("#located .of-sensor:visible").first.get_attribute("data-sensor")  # noqa: E731
        for option in options.all():
            value = option.get_attribute("value")
            page.select_option("#located-sensor", value)
            opened.check(shown() == value, f"sensor {value} is not shown over the covariates")
    button = page.locator("#worst button").last
    if button.count():
        button.click()
        start, end = float(button.get_attribute("data-from")), float(button.get_attribute("data-to"))
        window = opened.window()
        opened.check(window[0] <= start and window[1] >= end, f"the worst stretch {start} {end} is not in {window}")
        opened.check(window[1] - window[0] < 3 * max(end - start, 0.5), "the worst stretch is not zoomed")
        opened.check(page.input_value("#recording") == button.get_attribute("data-recording"), "another recording")
        opened.check(page.input_value("#sensor") == button.get_attribute("data-sensor"), "another sensor")


def controls(opened, screen):
    zooms(opened)
    if screen == "telephone":
        pinches(opened)
    switches(opened)


def main():
    path = Path(sys.argv[1]).resolve()
    folder = Path(sys.argv[2]) / path.stem
    folder.mkdir(parents=True, exist_ok=True)
    failed = False
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        # The first page of a browser waits for the browser to start, on a busy machine for longer than a page may.
        Page(browser, path, next(iter(SCREENS.values())), "light").page.context.close()
        cases = [(screen, scheme, True) for screen in SCREENS for scheme in ("light", "dark")]
        cases += [(screen, "light", False) for screen in SCREENS]
        for screen, scheme, script in cases:
            name = f"{screen}-{scheme}" + ("" if script else "-without-script")
            opened = Page(browser, path, SCREENS[screen], scheme, script)
            page = opened.page
            page.wait_for_timeout(200)
            page.screenshot(path=folder / f"{name}.png", full_page=True, timeout=60000)
            panels(opened)
            if script:
                loaded = page.evaluate("performance.getEntriesByType('navigation')[0].loadEventEnd")
                opened.check(loaded < LOADED_MS, f"loaded in {loaded:.0f} ms")
                small_letters(opened)
                cut_letters(opened)
                if opened.has_recordings():
                    controls(opened, screen)
                    page.screenshot(path=folder / f"{name}-zoomed.png")
                    panels(opened)
            for wrong in dict.fromkeys(opened.wrong):
                print(f"{path.stem}, {name}: {wrong}\n", end="")
            failed |= bool(opened.wrong)
            print(f"{path.stem}, {name}: {'FAILED' if opened.wrong else 'good'}\n", end="", flush=True)
            page.context.close()
        browser.close()
    sys.exit(failed)


if __name__ == "__main__":
    main()
