"""A sweep's store holds every cell once, whole and of one study alone; damage is named."""

import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import deadtime as dt
from deadtime.cli.application import main
from deadtime.scenarios.sweeps import store
from deadtime.scenarios.sweeps.blocks import layout_of
from deadtime.scenarios.sweeps.run_sweep import prepare
from deadtime.scenarios.sweeps.store import open_store
from own_sweep import PROBLEM, STUDY, filled, load, make_loop, tree


def test_a_store_made_anew_under_the_same_name_is_not_taken_for_the_old_one(tmp_path):
    first = dt.function_study(lambda delay: make_loop(delay, 0.5), {"delay": [0.1]}, scenarios=2)
    second = dt.function_study(
        lambda delay: make_loop(delay, 0.5), {"delay": [0.1, 0.2, 0.3]}, scenarios=2
    )
    old = filled(first, tmp_path / "x.zarr")
    assert old.ise.load().notnull().all()
    old = dt.open_sweep(tmp_path / "x.zarr")
    shutil.rmtree(tmp_path / "x.zarr")
    assert filled(second, tmp_path / "x.zarr").ise.load().notnull().all()
    with pytest.raises(dt.StoreError):
        old.ise.load()


def test_a_store_opens_with_plain_xarray_and_carries_the_study(own, own_store):
    with xr.open_zarr(own_store[1]) as plain:
        np.testing.assert_array_equal(plain.ise, own[1].ise)
        assert plain.ise.attrs == {"units": "x^2 s", "long_name": "integral of |x|^2"}
        assert plain.delay_error.attrs["long_name"] == "delay error"
        assert plain.diverged.dtype == bool
        assert plain["plant.delay"].values.tolist() == [0.234, 0.31]
        assert plain.attrs["study"] == STUDY
        assert (plain.attrs["version"], plain.attrs["seed"]) == (dt.__version__, 3)


@pytest.mark.few(4)
@pytest.mark.parametrize("shape", [(), (7,), (3, 5), (2, 3, 4), (4, 1, 9, 2)])
@pytest.mark.parametrize("cost", [1e-3, 0.07, 0.3, 5.0])
def test_blocks_cover_every_cell_once_and_take_about_a_second(tmp_path, shape, cost):
    study = load(tmp_path, STUDY.split("plant.delay")[0])
    axes = {f"seed{i}": tuple(range(size)) for i, size in enumerate(shape)}
    object.__setattr__(study, "grid", axes)
    layout = layout_of(study, np.full(shape, cost))
    seen = [index for number in range(layout.size) for index in layout.cells(number)]
    assert sorted(seen) == sorted(np.ndindex(shape))
    assert len(list(layout.cells(0))) * cost <= max(1.0 + 1e-9, cost)
    assert layout.size <= 2 * max(1.0, len(seen) * cost) or cost > 0.25


@pytest.mark.long
def test_a_cell_half_written_is_absent_and_is_written_again(own, tmp_path):
    study, data = own
    store = tmp_path / "x.zarr"
    target = prepare(study, str(store))
    target.array("ise")[target.layout.slices(0)] = 1.0  # killed before anything else was written
    opened = dt.open_sweep(store)
    assert opened.ise.isnull().all()
    assert not opened.done.any()
    assert target.missing() == list(range(target.layout.size))
    xr.testing.assert_identical(filled(study, store).load(), data)


def test_a_changed_study_does_not_mix_with_an_old_store(own, tmp_path):
    study, _ = own
    prepare(study, str(tmp_path / "x.zarr"))
    for old, new, message in (
        ("scenarios = 12", "scenarios = 13", r"scenarios was 12, is 13"),
        (
            "[0.234, 0.31]",
            "[0.234, 0.4]",
            r"grid\.plant\.delay was \[0\.234, 0\.31\], is \[0\.234, ",
        ),
        ("delay_error = [-0.1, 0.0, 0.1]\n", "", r"grid\.delay_error is gone"),
    ):
        other = load(tmp_path, STUDY.replace(old, new))
        with pytest.raises(dt.ArgumentError, match=rf"holds another study: {message}.*Choose"):
            dt.sweep(other, tmp_path / "x.zarr")
    changed = load(tmp_path, problem=PROBLEM.replace("1.5, 0.0, 0.5", "1.5, 0.0, 0.6"))
    with pytest.raises(dt.ArgumentError, match=r"problem\.switching\.rates was"):
        dt.sweep(changed, tmp_path / "x.zarr")
    assert load(tmp_path, "# a comment\n" + STUDY).definition() == study.definition()


def test_a_store_of_another_version_is_refused(own, tmp_path, monkeypatch):
    study, _ = own
    monkeypatch.setattr("deadtime.scenarios.sweeps.study.__version__", "0.0.1")
    prepare(study, str(tmp_path / "x.zarr"))
    monkeypatch.undo()
    with pytest.raises(dt.ArgumentError, match=r"version was .0\.0\.1., is .*Choose another store"):
        dt.sweep(study, tmp_path / "x.zarr")


def test_two_sweeps_that_make_one_store_at_once_do_not_mix(own, tmp_path, monkeypatch):
    study, _ = own
    fill, place = store._fill, str(tmp_path / "x.zarr")

    def slowly(*given):
        fill(*given)
        monkeypatch.undo()
        prepare(replace(study, seed=9), place)

    monkeypatch.setattr(store, "_fill", slowly)
    with pytest.raises(dt.ArgumentError, match="holds another study: seed was 9, is 3"):
        prepare(study, place)
    assert [path.name for path in tmp_path.iterdir()] == ["x.zarr"]


def test_what_is_no_store_is_refused(tmp_path):
    study = load(tmp_path)
    with pytest.raises(dt.ArgumentError, match="does not exist: run the sweep first"):
        dt.open_sweep(tmp_path / "none.zarr")
    (tmp_path / "folder.zarr").mkdir()
    (tmp_path / "folder.zarr" / "mine.txt").write_text("kept")
    for name in ("folder.zarr", "study.toml"):
        with pytest.raises(dt.ArgumentError, match=rf"{name}' is there, but is no Zarr store"):
            dt.sweep(study, tmp_path / name)
    with pytest.raises(dt.StoreError, match=r"s3://none.* cannot be opened: .*s3fs"):
        dt.sweep(study, "s3://none/x.zarr")
    with pytest.raises(dt.ArgumentError, match="workers are those of the scheduler"):
        dt.sweep(study, tmp_path / "x.zarr", "tcp://127.0.0.1:9", workers=2)
    with pytest.raises(dt.ArgumentError, match="scenarios must be at most 33,554,432 with 4 laws"):
        dt.sweep(replace(study, scenarios=10**9), tmp_path / "x.zarr", workers=1)
    assert (tmp_path / "folder.zarr" / "mine.txt").read_text() == "kept"
    xr.Dataset({"a": 1}).to_zarr(tmp_path / "other.zarr", consolidated=False)
    with pytest.raises(dt.ArgumentError, match="is Zarr, but not made by deadtime sweep"):
        dt.open_sweep(tmp_path / "other.zarr")


@pytest.mark.long
def test_a_damaged_chunk_is_named_and_computed_again_on_request(
    own_store, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    load(tmp_path)
    shutil.copytree(own_store[1], "x.zarr")
    whole = dt.open_sweep("x.zarr").load()
    before = tree("x.zarr")
    chunk = next(p for p in Path("x.zarr/energy/c").rglob("0") if p.is_file())
    damaged = bytearray(chunk.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    chunk.write_bytes(damaged)
    with pytest.raises(dt.StoreError, match=rf"damaged chunk, .*{chunk}.*--verify"):
        dt.open_sweep("x.zarr").energy.load()
    np.testing.assert_array_equal(dt.open_sweep("x.zarr").ise, whole.ise)
    for name in ("peak", "diverged", "reason"):
        gone = next(p for p in Path(f"x.zarr/{name}/c").rglob("0") if p.is_file())
        kept = gone.read_bytes()
        gone.unlink()
        with pytest.raises(dt.StoreError, match=rf"lacks the chunk .*{gone}"):
            dt.open_sweep("x.zarr")[name].load()
        if name != "peak":
            gone.write_bytes(kept)
    shutil.rmtree("x.zarr/delay_error/c")
    assert dt.open_sweep("x.zarr").delay_error.values.tolist() == [-0.1, 0.0, 0.1]
    found = [fault for _, fault in open_store(str(Path("x.zarr").absolute())).faults()]
    assert len(found) == 1  # both belong to the one block that there is
    with pytest.raises(SystemExit) as stopped:
        main(["sweep", "study.toml", "--store", "x.zarr", "--workers", "1", "--verify", "--json"])
    assert stopped.value.code == 0
    said = capsys.readouterr().err
    assert str(chunk) in said
    assert "the values of delay_error were damaged" in said
    assert tree("x.zarr") == before
    xr.testing.assert_identical(dt.open_sweep("x.zarr").load(), whole)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_store_that_may_not_be_written_is_named(own, tmp_path):
    study, _ = own
    prepare(study, str(tmp_path / "x.zarr"))
    for folder in [tmp_path / "x.zarr", *(tmp_path / "x.zarr").rglob("*")]:
        folder.chmod(0o500 if folder.is_dir() else 0o400)
    with pytest.raises(dt.StoreError, match=r"x\.zarr' may not be written: what is stored is kept"):
        dt.sweep(study, tmp_path / "x.zarr", workers=1)


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("options", "message"),
    [("size=200k", "is full: what is stored is kept; make room"), ("ro", "may not be written")],
)
def test_a_full_disk_and_a_read_only_one_are_named_and_what_is_stored_is_kept(
    tmp_path, options, message
):
    study = load(tmp_path, STUDY.split("law.told")[0])
    data = filled(study, tmp_path / "elsewhere.zarr").load()
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", str(disk)], capture_output=True
    )
    if mounted.returncode:
        pytest.skip("a disk cannot be mounted here")
    try:
        store = disk / "x.zarr"
        target = prepare(study, str(store))
        if options == "ro":
            subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        else:
            (disk / "ballast").write_bytes(bytes(os.statvfs(disk).f_bavail * 4096 - 4096))
        with pytest.raises(dt.StoreError, match=message):
            dt.sweep(study, store, workers=1)
        assert not dt.open_sweep(store).done.any()
        subprocess.run(["mount", "-o", "remount,rw,size=20M", str(disk)], check=True)
        (disk / "ballast").unlink(missing_ok=True)
        assert target.missing()
        xr.testing.assert_identical(dt.sweep(study, store, workers=1).load(), data)
    finally:
        subprocess.run(["umount", str(disk)], check=True)
