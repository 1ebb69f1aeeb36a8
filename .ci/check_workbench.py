#!/usr/bin/env python3
"""The workbench in a real browser: usage check_workbench.py MAGPIE FOLDER

Adds effects and formulas, undoes and redoes, compares, writes; a wrong formula, a second tab, a campaign that is removed
meanwhile. Nothing may be said on the console, and the page may not scroll sideways. Leaves screenshots in FOLDER.
"""

import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

DATA = Path("tests/data").resolve()
SCREENS = {"laptop": ((1280, 900), "light"), "telephone": ((390, 844), "dark")}
RIPPLE = "own: dz_um = a*sin(motor_angle_rad) + b*cos(motor_angle_rad)"
# A click shows its result within this time, in milliseconds: much more than on a machine that has nothing else to do.
SHOWN_MS = 60000


class Server:
    """`magpie workbench` in a folder of its own."""

    running = []

    def __init__(self, magpie, campaign, *options):
        self.folder = Path(tempfile.mkdtemp())
        shutil.copytree(DATA / campaign, self.folder / "campaign")
        command = [magpie, "workbench", "campaign", "--json", *options]
        self.process = subprocess.Popen(command, cwd=self.folder, stdout=subprocess.PIPE, text=True)
        Server.running.append(self)
        self.url = json.loads(self.process.stdout.readline())["url"]

    def end(self):
        Server.running.remove(self)
        self.process.kill()
        self.process.wait()
        shutil.rmtree(self.folder)


class Page:
    """A tab with the workbench, and all that went wrong in it."""

    def __init__(self, browser, url, size=(1280, 900), scheme="light"):
        context = browser.new_context(viewport=dict(zip(("width", "height"), size)), color_scheme=scheme)
        self.wrong = []
        self.expected_errors = 0
        self.page = context.new_page()
        self.page.set_default_timeout(SHOWN_MS)
        self.page.on("console", self.said)
        self.page.on("pageerror", lambda error: self.wrong.append(f"error: {error}"))
        self.page.goto(url)
        self.shown()

    def said(self, message):
        # A refused request or script is a line of the browser's own.
        lines = ("status of 422", "status of 409", "Content Security Policy")
        if any(line in message.text for line in lines) and self.expected_errors > 0:
            self.expected_errors -= 1
        else:
            self.wrong.append(f"console: {message.text}")

    def check(self, good, what):
        if not good:
            self.wrong.append(what)

    def shown(self):
        self.page.wait_for_selector("#view[aria-busy=false]")

    def act(self, action):
        """Does what fits a model, and waits until it is shown."""
        before = self.page.inner_html("#present") + self.page.inner_text("#headline")
        action()
        self.page.wait_for_function(
            "before => document.querySelector('#view').ariaBusy === 'false' && "
            "document.querySelector('#present').innerHTML + document.querySelector('#headline').innerText !== before",
            arg=before,
        )

    def present(self):
        return self.page.locator("#present li[data-effect]").evaluate_all("all => all.map(one => one.dataset.effect)")

    def excess(self):
        """Last excess over noise in the headline, in newtons."""
        words = self.page.inner_text("#headline").split("excess over noise")[1].split(" N.")[0]
        return float(words.split("\u2192")[-1])

    def fits(self):
        wide = self.page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        self.check(wide <= 0, f"the page is {wide} pixels too wide")


def effects(browser, magpie, folder, name):
    size, scheme = SCREENS[name]
    server = Server(magpie, "friction")
    tab = Page(browser, server.url, size, scheme)
    page = tab.page
    base = tab.excess()
    tab.check(base > 2, f"the base has an excess of {base} N")
    tab.fits()

    # The scatter follows the stretch of the plots over time.
    scatter = "#scatter-plot svg"
    page.wait_for_selector(scatter)
    page.select_option("#covariate", "fx_n")
    page.wait_for_function("() => document.querySelector('#scatter-plot svg').ariaLabel.includes('lateral force')")
    whole = page.get_attribute(scatter, "aria-label")
    page.click("[data-zoom=in]")
    page.wait_for_function("whole => document.querySelector('#scatter-plot svg').ariaLabel !== whole", arg=whole)

    # What a diagnosis finds can be added.
    page.click("#diagnose")
    page.wait_for_selector("#diagnosis-result li button")
    found = page.locator("#diagnosis-result li").all_inner_texts()
    friction = [text for text in found if text.startswith("Add hysteresis")]
    stated = len(friction) == 1 and " N, friction force" in friction[0] and "gain 99" in friction[0]
    tab.check(stated and len(found) == 3, f"diagnosis: {found}")

    # What takes long is cancelled by a click.
    tab.check(page.is_hidden("#cancel"), "there is nothing to cancel")
    tab.expected_errors = 1
    page.click("#plan")
    page.click("#cancel")
    page.wait_for_function("() => document.querySelector('#diagnosis-result').innerText === 'cancelled'")
    tab.check(page.is_hidden("#cancel"), "what was cancelled goes on")

    # A script of somebody else does not run.
    tab.expected_errors = 1
    foreign = "() => { const script = document.createElement('script'); script.textContent = 'window.foreign = 1'; document.body.append(script); return window.foreign }"
    tab.check(page.evaluate(foreign) is None, "a script without the number of the page runs")

    # The prediction under the pointer or with the keyboard, then the effect itself.
    page.focus("#candidates li[data-effect=magnet_temperature] button")
    tab.check(page.inner_text("#predicted").endswith(" N"), "no prediction for the effect in focus")
    tab.act(lambda: page.keyboard.press("Enter"))
    tab.act(lambda: page.click("#candidates li[data-effect=hysteresis] button"))
    tab.check(tab.present() == ["magnet_temperature", "hysteresis"], f"in the model: {tab.present()}")
    both = tab.excess()
    tab.check(both < 0.2, f"with both effects the excess is {both} N")
    tab.check("B: base" in page.inner_text("#view"), "the base is not shown next to it")
    tab.check(page.locator("#plots svg path.curve").count() > 4, "no curves over time")
    tab.fits()
    page.screenshot(path=folder / f"{name}.png")

    tab.act(lambda: page.click("#undo"))
    tab.check(tab.present() == ["magnet_temperature"], f"after undo: {tab.present()}")
    page.locator("body").press("Control+z")
    tab.shown()
    page.wait_for_function("() => !document.querySelector('#present li[data-effect]')")
    tab.check(page.is_disabled("#undo"), "undo goes on before the first model")
    tab.act(lambda: page.click("#redo"))
    tab.act(lambda: page.locator("body").press("Control+Shift+z"))
    tab.check(abs(tab.excess() - both) < 1e-9, "redo shows another model")

    # Any two models side by side.
    page.select_option("#baseline", label="magnet_temperature")
    page.wait_for_function("() => document.querySelector('#view').innerText.includes('A: magnet_temperature')")

    # What is written is what the shown commands write.
    for kind, file in [("model", "model.toml"), ("tables", "tables.rs"), ("report", "report.html")]:
        page.select_option("#write-kind", kind)
        page.click("#write-form button")
        page.wait_for_function("file => document.querySelector('#written').innerText.includes(file)", arg=file)
        tab.check((server.folder / file).stat().st_size > 1000, f"{file} was not written")
    page.click("#bottom summary")
    commands = page.inner_text("#commands").splitlines()
    tab.check(any("add base.toml" in line and "hysteresis" in line for line in commands), f"commands: {commands}")
    for line in commands:
        done = subprocess.run(line.replace("cargo magpie", magpie), shell=True, cwd=server.folder, capture_output=True, text=True)
        tab.check(done.returncode == 0, f"{line}: {done.stderr}")

    # A page that is loaded again shows the same model, with its history.
    page.reload()
    tab.shown()
    page.wait_for_selector("#present li[data-effect=hysteresis]")
    tab.check(tab.present() == ["magnet_temperature", "hysteresis"], f"after loading again: {tab.present()}")
    tab.check(page.is_enabled("#undo"), "no undo after loading again")
    tab.shown()

    # A second tab has models of its own, on the same server.
    other = Page(browser, server.url)
    other.check(other.present() == [], "the second tab begins with the models of the first")
    other.act(lambda: other.page.click("#candidates li[data-effect=hysteresis] button"))
    tab.check(tab.present() == ["magnet_temperature", "hysteresis"], "the second tab changes the first")

    # The recordings are gone, and come back.
    (server.folder / "campaign").rename(server.folder / "away")
    tab.expected_errors = 1
    page.click("summary:has-text('Not significant')")
    page.click("#others li:first-child button")
    page.wait_for_function("() => document.querySelector('#error').innerText.includes('campaign')")
    tab.check(tab.present() == ["magnet_temperature", "hysteresis"], "an error changes the model")
    (server.folder / "away").rename(server.folder / "campaign")
    tab.act(lambda: page.click("#present li[data-effect=hysteresis] button"))
    tab.check(tab.present() == ["magnet_temperature"], f"after removal: {tab.present()}")
    return tab.wrong + other.wrong


def formula(browser, magpie, folder, name):
    size, scheme = SCREENS[name]
    server = Server(magpie, "ripple")
    tab = Page(browser, server.url, size, scheme)
    page = tab.page
    tab.expected_errors = 1
    page.fill("#formula", "own: dz_um = a*sin(motor_angel_rad)")
    page.press("#formula", "Enter")
    page.wait_for_function("() => document.querySelector('#error').innerText.includes('did you mean motor_angle_rad')")
    tab.check("^" in page.inner_text("#error"), "the error does not show its place")
    tab.check(tab.present() == [], "a wrong formula changes the model")
    # Names are completed while typing, and inserted by a click.
    page.fill("#formula", "")
    page.type("#formula", "own: dz_um = a*motor_ang")
    words = page.locator("#words option").evaluate_all("all => all.map(one => one.value)")
    tab.check("own: dz_um = a*motor_angle_rad" in words, f"completions: {words}")
    page.click("summary:has-text('Names for formulas')")
    page.click("#names button:text-is('motor_angle_rad')")
    tab.check(page.input_value("#formula").endswith("a*motor_angle_rad"), f"inserted: {page.input_value('#formula')}")
    page.fill("#formula", RIPPLE)
    tab.act(lambda: page.press("#formula", "Enter"))
    tab.check(tab.present() == ["own"] and tab.excess() < 0.3, f"{tab.present()}, {tab.excess()} N")
    tab.fits()
    page.screenshot(path=folder / f"formula-{name}.png")
    return tab.wrong


def live(browser, magpie, folder, name):
    size, scheme = SCREENS[name]
    server = Server(magpie, "ripple", "--virtual")
    tab = Page(browser, server.url, size, scheme)
    page = tab.page
    # Repeated grasps: the forces change.
    forces = "() => [...document.querySelectorAll('#live-sensors td:nth-child(2)')].map(cell => parseFloat(cell.innerText))"
    page.wait_for_function("() => document.querySelectorAll('#live-sensors tr').length === 4")
    page.wait_for_function("() => Math.abs(parseFloat(document.querySelector('#live-sensors td:nth-child(2)').innerText)) > 5")
    tab.check(len(page.evaluate(forces)) == 4, "not four sensors")
    page.wait_for_function("() => document.querySelector('#live-state').innerText.includes('1000 ticks per second')")
    tab.check("no faults" in page.inner_text("#live-state"), page.inner_text("#live-state"))
    tab.fits()
    page.screenshot(path=folder / f"live-{name}.png")
    # A recording by `magpie record`, ended by a click.
    page.fill("#record-output", "recorded/1")
    page.click("#record-form button[type=submit]")
    page.wait_for_function("() => document.querySelector('#record-lines').innerText.includes('Recording.')")
    # The header is written before the first row; a busy machine takes seconds to start the program.
    table = server.folder / "recorded" / "1" / "hall.csv"
    for _ in range(150):
        if table.exists():
            break
        page.wait_for_timeout(200)
    page.wait_for_timeout(2500)
    page.click("#record-end")
    page.wait_for_function("() => document.querySelector('#record-lines').innerText.includes('has ended')")
    rows = len(table.read_text().splitlines())
    tab.check(rows > 500, f"{rows} rows were recorded: {page.inner_text('#record-lines')}")
    # Recordings that are added are fitted after a click.
    recordings = "#view #recording option"
    tab.check(page.locator(recordings).count() == 3, "not three recordings")
    (server.folder / "campaign" / "3").rename(server.folder / "3")
    tab.act(lambda: page.click("#reload"))
    tab.check(page.locator(recordings).count() == 2, "a removed recording is still shown")
    return tab.wrong


def main():
    magpie, folder = sys.argv[1], Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    bad = False
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        for check in (effects, formula, live):
            for name in SCREENS:
                try:
                    wrong = check(browser, magpie, folder, name)
                except Exception as error:  # The other checks still say something.
                    wrong = [str(error)]
                while Server.running:
                    Server.running[0].end()
                print(f"workbench, {check.__name__}, {name}: {'; '.join(wrong) or 'good'}")
                bad |= bool(wrong)
        browser.close()
    sys.exit(bad)


main()
