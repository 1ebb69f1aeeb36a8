#!/usr/bin/env python3
"""A report in a real browser: usage check_report.py PAGE FOLDER

Wide and narrow, light and dark, with and without its script: nothing is fetched, nothing is written to the console, each
section has a size, each figure draws something, the page does not scroll sideways, and its controls work. Leaves screenshots
in a folder of the page's name in FOLDER.
"""

import sys
from itertools import product
from pathlib import Path

from browser import SCREENS, Page, chromium

SHAPES = "path, polyline, polygon, rect, circle, line"
# A page that is shown in less time than a person waits, in milliseconds.
LOADED_MS = 3000
# Least height of letters in plots, in pixels on the screen.
LETTERS = 8.5


class Report(Page):
    def __init__(self, browser, path, *options):
        super().__init__(browser, path.as_uri(), path.as_uri(), *options)
        self.plot = self.page.locator("#plots svg").first

    def drawn(self):
        """The page after what was asked for is drawn."""
        self.page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        return self.page

    def window(self):
        """Seconds that the overlay shows: from, to, and between."""
        start, _, end, *_ = self.drawn().inner_text("#window").split()
        return float(start), float(end), float(end) - float(start)

    def curve(self):
        return self.drawn().get_attribute("#plots svg path.curve >> nth=0", "d")

    def place(self):
        """Gives places in the plot, by their share of its width."""
        self.plot.scroll_into_view_if_needed()
        box = self.plot.bounding_box()
        return lambda share: (box["x"] + share * box["width"], box["y"] + 60)


def sections(report):
    page = report.page
    ids = page.locator("section").evaluate_all("sections => sections.map(one => '#' + one.id)")
    drawn = [one for one in ids if page.locator(f"{one} figure, {one} #plots").count()]
    report.check(drawn, "a page without plots")
    for section in ["h1", *ids]:
        box = page.locator(section).first.bounding_box()
        report.check(box and box["width"] > 100 and box["height"] > 15, f"{section} has no size")
    for section in drawn:
        plots = page.locator(f"{section} svg[role=img]")
        report.check(plots.count() and plots.first.locator(SHAPES).count() > 3, f"{section} draws nothing")
    unlabelled = page.locator("svg[role=img]").evaluate_all("plots => plots.filter(plot => !plot.ariaLabel).length")
    report.check(not unlabelled, f"{unlabelled} plots without a label")
    report.check_width()


def letters(report):
    """Letters in plots stay readable, and no label is cut off at the edge of its plot."""
    smallest, cut = report.page.evaluate("""() => {
        const all = [...document.querySelectorAll('svg[role=img] text')].filter(t => t.getBoundingClientRect().width);
        const height = t => parseFloat(getComputedStyle(t).fontSize) * t.ownerSVGElement.getScreenCTM().a;
        const is_cut = t => {
            const own = t.getBoundingClientRect(), box = t.closest('svg[role=img]').getBoundingClientRect();
            return own.left < box.left - 1 || own.right > box.right + 1;
        };
        return [Math.min(...all.map(height)), all.filter(is_cut).map(t => t.textContent)];
    }""")
    report.check(smallest >= LETTERS, f"letters of {smallest:.1f} pixels")
    report.check(not cut, f"labels are cut off: {cut}")


def zooms(report):
    page, whole, before = report.page, report.window(), report.curve()
    page.click("[data-zoom=in]")
    inner = report.window()
    report.check(inner[2] < 0.8 * whole[2], f"the button zooms {whole} to {inner}")
    report.check(report.curve() != before, "the curve stays as it was")
    labels = [float(text.replace("\u2212", "-")) for text in report.plot.locator("text.time").all_text_contents()]
    inside = all(inner[0] - 0.01 <= label <= inner[1] + 0.01 for label in labels)
    report.check(len(labels) >= 2 and inside, f"time labels {labels} in {inner}")
    page.focus("#plots")
    page.keyboard.press("ArrowRight")
    report.check(report.window()[0] > inner[0], "the arrow does not move it")
    page.keyboard.press("+")
    report.check(report.window()[2] < inner[2], "plus does not zoom")
    page.keyboard.press("0")
    report.check(report.window() == whole, "0 does not show all")
    place = report.place()

    def drag(start, end):
        page.mouse.move(*place(start))
        page.mouse.down()
        page.mouse.move(*place(end), steps=4)
        page.mouse.up()

    page.mouse.move(*place(0.5))
    report.check(" s: measured " in page.text_content("#value"), "the curve under the mouse is not read")
    drag(0.5, 0.7)
    chosen = report.window()
    report.check(0.15 < chosen[2] / whole[2] < 0.35, f"dragging over a fifth of {whole} shows {chosen}")
    drag(0.7, 0.5)
    moved = report.window()
    report.check(moved[0] > chosen[0], f"dragging moves {chosen} to {moved}")
    page.mouse.wheel(0, -200)
    report.check(report.window()[2] < moved[2], "the wheel does not zoom")
    page.click("[data-zoom=all]")
    report.check(report.window() == whole, "Show all does not")


def pinches(report):
    """Two fingers, through the browser's own touch input."""
    place, whole, devtools = report.place(), report.window(), report.page.context.new_cdp_session(report.page)
    for spread in (0, 0.02, 0.05, 0.1, 0.15, None):
        shares = () if spread is None else (0.5 - spread, 0.6 + spread)
        kind = "touchMove" if spread else "touchEnd" if spread is None else "touchStart"
        points = [dict(zip("xy", place(share)), id=finger) for finger, share in enumerate(shares)]
        devtools.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    inner = report.window()
    report.check(inner[2] < 0.6 * whole[2], f"pinching {whole} shows {inner}")
    report.page.click("[data-zoom=all]")


def switches(report):
    page = report.page

    def others(select):
        values = page.locator(f"{select} option").evaluate_all("all => all.map(one => one.value)")
        return [value for value in values if value != page.input_value(select)]

    for select in ("#sensor", "#recording"):
        for other in others(select)[:1]:
            before = report.curve()
            page.select_option(select, other)
            report.check(report.curve() != before, f"{select} changes nothing")
    if page.locator("#located-sensor").count():
        for sensor in [*others("#located-sensor"), page.input_value("#located-sensor")]:
            page.select_option("#located-sensor", sensor)
            shown = page.locator("#located .of-sensor:visible").first.get_attribute("data-sensor")
            report.check(shown == sensor, f"sensor {sensor} is not shown over the covariates")
    button = page.locator("#worst button").last
    if button.count():
        button.click()
        stretch = button.evaluate("button => ({...button.dataset})")
        start, end, window = float(stretch["from"]), float(stretch["to"]), report.window()
        is_shown = window[0] <= start and window[1] >= end and window[2] < 3 * max(end - start, 0.5)
        report.check(is_shown, f"the worst stretch {start} {end} is not zoomed to: {window}")
        for name in ("recording", "sensor"):
            report.check(page.input_value(f"#{name}") == stretch[name], f"another {name}")


def check(browser, path, folder, screen, scheme, script):
    name = f"{screen}-{scheme}" + ("" if script else "-without-script")
    report = Report(browser, path, screen, scheme, script)
    page = report.page
    page.wait_for_timeout(200)
    page.screenshot(path=folder / f"{name}.png", full_page=True)
    sections(report)
    if script:
        loaded = page.evaluate("performance.getEntriesByType('navigation')[0].loadEventEnd")
        report.check(loaded < LOADED_MS, f"loaded in {loaded:.0f} ms")
        letters(report)
    if script and page.locator("#overlay").count():
        zooms(report)
        if screen == "telephone":
            pinches(report)
        switches(report)
        page.screenshot(path=folder / f"{name}-zoomed.png")
        sections(report)
    # One write for each line: two pages are checked at a time.
    for wrong in [*dict.fromkeys(report.wrong), "FAILED" if report.wrong else "good"]:
        print(f"{path.stem}, {name}: {wrong}\n", end="", flush=True)
    page.close()
    return not report.wrong


path = Path(sys.argv[1]).resolve()
folder = Path(sys.argv[2]) / path.stem
folder.mkdir(parents=True, exist_ok=True)
with chromium() as browser:
    # The first page of a browser waits for the browser to start, on a busy machine for longer than a page may.
    Report(browser, path, "laptop").page.close()
    cases = product(SCREENS, (("light", True), ("dark", True), ("light", False)))
    good = [check(browser, path, folder, screen, *options) for screen, options in cases]
sys.exit(not all(good))
