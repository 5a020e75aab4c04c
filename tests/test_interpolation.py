"""From files to frames: the photographs at the ends, every kind of input, and all of it or nothing."""

import gc
import weakref
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO
import pytest

from interpolation_samples import CHAIN, Hall, job_of, listing, use_ffmpeg, write_entries
from omnisyn_cli.errors import EncodingError, ImageError, InputError, OutputPathError
from omnisyn_cli.interpolation.job import POSES_FROM_PICTURES, InterpolationJob
from omnisyn_cli.interpolation.plan import InterpolationPlan, plan_interpolation
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import Panorama, read_depth, read_panorama, write_depth, write_image
from omnisyn_cli.poses.file import PosedPanorama, write_poses
from synthesis_samples import SIZE, as_bytes, distance_to_wall, hall_image, posed, world_directions, write_hall, ws_psnr


def run(job: InterpolationJob) -> list[np.ndarray]:
    run_interpolation(plan_interpolation(job))
    return [samples_of(file) for file in sorted(job.output.iterdir())]


def check_frames(plan: InterpolationPlan) -> None:
    """All frames show the hall from where the camera is."""
    for waypoint, frame in zip(plan.path, run(plan.job), strict=True):
        assert ws_psnr(frame / 255, hall_image(waypoint.pose)) > 45


def samples_of(file: Path) -> np.ndarray:
    return read_panorama(file).original


def test_photographs_come_out_bit_by_bit_and_frames_between_are_right(tmp_path: Path, chain: Hall) -> None:
    plan = chain.plan(frames=7)
    run_interpolation(plan)
    shown = set()
    for waypoint, file in zip(plan.path, sorted((tmp_path / "out").iterdir()), strict=True):
        frame, place = samples_of(file), waypoint.segment + waypoint.t
        if place in (0, 1, 2):
            np.testing.assert_array_equal(frame, samples_of(chain.images[int(place)]))
            shown.add(place)
        else:
            assert ws_psnr(frame / 255, hall_image(waypoint.pose)) > 45
    assert shown == {0, 1, 2}


def test_panoramas_are_let_go_of_as_soon_as_a_run_has_ended(tmp_path: Path) -> None:
    """Not only when somebody looks for cycles: a worker of a batch has begun the next job by then."""
    plan = plan_interpolation(job_of(tmp_path, write_hall(tmp_path, CHAIN), frames=5))
    held = []

    def read(path: Path, **options: Any) -> Panorama:
        panorama = read_panorama(path, **options)
        held.append(weakref.ref(panorama.original))
        return panorama

    gc.disable()
    try:
        run_interpolation(plan, read=read)
        assert [reference() for reference in held] == [None] * 2 * len(CHAIN)  # each was read for outlines, too
    finally:
        gc.enable()


def test_with_a_common_heading_a_chain_is_level_and_still_passes_through(tmp_path: Path, chain: Hall) -> None:
    for heading in ("first", "fixed", "travel"):
        check_frames(chain.plan(frames=5, heading=heading, output=tmp_path / heading))


@pytest.mark.parametrize("suffix", [".png", ".exr", ".tif"])
def test_inputs_of_more_than_8_bits_are_rounded_once(tmp_path: Path, suffix: str) -> None:
    write_hall(tmp_path, CHAIN[:2])
    exact = [hall_image(pose) for pose in CHAIN[:2]]
    images = [tmp_path / f"deep{index}{suffix}" for index in (0, 1)]
    for path, image in zip(images, exact, strict=True):
        write_image(path, image if suffix == ".exr" else np.rint(image * 65535).astype(np.uint16))
    write_entries(tmp_path, images)
    frames = run(job_of(tmp_path, images))
    for frame, image in zip(frames[::2], exact, strict=True):
        assert np.abs(frame - image * 255).max() <= 0.51
    assert len(frames) == 3


def write_alpha(path: Path, samples: np.ndarray, usable: np.ndarray) -> None:
    rgba = np.concatenate([samples, np.where(usable, 255, 0).astype(np.uint8)[..., None]], axis=-1)
    writer = OpenImageIO.ImageOutput.create(str(path))
    assert writer.open(str(path), OpenImageIO.ImageSpec(rgba.shape[1], rgba.shape[0], 4, "uint8"))
    assert writer.write_image(np.ascontiguousarray(rgba))
    assert writer.close()


@pytest.mark.parametrize("way", ["alpha", "mask file", "half of each"])
def test_what_is_masked_comes_from_the_other_photograph(tmp_path: Path, pair: Hall, way: str) -> None:
    usable = np.ones(SIZE, bool)
    usable[40:60, 30:50] = False
    samples = samples_of(pair.images[0]).copy()
    samples[~usable] = (255, 0, 255)
    entries = [PosedPanorama(pose, tmp_path / f"p{index}_depth.exr") for index, pose in enumerate(CHAIN[:2])]
    is_upper = np.arange(SIZE[0])[:, None] < 50
    in_alpha = {"alpha": usable, "mask file": None, "half of each": usable | is_upper}[way]
    in_file = {"alpha": None, "mask file": usable, "half of each": usable | ~is_upper}[way]
    write_image(pair.images[0], samples)
    if in_alpha is not None:
        write_alpha(pair.images[0], samples, in_alpha)
    if in_file is not None:
        write_image(tmp_path / "mask.png", np.where(in_file, 255, 0).astype(np.uint8))
        entries[0] = replace(entries[0], mask=tmp_path / "mask.png")
    write_poses(tmp_path / "poses.json", dict(zip([path.name for path in pair.images], entries, strict=True)))
    plan = pair.plan(nadir_fill=True)
    run_interpolation(plan)
    for waypoint, frame in zip(plan.path, map(samples_of, sorted((tmp_path / "out").iterdir())), strict=True):
        assert np.abs(frame / 255 - hall_image(waypoint.pose)).max() < 0.1
    np.testing.assert_array_equal(samples_of(tmp_path / "out" / "000002.png"), samples_of(pair.images[1]))


@pytest.mark.parametrize(
    ("samples", "words"),
    [
        (np.ones(SIZE, np.uint8), r"mask\.png: expected white where the panorama may be used"),  # white was meant
        (np.full((8, 16), 255, np.uint8), "128×64 pixels, got 16×8"),
    ],
)
def test_a_mask_that_forbids_everything_or_does_not_fit_is_refused(tmp_path, pair, samples, words) -> None:
    write_image(tmp_path / "mask.png", samples)
    write_entries(tmp_path, pair.images, mask="mask.png")
    with pytest.raises(InputError, match=words):
        run_interpolation(pair.plan())
    assert not (tmp_path / "out").exists()


def test_depth_is_kept_on_request_for_every_pair(tmp_path: Path, chain: Hall) -> None:
    run(chain.job(frames=3, save_depth=tmp_path / "depth"))
    names = ["0000_p0_depth.exr", "0000_p1_depth.exr", "0001_p1_depth.exr", "0001_p2_depth.exr"]
    assert sorted(file.name for file in (tmp_path / "depth").iterdir()) == names
    for name, index in zip(names, (0, 1, 1, 2), strict=True):
        saved = read_depth(tmp_path / "depth" / name)
        np.testing.assert_allclose(saved, distance_to_wall(CHAIN[index], SIZE), rtol=1e-5)
    chain.refuses(OutputPathError, r"0000_p0_depth\.exr", output=tmp_path / "b", save_depth=tmp_path / "depth")


def test_depth_of_both_is_kept_where_only_their_endings_differ(tmp_path: Path) -> None:
    first, second = write_hall(tmp_path, CHAIN[:2])
    images = [first.rename(tmp_path / "p.png"), tmp_path / "p.tif"]
    write_image(images[1], samples_of(second))
    write_entries(tmp_path, images)
    run(job_of(tmp_path, images, save_depth=tmp_path / "depth"))
    for name, pose in zip(("0000_p.png_depth.exr", "0000_p.tif_depth.exr"), CHAIN, strict=False):
        np.testing.assert_allclose(read_depth(tmp_path / "depth" / name), distance_to_wall(pose, SIZE), rtol=1e-5)


def test_frames_are_kept_besides_the_video_on_request(tmp_path: Path, pair: Hall) -> None:
    job = pair.job(output=tmp_path / "a.mp4", save_frames=tmp_path / "frames", encoder_preset="ultrafast")
    seen: list[int] = []
    summary = run_interpolation(plan_interpolation(job), seen.append)
    assert seen == [1, 2, 3]
    assert b"ftyp" in (tmp_path / "a.mp4").read_bytes()[:16]
    assert sorted(file.name for file in (tmp_path / "frames").iterdir()) == ["000000.png", "000001.png", "000002.png"]
    np.testing.assert_array_equal(samples_of(tmp_path / "frames" / "000002.png"), samples_of(pair.images[1]))
    described = summary.describe()
    assert {"decode", "depth", "mesh", "render", "fuse", "encode", "total"} <= set(described["stages"])
    assert described["encoder"] == "h264 crf 17 preset ultrafast"


def test_damage_found_late_leaves_nothing_at_all(tmp_path: Path, chain: Hall) -> None:
    chain.images[2].write_bytes(chain.images[2].read_bytes()[:-300])
    before = listing(tmp_path)
    job = chain.job(output=tmp_path / "a.mp4", save_frames=tmp_path / "f", save_depth=tmp_path / "d")
    with pytest.raises(ImageError, match="damaged"):
        run_interpolation(plan_interpolation(job))
    assert listing(tmp_path) == before
    assert not [path for path in tmp_path.iterdir() if path.is_dir()]


def test_an_encoder_that_fails_at_the_very_end_takes_everything_with_it(tmp_path, monkeypatch) -> None:
    inputs, out = tmp_path / "in", tmp_path / "out"
    inputs.mkdir()
    out.mkdir()
    images = write_hall(inputs, CHAIN[:2])
    use_ffmpeg(monkeypatch, tmp_path, "sys.stdin.buffer.read()\nsys.exit('the muxer lost its mind')")
    job = job_of(
        inputs, images, output=out / "a.mp4", save_frames=out / "frames", save_depth=out / "depth",
        save_confidence=out / "sure",
    )  # fmt: skip
    with pytest.raises(EncodingError, match="the muxer lost its mind"):
        run_interpolation(plan_interpolation(job))
    assert list(out.iterdir()) == []


def test_one_place_twice_is_a_cross_fade_and_said_so(tmp_path: Path) -> None:
    images = write_hall(tmp_path, [CHAIN[0], CHAIN[0], posed((0, 0, 0.6), 1.0)], with_depth=False)
    plan = plan_interpolation(job_of(tmp_path, images, frames=5))
    assert plan.length == 0
    assert [note.partition(": ")[2] for note in plan.notes] == [
        "there is no parallax to follow, the video cross-fades",
        "there is no parallax to follow, the video turns in place and cross-fades",
    ]
    check_frames(plan)


def test_other_aspect_ratios_are_refused_or_resampled(pair: Hall) -> None:
    for image in pair.images:
        write_image(image, samples_of(image).repeat(2, axis=0))
    pair.refuses(ImageError, "twice as wide as high, got 128×128")
    plan = pair.plan(allow_aspect=True)
    assert plan.size == SIZE
    check_frames(plan)


def test_saved_depth_can_be_used_again(tmp_path: Path, pair: Hall) -> None:
    first = run(pair.job(save_depth=tmp_path / "depth"))
    write_entries(tmp_path, pair.images, depth="depth/0000_p{}_depth.exr")
    for a, b in zip(first, run(pair.job(output=tmp_path / "again")), strict=True):
        assert np.abs(a.astype(int) - b).max() <= 1


def test_nothing_there_is_a_place_infinitely_far(tmp_path: Path, pair: Hall) -> None:
    for index in (0, 1):
        write_depth(tmp_path / f"p{index}_depth.exr", np.full(SIZE, np.inf))
    run(pair.job(save_depth=tmp_path / "depth"))
    assert np.isinf(read_depth(tmp_path / "depth" / "0000_p0_depth.exr")).all()


def test_the_summary_says_how_high_the_cameras_stand_and_doubts_what_is_unusual(tmp_path: Path, pair: Hall) -> None:
    for height, is_usual in ((1.6, True), (16.0, False)):
        for index, pose in enumerate(CHAIN[:2]):
            down = np.maximum(-world_directions(pose, SIZE)[..., 1], 1e-3)
            write_depth(tmp_path / f"p{index}_depth.exr", (pose.position[1] + height) / down)
        summary = run_interpolation(pair.plan(output=tmp_path / f"{height}"))
        mean = height + 0.5 * (CHAIN[0].position[1] + CHAIN[1].position[1])
        assert summary.describe()["camera_heights"] == [{"first": 0, "metres": pytest.approx(mean, rel=0.02)}]
        assert any("which is unusual" in line for line in summary.lines()) != is_usual
        found = replace(summary, plan=replace(summary.plan, job=pair.job(poses=POSES_FROM_PICTURES)))
        baseline = float(np.linalg.norm(CHAIN[1].position - CHAIN[0].position))
        advice = f"give --baseline {1.5 * baseline / mean:.2g}"
        assert any(line.endswith(advice) for line in found.lines()) != is_usual


def test_exr_frames_keep_what_eight_bits_would_round(tmp_path: Path, pair: Hall) -> None:
    run_interpolation(pair.plan(codec="exr"))
    middle = read_panorama(tmp_path / "out" / "000001.exr").image
    assert np.abs(middle * 255 - np.rint(middle * 255)).max() > 0.25
    run_interpolation(pair.plan(output=tmp_path / "png"))
    np.testing.assert_array_equal(samples_of(tmp_path / "png" / "000001.png"), as_bytes(middle))


def test_prores_takes_sixteen_bits_and_a_folder_takes_no_quality(tmp_path: Path, pair: Hall) -> None:
    run_interpolation(pair.plan(output=tmp_path / "clip.mov", codec="prores"))
    assert (tmp_path / "clip.mov").stat().st_size > 0
    pair.refuses(OutputPathError, "leave it out", crf=18)


def test_overwriting_frames_spares_files_that_only_look_numbered(tmp_path: Path, pair: Hall) -> None:
    out = tmp_path / "out"
    out.mkdir()
    others = dict.fromkeys(("0001.png", "7.png", "20230615.png", "000009.png"), b"somebody's")
    for name, content in {**others, "000002.png": b"former frame", "000003.png": b"former frame"}.items():
        (out / name).write_bytes(content)
    run_interpolation(pair.plan(overwrite=True))
    found = listing(out)
    assert found.keys() == {"000000.png", "000001.png", "000002.png", *others}
    assert found["000002.png"] != b"former frame"
