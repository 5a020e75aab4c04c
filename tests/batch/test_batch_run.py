"""A batch does what interpolating one pair after another does, and started again it does only what is missing."""

import hashlib
import json
import math
import os
import platform
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from batch_samples import SIZE, InlineExecutor, contents, line, records, write_lines, write_row
from tests.runtime.test_monocular_session import network

from omnisyn_cli.batch import batch_runner as batch_module
from omnisyn_cli.batch import interpolations, provenance
from omnisyn_cli.batch.batch_runner import BatchOptions, BatchReport, Progress, run_batch
from omnisyn_cli.batch.executor import Work
from omnisyn_cli.batch.folder import attempt_folder, open_staging_dir, remove_leftovers, write_outputs
from omnisyn_cli.batch.interpolations import Interpolator
from omnisyn_cli.batch.manifest import read_manifest
from omnisyn_cli.errors import InputError, OutputPathError, WriteError
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.interpolation.added_models import add_model
from omnisyn_cli.interpolation.plan import plan_interpolation
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import read_panorama, write_image
from omnisyn_cli.io.outputs import replaced_when_complete
from omnisyn_cli.poses import estimation as posing
from omnisyn_cli.poses.estimation import FoundPoses
from omnisyn_cli.poses.file import PosedPanorama, read_poses, write_poses
from omnisyn_cli.runtime import models
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path
from omnisyn_cli.types import DepthEstimate, View
from synthesis_samples import as_bytes, ws_psnr


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch):
    """No processes: what they add is tested with the engine and with the command."""

    def inline(place: tuple[Path, str], options: BatchOptions, jobs: int) -> InlineExecutor:
        return InlineExecutor(Work(batch_module.INTERPOLATOR, (*place, 1)))

    monkeypatch.setattr(batch_module, "make_executor", inline)


def batch(folder: Path, *lines: Any, **options: Any) -> BatchReport:
    path = write_lines(folder / "jobs.jsonl", list(lines))
    return run_batch(read_manifest(path), folder / "out", BatchOptions(**options))


def ids(found: list[dict[str, Any]]) -> list[str]:
    return sorted(record["id"] for record in found)


def test_a_batch_makes_what_interpolating_makes(tmp_path):
    write_row(tmp_path, 3)
    lines = [line(0, 1, group="a"), line(1, 0, group="a", save_depth="depth/1-0"), line(0, 2, output="f/v_%03d.png")]
    report = batch(tmp_path, *lines)
    assert (ids(report.done), report.failed, report.kept) == (["0-1", "0-2", "1-0"], [], [])
    (tmp_path / "alone" / "depth").mkdir(parents=True)
    for job in read_manifest(tmp_path / "jobs.jsonl").jobs:
        run_interpolation(plan_interpolation(job.interpolation(tmp_path / "alone", threads=1)))
    assert contents(tmp_path / "out") == contents(tmp_path / "alone")
    assert "f/v_001.png" in contents(tmp_path / "out")
    assert not list((tmp_path / "out").glob(".*"))


def test_a_record_says_what_a_result_was_made_of(tmp_path):
    write_row(tmp_path, 2)
    batch(tmp_path, line(0, 1))
    (record,) = records(tmp_path / "out")
    assert (record["id"], record["status"], record["attempts"], record["panoramas_decoded"]) == ("0-1", "done", 1, 2)
    made = [file.stat().st_size for file in (tmp_path / "out" / "0-1").iterdir()]
    assert record["outputs"] == {"0-1": {"files": 3, "bytes": sum(made), "names": ["#"]}}
    assert record["sources"]["options"] == {"frames": 3}
    assert {Path(name).name for name in record["sources"]["files"]} == {"p0.png", "p1.png", "depth0.exr", "depth1.exr"}
    assert {"decode", "mesh", "render", "fuse", "total"} <= set(record["summary"]["stages"])
    assert record["summary"]["depth"] == "file"


def test_records_tell_nothing_about_the_machine(tmp_path):
    """Files are named as the manifest might name them, in errors too; so a folder that is moved is as it was."""
    folder, moved = tmp_path / "tour", tmp_path / "elsewhere"
    folder.mkdir()
    write_row(folder, 2)
    for name in ("mask.png", "../mask.png"):
        write_image(folder / name, np.full(SIZE, 255, np.uint8))
    (folder / "own.onnx").write_bytes(b"no network")
    lines = [
        line(0, 1, masks=["mask.png", "../mask.png"], view="walk.html", save_depth="depth"),
        line(1, 0, model="own.onnx", depth="network"),
        line(1, 0, depth_prior="own.onnx", depth="refined") | {"id": "prior", "output": "prior"},
    ]
    assert len(batch(folder, *lines).failed) == 2
    text = (folder / "out" / "results.jsonl").read_text()
    assert str(tmp_path) not in text
    assert platform.node() + ":" not in text
    done, failed, prior = sorted(records(folder / "out"), key=lambda record: record["id"])
    assert done["sources"]["inputs"] == ["p0.png", "p1.png"]
    assert {"p0.png", "mask.png", "../mask.png"} <= set(done["sources"]["files"])
    assert failed["sources"]["options"]["model"] == "own.onnx"
    assert prior["sources"]["options"]["depth_prior"] == "own.onnx"
    assert "own.onnx" in prior["sources"]["files"]
    assert failed["worker"] == str(os.getpid())
    folder.rename(moved)
    assert (len(batch(moved, *lines).kept), len(records(moved / "out"))) == (1, 3)
    batch(moved, lines[1], record_host=True, retry_failed=True)
    assert records(moved / "out")[-1]["worker"] == f"{platform.node()}:{os.getpid()}"


def test_an_added_network_is_recorded_by_its_digest(tmp_path, monkeypatch):
    """It lies elsewhere on every machine."""
    for name in ("XDG_DATA_HOME", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(tmp_path / name))
    entry = add_model(network(tmp_path / "own.onnx"), "mine")
    write_row(tmp_path, 2)
    (job,) = read_manifest(write_lines(tmp_path / "jobs.jsonl", [line(0, 1, depth_prior="mine")])).jobs
    sources = provenance.job_sources(job)
    assert (sources["options"]["depth_prior"], sources["models"][entry.file]) == ("mine", entry.sha256)
    assert str(tmp_path) not in json.dumps(sources)
    path = str(models.added_models_folder() / entry.file)
    assert provenance.digest_of_network(path, sources, job) == entry.sha256


def test_shared_panoramas_are_decoded_and_their_depth_found_once(tmp_path, monkeypatch):
    """Six jobs of four pictures, three pairs; the first of a pair has another depth, so that the wrong order shows."""
    monkeypatch.setattr(interpolations, "make_estimator", lambda source, **_: lopsided)
    write_row(tmp_path, 4)
    both = [pair for k in range(3) for pair in ((k, k + 1), (k + 1, k))]
    lines = [line(a, b, group="walk", depth="matching", frames=3) for a, b in both]
    batch(tmp_path, *lines)
    done = records(tmp_path / "out")
    assert sum(record["panoramas_decoded"] for record in done) == 4
    assert [record["pairs_matched"] for record in done] == [1, 0] * 3
    shared = contents(tmp_path / "out")
    shutil.rmtree(tmp_path / "out")
    for one in reversed(lines):
        batch(tmp_path, one | {"group": one["id"]})
    assert contents(tmp_path / "out") == shared


def lopsided(first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
    near, far = (DepthEstimate(np.full(SIZE, value, np.float32), np.ones(SIZE, np.float32)) for value in (0.5, 0.25))
    return near, far


def test_a_second_run_does_nothing(tmp_path):
    write_row(tmp_path, 3)
    lines = [line(0, 1), line(1, 2)]
    batch(tmp_path, *lines)
    before = {file: file.stat().st_mtime_ns for file in (tmp_path / "out").rglob("*")}
    os.utime(tmp_path / "p0.png", ns=(1, 1))  # touched, not changed
    report = batch(tmp_path, *lines)
    assert (report.done, ids(report.kept)) == ([], ["0-1", "1-2"])
    assert {file: file.stat().st_mtime_ns for file in (tmp_path / "out").rglob("*")} == before


def change_pose(folder: Path) -> None:
    entries = dict(read_poses(folder / "poses.json").panoramas)
    entries["p2.png"] = replace(entries["p2.png"], pose=Pose(np.eye(3), np.array([0.0, 0.0, -2.5])))
    write_poses(folder / "poses.json", entries)


CHANGES = {
    "picture": lambda folder: write_image(folder / "p2.png", np.zeros((*SIZE, 3), np.uint8)),
    "depth": lambda folder: (folder / "depth2.exr").write_bytes((folder / "depth0.exr").read_bytes()[:-1] + b"\0"),
    "pose": change_pose,
    "output": lambda folder: (folder / "out" / "1-2" / "000001.png").unlink(),
    "option": None,
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_only_what_changed_is_done_again(tmp_path, change):
    """A picture, a depth file, a pose, an output that went away, and an option (None)."""
    write_row(tmp_path, 3)
    batch(tmp_path, line(0, 1), line(1, 2))
    if change:
        change(tmp_path)
    report = batch(tmp_path, line(0, 1), line(1, 2, **({} if change else {"ease": "smooth"})), line(1, 0))
    assert (ids([*report.done, *report.failed]), ids(report.kept)) == (["1-0", "1-2"], ["0-1"])
    assert len(list((tmp_path / "out" / "1-2").iterdir())) == 3


NETWORKS = {
    "completion-balanced": "completion", "depth-guided": "guided-depth", "descriptors": "descriptors",
    "fusion-residual": "fusion",
}  # fmt: skip


def install(folder: Path, **contents: str) -> None:
    """Networks of the manifest with these contents, by their roles; those that are not named stay as they were."""
    entries = []
    for name, role in NETWORKS.items():
        file = folder / f"{name}.onnx"
        if role in contents or not file.exists():
            file.write_text(contents.get(role, "first"))
        digest = hashlib.sha256(file.read_bytes()).hexdigest()
        entries.append(
            f'[[models]]\nname = "{name}"\nrole = "{role}"\nvariant = ""\nfile = "{file.name}"\nsha256 = "{digest}"\n'
            'size = [16, 32]\nparameters = 1\ntraining = ""\nlicence = ""\n'
        )
    (folder / "manifest.toml").write_text("version = 1\n" + "\n".join(entries))


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """A folder of networks that is the program's; nothing is computed with them."""
    folder = tmp_path / "models"
    folder.mkdir()
    install(folder)
    monkeypatch.setattr(models, "models_folder", lambda: folder)
    monkeypatch.setattr(interpolations, "make_estimator", lambda source, **_: lopsided)
    fuser = lambda name, settings, **_: GeometricFuser(settings.size, threads=1)  # noqa: E731
    monkeypatch.setattr("omnisyn_cli.pipeline.config.make_fuser", fuser)
    return folder


@pytest.mark.parametrize(
    ("change", "again"),
    [(lambda folder: install(folder), []), (lambda folder: os.utime(folder / "manifest.toml", ns=(1, 1)), []),
     (lambda folder: install(folder, completion="second"), ["preset"]),
     (lambda folder: install(folder, fusion="second"), ["fusion"]),
     (lambda folder: (folder.parent / "mine.onnx").write_text("other"), ["mine"]),
     (lambda folder: os.utime(folder.parent / "mine.onnx", ns=(1, 1)), [])],
    ids=["the same", "touched", "of the preset", "for fusion", "of the user", "of the user touched"],
)  # fmt: skip
def test_another_network_does_the_jobs_again_that_use_it(tmp_path, installed, change, again):
    """A job without a network, one with that of its preset, others with that for fusion, or of a file."""
    write_row(tmp_path, 2)
    (tmp_path / "mine.onnx").write_text("mine")
    wishes = {"none": {}, "preset": {"preset": "fast", "depth": "refined"}, "fusion": {"fusion": "network"},
              "mine": {"depth": "network", "model": "mine.onnx"}}  # fmt: skip
    lines = [line(0, 1, **wish) | {"id": name, "output": name} for name, wish in wishes.items()]
    first = batch(tmp_path, *lines)
    assert (ids(first.done), first.failed) == (sorted(wishes), [])
    change(installed)
    second = batch(tmp_path, *lines)
    assert (ids(second.done), ids(second.kept)) == (again, sorted(set(wishes) - set(again)))
    assert ids(batch(tmp_path, *lines).kept) == sorted(wishes)


def test_a_job_that_lacked_its_network_is_tried_again_when_there_is_one(tmp_path, installed):
    write_row(tmp_path, 2)
    manifest = (installed / "manifest.toml").read_text()
    (installed / "manifest.toml").unlink()
    assert ids(batch(tmp_path, line(0, 1, depth="refined")).failed) == ["0-1"]
    assert ids(batch(tmp_path, line(0, 1, depth="refined")).failed) == ["0-1"]
    assert len(records(tmp_path / "out")) == 1, "it was not tried a second time"
    (installed / "manifest.toml").write_text(manifest)
    assert ids(batch(tmp_path, line(0, 1, depth="refined")).done) == ["0-1"]


def test_a_worker_loads_a_network_once_and_again_when_it_changes(tmp_path, installed, monkeypatch):
    loaded = []
    monkeypatch.setattr(interpolations, "make_estimator", lambda source, **_: loaded.append(source.model) or lopsided)
    write_row(tmp_path, 3)
    (tmp_path / "mine.onnx").write_text("mine")
    lines = [line(0, 1, depth="refined"), line(1, 2, depth="refined", ease="smooth", nadir=9),
             line(0, 2, depth="network", model="mine.onnx")]  # fmt: skip
    jobs = read_manifest(write_lines(tmp_path / "jobs.jsonl", lines)).jobs
    (tmp_path / "out").mkdir()
    with open_staging_dir(tmp_path / "out") as staging:
        work = Interpolator(tmp_path / "out", staging, 1)
        for _ in range(2):
            for job in jobs:
                work(job)
        mine = jobs[2].options["model"]
        assert loaded == ["completion-balanced", mine]
        install(installed, completion="second")
        (tmp_path / "mine.onnx").write_text("other")
        for job in jobs:
            work(job)
    assert loaded == ["completion-balanced", mine] * 2


def test_masks_are_the_manifests_and_changing_one_does_the_job_again(tmp_path):
    write_row(tmp_path, 2)
    for name in ("m0.png", "m1.png"):
        write_image(tmp_path / name, np.full(SIZE, 255, np.uint8))
    asked = line(0, 1, masks=["m0.png", "m1.png"], nadir=20, save_confidence="doubts/%03d.png")
    (job,) = read_manifest(write_lines(tmp_path / "jobs.jsonl", [asked])).jobs
    made = job.interpolation(tmp_path / "out")
    assert (made.masks, made.nadir) == ((tmp_path / "m0.png", tmp_path / "m1.png"), math.radians(20))
    assert made.save_confidence == tmp_path / "out" / "doubts" / "%03d.png"
    assert len(batch(tmp_path, asked).done) == 1
    assert sum(name.startswith("doubts/") for name in contents(tmp_path / "out")) == 3
    assert len(batch(tmp_path, asked).kept) == 1
    mask = np.full(SIZE, 255, np.uint8)
    mask[:4] = 0
    write_image(tmp_path / "m1.png", mask)
    assert len(batch(tmp_path, asked).done) == 1


def test_files_of_others_in_a_jobs_folder_stay_and_redo_nothing(tmp_path):
    """Frames of another format and the ones that are too many go, whatever has other names stays."""
    write_row(tmp_path, 2)
    batch(tmp_path, line(0, 1, frames=5, codec="jpg"))
    mine = tmp_path / "out" / "0-1" / "notes.txt"
    mine.write_text("mine")
    assert len(batch(tmp_path, line(0, 1, frames=5, codec="jpg")).kept) == 1
    assert len(batch(tmp_path, line(0, 1, frames=3, codec="png")).done) == 1
    assert {name.removeprefix("0-1/") for name in contents(tmp_path / "out")} == {
        "000000.png", "000001.png", "000002.png", "notes.txt",
    }  # fmt: skip
    assert mine.read_text() == "mine"
    (tmp_path / "out" / "0-1" / "000001.png").unlink()
    assert len(batch(tmp_path, line(0, 1, frames=3, codec="png")).done) == 1


def test_poses_are_found_in_the_pictures_as_well_as_given(tmp_path):
    """``auto`` and a baseline: the middle frame is the true one nearly as much as with the poses of the generator."""
    scene = generate_scene("street", 101)
    path = sample_path(scene, 101, 3, baseline=1.0)
    truth = []
    for name, pose in zip(("a.png", "b.png", "c.png"), path, strict=True):
        image, _ = render_panorama(scene, pose, (192, 384), supersample=2, threads=1)
        truth.append(np.asarray(image))
        write_image(tmp_path / name, as_bytes(image))
    write_poses(tmp_path / "poses.json", {"a.png": PosedPanorama(path[0]), "c.png": PosedPanorama(path[2])})
    baseline = float(np.linalg.norm(path[2].position - path[0].position))
    common = {"inputs": ["a.png", "c.png"], "frames": 3, "depth": "matching", "preset": "fast"}
    lines = [{"id": "found", "output": "found", "poses": "auto", "baseline": baseline, **common},
             {"id": "given", "output": "given", "poses": "poses.json", **common}]  # fmt: skip
    report = batch(tmp_path, *lines)
    assert (ids(report.done), report.failed) == (["found", "given"], [])
    found, given = (ws_psnr(read_panorama(tmp_path / "out" / name / "000001.png").image, truth[1])
                    for name in ("found", "given"))  # fmt: skip
    assert found > given - 0.5 > ws_psnr((truth[0] + truth[2]) / 2, truth[1]) + 3
    by_id = {record["id"]: record["summary"] for record in records(tmp_path / "out")}
    assert by_id["found"]["path_metres"] == pytest.approx(baseline, abs=1e-4)
    assert any("matches agree" in note for note in by_id["found"]["notes"])
    assert ids(batch(tmp_path, *lines).kept) == ["found", "given"]


def test_another_baseline_or_picture_does_a_job_with_found_poses_again(tmp_path, monkeypatch):
    """And one that is tried without features in the pictures fails alone, saying what is missing."""
    write_row(tmp_path, 3)
    lines = [line(0, 1, poses="auto", baseline=1.5), line(1, 2)]
    failed = batch(tmp_path, *lines).failed
    assert ids(failed) == ["0-1"]
    assert "matches that agree" in failed[0]["error"]
    monkeypatch.setattr(posing, "estimate_poses", lambda images, *_, **__: FoundPoses(
        read_poses(tmp_path / "poses.json").panoramas, (), 1, images))  # fmt: skip
    assert ids(batch(tmp_path, *lines, retry_failed=True).done) == ["0-1"]
    assert ids(batch(tmp_path, *lines).kept) == ["0-1", "1-2"]
    other = line(0, 1, poses="auto", baseline=2.5)
    assert ids(batch(tmp_path, other, lines[1]).done) == ["0-1"]
    write_image(tmp_path / "p0.png", np.zeros((*SIZE, 3), np.uint8))
    assert (ids(batch(tmp_path, other, lines[1]).done)) == ["0-1"]


def test_a_bad_pair_stops_nothing_and_is_tried_again_when_told_or_mended(tmp_path):
    write_row(tmp_path, 3)
    good = (tmp_path / "p2.png").read_bytes()
    (tmp_path / "p2.png").write_bytes(good[:200])
    lines = [line(1, 2), line(0, 1)]
    first = batch(tmp_path, *lines)
    assert (ids(first.done), ids(first.failed)) == (["0-1"], ["1-2"])
    assert "p2.png" in first.failed[0]["error"]
    assert "1-2/000000.png" not in contents(tmp_path / "out")
    second = batch(tmp_path, *lines)
    assert (second.done, ids(second.kept), ids(second.failed)) == ([], ["0-1"], ["1-2"])
    assert len(records(tmp_path / "out")) == 2, "nothing was tried"
    third = batch(tmp_path, *lines, retry_failed=True)
    assert (ids(third.failed), len(records(tmp_path / "out"))) == (["1-2"], 3)
    (tmp_path / "p2.png").write_bytes(good)
    fourth = batch(tmp_path, *lines)
    assert (ids(fourth.done), ids(fourth.kept), fourth.failed) == (["1-2"], ["0-1"], [])


def test_files_that_no_batch_has_written_are_safe(tmp_path):
    write_row(tmp_path, 2)
    (tmp_path / "out" / "0-1").mkdir(parents=True)
    (tmp_path / "out" / "0-1" / "mine.txt").write_text("mine")
    with pytest.raises(OutputPathError, match="overwrite"):
        batch(tmp_path, line(0, 1))
    assert (tmp_path / "out" / "0-1" / "mine.txt").exists()
    assert len(batch(tmp_path, line(0, 1), overwrite=True).done) == 1


def test_files_that_no_record_names_are_safe_beside_those_of_a_batch(tmp_path):
    write_row(tmp_path, 3)
    batch(tmp_path, line(0, 1))
    mine = tmp_path / "out" / "1-2"
    mine.mkdir()
    (mine / "mine.txt").write_text("mine")
    with pytest.raises(OutputPathError, match="1 that exist"):
        batch(tmp_path, line(0, 1, frames=4), line(1, 2))
    assert (mine / "mine.txt").exists()
    assert len(batch(tmp_path, line(0, 1, frames=4)).done) == 1, "what the batch has made it may replace"


def test_what_a_killed_run_had_no_time_to_record_is_replaced(tmp_path):
    write_row(tmp_path, 2)
    (tmp_path / "out" / "0-1").mkdir(parents=True)
    killed = open_staging_dir(tmp_path / "out")
    staging = tmp_path / "out" / killed.__enter__()
    (staging / "unfinished").touch()
    report = batch(tmp_path, line(0, 1))
    assert (len(report.done), report.leftovers) == (1, [staging])
    assert not list((tmp_path / "out").glob(".*"))


def test_a_worker_that_outlives_its_batch_writes_nothing(tmp_path):
    former, work = open_staging_dir(tmp_path), open_staging_dir(tmp_path)
    with attempt_folder(tmp_path / former.__enter__()) as (attempt, _), work as staging:
        assert remove_leftovers(tmp_path, staging) == [attempt.parent]
        with pytest.raises(WriteError), replaced_when_complete(attempt / "a.mp4") as file:
            file.touch()
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("mistaken", ["depth1.exr", "mask.png"])
def test_what_a_pose_file_names_is_never_an_output(tmp_path, mistaken):
    write_row(tmp_path, 2)
    poses = json.loads((tmp_path / "poses.json").read_text())
    poses["panoramas"]["p0.png"]["mask"] = "mask.png"
    (tmp_path / "poses.json").write_text(json.dumps(poses))
    write_image(tmp_path / "mask.png", np.full((*SIZE, 3), 255, np.uint8))
    (tmp_path / mistaken).rename(tmp_path / "a.mp4")
    (tmp_path / "poses.json").write_text((tmp_path / "poses.json").read_text().replace(mistaken, "a.mp4"))
    before = (tmp_path / "a.mp4").read_bytes()
    path = write_lines(tmp_path / "jobs.jsonl", [line(0, 1, output="a.mp4")])
    with pytest.raises(OutputPathError, match="expected inputs"):
        run_batch(read_manifest(path), tmp_path, BatchOptions(overwrite=True))
    assert (tmp_path / "a.mp4").read_bytes() == before


@pytest.mark.parametrize("mistaken", ["p1.png", "poses.json", "jobs.jsonl"])
def test_inputs_are_never_outputs(tmp_path, mistaken):
    """Not even where their names are those of videos."""
    write_row(tmp_path, 2)
    names = {name: "a.mp4" if name == mistaken else name for name in ("p1.png", "poses.json", "jobs.jsonl")}
    text = (tmp_path / "poses.json").read_text().replace("p1.png", names["p1.png"])
    (tmp_path / "poses.json").write_text(text)
    for name in ("p1.png", "poses.json"):
        (tmp_path / name).rename(tmp_path / names[name])
    job = line(0, 1, output="a.mp4", poses=names["poses.json"]) | {"inputs": ["p0.png", names["p1.png"]]}
    path = write_lines(tmp_path / names["jobs.jsonl"], [job])
    before = contents(tmp_path)
    with pytest.raises(OutputPathError, match="expected inputs"):
        run_batch(read_manifest(path), tmp_path, BatchOptions(overwrite=True))
    assert contents(tmp_path) == before


def test_a_folder_with_inputs_in_it_is_never_replaced(tmp_path):
    (tmp_path / "tour").mkdir()
    write_row(tmp_path / "tour", 2)
    one = {"id": "a", "scene": "tour", "output": "tour", "frames": 3}
    path = write_lines(tmp_path / "jobs.jsonl", [one])
    with pytest.raises(OutputPathError, match="expected inputs"):
        run_batch(read_manifest(path), tmp_path, BatchOptions(overwrite=True))


def test_a_manifest_with_problems_is_not_begun(tmp_path):
    write_row(tmp_path, 2)
    with pytest.raises(InputError, match="got 1"):
        batch(tmp_path, line(0, 1), "{")
    assert not (tmp_path / "out").exists()


def test_a_worker_that_does_not_see_the_folder_sends_the_files(tmp_path):
    write_row(tmp_path, 2)
    path = write_lines(tmp_path / "jobs.jsonl", [line(0, 1, save_depth="depth", output="f/v_%02d.png")])
    (job,) = read_manifest(path).jobs
    there, elsewhere = tmp_path / "there", tmp_path / "elsewhere"
    there.mkdir()
    with open_staging_dir(there) as staging:
        seen = Interpolator(there, staging, 1)(job)
        sent = Interpolator(elsewhere, staging, 1)(job)
        other = Interpolator(there, "another", 1)(job)
    assert seen["files"] is None
    assert not elsewhere.exists()
    assert set(sent["files"]) == set(contents(there)) == set(other["files"])
    elsewhere.mkdir()
    write_outputs(sent["files"], elsewhere, job.places)
    assert contents(elsewhere) == contents(there)
    assert sent["outputs"] == seen["outputs"]


def test_progress_counts_jobs_and_their_costs(tmp_path):
    write_row(tmp_path, 3)
    path = write_lines(tmp_path / "jobs.jsonl", [line(0, 1), line(1, 2, frames=300, max_pixels=1), line(0, 2)])
    seen: list[Progress] = []
    report = run_batch(read_manifest(path), tmp_path / "out", BatchOptions(), seen.append)
    assert [(p.done, p.failed, p.jobs) for p in seen] == [(0, 0, 3), (0, 1, 3), (1, 1, 3), (2, 1, 3)]
    assert seen[0].cost_done == 0
    assert seen[-1].cost_done == pytest.approx(seen[-1].cost)
    json.dumps(report.describe())
