"""What can be refused for a job's own words and for what the headers of its files say."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from omnisyn_cli.errors import InputError, OutputPathError
from omnisyn_cli.interpolation import job as jobs
from omnisyn_cli.interpolation.job import InterpolationJob, TourJob
from omnisyn_cli.io import MAX_PIXELS, check_output, check_video, read_header
from omnisyn_cli.io.depth_files import depth_size
from omnisyn_cli.io.encode import ImageSequence, image_sequence, is_sequence
from omnisyn_cli.io.images import check_mask_size, sphere_size
from omnisyn_cli.io.outputs import check_kept, check_name, check_staged_folder, real_path
from omnisyn_cli.pipeline.config import RunConfig
from omnisyn_cli.pipeline.methods import METHODS, OMNISYN
from omnisyn_cli.poses.file import PosedPanorama

# Fields of a job that mean nothing to the methods that it is compared with.
SURFACE_FIELDS = (
    "preset", "depth", "model", "depth_prior", "renderer", "cut", "cut_metres", "fusion", "adaptive", "fallback",
    "save_confidence", "save_depth", "view",
)  # fmt: skip
MAX_NADIR_RADIANS = math.radians(90.0)  # a cap that is no hemisphere yet


def check_names(job: TourJob) -> None:
    """Refuse names that are no UTF-8 (InputError), which image libraries do not take, or no names (OutputPathError)."""
    outputs = [place for name in jobs.OUTPUTS if (place := getattr(job, name, None)) is not None]
    for path in (*job.images, *jobs.input_files(job), job.poses, *outputs):
        name = str(path)
        if name.encode("utf-8", "replace") != name.encode("utf-8", "surrogateescape"):
            raise InputError(f"{name!r}: expected a file name in UTF-8, got other bytes; rename the file or its folder")
    for target in outputs:
        check_name(target)


def check_choices(job: TourJob) -> None:
    """Refuse (InputError) what the command line does not offer as a choice, for those who call the library."""
    for name, known in jobs.CHOICES.items():
        if (value := getattr(job, name, known[0])) not in known:
            raise InputError(f"expected one of {', '.join(known)} as {name}, got {value!r}; choose one of these")
    if job.cut is not None and job.cut_metres is not None:
        raise InputError("expected either cut or cut_metres, got both; name one")
    if job.masks and len(job.masks) != len(job.images):
        raise InputError(
            f"expected one mask for each of {len(job.images)} panoramas, got {len(job.masks)}; name them in the order "
            "of the panoramas, or in the pose file"
        )
    if job.nadir is not None and not 0.0 <= job.nadir < MAX_NADIR_RADIANS:
        raise InputError(
            f"expected a cap around the nadir of at least 0 and less than {math.degrees(MAX_NADIR_RADIANS):g} degrees, "
            f"got {math.degrees(job.nadir):g}; give the angle from straight down to its edge"
        )


def check_pose_options(job: TourJob) -> None:
    """Refuse options that are for poses from pictures alone, or for poses from a file alone (InputError)."""
    is_found = job.poses == jobs.POSES_FROM_PICTURES
    for name, metres in (("baseline", job.baseline), ("height of the camera", job.camera_height)):
        if metres is not None and not is_found:
            raise InputError(
                f"expected a {name} only where poses are found in the pictures (--poses auto), got {metres:g} m "
                f"and {job.poses}; leave out one of them"
            )
    if job.baseline is not None and job.camera_height is not None:
        raise InputError("expected a baseline or the height of the camera, got both; leave out one of them")
    if job.refine and is_found:
        raise InputError("expected poses to refine, got --poses auto, which finds them; leave out one of them")


def check_method(job: InterpolationJob) -> None:
    """Refuse (InputError) options that only say how this program's own frames are made beside another method."""
    defaults = InterpolationJob(job.images, job.poses, job.output)
    for name in () if METHODS[job.method].draws_surfaces else SURFACE_FIELDS:
        if (chosen := getattr(job, name)) != getattr(defaults, name):
            raise InputError(
                f"expected no {name.replace('_', '-')} with the method {job.method}, which leaves none to choose, got "
                f"{chosen}; leave it out, or take the method {OMNISYN}"
            )


def check_view(job: InterpolationJob) -> None:
    """Refuse (InputError) what does not go with a flat view or with both eyes, and what only goes with one."""
    is_flat, is_stereo = job.projection == "flat", job.stereo != "mono"
    kind = "--view flat" if is_flat else "--stereo top-bottom" if is_stereo else "a 360° video"
    unfit = {
        "fov": not is_flat and job.fov is not None,
        "look": not is_flat and job.look is not None,
        "heading": is_flat and job.heading != "panoramas",
        "stereo": is_flat and is_stereo,
        "save-confidence": is_stereo and job.save_confidence is not None,
        "fusion": is_flat and job.fusion not in ("auto", "geometric"),
        "renderer": is_flat and job.renderer not in ("auto", "mesh"),
        "method": (is_flat or is_stereo) and job.method != OMNISYN,
    }
    for option, is_unfit in unfit.items():
        if is_unfit:
            raise InputError(f"expected no --{option} with {kind}, got one; leave it out")


def source_size(job: TourJob, image: Path) -> tuple[int, int]:
    """Height and width of the panorama that a file becomes. Raises ImageError: there is none."""
    header, reading = read_header(image), jobs.reading_of(job)
    return sphere_size(header, allow_aspect=job.allow_aspect, max_pixels=job.max_pixels, reading=reading)


def check_companions(
    job: TourJob, entries: Sequence[PosedPanorama], sizes: Sequence[tuple[int, int]], config: RunConfig
) -> None:
    """Refuse masks of other sizes than their panoramas, and depth files, if they are used, that are none.

    Raises ImageError: one is missing or unreadable, or is no depth; InputError: a mask has another size.
    """
    for k, (entry, size) in enumerate(zip(entries, sizes, strict=True)):
        for mask in (entry.mask, *job.masks[k : k + 1], *job.blur[k : k + 1]):
            if mask not in (None, jobs.FACES):
                check_mask_size(mask, source_size(job, mask), size)
        if entry.depth is not None and config.depth.strategy.reads_files:
            depth_size(read_header(entry.depth))


def check_shape(job: InterpolationJob, size: tuple[int, int]) -> None:
    """Refuse (InputError) a height and width of a 360° video that are not 1:2."""
    if size[1] != 2 * size[0] and job.projection != "flat":
        raise InputError(f"expected a size twice as wide as high, got {size[1]}x{size[0]}; try {2 * size[0]}x{size[0]}")


def check_outputs(job: InterpolationJob, size: tuple[int, int]) -> None:
    """Refuse what cannot be written.

    Raises InputError: the size is not 2:1, too large, or nothing for the encoder; OutputPathError: a place exists
    already, cannot be written to, or is that of another output.
    """
    check_shape(job, size)
    if size[0] * size[1] > MAX_PIXELS:
        raise InputError(f"expected a size of at most {MAX_PIXELS:,} pixels, got {size[1]}x{size[0]}; ask for less")
    if job.save_frames is not None and not is_sequence(job.save_frames):
        raise OutputPathError(
            f"{job.save_frames}: expected a folder or a pattern such as frames/%05d.png, got a file name"
        )
    whole = (2 * size[0], size[1]) if job.stereo == "top-bottom" else size
    for place, encoding in jobs.targets(job).items():
        check_video(place, size=whole, overwrite=job.overwrite, **encoding)
    if job.save_confidence is not None:
        check_video(job.save_confidence, size=size, fps=job.fps, overwrite=job.overwrite)
    if job.view is not None:
        check_page(job.view, job.overwrite)
    places = (job.output, job.save_frames, job.save_confidence, job.view)
    _check_distinct(path for path in places if path is not None)
    if job.audio is not None and is_sequence(job.output):
        raise InputError(f"{job.output}: expected a video for --audio, got a place for images; name one such as a.mp4")
    if job.save_depth is not None:
        check_staged_folder(job.save_depth)
        for file in jobs.depth_files(job):
            if file.exists():
                check_output(file, job.overwrite)


def check_page(path: Path, overwrite: bool) -> None:
    """Refuse (OutputPathError) a place that no page can be written to."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise OutputPathError(f"{path}: expected a name ending in .html, got '{path.suffix}'; change it")
    check_output(path, overwrite)


def _check_distinct(targets: Iterable[Path]) -> None:
    """Refuse two targets that are one file, or one row of numbered images."""
    taken: set[Path | ImageSequence] = set()
    for target in targets:
        place: Path | ImageSequence = real_path(target)
        if is_sequence(target):
            images = image_sequence(target)
            place = replace(images, folder=real_path(images.folder))
        if place in taken:
            raise OutputPathError(f"{target}: expected a place of its own, got that of another output; name another")
        taken.add(place)


def check_inputs_survive(job: InterpolationJob, entries: Sequence[PosedPanorama]) -> None:
    """Refuse outputs that would overwrite what the video is made of. Raises OutputPathError: one would."""
    outputs = [job.output, *jobs.depth_files(job)]
    outputs += [path for path in (job.save_confidence, job.view) if path is not None]
    for place in (job.output, job.save_frames, job.save_confidence):
        if place is not None and is_sequence(place):
            outputs.extend(image_sequence(place).existing())
    companions = (file for entry in entries for file in entry.companions)
    check_kept(outputs, (*job.images, *jobs.input_files(job), job.poses, *companions))
