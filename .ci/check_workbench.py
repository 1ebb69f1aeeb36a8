#!/usr/bin/env python3
"""The workbench in a real browser: usage check_workbench.py MAGPIE FOLDER

Adds effects and formulas, undoes and redoes, compares, writes; a wrong formula, a second tab, a campaign that is removed
meanwhile. Tables of another logger become a campaign and a model. Nothing may be written to the console, and the page may not
scroll sideways. Leaves screenshots in FOLDER.
"""

import contextlib
import csv
import gzip
import json
import shutil
import subprocess
import sys
import tempfile
import time
from itertools import product
from pathlib import Path

from browser import SHOWN_MS, Page, chromium
from playwright.sync_api import expect

MAGPIE, PICTURES = sys.argv[1], Path(sys.argv[2])
# Colours on each screen.
SCHEMES = {"laptop": "light", "telephone": "dark"}
DATA = Path("tests/data")
RIPPLE = "own: dz_um = a*sin(motor_angle_rad) + b*cos(motor_angle_rad)"
# Whether a model with these effects is shown.
IS_SHOWN = """expected => {
    const effects = [...document.querySelectorAll('#present li[data-effect]')].map(one => one.dataset.effect);
    return document.querySelector('#view').ariaBusy === 'false' && effects.join() === expected;
}"""
HAS_TEXT = "([selector, text]) => document.querySelector(selector).innerText.includes(text)"


# Column of another logger, and that of the recording with its factor.
FOREIGN = {"t [ms]": ("t_us", 1e-3), "Temp0": ("s0_temp_c", 1), "width (um)": ("opening_mm", 1e3)}
FOREIGN |= {f"Mag0{axis} [mT]": (f"s0_{axis}_lsb", 0.0125) for axis in "xyz"}
FOREIGN |= {f"Load0_{axis} (g)": (f"f0_{axis}_n", 1 / 9.80665e-3) for axis in "xz"}
DESIGN = {"gap_mm": 1.5, "stiffness_x_n_per_mm": 500, "stiffness_z_n_per_mm": 800, "force_range_n": 250}
DESIGN |= {"diameter_mm": 3, "length_mm": 2, "remanence_t": 1.2}


def foreign_tables(campaign, folder):
    """The first sensor of each recording, with both sides in one table."""
    names = []
    for recording in sorted((DATA / campaign).iterdir()):
        tables = []
        for side in ("hall", "force"):
            with gzip.open(recording / f"{side}.csv.gz", "rt") as file:
                tables.append(list(csv.DictReader(file)))
        forces = {row["t_us"]: row for row in tables[1]}
        names.append(f"run{recording.name}.csv")
        with open(folder / names[-1], "w") as file:
            writer = csv.writer(file, delimiter=";")
            writer.writerow(FOREIGN)
            for row in tables[0]:
                both = row | forces.get(row["t_us"], {})
                writer.writerow([format(float(both[of]) * factor, ".5f") if of in both else "" for of, factor in FOREIGN.values()])
    return names


@contextlib.contextmanager
def server(campaign, *options, is_foreign=False):
    """Folder and address of `magpie workbench` in a folder of its own."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(DATA / campaign, folder / "campaign")
        paths = foreign_tables(campaign, folder) if is_foreign else ["campaign"]
        command = [MAGPIE, "workbench", *paths, "--json", *options]
        with subprocess.Popen(command, cwd=name, stdout=subprocess.PIPE, text=True) as process:
            try:
                yield Path(name), json.loads(process.stdout.readline())["url"]
            finally:
                process.kill()


class Tab(Page):
    def __init__(self, browser, url, screen="laptop", has_model=True):
        super().__init__(browser, url, "/".join(url.split("/")[:3]), screen, SCHEMES[screen])
        if has_model:
            self.wait_for_model()

    def wait_for_model(self, *effects):
        self.page.wait_for_function(IS_SHOWN, arg=",".join(effects))

    def wait_for_text(self, selector, text):
        # In each frame: some texts are shown for a moment.
        self.page.wait_for_function(HAS_TEXT, arg=[selector, text])

    def picture(self, name):
        self.check_width()
        self.page.screenshot(path=PICTURES / f"{name}.png")


def effects(tab, folder, screen):
    both = ["magnet_temperature", "hysteresis"]
    page = tab.page
    tab.check_width()
    explores(tab)

    # The prediction under the pointer or with the keyboard, then the effect itself.
    page.focus("#candidates li[data-effect=magnet_temperature] button")
    tab.check(page.inner_text("#predicted").endswith(" N"), "no prediction for the effect in focus")
    page.keyboard.press("Enter")
    tab.wait_for_model("magnet_temperature")
    page.click("#candidates li[data-effect=hysteresis] button")
    tab.wait_for_model(*both)
    tab.check("B: base" in page.inner_text("#view"), "the base is not shown next to it")
    tab.check(page.locator("#plots svg path.curve").count() > 4, "no curves over time")
    tab.picture(screen)
    headline = page.inner_text("#headline")
    page.click("#undo")
    tab.wait_for_model("magnet_temperature")
    page.keyboard.press("Control+z")
    tab.wait_for_model()
    tab.check(page.is_disabled("#undo"), "undo goes on before the first model")
    page.click("#redo")
    tab.wait_for_model("magnet_temperature")
    page.keyboard.press("Control+Shift+z")
    tab.wait_for_model(*both)
    tab.check(page.inner_text("#headline") == headline, "redo shows another model")
    # Any two models side by side.
    page.select_option("#baseline", label="magnet_temperature")
    tab.wait_for_text("#view", "A: magnet_temperature")
    writes(tab, folder)

    # A page that is loaded again shows the same model, with its history; a second tab has models of its own.
    page.reload()
    tab.wait_for_model(*both)
    tab.check(page.is_enabled("#undo"), "no undo after loading again")
    other = Tab(page.context.browser, page.url)
    other.page.click("#candidates li[data-effect=hysteresis] button")
    other.wait_for_model("hysteresis")
    tab.wait_for_model(*both)

    # The recordings are gone, and come back.
    (folder / "campaign").rename(folder / "away")
    tab.expected_errors = 1
    page.click("summary:has-text('Not significant')")
    page.click("#others li:first-child button")
    tab.wait_for_text("#error", "campaign")
    tab.wait_for_model(*both)
    (folder / "away").rename(folder / "campaign")
    page.click("#present li[data-effect=hysteresis] button")
    tab.wait_for_model("magnet_temperature")
    tab.wrong += other.wrong


def explores(tab):
    """The scatter follows the stretch of the plots over time; findings can be added; a click cancels what takes long."""
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
    tab.wait_for_text("#diagnosis-result", "cancelled")
    tab.check(page.is_hidden("#cancel"), "what was cancelled goes on")


def writes(tab, folder):
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
        command = line.replace("cargo magpie", MAGPIE)
        done = subprocess.run(command, shell=True, cwd=folder, capture_output=True, text=True)
        tab.check(done.returncode == 0, f"{line}: {done.stderr}")


def formula(tab, _, screen):
    page = tab.page
    tab.expected_errors = 1
    page.fill("#formula", "own: dz_um = a*sin(motor_angel_rad)")
    page.press("#formula", "Enter")
    tab.wait_for_text("#error", "did you mean motor_angle_rad")
    tab.check("^" in page.inner_text("#error"), "the error does not show its place")
    tab.wait_for_model()
    # Names are completed while typing, and inserted by a click.
    page.fill("#formula", "")
    page.type("#formula", "own: dz_um = a*motor_ang")
    words = page.locator("#words option").evaluate_all("all => all.map(one => one.value)")
    tab.check("own: dz_um = a*motor_angle_rad" in words, f"completions: {words}")
    page.click("summary:has-text('Names for formulas')")
    page.click("#names button:text-is('motor_angle_rad')")
    tab.check(page.input_value("#formula").endswith("a*motor_angle_rad"), f"inserted: {page.input_value('#formula')}")
    page.fill("#formula", RIPPLE)
    page.press("#formula", "Enter")
    tab.wait_for_model("own")
    tab.picture(f"formula-{screen}")


def live(tab, folder, screen):
    page = tab.page
    # Repeated grasps: the forces change.
    expect(page.locator("#live-sensors tr")).to_have_count(4, timeout=SHOWN_MS)
    force = "document.querySelector('#live-sensors td:nth-child(2)').innerText"
    page.wait_for_function(f"() => Math.abs(parseFloat({force})) > 5")
    tab.wait_for_text("#live-state", "1000 ticks per second")
    tab.check("no faults" in page.inner_text("#live-state"), page.inner_text("#live-state"))
    tab.picture(f"live-{screen}")
    # A recording by `magpie record`, ended by a click.
    page.fill("#record-output", "recorded/1")
    page.click("#record-form button[type=submit]")
    tab.wait_for_text("#record-lines", "Recording.")
    # The header is written before the first row; a busy machine takes seconds to start the program.
    table = folder / "recorded/1/hall.csv"
    for _ in range(150):
        if not table.exists():
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
    page.click("#reload")
    expect(recordings).to_have_count(2, timeout=SHOWN_MS)
    # Time in which the page would ask about the recording that is gone.
    page.wait_for_timeout(1000)


def imports(tab, folder, screen):
    page, began = tab.page, time.monotonic()
    tab.check(page.locator("#columns svg path").count() == len(FOREIGN), "not a plot of each column")
    page.select_option("[name=geometry]", "known")
    tab.check_width()
    page.click("#import")
    tab.check(not list(folder.glob("*campaign-*")), "imported without a gap")
    for name, value in DESIGN.items():
        page.fill(f"[name={name}]", str(value))
    tab.picture(f"import-{screen}")
    page.fill("[name=campaign]", "campaign")
    tab.expected_errors = 1
    page.click("#import")
    tab.wait_for_text("#error", "it is not overwritten")
    tab.check("wrong" in page.locator("label:has([name=campaign])").get_attribute("class"), "the field is not marked")
    page.fill("[name=campaign]", "bench")
    page.click("#import")
    # Without notes the workbench appears by itself.
    page.wait_for_selector("#open:visible, #present")
    if page.is_visible("#open"):
        tab.picture(f"imported-{screen}")
        page.click("#open")
    tab.wait_for_model()
    page.click("#diagnose")
    page.click("#diagnosis-result li button:has-text('Add hysteresis')")
    tab.wait_for_model("hysteresis")
    page.click("#write-form button")
    tab.wait_for_text("#written", "model.toml")
    print(f"from tables to a model: {time.monotonic() - began:.0f} s")
    tab.check((folder / "bench.mapping.toml").exists(), "no mapping file")
    commands = page.text_content("#commands").splitlines()
    tab.check(commands[0].startswith("cargo magpie import bench.mapping.toml run1.csv"), f"commands: {commands}")
    again = commands[0].replace("cargo magpie", MAGPIE).replace("-o bench", "-o again")
    subprocess.run(again, shell=True, cwd=folder, check=True, capture_output=True)


CHECKS = ((effects, "friction"), (formula, "ripple"), (live, "ripple", "--virtual"), (imports, "friction"))
good = True
PICTURES.mkdir(parents=True, exist_ok=True)
with chromium() as browser:
    for (check, *options), screen in product(CHECKS, SCHEMES):
        try:
            is_foreign = check is imports
            with server(*options, is_foreign=is_foreign) as (folder, url):
                tab = Tab(browser, url, screen, has_model=not is_foreign)
                check(tab, folder, screen)
            wrong = tab.wrong
        except Exception as error:  # The other checks still say something.
            wrong = [str(error)]
        print(f"workbench, {check.__name__}, {screen}: {'; '.join(wrong) or 'good'}", flush=True)
        good &= not wrong
sys.exit(not good)
