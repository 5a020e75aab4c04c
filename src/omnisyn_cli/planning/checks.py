"""What can be refused for a job's own words and for what the headers of its files say."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from omnisyn_cli.errors import InputError, OutputPathError
from omnisyn_cli.io import MAX_PIXELS, PosedPanorama, check_output, check_video, read_header, sample_type
from omnisyn_cli.io.depth import check_depth_header
from omnisyn_cli.io.paths import check_name
from omnisyn_cli.io.sequence import image_sequence, is_sequence
from omnisyn_cli.io.staging import check_staged_folder
from omnisyn_cli.planning.job import DEPTH_METHODS, FALLBACKS, RENDERER_CHOICES, InterpolationJob, depth_files
from omnisyn_cli.presets import FUSION_CHOICES, METHODS, OMNISYN, PRESETS
from omnisyn_cli.runtime.session import DEVICES
from omnisyn_cli.trajectory import EASES, HEADINGS

__all__ = [
    "check_choices",
    "check_companions",
    "check_inputs_survive",
    "check_names",
    "check_outputs",
]

OF_OWN_FRAMES = (
    "preset", "depth", "model", "renderer", "cut", "fusion", "adaptive", "fallback", "save_confidence", "save_depth",
)  # fmt: skip
"""Fields of a job that mean nothing to the methods that it is compared with."""

MOST_NADIR = math.radians(90.0)
"""A cap that is no hemisphere yet."""


def check_names(job: InterpolationJob) -> None:
    """Refuse names that cannot be used.

    File names that are not text (bytes from another encoding) cannot be handed to the image libraries.

    Raises:
        InputError: one is no UTF-8.
        OutputPathError: the system cannot give it to anything.
    """
    for path in (*job.images, *job.masks, job.poses, job.output, job.save_depth, job.save_frames, job.save_confidence):
        name = str(path)
        if name.encode("utf-8", "replace") != name.encode("utf-8", "surrogateescape"):
            raise InputError(f"{name!r}: expected a file name in UTF-8, got other bytes; rename the file or its folder")
    for target in (job.output, job.save_depth, job.save_frames, job.save_confidence):
        if target is not None:
            check_name(target)


def check_choices(job: InterpolationJob) -> None:
    """Refuse what the command line does not offer as a choice, for those who call the library.

    Raises:
        InputError: an unknown name, another number of masks than of panoramas, or a cap of a hemisphere or more.
    """
    choices = {
        "method": (job.method, METHODS),
        "preset": (job.preset, PRESETS),
        "depth": (job.depth, DEPTH_METHODS),
        "renderer": (job.renderer, RENDERER_CHOICES),
        "fusion": (job.fusion, FUSION_CHOICES),
        "ease": (job.ease, EASES),
        "heading": (job.heading, HEADINGS),
        "device": (job.device, DEVICES),
        "fallback": (job.fallback, FALLBACKS),
    }
    for name, (value, known) in choices.items():
        if value not in known:
            raise InputError(f"expected one of {', '.join(known)} as {name}, got {value!r}; choose one of these")
    if job.method != OMNISYN:
        _check_is_plain(job)
    if job.masks and len(job.masks) != len(job.images):
        raise InputError(
            f"expected one mask for each of {len(job.images)} panoramas, got {len(job.masks)}; name them in the order "
            "of the panoramas, or in the pose file"
        )
    if not 0.0 <= job.nadir < MOST_NADIR:
        raise InputError(
            f"expected a cap around the nadir of at least 0 and less than {math.degrees(MOST_NADIR):g} degrees, got "
            f"{math.degrees(job.nadir):g}; give the angle from straight down to its edge"
        )


def _check_is_plain(job: InterpolationJob) -> None:
    """Refuse options that only say how this program's own frames are made.

    Raises:
        InputError: there is one.
    """
    usual = InterpolationJob(job.images, job.poses, job.output)
    for name in OF_OWN_FRAMES:
        chosen = getattr(job, name)
        if chosen != getattr(usual, name):
            raise InputError(
                f"expected no {name.replace('_', '-')} with the method {job.method}, which leaves none to choose, got "
                f"{chosen}; leave it out, or take the method {OMNISYN}"
            )


def check_companions(entries: Sequence[PosedPanorama], depth: str) -> None:
    """Refuse masks, and depth files if they are used, that are not there.

    Raises:
        ImageError: one is missing or unreadable, or is no depth.
    """
    for entry in entries:
        if entry.mask is not None:
            read_header(entry.mask)
        if entry.depth is not None and depth == "file":
            check_depth_header(read_header(entry.depth))


def check_outputs(job: InterpolationJob, size: tuple[int, int]) -> None:
    """Refuse places and sizes that nothing could be written to or in.

    Raises:
        InputError: the size is not 2:1 or too large, or nothing that the encoder can do.
        OutputPathError: a place exists already, cannot be written to, or is that of another output.
    """
    if size[1] != 2 * size[0]:
        raise InputError(f"expected a size twice as wide as high, got {size[1]}x{size[0]}; try {2 * size[0]}x{size[0]}")
    if size[0] * size[1] > MAX_PIXELS:
        raise InputError(f"expected a size of at most {MAX_PIXELS:,} pixels, got {size[1]}x{size[0]}; ask for less")
    check_video(
        job.output,
        size=size,
        fps=job.fps,
        codec=job.codec,
        crf=job.crf,
        preset=job.encoder_preset,
        dtype=sample_type(job.output, job.codec),
        overwrite=job.overwrite,
    )
    if job.save_frames is not None:
        _check_saved_frames(job, job.save_frames, size)
    if job.save_confidence is not None:
        check_video(job.save_confidence, size=size, fps=job.fps, overwrite=job.overwrite)
        if job.save_confidence.resolve() == job.output.resolve():
            raise OutputPathError(f"{job.output}: expected another place for the confidence; name another file")
    if job.save_depth is not None:
        check_staged_folder(job.save_depth)
        for file in depth_files(job):
            if file.exists():
                check_output(file, job.overwrite)


def _check_saved_frames(job: InterpolationJob, frames: Path, size: tuple[int, int]) -> None:
    if not is_sequence(frames):
        raise OutputPathError(f"{frames}: expected a folder or a pattern such as frames/%05d.png, got a file name")
    if is_sequence(job.output) and image_sequence(frames) == image_sequence(job.output):
        raise OutputPathError(f"{frames}: expected another place than the output's, got the same; name another folder")
    check_video(frames, size=size, fps=job.fps, overwrite=job.overwrite)


def check_inputs_survive(job: InterpolationJob, entries: Sequence[PosedPanorama]) -> None:
    """Refuse outputs that would overwrite what the video is made of.

    Raises:
        OutputPathError: one would.
    """
    replaced = {job.output.resolve(), *(file.resolve() for file in depth_files(job))}
    if job.save_confidence is not None:
        replaced.add(job.save_confidence.resolve())
    for place in (job.output, job.save_frames, job.save_confidence):
        if place is not None and is_sequence(place):
            replaced.update(file.resolve() for file in image_sequence(place).existing())
    companions = (file for entry in entries for file in (entry.depth, entry.mask) if file is not None)
    for file in (*job.images, *job.masks, job.poses, *companions):
        if file.resolve() in replaced:
            raise OutputPathError(f"{file}: expected inputs that are not overwritten, got this one; write elsewhere")
