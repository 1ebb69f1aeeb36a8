"""The package against the command, and the device over arrays against the device on files."""

import math
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow
import pytest

import magpie
from conftest import DATA, ROOT


@pytest.fixture(scope="session")
def improved(ripple, fitted):
    expr = "ripple: dz_um = a*sin(motor_angle_rad) + b*cos(motor_angle_rad)"
    return magpie.add(fitted.model, ripple, exprs=[expr])


def table_of(recording, name):
    return pd.read_csv(next(Path(recording["folder"]).glob(f"{name}.csv*")))


def test_campaign_is_described(ripple):
    assert ripple.sensors == [0, 1]
    folders = [path for path in (DATA / "ripple").iterdir() if path.is_dir()]
    assert len(ripple.recordings) == len(folders)
    assert "motor_angle_rad" in ripple.recordings[0]["covariates"]


def test_diagnosis_is_that_of_the_command(command, ripple, fitted):
    stages = []
    found = magpie.diagnose(
        fitted.model, ripple, progress=lambda stage, share: stages.append((stage, share))
    )
    assert found.data == command("diagnose", fitted.model.path, ripple.path)
    assert found.formulas[0]["covariates"] == ["motor_angle_rad"]
    shares = [share for _, share in stages]
    assert shares == sorted(shares) and 0 <= shares[0] and shares[-1] < 1
    assert len(found.to_pandas()) == len(found.verdicts)
    assert "<table>" in found._repr_html_()
    # The formula, not only its name.
    (expression,) = found.expressions
    assert "sin(motor_angle_rad)" in expression
    assert str(found).endswith(expression) and expression in repr(found) and len(repr(found)) < 300


def test_comparison_and_replay_are_those_of_the_command(command, ripple, fitted):
    compared = magpie.compare(fitted.model, ripple)
    expected = command("compare", fitted.model.path, ripple.path)
    assert {name: compared.data[name] for name in expected} == expected
    replayed = magpie.replay(fitted.model, ripple)
    expected = command("replay", fitted.model.path, ripple.path)
    speeds = [data.pop("times_real_time") for data in (replayed.data, expected)]
    assert replayed.data == expected and min(speeds) > 1
    assert replayed.force.rms_n > 1.0


def test_parameters_have_errors_and_correlations(ripple, fitted, improved):
    table = fitted.parameters_to_pandas()
    assert len(table) == 2 * 14 and set(table["sensor"]) == {0, 1}
    assert (table["identifiable"] == (table["std_error"] <= 0.5 * table["prior_width"])).all()
    assert magpie.compare(fitted.model, ripple).parameters == fitted.parameters
    matrix = fitted.correlation(1)
    np.testing.assert_array_equal(matrix, matrix.T)
    assert matrix.shape == (14, 14) and (np.diag(matrix) == 1).all()
    (first, second), rows = matrix.index[:2], fitted.data["correlations"][1]["rows"]
    assert matrix.loc[first, second] == rows[0][0]
    assert {one["effect"] for one in improved.parameters} == {None, "ripple"}
    assert "ripple.a" in improved.correlation(0).index
    assert all(one["remedy"] for one in fitted.unidentified)
    with pytest.raises(KeyError):
        fitted.correlation(7)


def test_added_formula_lowers_the_error_and_is_removed_again(ripple, improved):
    before, after = improved.force
    assert before.excess_n > 10 * after.excess_n
    assert f"before: {before}" in str(improved) and f"after: {after}" in str(improved)
    removed = magpie.remove(improved.model, ripple, "ripple")
    assert math.isclose(removed.force[1].rms_n, before.rms_n, rel_tol=1e-6)


def test_an_edit_that_the_board_cannot_compute_states_why(ripple):
    polynomial = magpie.fit(ripple, base="polynomial").model
    edit = magpie.add(polynomial, ripple, exprs="ripple: bz_g = a*sin(motor_angle_rad)")
    assert edit.force[1].rms_n < 0.7 * edit.force[0].rms_n
    # The device holds tables over three quantities.
    product = "own: bz_g = a*opening_mm*motor_iq_a*temp_c*fx_n"
    edit = magpie.add(polynomial, ripple, exprs=product)
    assert edit.force is None
    assert "Error of the forces: not available" in str(edit) and "G before, " in str(edit)


def test_device_over_arrays_has_the_bits_of_the_device_on_the_file(ripple, improved):
    recording = ripple.recordings[0]
    device = magpie.Device(improved.model)
    from_file = device.run_recording(recording["folder"])
    table = table_of(recording, "hall")
    device.reset()
    from_arrays = device.run(table)
    assert from_arrays.force_n.shape == (len(table), 2, 2)
    for name in ("time_s", "force_n", "is_valid", "is_disturbed"):
        np.testing.assert_array_equal(getattr(from_arrays, name), getattr(from_file, name))
    # Rows continue those before, in parts or one at a time.
    device.reset()
    parts = [device.run(table[:700]), device.run(table[700:])]
    joined = np.concatenate([part.force_n for part in parts])
    np.testing.assert_array_equal(joined, from_file.force_n)
    device.reset()
    np.testing.assert_array_equal(device.run(dates_of(table)).force_n, from_file.force_n)
    device.reset()
    step = device.step(dict(table.iloc[0]))
    np.testing.assert_array_equal(step, from_file.force_n[0])


def test_error_of_the_device_is_that_of_the_replay(ripple, improved):
    replayed = magpie.replay(improved.model, ripple).data["recordings"][0]
    recording = ripple.recordings[0]
    estimates = magpie.Device(improved.model).run_recording(recording["folder"])
    force = table_of(recording, "force")
    for place, number in enumerate(estimates.sensors):
        for axis, letter in enumerate("xz"):
            reference = np.interp(
                estimates.time_s,
                1e-6 * force["t_us"],
                force[f"f{number}_{letter}_n"],
                left=np.nan,
                right=np.nan,
            )
            error = estimates.force_n[:, place, axis] - reference
            rmse = np.sqrt(np.nanmean(error[estimates.is_valid[:, place]] ** 2))
            wanted = [s for s in replayed["sensors"] if (s["sensor"], s["axis"]) == (number, letter)]
            assert math.isclose(rmse, wanted[0]["rmse_n"], rel_tol=1e-6)


def test_arrays_make_the_same_campaign(ripple, fitted):
    recordings = [
        (table_of(recording, "hall"), table_of(recording, "force"))
        for recording in ripple.recordings
    ]
    folder = Path(ripple.recordings[0]["folder"])
    description = tomllib.loads((folder / "recording.toml").read_text())
    keys = ("range_gauss", "gauss_per_lsb", "design")
    copy = magpie.Campaign.from_arrays(
        recordings, **{key: description[key] for key in keys if key in description}
    )
    assert copy.sensors == ripple.sensors
    assert magpie.fit(copy).held_out_rms_g == fitted.held_out_rms_g


DESIGN = {
    "gap_mm": np.float64(1.5),
    "stiffness_x_n_per_mm": np.int64(400),
    "stiffness_z_n_per_mm": 600.0,
    "force_range_n": np.array(250.0),
    "magnet": {"shape": "cylinder", "diameter_mm": np.float32(3.0), "length_mm": 2.0, "remanence_t": 1.3, "axis": "y"},
}


@pytest.fixture(scope="session")
def short(ripple):
    """The first seconds of a recording, with counts as gauss: their size does not matter to a table."""
    hall, force = (table_of(ripple.recordings[0], name) for name in ("hall", "force"))
    hall = hall[:3000].rename(columns=lambda name: name.replace("_lsb", "_gauss"))
    return hall, force[force.t_us <= hall.t_us.iloc[-1]]


def dates_of(table):
    return table.assign(t_us=pd.Timestamp("2026-01-02T03:04:05") + pd.to_timedelta(table.t_us, unit="us"))


TABLES = {
    "series": lambda table: {name: table[name].set_axis(range(7, 7 + len(table))) for name in table},
    "lists": lambda table: {name: table[name].tolist() for name in table},
    "arrow": lambda table: pyarrow.Table.from_pandas(table, preserve_index=False),
    "structured array": lambda table: table.to_records(index=False),
    "numbers that may be missing": lambda table: table.convert_dtypes(),
    "dates": dates_of,
    "dates of a zone": lambda table: dates_of(table).assign(t_us=lambda dates: dates.t_us.dt.tz_localize("Asia/Tokyo")),
}


@pytest.mark.parametrize("kind", TABLES)
def test_tables_of_other_kinds_make_the_same_campaign(short, kind):
    hall, force = short
    copy = magpie.Campaign.from_arrays([tuple(map(TABLES[kind], short))], design=DESIGN)
    for name, table in (("hall", hall), ("force", force)):
        read = table_of(copy.recordings[0], name)
        # Dates are counted from the first row of the board.
        first_us = hall.t_us.iloc[0] if kind.startswith("dates") else 0
        expected = table.reset_index(drop=True).assign(t_us=table.t_us.to_numpy() - first_us)
        pd.testing.assert_frame_equal(read, expected, check_dtype=False, check_exact=True)
    assert tomllib.loads((copy.path / "1" / "recording.toml").read_text())["design"] == DESIGN


def test_forces_that_were_not_measured_are_empty_cells(short):
    hall, force = short
    for missing in (np.nan, None):
        gaps = {name: [missing if name == "f0_x_n" and row % 3 == 0 else value for row, value in enumerate(force[name])] for name in force}
        copy = magpie.Campaign.from_arrays([(hall, gaps)])
        assert table_of(copy.recordings[0], "force").f0_x_n.isna().sum() == -(-len(force) // 3)


def without(table, **changes):
    return {**{name: table[name].to_numpy() for name in table}, **changes}


ARGUMENTS = {
    "an array": (lambda hall, force: {"recordings": [(hall.to_numpy(), force)]}, TypeError, r"recordings\[0\], hall: ndarray has no names"),
    "no pairs": (lambda hall, force: {"recordings": (hall, force)}, TypeError, r"recordings\[0\]: a pair of tables"),
    "none": (lambda hall, force: {"recordings": []}, magpie.MagpieError, "at least one pair"),
    "a column of rows": (
        lambda hall, force: {"recordings": [(without(hall, s0_x_gauss=np.zeros((len(hall), 3))), force)]},
        magpie.MagpieError,
        r"recordings\[0\], hall, column s0_x_gauss: the shape is \(3000, 3\)",
    ),
    "texts": (
        lambda hall, force: {"recordings": [(without(hall, s0_x_gauss=["x"] * len(hall)), force)]},
        TypeError,
        "column s0_x_gauss: numbers are needed",
    ),
    "lengths": (
        lambda hall, force: {"recordings": [(without(hall, s0_x_gauss=[1.0]), force)]},
        magpie.MagpieError,
        r"recordings\[0\], hall: columns of different length",
    ),
    "a field that is missing": (
        lambda hall, force: {"recordings": [(hall, force), (without(hall, s0_x_gauss=[1.0] * 5 + [math.nan] * 2995), force)]},
        magpie.MagpieError,
        r"^recordings\[1\], hall, row 5, column s0_x_gauss: ",
    ),
    "one clock of dates": (lambda hall, force: {"recordings": [(hall, dates_of(force))]}, magpie.MagpieError, "give both tables one clock"),
    "no date": (
        lambda hall, force: {"recordings": [(without(hall, t_us=np.full(len(hall), np.datetime64("NaT"))), force)]},
        magpie.MagpieError,
        "row 0, column t_us: there is no time",
    ),
    "an unknown column": (
        lambda hall, force: {"recordings": [(without(hall, humidity_pct=hall.t_us), force)]},
        magpie.MagpieError,
        r'^recordings\[0\], hall, column humidity_pct: .*by the argument covariates=\["NAME_unit"\]',
    ),
    "a text of covariates without a unit": (lambda hall, force: {"covariates": "foo"}, magpie.MagpieError, r"^recordings\[0\], column covariates: .*foo"),
    "starts": (lambda hall, force: {"starts_s": []}, magpie.MagpieError, "starts_s: there are 0 values for 1 recordings"),
    "a key of the design": (lambda hall, force: {"design": {"gap_mm": None}}, TypeError, "design.gap_mm: a number"),
    "a design without a magnet": (lambda hall, force: {"design": {"gap_mm": 1.5}}, magpie.MagpieError, "^argument design: .*missing field"),
    "a value of the design": (lambda hall, force: {"design": {**DESIGN, "gap_mm": -1.0}}, magpie.MagpieError, r"^recordings\[0\].*design"),
    "the design": (lambda hall, force: {"design": "design.toml"}, TypeError, "design: a mapping is needed"),
}


@pytest.mark.parametrize("case", ARGUMENTS)
def test_errors_of_arrays_name_the_argument(short, case):
    make, kind, text = ARGUMENTS[case]
    with pytest.raises(kind, match=text) as raised:
        magpie.Campaign.from_arrays(**{"recordings": [short], **make(*short)})
    if kind is magpie.MagpieError:
        assert (raised.value.file, raised.value.line) == (None, None)
        assert "magpie-" not in str(raised.value) and "recording.toml" not in str(raised.value)


CALLS = {
    "a list of effects": (lambda *both: magpie.add(*both, ["hysteresis"]), TypeError, "each effect is an argument"),
    "no effect": (lambda *both: magpie.add(*both), magpie.MagpieError, "name an effect"),
    "a negative seed": (lambda *both: magpie.diagnose(*both, seed=-1), magpie.MagpieError, "seed = -1"),
    "a seed that is no whole number": (lambda *both: magpie.add(*both, "creep", seed=1.5), TypeError, "seed: a whole number"),
    "negative units": (lambda *both: magpie.train(*both, hidden=-4), magpie.MagpieError, "hidden = -4"),
    "a degree": (lambda *both: magpie.fit(both[1], base="polynomial", degree=300), magpie.MagpieError, "degree = 300"),
    "no sources": (lambda *both: magpie.guess_mapping([], "mapping.toml"), magpie.MagpieError, "sources: the list is empty"),
    "one source": (lambda *both: magpie.guess_mapping("absent.csv", "mapping.toml"), magpie.MagpieError, "absent.csv: cannot be read"),
    "ranges": (lambda *both: magpie.add(*both, exprs="own: dz_um = a*lag(opening_mm, tau)", ranges={"tau": 3}), TypeError, "ranges: a mapping"),
    "a range": (lambda *both: magpie.add(*both, exprs="own: dz_um = a*lag(opening_mm, tau)"), magpie.MagpieError, "ranges: tau=1..10"),
    "both kinds of effects": (lambda *both: magpie.simulate("new", "creep", random_effects=1), magpie.MagpieError, "not both"),
    "strength": (lambda *both: magpie.simulate("new", random_effects=1, strength=-1.0), magpie.MagpieError, "strength = -1.0"),
    "noise": (lambda *both: magpie.simulate("new", noise="pink"), magpie.MagpieError, "noise: .*white"),
}


@pytest.mark.parametrize("case", CALLS)
def test_errors_of_other_arguments_name_them(ripple, fitted, tmp_path, monkeypatch, case):
    monkeypatch.chdir(tmp_path)
    call, kind, text = CALLS[case]
    with pytest.raises(kind, match=text):
        call(fitted.model, ripple)
    assert not list(tmp_path.iterdir())


def test_errors_have_a_place(tmp_path, fitted):
    broken = tmp_path / "campaign" / "1"
    broken.mkdir(parents=True)
    (broken / "recording.toml").write_text("format = 1\nstart_s = 0.0\n")
    (broken / "hall.csv").write_text("t_us,s0_x_gauss,s0_y_gauss,s0_z_gauss\n0,1,2,3\n1000,1,x,3\n")
    (broken / "force.csv").write_text("t_us,f0_x_n,f0_z_n\n0,1,2\n1000,1,2\n")
    with pytest.raises(magpie.MagpieError) as raised:
        magpie.Campaign.read(tmp_path / "campaign")
    assert str(raised.value.file).endswith("hall.csv")
    assert (raised.value.line, raised.value.column) == (3, "s0_y_gauss")
    with pytest.raises(magpie.MagpieError) as raised:
        magpie.fit(tmp_path / "campaign")
    assert (raised.value.line, raised.value.column) == (3, "s0_y_gauss")
    flipped = Path(tmp_path) / "flipped"
    shutil.copytree(DATA / "clean", flipped)
    for path in flipped.glob("*/force.csv.gz"):
        force = pd.read_csv(path)
        force.assign(f0_x_n=-force.f0_x_n).to_csv(path, index=False)
    with pytest.raises(magpie.MagpieError, match="flipped") as raised:
        magpie.fit(flipped)
    assert (raised.value.file.name, raised.value.column) == ("force.csv.gz", "f0_x_n")
    with pytest.raises(magpie.MagpieError, match="hysterisis.*did you mean hysteresis"):
        magpie.simulate(tmp_path / "simulated", "hysterisis")
    one_sensor = {f"s0_{axis}_gauss": [1.0] for axis in "xyz"}
    with pytest.raises(magpie.MagpieError, match="s1_x_gauss"):
        magpie.Device(fitted.model).run(one_sensor)
    with pytest.raises(magpie.MagpieError, match="row 0"):
        magpie.Device(fitted.model).run({"s0_x_gauss": [math.nan]})


def test_formulas_are_searched_without_the_catalogue(ripple, fitted):
    found = magpie.search_formulas(fitted.model, ripple)
    assert found.verdicts == [] and found.accepted == []
    assert [formula["name"] for formula in found.formulas] == ["formula_1"]
    assert "sin(motor_angle_rad)" in found.formulas[0]["effects"][0]["expression"]


def test_simulation_is_diagnosed_and_exported(tmp_path):
    simulated = magpie.simulate(
        tmp_path / "campaign", "viscous_lag=12", sensors=1, seconds=12.0, seed=3
    )
    model = magpie.fit(simulated.campaign, tmp_path / "model.toml").model
    found = magpie.diagnose(model, simulated.campaign)
    (lag,) = [verdict for verdict in found.verdicts if verdict.effect == "viscous_lag"]
    assert lag.verdict in ("found", "tied")
    tables = magpie.export(model, tmp_path / "tables.rs")
    assert "pub" in tables.path.read_text()


def test_random_effects_are_those_of_the_command(command, tmp_path):
    options = {"random_effects": 2, "strength": 1.5, "load": 0.9, "warmer": -3.0, "noise": "ar1", "field_noise": 0.4, "reference_noise": 0.1}
    options |= {"programme": "still", "seconds": 4.0, "recordings": 1, "sensors": 1, "seed": 9}
    simulated = magpie.simulate(tmp_path / "here", **options)
    words = [word for name, value in options.items() for word in (f"--{name.replace('_', '-')}", value)]
    command("simulate", "-o", tmp_path / "there", *words)
    for path in simulated.campaign.glob("*/*"):
        assert path.read_bytes() == (tmp_path / "there" / path.relative_to(simulated.campaign)).read_bytes()
    assert simulated.data["effects"] is None and simulated.to_pandas().empty
    assert len(tomllib.loads(simulated.truth.read_text())["effect"]) == 2


def test_networks_are_those_of_the_command_also_after_an_interruption(command, tmp_path, ripple, fitted):
    options = {"hidden": 4, "epochs": 2, "seed": 3}
    path = tmp_path / "network.safetensors"
    trained = magpie.train(fitted.model, ripple, output=path, **options)
    written = tmp_path / "command.safetensors"
    words = [word for key, value in options.items() for word in (f"--{key}", value)]
    expected = command("train", fitted.model.path, ripple.path, *words, "-o", written)
    for data in (trained.data, expected):
        data.pop("seconds")
    assert trained.data == expected and path.read_bytes() == written.read_bytes()
    assert str(trained).startswith("Over all forces: ")

    def stop(stage, share):
        raise RuntimeError(stage)

    checkpoint = tmp_path / "checkpoint.safetensors"
    with pytest.raises(RuntimeError, match="training, held-out loss"):
        magpie.train(fitted.model, ripple, checkpoint=checkpoint, progress=stop, **options)
    shares = []
    resumed = magpie.train(
        fitted.model, ripple, checkpoint=checkpoint, progress=lambda stage, share: shares.append(share), **options
    )
    assert shares == [1.0] and resumed.network.path.read_bytes() == path.read_bytes()

    estimates = magpie.Device(fitted.model, resumed.network).run_recording(ripple.recordings[0]["folder"])
    # None until its state has decayed.
    sigma_n = estimates.to_pandas().f1_z_sigma_n.dropna()
    assert len(sigma_n) > 1000 and (sigma_n > 0).all()
    tables = magpie.export(fitted.model, tmp_path / "tables.rs", network=resumed.network)
    assert len(tables.path.read_text()) > len(magpie.export(fitted.model, tmp_path / "without.rs").path.read_text())
    refused = {"axes": "xw", "hidden": 33, "rate": 5.0, "zero_weight": 0.0, "epochs": 0, "patience": 0}
    for name, value in refused.items():
        with pytest.raises(magpie.MagpieError, match=name.replace("_", "-")):
            magpie.train(fitted.model, ripple, **{name: value})
    with pytest.raises(magpie.MagpieError, match="different files"):
        magpie.train(fitted.model, ripple, output=tmp_path / "one", checkpoint=tmp_path / "one")


def test_files_with_the_estimates_are_imported_again(tmp_path, ripple, fitted):
    files = magpie.export_mcap(fitted.model, ripple, tmp_path / "mcap")
    assert len(files) == len(ripple.recordings)
    proposal = magpie.guess_mapping(files, tmp_path / "mapping.toml")
    assert "s0_x_lsb" in set(proposal.to_pandas().to)
    copy = magpie.Campaign.from_files(files, proposal.mapping)
    assert copy.sensors == ripple.sensors and copy.notes == []
    assert magpie.fit(copy).held_out_rms_g == fitted.held_out_rms_g
    with pytest.raises(magpie.MagpieError, match=r"design: .*has a table \[design\]"):
        magpie.Campaign.from_files(files, proposal.mapping, design=DESIGN)
    # The same design, given apart.
    tables = re.split(r"^(?=\[)", Path(proposal.mapping).read_text(), flags=re.MULTILINE)
    (tmp_path / "without.toml").write_text("".join(table for table in tables if not table.startswith("[design")))
    given = tomllib.loads("".join(tables))["design"]
    copy = magpie.Campaign.from_files(files, tmp_path / "without.toml", design=given)
    assert magpie.fit(copy).held_out_rms_g == fitted.held_out_rms_g


def test_errors_of_an_import_say_what_to_correct(tmp_path):
    (tmp_path / "run.csv").write_text("t,bx,by,bz,fx\n0,1,2,3,0\n1,1,,3,0\n")
    column = '{{ from = "{0}", unit = "{1}", to = "{2}" }}'.format
    fields = ", ".join(column(f"b{axis}", "G", f"s0_{axis}_gauss") for axis in "xyz")
    side = '[{0}]\nclock = {{ from = "t", unit = "s" }}\ncolumns = [{1}]\n'.format
    mapping = tmp_path / "mapping.toml"
    mapping.write_text('description = "test"\n' + side("hall", fields) + side("force", column("fx", "N", "f0_x_n")))
    for design, text in (({"gap_mm": 1.5}, "^argument design: .*missing"), (DESIGN, "leave the column out of .*mapping.toml")):
        with pytest.raises(magpie.MagpieError, match=text) as raised:
            magpie.Campaign.from_files(tmp_path / "run.csv", mapping, design=design)
        assert "magpie-" not in str(raised.value)
    with pytest.raises(magpie.MagpieError, match="leave the column out of .*mapping.toml") as raised:
        magpie.Campaign.from_files([tmp_path / "run.csv"], mapping)
    assert (Path(raised.value.file).name, raised.value.line, raised.value.column) == ("run.csv", 3, "by")


def test_tables_of_results_are_arrow_tables_too(ripple, fitted):
    compared = magpie.compare(fitted.model, ripple)
    assert compared.to_arrow().column_names == list(compared.to_pandas().columns)
    estimates = magpie.Device(fitted.model).run_recording(ripple.recordings[0]["folder"])
    np.testing.assert_array_equal(estimates.to_arrow()["f1_z_n"].to_numpy(), estimates.force_n[:, 1, 1])


def test_other_threads_run_during_a_fit(ripple):
    counted = 0
    done = threading.Event()

    def count():
        nonlocal counted
        while not done.wait(0.001):
            counted += 1

    thread = threading.Thread(target=count)
    thread.start()
    magpie.fit(ripple)
    done.set()
    thread.join()
    assert counted > 20


def test_exception_in_the_progress_ends_the_diagnosis(ripple, fitted):
    def stop(stage, share):
        raise RuntimeError(stage)

    with pytest.raises(RuntimeError, match="fitting the model"):
        magpie.diagnose(fitted.model, ripple, progress=stop)


def test_ctrl_c_ends_a_diagnosis(ripple, fitted):
    stages = []

    def interrupt(stage, share):
        if not stages:
            os.kill(os.getpid(), signal.SIGINT)
        stages.append(stage)

    # A process in the background of a shell ignores the signal from its start.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    with pytest.raises(KeyboardInterrupt):
        magpie.diagnose(fitted.model, ripple, progress=interrupt)
    signal.signal(signal.SIGINT, before)
    complete = []
    magpie.diagnose(fitted.model, ripple, progress=lambda stage, share: complete.append(stage))
    assert len(stages) < len(complete)


def test_readme_runs():
    text = (ROOT / "host-tools" / "python" / "README.md").read_text()
    example = text.split("```python\n")[1].split("```")[0]
    done = subprocess.run(
        [sys.executable, "-c", example + "\nassert estimates.force_n.shape[1:] == (2, 2)"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "N (noise" in done.stdout


def test_catalogue_is_listed():
    names = [effect["effect"] for effect in magpie.effects()]
    assert "hysteresis" in names and len(names) == len(set(names)) >= 20
