"""Calibration of a fleet: a worker that dies, a run that goes on, and grippers that differ from the others."""

import gzip
import os
import shutil
import signal

import fsspec
import numpy
import pandas
import pytest
from distributed import Client, LocalCluster

import magpie
from magpie import fleet

COUNT, WEAK, DEAD = 14, 5, 9


def rewrite(campaign, change):
    """Changes the columns of the board's tables."""
    for path in campaign.glob("*/hall.csv.gz"):
        table = pandas.read_csv(path)
        change(table)
        with gzip.open(path, "wt", newline="") as file:
            table.to_csv(file, index=False)


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory):
    root = tmp_path_factory.mktemp("fleet")
    for number in range(COUNT):
        options = {"recordings": 2, "seconds": 5.0, "sensors": 1, "seed": 100 + number}
        folder = root / "campaigns" / f"g{number:02}"
        folder.parent.mkdir(exist_ok=True)
        magpie.simulate(folder, truth=root / f"truth-{number}.toml", **options)

    def weaken(table):
        fields = [f"s0_{axis}_lsb" for axis in "xyz"]
        table[fields] = (0.75 * table[fields]).round().astype(int)

    rewrite(root / "campaigns" / f"g{WEAK:02}", weaken)
    rewrite(root / "campaigns" / f"g{DEAD:02}", lambda table: table.__setitem__("s0_y_lsb", 0))
    return root / "campaigns"


def test_a_killed_worker_loses_and_repeats_nothing(campaigns, tmp_path):
    found = fleet.find_campaigns(str(campaigns))
    assert [address.rsplit("/", 1)[-1] for address in found] == [f"g{number:02}" for number in range(COUNT)]
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:

        def kill_one(done, total, passed_s):
            if done == 2:
                os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)

        table = fleet.run(found, str(tmp_path / "killed"), client=client, progress=kill_one)
    assert table.campaign.nunique() == COUNT
    assert not table.duplicated(["campaign", "kind", "sensor", "name", "verdict"]).any()
    # Without a cluster, and with all but three of the results of a run that was ended.
    kept = tmp_path / "one" / "results"
    kept.mkdir(parents=True)
    for file in sorted((tmp_path / "killed" / "results").glob("*.json"))[3:]:
        (kept / file.name).write_bytes(file.read_bytes())
    times = {file.name: file.stat().st_mtime_ns for file in kept.iterdir()}
    fleet.run(found, str(tmp_path / "one"), workers=0)
    assert times.items() <= {file.name: file.stat().st_mtime_ns for file in kept.iterdir()}.items()
    tables = [(tmp_path / run / "fleet.parquet").read_bytes() for run in ("killed", "one")]
    assert tables[0] == tables[1]


def test_campaigns_and_results_may_be_in_an_object_store(campaigns, tmp_path):
    store = fsspec.filesystem("memory")
    for name in ("g00", "g01"):
        store.put(str(campaigns / name), f"/fleet/campaigns/{name}", recursive=True)
    found = fleet.find_campaigns("memory://fleet/campaigns")
    table = fleet.run(found, "memory://fleet/out", workers=0)
    local = fleet.run([str(campaigns / name) for name in ("g00", "g01")], str(tmp_path), workers=0)
    pandas.testing.assert_frame_equal(table, local)
    assert store.exists("/fleet/out/fleet.parquet")
    for suffix, content in ((".json", "rows"), (".toml", 'campaign = "g01"'), (".rs", "static SENSORS")):
        assert content in store.cat_file(f"/fleet/out/results/g01{suffix}").decode()


def test_a_task_that_fails_is_a_row_and_not_the_end(campaigns, tmp_path, monkeypatch):
    calibrate = fleet.calibrate

    def fail_once(address, **options):
        if address.endswith("g01"):
            raise MemoryError("too large")
        return calibrate(address, **options)

    monkeypatch.setattr(fleet, "calibrate", fail_once)
    addresses = [str(campaigns / name) for name in ("g00", "g01")]
    table = fleet.run(addresses, str(tmp_path), workers=0)
    (row,) = table[table.campaign == "g01"].itertuples()
    assert (row.kind, row.verdict) == ("problem", "MemoryError: too large")
    monkeypatch.undo()
    table = fleet.run(addresses, str(tmp_path), workers=0)
    assert len(table[table.campaign == "g01"]) > 20


def test_a_damaged_result_is_repeated_and_a_failure_is_the_exit_status(campaigns, tmp_path, monkeypatch, capsys):
    few, out = tmp_path / "few", tmp_path / "out"
    for name in ("g00", "g01"):
        shutil.copytree(campaigns / name, few / name)
    arguments = [str(few), "-o", str(out), "--workers", "0"]
    assert fleet.main(arguments) == 0
    files = ["fleet.parquet", "results/g00.json", "results/g01.json"]
    whole = [(out / name).read_bytes() for name in files]
    for torn in (b"", whole[2][: len(whole[2]) // 2], b"[]"):
        (out / files[2]).write_bytes(torn)
        assert fleet.main(arguments) == 0
        assert [(out / name).read_bytes() for name in files] == whole
    # What is written is there as a whole or not at all.
    monkeypatch.setattr(fleet.os, "replace", lambda *_: (_ for _ in ()).throw(OSError("the disk is full")))
    (out / files[1]).write_bytes(b"")
    with pytest.raises(OSError, match="the disk is full"):
        fleet.main(arguments)
    assert (out / files[0]).read_bytes() == whole[0]
    assert not list(out.rglob(".magpie-*"))
    monkeypatch.undo()

    def fail(address, **options):
        raise MemoryError("too large")

    monkeypatch.setattr(fleet, "calibrate", fail)
    assert fleet.main(arguments) == 1
    assert "1 of 2 campaigns failed; run again to repeat them" in capsys.readouterr().err


def test_the_cluster_of_this_machine_accepts_its_own_client_only(campaigns, tmp_path):
    from distributed import default_client

    seen = []
    found = [str(campaigns / name) for name in ("g00", "g01")]
    fleet.run(found, str(tmp_path), workers=2, progress=lambda *_: seen.append(default_client().scheduler.address))
    assert seen and all(address.startswith("tls://127.0.0.1:") for address in seen)


def test_grippers_that_differ_are_named(campaigns, tmp_path):
    fleet.main([str(campaigns), "-o", str(tmp_path), "--workers", "0"])
    table = pandas.read_parquet(tmp_path / "fleet.parquet")
    strange = fleet.outliers(table)
    assert set(strange.campaign) == {f"g{WEAK:02}", f"g{DEAD:02}"}, strange
    page = (tmp_path / "fleet.html").read_text()
    assert "<h2>Control charts</h2>" in page and page.count("<img ") >= 10
    assert "at most 5% of the grippers have it: in one gripper, of 20 or more" in page


def test_few_grippers_are_not_called_without_outliers(campaigns, tmp_path, capsys):
    few = tmp_path / "few"
    for name in ("g00", "g01"):
        shutil.copytree(campaigns / name, few / name)
    fleet.main([str(few), "-o", str(tmp_path / "out"), "--workers", "0"])
    printed, page = capsys.readouterr().out, (tmp_path / "out" / "fleet.html").read_text()
    for text in (printed, page):
        assert "Fewer than 10 grippers: not tested for outliers." in text and "No outliers" not in text
    with pytest.raises(SystemExit):
        fleet.main([str(campaigns / "g00"), "-o", str(tmp_path / "out")])
    assert "g00 is itself a campaign: give its parent folder" in capsys.readouterr().err


def effect_rows(verdicts):
    common = {"recorded": None, "sensor": None, "value": 1.0, "std_error": 0.1, "unit": "", "recordings_sha256": ""}
    return pandas.DataFrame({"campaign": f"g{i:03}", "kind": "effect", "name": "creep", "verdict": v, **common} for i, v in enumerate(verdicts))


def test_an_effect_that_is_tied_is_not_counted_as_found():
    assert fleet.common_effects(effect_rows(["found", "tied", "absent", "absent"]))["creep"] == 0.25


@pytest.mark.parametrize("count, is_named", [(19, False), (20, True)])
def test_an_effect_of_one_gripper_is_named_from_twenty_on(count, is_named):
    strange = fleet.outliers(effect_rows(["found"] + ["absent"] * (count - 1)))
    assert list(strange.campaign) == (["g000"] if is_named else [])


def test_charts_name_the_grippers_and_number_the_sensors(monkeypatch):
    from matplotlib.figure import Figure

    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure.axes[0]))
    common = {"recorded": None, "kind": "parameter", "name": "gap", "value": 1.5, "std_error": 0.01, "unit": "mm", "verdict": None}
    # The sensor is a floating-point number where other rows have none; one gripper has no second sensor.
    rows = [{**common, "campaign": name, "sensor": sensor} for sensor, names in ((0.0, "abc"), (1.0, "bc")) for name in names]
    fleet.page(pandas.DataFrame(rows))
    (axes,) = drawn
    assert [label.get_text() for label in axes.get_xticklabels()] == list("abc")
    assert axes.get_legend_handles_labels()[1] == ["sensor 0", "sensor 1"]
    second = axes.containers[1][0]
    assert list(second.get_xdata()) == [1, 2]


def test_scores_consider_the_scatter_of_the_production_and_the_error_of_each_value():
    values = numpy.array([1.0, 2.0, 3.0, 4.0, 5.0, 13.0])
    # Median 3.5, median absolute deviation 1.5, so 2.2239 of a normal distribution.
    exact = fleet.z_scores(values, numpy.zeros(6))
    assert exact[5] == pytest.approx(9.5 / 2.2239, rel=1e-4)
    # A value whose own error is as large as its deviation says nothing.
    uncertain = fleet.z_scores(values, numpy.array([0, 0, 0, 0, 0, 9.5]))
    assert uncertain[5] == pytest.approx(9.5 / numpy.hypot(2.2239, 9.5), rel=1e-4)


def test_a_drift_over_the_serial_number_is_found_and_noise_is_not():
    random = numpy.random.default_rng(3)
    rows = []
    for number in range(60):
        common = {"campaign": f"g{number:03}", "recorded": None, "kind": "parameter", "sensor": 0, "std_error": 0.001}
        rows.append({**common, "name": "gap", "value": 1.5 + 0.001 * number + 0.01 * random.standard_normal(), "unit": "mm"})
        rows.append({**common, "name": "bias_x", "value": random.standard_normal(), "unit": "G"})
    found = fleet.trends(pandas.DataFrame(rows))
    assert list(found.parameter) == ["gap"]
    assert found.low[0] < 0.001 < found.high[0]
