"""What ``--dry-run`` says about memory is what a run takes."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest

from interpolation_samples import CHAIN, Hall, job_of, tour_job
from omnisyn_cli.interpolation.export.formats import ExportJob, plan_export
from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.interpolation.plan import plan_interpolation
from omnisyn_cli.interpolation.viewer.run import ViewJob, plan_view
from omnisyn_cli.io import read_header, write_image
from omnisyn_cli.pipeline.depth_sources import PRIOR_BYTES
from omnisyn_cli.pipeline.fusions import FUSIONS
from process_limits import STATUS
from synthesis_samples import as_bytes, hall_image, posed, write_hall

where_the_peak_is_told = pytest.mark.skipif(not STATUS.exists(), reason="nobody tells the peak of memory there")
MEASURED = """
import sys
from pathlib import Path
from omnisyn_cli.cli import main
from omnisyn_cli.compute.jit import when_compiling
compiled = []
try:
    with when_compiling(lambda: compiled.append(True)):
        main(sys.argv[1:])
finally:
    status = Path("/proc/self/status").read_text().splitlines()
    print(next(line for line in status if line.startswith("VmHWM")).split()[1], any(compiled))
"""


def peak_of(command: list[str]) -> int:
    """Bytes of a process that compiles no kernels, which takes memory of its own: a second one where the first does."""
    for _ in range(2):
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        peak, compiled = done.stdout.split()[-2:]
        if compiled == "False":
            break
    return int(peak) * 1024


def peak_of_interpolation(job: InterpolationJob, chosen: dict[str, str]) -> int:
    options = ["--poses", job.poses, "-o", job.output, "--frames", job.frames, "-q", "--overwrite"]
    options += [] if job.size is None else ["--size", f"{job.size[1]}x{job.size[0]}"]
    options += [word for name, value in chosen.items() for word in (f"--{name}", value)]
    return peak_of([sys.executable, "-c", MEASURED, "interpolate", *map(str, [*job.images, *options])])


@where_the_peak_is_told
@pytest.mark.parametrize(
    ("count", "size", "chosen"),
    [
        (2, (256, 512), {"preset": "balanced"}), (2, (1024, 2048), {"preset": "balanced"}),
        (2, (256, 512), {"preset": "fast"}), (4, (256, 512), {"preset": "fast"}),
        (2, (256, 512), {"depth": "matching", "renderer": "two-pass"}),
        (2, (256, 512), {"depth": "matching", "renderer": "points"}), (2, (256, 512), {"method": "synsin"}),
    ],
    ids=str,
)  # fmt: skip
def test_the_plan_is_within_a_fifth_of_the_peak(tmp_path, count, size, chosen) -> None:
    """From photographs alone: with colours held and on demand, with and without networks and sharpening; of a tour."""
    images = write_hall(tmp_path, [posed((0, 0, 0.3 - 0.6 * k)) for k in range(count)], (256, 512), with_depth=False)
    frames = 2 * count - 1
    job = InterpolationJob(
        tuple(images), tmp_path / "poses.json", tmp_path / "a.mp4", frames=frames, size=size, **chosen
    )
    planned = plan_interpolation(job).memory
    for_prior = PRIOR_BYTES if chosen.get("preset") == "balanced" else 0.0  # of a network that this pair does not need
    assert 0.8 * (planned - for_prior) < peak_of_interpolation(job, chosen) < 1.2 * planned


@where_the_peak_is_told
def test_a_pair_that_matching_leaves_open_takes_the_memory_of_the_network_for_it(tmp_path: Path) -> None:
    """Nothing can be matched but above 45° here."""
    poses = [posed((0, 0, 0.3)), posed((0, 0, -0.3))]
    images = write_hall(tmp_path, poses, (256, 512), with_depth=False)
    for image, pose in zip(images, poses, strict=True):
        samples = hall_image(pose, (256, 512))
        samples[64:] = samples[64:].mean()
        write_image(image, as_bytes(samples))
    job = InterpolationJob(tuple(images), tmp_path / "poses.json", tmp_path / "a.mp4", frames=3, preset="balanced")
    planned = plan_interpolation(job).memory
    peak, without = (peak_of_interpolation(job, {"preset": preset}) for preset in ("balanced", "fast"))
    assert peak - without > PRIOR_BYTES
    assert 0.8 < peak / planned < 1.2


@where_the_peak_is_told
@pytest.mark.parametrize(
    ("command", "output"), [(["view"], "a.html"), (["export", "--format", "colmap"], "set")], ids=["view", "colmap"]
)
def test_what_is_made_of_surfaces_takes_what_its_plan_says(tmp_path, command, output, omnisyn) -> None:
    images = write_hall(tmp_path, [posed((0, 0, 0.3)), posed((0, 0, -0.3))], (1024, 2048), with_depth=False)
    words = [*command, *map(str, images), "-o", str(tmp_path / output), "--preset", "fast"]
    planned = omnisyn.json(*words, "--dry-run")["memory_mib"] * 2**20
    measured = peak_of([sys.executable, "-c", MEASURED, *words, "--overwrite", "-q"])
    assert 0.8 < measured / planned < 1.2


def test_points_of_many_panoramas_take_memory_in_the_end(tmp_path: Path) -> None:
    """Their number grows with the panoramas and falls with the square of the stride; a page only grows a little."""
    images = write_hall(tmp_path, CHAIN, with_depth=False)

    def bytes_of(count: int, **changes: object) -> int:
        return plan_export(
            tour_job(ExportJob, tmp_path, [images[k % 3] for k in range(count)], "a.ply", **changes)
        ).memory

    few, many = bytes_of(10), bytes_of(100)
    assert many - few > 90 * 2 * 107 * 0.6 * 256 * 512
    assert bytes_of(100, stride=4) - bytes_of(10, stride=4) < (many - few) / 10
    pages = [
        plan_view(tour_job(ViewJob, tmp_path, [images[k % 3] for k in range(count)], "a.html")).memory
        for count in (10, 100)
    ]
    assert 0 < pages[1] - pages[0] < (many - few) / 10


def test_the_estimate_of_memory_grows_with_every_size(tmp_path: Path) -> None:
    small = write_hall(tmp_path, CHAIN[:2], (16, 32))
    targets = [plan_interpolation(job_of(tmp_path, small, size=(h, 2 * h))).memory for h in (16, 64, 1024, 4096)]
    assert targets == sorted(set(targets))
    write_image(small[0], np.zeros((512, 1024, 3), np.uint8))
    assert plan_interpolation(job_of(tmp_path, small, size=(1024, 2048))).memory > targets[2]
    assert 5e8 < plan_interpolation(job_of(tmp_path, small, size=(4096, 8192))).memory < 1e10


def test_the_network_that_corrects_the_blend_takes_the_same_at_every_size(pair: Hall) -> None:
    for size in ((64, 128), (512, 1024)):
        plain, corrected = (pair.plan(size=size, fusion=name).memory for name in ("geometric", "network"))
        assert corrected - plain == pytest.approx(FUSIONS["network"].network_bytes(0), abs=1)


def test_a_data_window_of_depth_takes_the_memory_of_the_whole_sphere(tmp_path: Path) -> None:
    """And is planned with: its own 24 rows would not be half its width."""
    images = write_hall(tmp_path, CHAIN[:2], (32, 64))
    whole = plan_interpolation(job_of(tmp_path, images)).memory
    for image in images:
        depth = str(tmp_path / f"{image.stem}_depth.exr")
        cropped = OpenImageIO.ImageBufAlgo.crop(OpenImageIO.ImageBuf(depth), OpenImageIO.ROI(0, 64, 2, 26))
        assert cropped.write(depth)
        assert read_header(depth).height == 24
    assert plan_interpolation(job_of(tmp_path, images)).memory == whole


def test_colours_are_held_only_where_every_pixel_is_looked_at_first(tmp_path: Path, pair: Hall) -> None:
    """Both renderings' colours, in frames of small cells; a network that corrects the blend needs no more of them."""

    def bytes_of(rows: int, **changes: object) -> float:
        job = pair.job(size=(rows, 2 * rows), **changes)
        return plan_interpolation(job).memory / (2 * rows**2)

    few, many = (bytes_of(rows) - bytes_of(rows, renderer="two-pass") for rows in (896, 898))
    assert few - many == pytest.approx(2 * 16, abs=0.1)
    corrected = bytes_of(1024, fusion="network") - bytes_of(1024)
    assert corrected == pytest.approx(FUSIONS["network"].network_bytes(0) / (2 * 1024**2), abs=1e-3)
    judged = bytes_of(1024, fallback="none", save_confidence=tmp_path / "confidence")
    assert judged == pytest.approx(bytes_of(1024, fallback="none") + 12, abs=1e-3) == bytes_of(1024)
