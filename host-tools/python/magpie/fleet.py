"""Calibration of many grippers: fit, diagnose and export over campaigns, one table, outliers, trends and control charts.

    python -m magpie.fleet CAMPAIGNS -o FOLDER --workers 2

CAMPAIGNS is a folder of campaigns, on a disk or in an object store (any address of fsspec, such as ``s3://bucket/campaigns``). The
work is distributed by Dask; ``--scheduler`` names a cluster that runs already. Each campaign leaves one result file, so that a run
that was ended goes on where it stopped, and a worker that dies loses nothing; a task that fails is a row, and repeated by the next run; the
exit status is then 1. Files are replaced at once, never changed in place. ``fleet.parquet`` has a row for each parameter,
effect and error; its bytes depend on the campaigns alone. ``results`` keeps the model and the tables of each gripper. ``fleet.html`` shows the control charts.
"""

from __future__ import annotations

import argparse
import base64
import functools
import hashlib
import html
import io
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import fsspec
import numpy
import pandas
import pyarrow
import pyarrow.parquet
from fsspec.implementations.local import LocalFileSystem
from scipy import stats

import magpie

SCHEMA = pyarrow.schema(
    [
        ("campaign", pyarrow.string()),
        ("recorded", pyarrow.string()),
        ("kind", pyarrow.string()),  # parameter, effect, formula, error, problem
        ("sensor", pyarrow.int32()),
        ("name", pyarrow.string()),
        ("value", pyarrow.float64()),
        ("std_error", pyarrow.float64()),
        ("unit", pyarrow.string()),
        ("verdict", pyarrow.string()),
        ("recordings_sha256", pyarrow.string()),
    ]
)
# Family-wise error probability of the outliers, and of the trends.
ALPHA = 0.01
# Effects that at most this share of the grippers have are outliers of these: one gripper is such a share from 1 / RARE grippers on.
RARE = 0.05
# Grippers from which a scatter is estimated.
FEWEST = 10
# Residual in noise floors up to which a field has no unusual error.
USUAL_FLOORS = 1.5
# Number of names on the axis of a chart.
MAX_NAMES = 40
# Name of the row of a task that ended with an error.
FAILED = "failed"
# Of a normal distribution: standard deviation by median absolute deviation.
MAD = 1.4826


def find_campaigns(address: str) -> list[str]:
    """Addresses of the campaigns in a folder: folders of recordings, in the order of their names."""
    files, root = fsspec.core.url_to_fs(address)
    found = files.glob(f"{root.rstrip('/')}/*/*/recording.toml")
    folders = sorted({path.rsplit("/", 2)[0] for path in found})
    return [files.unstrip_protocol(folder) for folder in folders]


def is_campaign(address: str) -> bool:
    """Whether a folder is itself a campaign."""
    files, root = fsspec.core.url_to_fs(address)
    return bool(files.glob(f"{root.rstrip('/')}/*/recording.toml"))


def _name(address: str) -> str:
    return address.rstrip("/").rsplit("/", 1)[-1]


def calibrate(address: str, *, base: str = "cylinder", seed: int = 1) -> tuple[list[dict], dict[str, str]]:
    """Fits, diagnoses and exports one campaign; the rows of the table, and by suffix the model (``.toml``) and the device's tables
    (``.rs``), with the effects that were found. An error of the recordings is a row, too."""
    files, path = fsspec.core.url_to_fs(address)
    with tempfile.TemporaryDirectory(prefix="magpie-fleet-") as folder:
        local = Path(path)
        if not isinstance(files, LocalFileSystem):
            local = Path(folder) / _name(address)
            files.get(path, str(local), recursive=True)
        common = {"campaign": _name(address), "recorded": _recorded(local)}
        try:
            return _rows(local, Path(folder), common, base, seed)
        except magpie.MagpieError as error:
            # Paths of a temporary folder would differ between runs.
            text = str(error).replace(str(local), common["campaign"])
            return [{**common, "kind": "problem", "name": "refused", "verdict": text}], {}


def _recorded(campaign: Path) -> str | None:
    """Date of the first recording."""
    for file in sorted(campaign.glob("*/recording.toml")):
        for line in file.read_text().splitlines():
            key, _, value = line.partition("=")
            if key.strip() == "recorded":
                return value.strip().strip("\"'")
    return None


def _rows(campaign: Path, folder: Path, common: dict, base: str, seed: int) -> tuple[list[dict], dict[str, str]]:
    fitted = magpie.fit(campaign, folder / "model.toml", base=base, seed=seed)
    found = magpie.diagnose(fitted.model, campaign, seed=seed)
    hashes = "".join(recording["sha256"] for recording in fitted.data["provenance"]["recordings"])
    common = {**common, "recordings_sha256": hashlib.sha256(hashes.encode()).hexdigest()}
    rows = []

    def add(kind, name, **values):
        rows.append({**common, "kind": kind, "name": name, **values})

    for finding in found.data["findings"]:
        add("problem", finding["id"], verdict=finding["message"])
    for parameter in fitted.data.get("parameters", []):
        values = {key: parameter[key] for key in ("sensor", "value", "std_error", "unit")}
        add("parameter", parameter["name"], **values)
    for verdict in found.data["verdicts"]:
        values = {key: verdict[key] for key in ("value", "std_error", "unit", "verdict")}
        add("effect", verdict["effect"], **values)
    for formula in found.data["formulas"]:
        text = "; ".join(effect["expression"] for effect in formula["effects"])
        add("formula", formula["name"], verdict=text)
    steps = found.data["staircase"]
    for step, when in [(steps[0], "base"), (steps[-1], "with effects")] if steps else []:
        for name in ("rms_n", "noise_n", "excess_n") if step["force"] else ():
            add("error", name, value=step["force"][name], unit="N", verdict=when)
        add("error", "field_floors", value=step["held_out_rms_g"] / step["floor_g"], verdict=when)
    if base == "polynomial":
        return rows, {".toml": fitted.model.path.read_text()}
    model = _with_effects(fitted, found, campaign, folder)
    tables = magpie.export(model, folder / "tables.rs")
    return rows, {".toml": model.path.read_text(), ".rs": tables.path.read_text()}


def _with_effects(fitted, found, campaign, folder):
    """The model with the effects that were found and that the device compensates."""
    effects = [names[0] for names in found.data["accepted"]]
    effects = [name for name in effects if any(verdict.effect == name for verdict in found.verdicts)]
    while effects:
        edit = magpie.add(fitted.model, campaign, *effects, output=folder / "better.toml")
        try:
            magpie.export(edit.model, folder / "tables.rs")
            return edit.model
        except magpie.MagpieError:
            effects.pop()
    return fitted.model


def _calibrate_to(output: str, base: str, seed: int, address: str) -> None:
    """Calibrates a campaign and writes its result file, if there is none of the same files."""
    files, path = fsspec.core.url_to_fs(address)
    listed = sorted((info["name"], info["size"], str(info.get("mtime", ""))) for info in files.find(path, detail=True).values())
    key = hashlib.sha256(json.dumps([listed, base, seed, magpie.__version__]).encode()).hexdigest()
    results, folder = fsspec.core.url_to_fs(output)
    target = f"{folder}/results/{_name(address)}.json"
    if (known := _result(results, target)) and known["key"] == key:
        return
    rows, written = calibrate(address, base=base, seed=seed)
    results.makedirs(f"{folder}/results", exist_ok=True)
    for suffix, content in written.items():
        _replace(results, target.removesuffix(".json") + suffix, content.encode())
    # Last: a worker that dies before leaves no result.
    _replace(results, target, json.dumps({"key": key, "rows": rows}).encode())


def _result(files, path: str) -> dict | None:
    """The content of a result file; None if there is none, or a damaged one."""
    try:
        found = json.loads(files.cat_file(path))
        return found if isinstance(found, dict) and {"key", "rows"} <= found.keys() else None
    except (FileNotFoundError, ValueError):
        return None


def _replace(files, path: str, content: bytes) -> None:
    """Writes a file so that there is the former or the new one at any time, as in an object store."""
    if not isinstance(files, LocalFileSystem):
        files.pipe_file(path, content)
        return
    with tempfile.NamedTemporaryFile(dir=Path(path).parent, prefix=".magpie-", delete=False) as file:
        try:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
            os.replace(file.name, path)
        except BaseException:
            Path(file.name).unlink(missing_ok=True)
            raise


def run(
    campaigns: Sequence[str],
    output: str,
    *,
    client=None,
    workers: int = 2,
    base: str = "cylinder",
    seed: int = 1,
    progress=None,
) -> pandas.DataFrame:
    """Calibrates campaigns on a Dask cluster and writes ``fleet.parquet``; returns its content.

    ``client``: of a running cluster (default: one of `workers` processes of this machine, each on one core; 0: this process).
    ``progress`` is called with the number done, the number of all, and the seconds since the start.
    """
    names = [_name(address) for address in campaigns]
    if len(set(names)) < len(names):
        raise ValueError("two campaigns have one name; the name is the serial number")
    task = functools.partial(_calibrate_to, output, base, seed)
    started, failed = time.monotonic(), {}
    for done, (address, error) in enumerate(_carried_out(task, campaigns, client, workers), start=1):
        if error is not None:
            failed[_name(address)] = f"{type(error).__name__}: {error}"
        if progress:
            progress(done, len(campaigns), time.monotonic() - started)
    table = collect(output, names, failed)
    files, folder = fsspec.core.url_to_fs(output)
    files.makedirs(folder, exist_ok=True)
    content = io.BytesIO()
    pyarrow.parquet.write_table(table, content, compression="zstd")
    _replace(files, f"{folder}/fleet.parquet", content.getvalue())
    return table.to_pandas()


def _carried_out(task, campaigns: Sequence[str], client, workers: int):
    """Yields each campaign with the error that ended its task, or None."""
    if not client and workers == 0:
        for address in campaigns:
            try:
                task(address)
                yield address, None
            except Exception as error:
                yield address, error
        return
    import dask
    from distributed import Client, LocalCluster, Security, as_completed

    own = None
    if not client:
        # A worker executes what any program of this machine sends to its port: only with the certificate of this run.
        settings = {"protocol": "tls", "security": Security.temporary(), "dashboard_address": None}
        # One core each: more workers, not more threads.
        with dask.config.set({"distributed.nanny.pre-spawn-environ.RAYON_NUM_THREADS": 1}):
            own = LocalCluster(n_workers=workers, threads_per_worker=1, **settings)
        client = Client(own)
    try:
        futures = dict(zip(client.map(task, campaigns, pure=False), campaigns))
        for future in as_completed(futures):
            yield futures[future], future.exception()
    finally:
        if own:
            client.close()
            own.close()


def collect(output: str, names: Iterable[str], failed: Mapping[str, str]) -> pyarrow.Table:
    """The rows of the result files, sorted; of a campaign whose task `failed` its error."""
    files, folder = fsspec.core.url_to_fs(output)
    failed, rows = dict(failed), []
    for name in names:
        if name not in failed and (found := _result(files, f"{folder}/results/{name}.json")):
            rows += found["rows"]
        else:
            failed.setdefault(name, "the result file is missing or damaged: run again")
    rows += [{"campaign": name, "kind": "problem", "name": FAILED, "verdict": error} for name, error in failed.items()]
    rows.sort(key=lambda row: (row["campaign"], row["kind"], row.get("sensor", -1), row["name"], row.get("verdict") or ""))
    return pyarrow.Table.from_pylist(rows, schema=SCHEMA)


def z_scores(values: numpy.ndarray, std_errors: numpy.ndarray) -> numpy.ndarray:
    """Deviations from the median in standard deviations: of the production (robust) and of each value's own error."""
    median = numpy.median(values)
    scatter = MAD * numpy.median(abs(values - median))
    production = max(scatter**2 - numpy.median(std_errors**2), 0.0)
    return (values - median) / numpy.sqrt(numpy.maximum(production + std_errors**2, 1e-300))


def is_tested(table: pandas.DataFrame) -> bool:
    """Whether there are enough grippers to test for outliers."""
    return table.campaign.nunique() >= FEWEST


NOT_TESTED = f"Fewer than {FEWEST} grippers: not tested for outliers."


def outliers(table: pandas.DataFrame) -> pandas.DataFrame:
    """Grippers that differ from the others: parameters, errors, rare effects, and refused recordings.

    Of fewer than ten grippers the problems only: their scatter is not known (`is_tested`).
    """
    found, count = [], table.campaign.nunique()
    parameters = table[(table.kind == "parameter") & numpy.isfinite(table.std_error)]
    groups = list(parameters.groupby(["name", "sensor"])) if count >= FEWEST else []
    limit = stats.norm.isf(ALPHA / 2 / max(len(parameters), 1))
    for (name, sensor), group in groups:
        scores = z_scores(group.value.to_numpy(), group.std_error.to_numpy())
        for row, score in zip(group.itertuples(), scores):
            if abs(score) > limit:
                found.append((row.campaign, int(sensor), name, row.value, row.unit, score))
    errors = table[(table.kind == "error") & (table.verdict == "with effects") & (table.name == "field_floors")]
    if len(errors) >= FEWEST:
        scores = z_scores(numpy.log(errors.value.to_numpy()), numpy.zeros(len(errors)))
        for row, score in zip(errors.itertuples(), scores):
            # What is at the floor is no outlier, however little the others scatter.
            if score > stats.norm.isf(ALPHA / count) and row.value > USUAL_FLOORS:
                found.append((row.campaign, None, "error of the field", row.value, "floors", score))
    effects = table[(table.kind == "formula") | ((table.kind == "effect") & table.verdict.isin(["found", "tied"]))]
    for name, group in effects.groupby(effects.name.where(effects.kind == "effect", "a formula")):
        if count >= FEWEST and group.campaign.nunique() <= RARE * count:
            found += [(row.campaign, None, f"effect {name}", row.value, row.unit, None) for row in group.itertuples()]
    for row in table[table.kind == "problem"].itertuples():
        found.append((row.campaign, None, f"{row.name}: {row.verdict}", None, None, None))
    columns = ["campaign", "sensor", "what", "value", "unit", "z"]
    return pandas.DataFrame(found, columns=columns).sort_values(["campaign", "what"], ignore_index=True)


def common_effects(table: pandas.DataFrame) -> pandas.Series:
    """Share of the grippers in which each effect was found, the most frequent first; not counted where it is tied with others."""
    effects = table[(table.kind == "effect") & (table.verdict == "found")]
    shares = effects.groupby("name").campaign.nunique() / table.campaign.nunique()
    return shares.sort_values(ascending=False)


def trends(table: pandas.DataFrame) -> pandas.DataFrame:
    """Parameters that drift over the serial number (order of the names) or the date of the recording."""
    parameters = table[(table.kind == "parameter") & numpy.isfinite(table.std_error)]
    groups, found = list(parameters.groupby(["name", "sensor"])), []
    for (name, sensor), group in groups:
        group = group.sort_values("campaign")
        orders = {"serial number": numpy.arange(len(group), dtype=float)}
        if group.recorded.notna().all():
            dates = pandas.to_datetime(group.recorded, utc=True, format="mixed")
            orders["date, days"] = (dates - dates.min()).dt.total_seconds().to_numpy() / 86400
        for over, order in orders.items():
            if len(group) < 10 or numpy.ptp(order) == 0:
                continue
            correlation = stats.spearmanr(order, group.value)
            if correlation.pvalue < ALPHA / max(len(groups) * len(orders), 1):
                slope = stats.theilslopes(group.value, order)
                found.append((name, int(sensor), over, slope.slope, slope.low_slope, slope.high_slope, correlation.pvalue))
    return pandas.DataFrame(found, columns=["parameter", "sensor", "over", "slope", "low", "high", "p"])


def page(table: pandas.DataFrame) -> str:
    """Control charts of all parameters, outliers, trends and common effects as an HTML page."""
    from matplotlib.figure import Figure

    strange, count = outliers(table), table.campaign.nunique()
    parts = [f"<h1>Calibration of {count} grippers</h1>"]
    rare = f"An effect is rare, and an outlier, if at most {RARE:.0%} of the grippers have it: in one gripper, of {1 / RARE:.0f} or more."
    tied = "Not counted where a gripper's recordings do not distinguish the effect from others (tied)."
    for heading, frame, note in (
        ("Outliers", strange, rare if is_tested(table) else NOT_TESTED),
        ("Drift", trends(table), ""),
        ("Effects found, share of the grippers", common_effects(table).to_frame("share"), tied),
    ):
        none = "" if note == NOT_TESTED else "<p>None.</p>"
        text = frame.to_html(na_rep="", float_format="{:.4g}".format) if len(frame) else none
        parts.append(f"<h2>{heading}</h2>{text}" + (f"<p>{note}</p>" if note else ""))
    parts.append("<h2>Control charts</h2><p>Bars: one standard error. Lines: median and three robust standard deviations.</p>")
    parameters = table[table.kind == "parameter"]
    names = sorted(parameters.campaign.unique())
    places = {campaign: place for place, campaign in enumerate(names)}
    labelled = range(0, len(names), -(-len(names) // MAX_NAMES) or 1)
    for name, group in parameters.groupby("name"):
        figure = Figure(figsize=(9, 3.2), layout="constrained")
        axes = figure.add_subplot()
        for sensor, own in group.groupby("sensor"):
            own = own.sort_values("campaign")
            median = own.value.median()
            limit = 3 * MAD * (own.value - median).abs().median()
            at = own.campaign.map(places).to_numpy()
            marks = axes.errorbar(at, own.value, own.std_error, fmt=".", ms=4, lw=0.6, label=f"sensor {sensor:.0f}")
            for level, style in ((median, "-"), (median - limit, "--"), (median + limit, "--")):
                axes.axhline(level, color=marks[0].get_color(), ls=style, lw=0.7)
            far = own.campaign.isin(strange[(strange.what == name) & (strange.sensor == sensor)].campaign).to_numpy()
            axes.plot(at[far], own.value[far], "o", mfc="none", ms=9, color="black")
        axes.set(xlabel="gripper", ylabel=f"{name}, {group.unit.iloc[0]}")
        axes.set_xticks(labelled, [names[place] for place in labelled], rotation=90, fontsize="small")
        axes.legend(loc="upper right", fontsize="small")
        content = io.BytesIO()
        figure.savefig(content, format="png", dpi=110)
        image = base64.b64encode(content.getvalue()).decode()
        parts.append(f'<figure><img alt="{html.escape(name)} of all grippers" src="data:image/png;base64,{image}"></figure>')
    style = "body{font:16px system-ui;margin:2em auto;max-width:70em;padding:0 1em}img{max-width:100%}td,th{padding:.2em .6em}"
    return f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Fleet</title><style>{style}</style>{"".join(parts)}</html>'


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; its exit status is 1 if a campaign was not calibrated."""
    parser = argparse.ArgumentParser(prog="python -m magpie.fleet", description=__doc__.partition("\n")[0])
    parser.add_argument("campaigns", nargs="+", help="folders of campaigns, or addresses of fsspec")
    parser.add_argument("-o", "--output", required=True, help="folder for fleet.parquet, fleet.html and the result files")
    parser.add_argument("--workers", type=int, default=2, help="processes of this machine, 0: none but this one (default: %(default)s)")
    parser.add_argument("--scheduler", help="address of a running Dask scheduler instead")
    parser.add_argument("--base", choices=["cylinder", "polynomial"], default="cylinder")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    campaigns = [campaign for address in options.campaigns for campaign in find_campaigns(address)]
    if not campaigns:
        text = f"no campaigns in {', '.join(options.campaigns)}: a campaign is a folder of recordings with a recording.toml each"
        own = [address for address in options.campaigns if is_campaign(address)]
        parser.error(f"{text}; {own[0]} is itself a campaign: give its parent folder" if own else text)
    client = None
    if options.scheduler:
        from distributed import Client

        client = Client(options.scheduler)
    shown_s = [0.0]

    def progress(done, total, passed_s):
        if passed_s - shown_s[0] >= 10 or done == total:
            shown_s[0] = passed_s
            print(f"{done} of {total} campaigns, {passed_s * (total - done) / done:.0f} s left", file=sys.stderr)

    settings = {"workers": options.workers, "base": options.base, "seed": options.seed}
    table = run(campaigns, options.output, client=client, progress=progress, **settings)
    files, folder = fsspec.core.url_to_fs(options.output)
    _replace(files, f"{folder}/fleet.html", page(table).encode())
    strange = outliers(table)
    if len(strange):
        print(strange.to_string(index=False))
    if not is_tested(table):
        print(NOT_TESTED)
    elif not len(strange):
        print("No outliers.")
    print(f"\n{table.campaign.nunique()} grippers; written: {options.output}/fleet.parquet, {options.output}/fleet.html")
    failed = int(((table.kind == "problem") & (table.name == FAILED)).sum())
    if failed:
        print(f"{failed} of {len(campaigns)} campaigns failed; run again to repeat them", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
