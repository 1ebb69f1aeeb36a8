#!/usr/bin/env python3
"""The workbench in a real browser: usage check_workbench.py MAGPIE FOLDER

Adds effects and formulas, undoes and redoes, compares, writes; a wrong formula, a second tab, a campaign that is removed
meanwhile. Nothing may be said on the console, and the page may not scroll sideways. Leaves screenshots in FOLDER.
"""

import contextlib
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from browser import Page, chromium

DATA = Path("tests/data").resolve()
# Screen and colours of each run.
RUNS = {"laptop": "light", "telephone": "dark"}
RIPPLE = "own: dz_um = a*sin(motor_angle_rad) + b*cos(motor_angle_rad)"
FOREIGN_SCRIPT = """() => {
    const script = document.createElement('script');
    script.textContent = 'window.foreign = 1';
    document.body.append(script);
    return window.foreign;
}"""
# What a model is shown by.
SHOWN = "document.querySelector('#present').innerHTML + document.querySelector('#headline').innerText"


@contextlib.contextmanager
def server(magpie, campaign, *options):
    """Folder and address of `magpie workbench` in a folder of its own."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(DATA / campaign, folder / "campaign")
        command = [magpie, "workbench", "campaign", "--json", *options]
        with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as process:
            try:
                yield folder, json.loads(process.stdout.readline())["url"]
            finally:
                process.kill()


class Tab(Page):
    def __init__(self, browser, url, screen="laptop"):
        super().__init__(browser, url, "/".join(url.split("/")[:3]), screen, RUNS[screen])
        self.shown()

    def shown(self):
        self.page.wait_for_selector("#view[aria-busy=false]")

    def wait_for_text(self, selector, text):
        self.page.wait_for_function(
            "([selector, text]) => document.querySelector(selector).innerText.includes(text)", arg=[selector, text]
        )

    def act(self, action):
        """Does what fits a model, and waits until it is shown."""
        before = self.page.evaluate(SHOWN)
        action()
        busy = "document.querySelector('#view').ariaBusy"
        self.page.wait_for_function(f"before => {busy} === 'false' && {SHOWN} !== before", arg=before)

    def click(self, selector):
        self.act(lambda: self.page.click(selector))

    def press(self, selector, key):
        self.act(lambda: self.page.locator(selector).press(key))

    def check_present(self, expected, when):
        found = self.page.locator("#present li[data-effect]").evaluate_all("all => all.map(one => one.dataset.effect)")
        self.check(found == expected, f"{when}: {found} in the model")


def effects(browser, magpie, pictures, screen):
    both = ["magnet_temperature", "hysteresis"]
    with server(magpie, "friction") as (folder, url):
        tab = Tab(browser, url, screen)
        page = tab.page
        tab.check_width()
        explores(tab)

        # The prediction under the pointer or with the keyboard, then the effect itself.
        page.focus("#candidates li[data-effect=magnet_temperature] button")
        tab.check(page.inner_text("#predicted").endswith(" N"), "no prediction for the effect in focus")
        tab.act(lambda: page.keyboard.press("Enter"))
        tab.click("#candidates li[data-effect=hysteresis] button")
        tab.check_present(both, "after adding")
        tab.check("B: base" in page.inner_text("#view"), "the base is not shown next to it")
        tab.check(page.locator("#plots svg path.curve").count() > 4, "no curves over time")
        tab.check_width()
        page.screenshot(path=pictures / f"{screen}.png")
        headline = page.inner_text("#headline")
        tab.click("#undo")
        tab.check_present(both[:1], "after undo")
        tab.press("body", "Control+z")
        tab.check_present([], "after undo with the keyboard")
        tab.check(page.is_disabled("#undo"), "undo goes on before the first model")
        tab.click("#redo")
        tab.press("body", "Control+Shift+z")
        tab.check(page.inner_text("#headline") == headline, "redo shows another model")
        # Any two models side by side.
        page.select_option("#baseline", label="magnet_temperature")
        tab.wait_for_text("#view", "A: magnet_temperature")
        writes(tab, folder, magpie)

        # A page that is loaded again shows the same model, with its history; a second tab has models of its own.
        page.reload()
        tab.shown()
        page.wait_for_selector("#present li[data-effect=hysteresis]")
        tab.check_present(both, "after loading again")
        tab.check(page.is_enabled("#undo"), "no undo after loading again")
        tab.shown()
        other = Tab(browser, url)
        other.check_present([], "in a second tab")
        other.click("#candidates li[data-effect=hysteresis] button")
        tab.check_present(both, "after a change in the second tab")

        # The recordings are gone, and come back.
        (folder / "campaign").rename(folder / "away")
        tab.expected_errors = 1
        page.click("summary:has-text('Not significant')")
        page.click("#others li:first-child button")
        tab.wait_for_text("#error", "campaign")
        tab.check_present(both, "after an error")
        (folder / "away").rename(folder / "campaign")
        tab.click("#present li[data-effect=hysteresis] button")
        tab.check_present(both[:1], "after removal")
    return tab.wrong + other.wrong


def explores(tab):
    """The scatter follows the stretch of the plots over time; findings can be added; what takes long is cancelled by a click; a
    script of somebody else does not run."""
    page, label = tab.page, "document.querySelector('#scatter-plot svg').ariaLabel"
    page.wait_for_selector("#scatter-plot svg")
    page.select_option("#covariate", "fx_n")
    page.wait_for_function(f"() => {label}.includes('lateral force')")
    whole = page.evaluate(label)
    page.click("[data-zoom=in]")
    page.wait_for_function(f"whole => {label} !== whole", arg=whole)
    page.click("#diagnose")
    page.wait_for_selector("#diagnosis-result li button")
    found = page.locator("#diagnosis-result li").all_inner_texts()
    tab.check(sum(text.startswith("Add hysteresis") for text in found) == 1, f"diagnosis: {found}")
    tab.check(page.is_hidden("#cancel"), "there is nothing to cancel")
    tab.expected_errors = 1
    page.click("#plan")
    page.click("#cancel")
    page.wait_for_function("() => document.querySelector('#diagnosis-result').innerText === 'cancelled'")
    tab.check(page.is_hidden("#cancel"), "what was cancelled goes on")
    tab.expected_errors = 1
    tab.check(page.evaluate(FOREIGN_SCRIPT) is None, "a script without the number of the page runs")


def writes(tab, folder, magpie):
    """What is written is what the shown commands write."""
    for kind, file in (("model", "model.toml"), ("tables", "tables.rs"), ("report", "report.html")):
        tab.page.select_option("#write-kind", kind)
        tab.page.click("#write-form button")
        tab.wait_for_text("#written", file)
        tab.check((folder / file).exists(), f"{file} was not written")
    tab.page.click("#bottom summary")
    commands = tab.page.inner_text("#commands").splitlines()
    tab.check(any("add base.toml" in line and "hysteresis" in line for line in commands), f"commands: {commands}")
    for line in commands:
        command = line.replace("cargo magpie", magpie)
        done = subprocess.run(command, shell=True, cwd=folder, capture_output=True, text=True)
        tab.check(done.returncode == 0, f"{line}: {done.stderr}")


def formula(browser, magpie, pictures, screen):
    with server(magpie, "ripple") as (_, url):
        tab = Tab(browser, url, screen)
        page = tab.page
        tab.expected_errors = 1
        page.fill("#formula", "own: dz_um = a*sin(motor_angel_rad)")
        page.press("#formula", "Enter")
        tab.wait_for_text("#error", "did you mean motor_angle_rad")
        tab.check("^" in page.inner_text("#error"), "the error does not show its place")
        tab.check_present([], "after a wrong formula")
        # Names are completed while typing, and inserted by a click.
        page.fill("#formula", "")
        page.type("#formula", "own: dz_um = a*motor_ang")
        words = page.locator("#words option").evaluate_all("all => all.map(one => one.value)")
        tab.check("own: dz_um = a*motor_angle_rad" in words, f"completions: {words}")
        page.click("summary:has-text('Names for formulas')")
        page.click("#names button:text-is('motor_angle_rad')")
        tab.check(page.input_value("#formula").endswith("a*motor_angle_rad"), f"inserted: {page.input_value('#formula')}")
        page.fill("#formula", RIPPLE)
        tab.press("#formula", "Enter")
        tab.check_present(["own"], "after a formula")
        tab.check_width()
        page.screenshot(path=pictures / f"formula-{screen}.png")
    return tab.wrong


def live(browser, magpie, pictures, screen):
    with server(magpie, "ripple", "--virtual") as (folder, url):
        tab = Tab(browser, url, screen)
        page = tab.page
        # Repeated grasps: the forces change.
        page.wait_for_function("() => document.querySelectorAll('#live-sensors tr').length === 4")
        force = "document.querySelector('#live-sensors td:nth-child(2)').innerText"
        page.wait_for_function(f"() => Math.abs(parseFloat({force})) > 5")
        tab.wait_for_text("#live-state", "1000 ticks per second")
        tab.check("no faults" in page.inner_text("#live-state"), page.inner_text("#live-state"))
        tab.check_width()
        page.screenshot(path=pictures / f"live-{screen}.png")
        # A recording by `magpie record`, ended by a click.
        page.fill("#record-output", "recorded/1")
        page.click("#record-form button[type=submit]")
        tab.wait_for_text("#record-lines", "Recording.")
        # The header is written before the first row; a busy machine takes seconds to start the program.
        table = folder / "recorded/1/hall.csv"
        for _ in range(150):
            if table.exists():
                break
            page.wait_for_timeout(200)
        page.wait_for_timeout(2500)
        page.click("#record-end")
        tab.wait_for_text("#record-lines", "has ended")
        rows = len(table.read_text().splitlines())
        tab.check(rows > 500, f"{rows} rows were recorded: {page.inner_text('#record-lines')}")
        # Recordings that are added are fitted after a click.
        recordings = page.locator("#view #recording option")
        tab.check(recordings.count() == 3, "not three recordings")
        (folder / "campaign/3").rename(folder / "3")
        tab.click("#reload")
        tab.check(recordings.count() == 2, "a removed recording is still shown")
    return tab.wrong


def main(magpie, folder):
    pictures, good = Path(folder), True
    pictures.mkdir(parents=True, exist_ok=True)
    with chromium() as browser:
        for check in (effects, formula, live):
            for screen in RUNS:
                try:
                    wrong = check(browser, magpie, pictures, screen)
                except Exception as error:  # The other checks still say something.
                    wrong = [str(error)]
                print(f"workbench, {check.__name__}, {screen}: {'; '.join(wrong) or 'good'}", flush=True)
                good &= not wrong
    sys.exit(not good)


main(*sys.argv[1:])
