"""Times the commands next to what other programs take for the same work, and how their cost grows. Writes tests/speed/RESULTS.md.

    run.py MAGPIE [--only WORD...] [--quick] [--growth-s SECONDS] [--results FOLDER]

Every figure is a ratio within one run. Times are of one machine and are asserted nowhere.
"""

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.csv

ROOT = Path(__file__).resolve().parents[3]
DATA = ROOT / "tests" / "data" / "clean"
ANCHORS = Path(__file__).with_name("anchors.py")


@dataclass
class Measured:
    wall_s: float
    cpu_s: float
    peak_mb: float
    output: str

    @property
    def json(self):
        return json.loads(self.output)


class Peak(threading.Thread):
    """Peak memory of a process since it began its program; ru_maxrss would count this interpreter, of which it is a copy at first."""

    def __init__(self, pid):
        super().__init__(daemon=True)
        self.pid, self.mb = pid, 0.0
        self.start()

    def run(self):
        own = Path("/proc/self/cmdline").read_bytes()
        while True:
            try:
                is_begun = Path(f"/proc/{self.pid}/cmdline").read_bytes() != own
                lines = Path(f"/proc/{self.pid}/status").read_text().splitlines()
            except OSError:
                return
            found = [line.split()[1] for line in lines if line.startswith("VmHWM")]
            if not found:
                return
            if is_begun:
                self.mb = int(found[0]) / 1024
            time.sleep(0.005)


def measure(words, cores=None, rounds=1, folder=None, **environment):
    """Shortest wall time of a program, on the first `cores` cores if given."""
    best = None
    for _ in range(rounds):
        limit = None if cores is None else lambda: os.sched_setaffinity(0, set(sorted(os.sched_getaffinity(0))[:cores]))
        with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as errors:
            start = time.perf_counter()
            child = subprocess.Popen(
                list(map(str, words)), stdout=out, stderr=errors, cwd=folder, env=os.environ | environment, preexec_fn=limit
            )
            peak = Peak(child.pid)
            _, status, used = os.wait4(child.pid, 0)
            wall_s = time.perf_counter() - start
            peak.join()
            child.returncode = os.waitstatus_to_exitcode(status)
            if child.returncode:
                errors.seek(0)
                raise RuntimeError(f"{' '.join(map(str, words))}: status {child.returncode}\n{errors.read()[-2000:]}")
            out.seek(0)
            measured = Measured(wall_s, used.ru_utime + used.ru_stime, peak.mb, out.read())
        if best is None or measured.wall_s < best.wall_s:
            best = measured
    return best


def anchor(*words, cores=1):
    """What an anchor states; one core, unless more are given."""
    threads = {name: str(cores) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
    return measure([sys.executable, ANCHORS, *words], cores=cores, **threads).json


def make_campaign(folder, seconds, recordings=3, sensors=4):
    """Recordings of `seconds` each at 1 kHz: those of the tests forwards and backwards, with other noise in the last bit."""
    rng = np.random.default_rng(round(1000 * seconds))
    for number in range(recordings):
        source = DATA / str(number % 3 + 1)
        target = folder / str(number + 1)
        target.mkdir(parents=True)
        for name in ("hall", "force"):
            table = pyarrow.csv.read_csv(next(source.glob(f"{name}.csv*")))
            kept = [c for c in table.column_names if c[:2] not in [f"{'sf'[name == 'force']}{s}" for s in range(sensors, 4)]]
            columns = {column: table[column].to_numpy() for column in kept}
            step_us = int(np.median(np.diff(columns["t_us"])))
            rows, count = len(columns["t_us"]), int(seconds * 1e6 / step_us) + 1
            order = np.concatenate([np.arange(rows), np.arange(rows - 2, 0, -1)])
            order = np.resize(order, count)
            made = {column: values[order] for column, values in columns.items()}
            made["t_us"] = np.arange(count) * step_us
            for column in kept:
                if column.endswith("_lsb"):
                    made[column] = made[column] + rng.integers(0, 2, count)
            with pyarrow.CompressedOutputStream(str(target / f"{name}.csv.gz"), "gzip") as out:
                options = pyarrow.csv.WriteOptions(quoting_style="none")
                pyarrow.csv.write_csv(pyarrow.table(made), out, options)
        text = (source / "recording.toml").read_text()
        lines = [line for line in text.splitlines() if not line.startswith("start_s")]
        (target / "recording.toml").write_text("\n".join([lines[0], f"start_s = {number * (seconds + 60):.1f}", *lines[1:]]) + "\n")
    return folder


class Bench:
    def __init__(self, magpie, work, quick):
        self.magpie, self.work, self.quick = magpie, work, quick
        self.rows = []
        self.growth = []

    def run(self, *words, **options):
        return measure([self.magpie, *words], folder=self.work, **options)

    def add(self, work, ours_s, other, other_s, ratio, unit, goal, remark=""):
        """A row; `goal` is the least ratio that is wanted, None where only the figure is."""
        self.rows.append((work, ours_s, other, other_s, f"{ratio:.3g} {unit}", goal, ratio, remark))
        wanted = "" if goal is None else f", wanted {goal:g}{'' if ratio >= goal else ': NOT MET'}"
        print(f"{work}: {ratio:.3g} {unit}{wanted}. {remark}", flush=True)

    def faster(self, work, ours_s, other, other_s, goal=None, remark=""):
        """The other's time relative to ours."""
        self.add(work, ours_s, other, other_s, other_s / ours_s, "times as fast", goal, remark)

    def real_time(self, work, ours_s, virtual_s, goal=None, remark=""):
        """Recorded or virtual time relative to ours."""
        self.add(work, ours_s, "real time", virtual_s, virtual_s / ours_s, "times real time", goal, remark)

    def campaign(self, seconds=30.0, recordings=3, sensors=4):
        folder = self.work / f"campaign-{recordings}x{seconds:g}x{sensors}"
        return folder if folder.exists() else make_campaign(folder, seconds, recordings, sensors)

    def model(self):
        path = self.work / "model.toml"
        if not path.exists():
            self.run("fit", self.campaign(), "-o", path)
        return path

    # Each group can be chosen by its name.

    def replay(self):
        campaign, model, recorded_s = self.campaign(), self.model(), 90.0
        network = self.work / "network.safetensors"
        self.run("train", model, campaign, "--quick", "--epochs", "1", "--hidden", "16", "-o", network)
        loadtxt, gunzip = anchor("loadtxt", campaign)["seconds"], anchor("gunzip", campaign)["seconds"]
        centres = self.run("dev", "export", model, "-o", self.work / "tables.rs", "--json").json["centres"]
        rbf = anchor("rbf", campaign, centres)["seconds"]
        for cores, name, goal in ((None, "all cores", 1500), (1, "one core", 900)):
            whole = self.run("replay", model, campaign, "--json", cores=cores, rounds=3)
            self.real_time(f"replay, {name}", whole.wall_s, recorded_s, goal, f"{whole.peak_mb:.0f} MB")
            self.faster(f"replay, {name}", whole.wall_s, "numpy.loadtxt of its files", loadtxt, 2)
            self.faster(f"replay, {name}", whole.wall_s, "gzip of its files", gunzip)
            self.faster(f"replay, {name}", whole.wall_s, "the RBFs in NumPy (float64)", rbf)
        whole = self.run("replay", model, campaign, "--network", network, "--json", cores=1, rounds=2)
        self.real_time("replay with four networks, one core", whole.wall_s, recorded_s, 400)

    def fit(self):
        campaign = self.campaign()
        whole = self.run("fit", campaign, "-o", self.work / "fit.toml", "--json", rounds=3)
        other = anchor("fit", campaign)
        remark = f"ours with cross-validation and error bars, {whole.json['held_out_rms_g']:.3f} G held out; theirs one fit, {other['rms_g']:.3f} G"
        self.faster("fit, 3 x 30 s", whole.wall_s, "SciPy with MagpyLib", other["seconds"], remark=remark)
        if not self.quick:
            campaign = self.campaign(450.0, 2)
            whole = self.run("fit", campaign, "-o", self.work / "long.toml", "--json")
            loadtxt = anchor("loadtxt", campaign)["seconds"]
            self.faster("fit, 2 x 450 s", whole.wall_s, "numpy.loadtxt of its files", loadtxt, remark=f"{whole.peak_mb:.0f} MB")

    def diagnose(self):
        campaign = self.campaign()
        whole = self.run("diagnose", self.model(), campaign, "--json", rounds=2)
        self.real_time("diagnose, 3 x 30 s without an effect", whole.wall_s, 90.0, remark=f"CPU {whole.cpu_s:.1f} s")

    def training(self):
        campaign = self.campaign(100.0 if not self.quick else 20.0)
        epochs = 6 if not self.quick else 2
        model = self.model()
        options = ["--hidden", "16", "--epochs", epochs, "--json"]
        whole = self.run("train", model, campaign, *options, "-o", self.work / "trained.safetensors")
        error = np.sqrt(np.mean([row["rmse_n"] ** 2 for row in whole.json["sensors"]]))
        other = anchor("train", campaign, 16, epochs, cores=os.cpu_count())
        remark = f"held out {error:.2f} N, theirs {other['rmse_n']:.2f} N; ours with reading and replay"
        self.faster(f"train, 3 x {100 if not self.quick else 20} s, hidden 16, {epochs} epochs", whole.wall_s, "PyTorch", other["seconds"], 2, remark)

    def design(self):
        count = 10_000 if not self.quick else 1_000
        whole = self.run("design", "sweep", "--count", count, "--json")
        other = anchor("sweep", count)
        self.faster(f"design sweep of {count}", whole.wall_s, "the same number of mounting errors by MagpyLib", other["seconds"])

    def field(self):
        words = ["cargo", "bench", "--quiet", "--locked", "--package", "tests", "--bench", "field"]
        line = measure(words, folder=ROOT, PYTHON=sys.executable).output.strip().splitlines()[-1]
        ratio = float(line.split(" times MagpyLib")[0].split()[-1])
        self.add("field of the cylinder, one core", None, "MagpyLib", None, ratio, "times as fast", 8)

    def closed_loop(self):
        whole = self.run("grasp", "--force", "100", "-o", self.work / "grasp.html", "--json", rounds=3)
        virtual_s = max(point["time_s"] for point in whole.json["points"])
        self.real_time("grasp in virtual time", whole.wall_s, virtual_s, 60)

    def faults(self):
        if not self.quick:
            whole = self.run("fault-campaign", "--json")
            self.add("fault campaign", whole.wall_s, "its CPU time", whole.cpu_s, whole.cpu_s / whole.wall_s, "cores busy", None)

    def grow(self, command, over, point, measured):
        self.growth.append((command, over, point, measured.wall_s, measured.peak_mb))
        print(f"{command} over {over} {point:g}: {measured.wall_s:.2f} s, {measured.peak_mb:.0f} MB", flush=True)

    def grows(self, longest_s):
        """Time and memory over seconds of recording, sensors, effects, designs and grippers."""
        model = self.model()
        lengths = [length for length in (3, 10, 30, 100, 300, 1000, 3000, 10_000) if length <= longest_s]
        for total_s in lengths:
            campaign = self.campaign(total_s / 3)
            for command, words in self.commands(model, campaign).items():
                self.grow(command, "seconds of recording", total_s, self.run(*words))
        for sensors in (1, 2, 3, 4):
            campaign = self.campaign(30.0, 3, sensors)
            own = self.work / f"model-{sensors}.toml"
            self.run("fit", campaign, "-o", own)
            for command, words in self.commands(own, campaign).items():
                self.grow(command, "sensors", sensors, self.run(*words))
        effects = ["geometric_stiffening", "cross_coupling", "sensor_temperature", "motor_leakage", "earth_field", "neighbour_magnet"]
        for count in range(1, len(effects) + 1):
            words = ["add", model, self.campaign(), *effects[:count], "-o", self.work / f"with-{count}.toml"]
            self.grow("add", "effects", count, self.run(*words))
            self.grow("replay", "effects", count, self.run("replay", self.work / f"with-{count}.toml", self.campaign()))
        for count in (300, 1_000, 3_000, 10_000):
            self.grow("design sweep", "designs", count, self.run("design", "sweep", "--count", count, "--json"))

        package = self.package()
        for grippers in (1, 2, 4, 8):
            campaigns = self.work / f"fleet-{grippers}"
            campaigns.mkdir()
            for gripper in range(grippers):
                shutil.copytree(self.campaign(10.0), campaigns / f"gripper-{gripper}")
            words = [sys.executable, "-m", "magpie.fleet", campaigns, "-o", self.work / f"fleet-{grippers}-results", "--workers", "1"]
            self.grow("fleet", "grippers", grippers, measure(words, PYTHONPATH=str(package)))

    def package(self):
        """Folder of the Python package with its library."""
        words = ["cargo", "build", "--quiet", "--release", "--locked", "--package", "magpie-python", "--message-format", "json"]
        artifacts = [json.loads(line) for line in measure(words, folder=ROOT).output.splitlines()]
        files = [file for artifact in artifacts if artifact.get("target", {}).get("name") == "_magpie" for file in artifact["filenames"]]
        folder = self.work / "package"
        shutil.copytree(ROOT / "host-tools" / "python" / "magpie", folder / "magpie")
        shutil.copy(next(file for file in files if file.endswith((".so", ".dylib"))), folder / "magpie" / "_magpie.abi3.so")
        return folder

    def commands(self, model, campaign):
        network = self.work / "grown.safetensors"
        return {
            "fit": ["fit", campaign, "-o", self.work / "grown.toml"],
            "replay": ["replay", model, campaign],
            "compare": ["compare", model, campaign],
            "diagnose": ["diagnose", model, campaign],
            "train, one epoch": ["train", model, campaign, "--epochs", "1", "--hidden", "16", "-o", network],
        }


def exponents(growth):
    """Exponent of time over the last three points of each curve, where they are beyond the start of the program."""
    curves = {}
    for command, over, point, wall_s, peak_mb in growth:
        curves.setdefault((command, over), []).append((point, wall_s, peak_mb))
    rows = []
    for (command, over), points in curves.items():
        last = np.log(np.array(points[-3:]))
        slope = lambda column: np.polyfit(last[:, 0], last[:, column], 1)[0] if len(points) > 2 else np.nan
        first, end = points[0], points[-1]
        rows.append((command, over, first, end, slope(1), slope(2)))
    return rows


def plot(growth, path):
    import matplotlib

    matplotlib.use("svg")
    # Text as text: a hundredth of the bytes of its outlines.
    matplotlib.rcParams |= {"svg.hashsalt": "speed", "svg.fonttype": "none"}
    import matplotlib.pyplot as plt

    overs = list(dict.fromkeys(over for _, over, *_ in growth))
    figure, axes = plt.subplots(2, len(overs), figsize=(4 * len(overs), 7), layout="constrained", squeeze=False)
    for column, over in enumerate(overs):
        commands = dict.fromkeys(command for command, own, *_ in growth if own == over)
        for command in commands:
            points = np.array([row[2:] for row in growth if row[:2] == (command, over)])
            for place, unit in ((1, "time, s"), (2, "peak memory, MB")):
                axis = axes[place - 1, column]
                axis.loglog(points[:, 0], points[:, place], marker="o", ms=3, label=command)
                axis.set(xlabel=over, ylabel=unit)
                axis.grid(alpha=0.3)
        axes[0, column].legend(fontsize="small")
    figure.savefig(path, metadata={"Date": None})


def cpu_name():
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.split(":")[1].strip()
    return platform.machine()


def report(bench, groups):
    version = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True).stdout.strip()
    lines = [
        "# Speed",
        "",
        f"Written by `cargo bench --package host-tools --bench speed`, {time.strftime('%Y-%m-%d')}, commit {version}, {cpu_name()},",
        f"{len(os.sched_getaffinity(0))} cores. Groups: {', '.join(groups)}. Every ratio is of times of this run; times of other machines differ. The",
        "recordings are those of `tests/data/clean`, repeated forwards and backwards to the length stated, four sensors at 1 kHz.",
        "",
        "| work | time | compared with | its time | ratio | wanted, at least | met | remark |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    text = lambda seconds: "" if seconds is None else f"{seconds:.3g} s"
    for work, ours_s, other, other_s, shown, goal, ratio, remark in bench.rows:
        wanted, met = ("", "") if goal is None else (f"{goal:g}", "yes" if ratio >= goal else "**no**")
        lines.append(f"| {work} | {text(ours_s)} | {other} | {text(other_s)} | {shown} | {wanted} | {met} | {remark} |")
    if bench.growth:
        lines += [
            "",
            "## Growth",
            "",
            "Exponents of time and peak memory over the last three points; 1 is proportional.",
            "",
            "![Time and memory](growth.svg)",
            "",
            "| command | over | from | to | time | memory | exponent of time | of memory |",
            "| --- | --- | --- | --- | --- | --- | --- | --- |",
        ]
        for command, over, first, end, of_time, of_memory in exponents(bench.growth):
            lines.append(
                f"| {command} | {over} | {first[0]:g} | {end[0]:g} | {first[1]:.2f} to {end[1]:.2f} s | {first[2]:.0f} to {end[2]:.0f} MB | "
                f"{of_time:.2f} | {of_memory:.2f} |"
            )
    return "\n".join(lines) + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("magpie", type=Path)
    names = ["replay", "fit", "diagnose", "training", "design", "field", "closed_loop", "faults", "growth"]
    parser.add_argument("--only", nargs="+", choices=names, default=names, help="groups (default: all)")
    parser.add_argument("--quick", action="store_true", help="shorter recordings; not comparable with the goals")
    parser.add_argument("--growth-s", type=float, default=1000.0, help="longest recording of the growth (default: %(default)g s)")
    parser.add_argument("--results", type=Path, help="folder of RESULTS.md and growth.svg (default: tests/speed for a whole run)")
    parser.add_argument("--bench", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="magpie-speed-") as folder:
        bench = Bench(options.magpie.resolve(), Path(folder), options.quick)
        for place, name in enumerate(options.only, start=1):
            print(f"[{place} of {len(options.only)}] {name}", flush=True)
            if name == "growth":
                bench.grows(30.0 if options.quick else options.growth_s)
            else:
                getattr(bench, name)()
    written = report(bench, options.only)
    results = options.results and ROOT / options.results
    if results is None and not options.quick and options.only == names:
        results = ROOT / "tests" / "speed"
    if results is None:
        print(written)
        return
    results.mkdir(parents=True, exist_ok=True)
    if bench.growth:
        plot(bench.growth, results / "growth.svg")
    (results / "RESULTS.md").write_text(written)
    print(f"Written to {results / 'RESULTS.md'}.")


if __name__ == "__main__":
    main()
