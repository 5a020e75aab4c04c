"""What a user asks for, and what follows from that alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from omnisyn_cli.estimators import DEPTH_SOURCES
from omnisyn_cli.io import MAX_PIXELS, sample_type
from omnisyn_cli.presets import DEFAULT_PRESET, OMNISYN
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.trajectory import Ease, Heading

__all__ = [
    "DEPTH_METHODS",
    "FALLBACKS",
    "POSES_FROM_PICTURES",
    "RENDERERS",
    "RENDERER_CHOICES",
    "InterpolationJob",
    "depth_files",
    "depth_name",
    "is_rounded",
    "sample_types",
    "targets",
]

DEPTH_METHODS = ("auto", *DEPTH_SOURCES)

RENDERERS = ("mesh", "points", "two-pass")
"""Those of :mod:`omnisyn_cli.render.renderer`, by name: importing it takes longer than planning."""

RENDERER_CHOICES = ("auto", *RENDERERS)
"""What users choose from: ``auto`` is the preset's."""

POSES_FROM_PICTURES = Path("auto")
"""Stands for a pose file where there is none."""

FALLBACKS = ("none", "crossfade", "fail")


@dataclass(frozen=True)
class InterpolationJob:
    """What a user asks for.

    Attributes:
        images: two or more panoramas, in walking order.
        poses: pose file that names them all, or :data:`POSES_FROM_PICTURES` to find them in the pictures.
        output: video file, folder or file name pattern.
        frames: number of frames; None follows from ``duration`` and ``fps``.
        duration: seconds; None means three per pair.
        fps: frames per second.
        size: (height, width) of the video; None means that of the largest panorama.
        method: how frames are made, one of :data:`omnisyn_cli.presets.METHODS`; those that are there to be compared
            with leave nothing to choose about depth, surfaces and fusion.
        preset: how much time accuracy is worth, one of :data:`omnisyn_cli.presets.PRESETS`.
        depth: ``matching``, ``refined`` (matching made better by a network), ``file`` (named in the pose file),
            ``network``, or ``auto``: files where every panorama has one, else what the preset says.
        model: for ``network`` and ``refined``: an ONNX file, or a name in the manifest of installed models; None is the
            preset's.
        device: where the network runs: ``auto``, ``cpu`` or ``cuda``, with which the GPU makes the frames as well if it
            can (:mod:`omnisyn_cli.planning.on_gpu`). Poses and matching are found on the processor.
        renderer: ``mesh``, ``points``, ``two-pass``, or ``auto``: what the preset says.
        cut: where meshes are cut; None is the preset's.
        fusion: ``geometric``, ``network``, which corrects it where the views contradict each other, ``painting``, which
            does without it, or ``auto``: what the preset says where depth is estimated, ``geometric`` where it comes
            from files.
        ease, heading: see :func:`omnisyn_cli.trajectory.plan_path`.
        codec, crf, encoder_preset: see :func:`omnisyn_cli.io.open_video`.
        save_depth: folder for the depth of every panorama, as EXR; None saves none.
        masks: an image for every panorama, black where it must not be used, besides those of the pose file; or none.
        nadir: radians around every panorama's own straight down (its last row) that are not used: tripod, car roof.
        fallback: what is done about pairs of low confidence: ``none`` warns, ``crossfade`` shows the photographs,
            cross-faded, in doubtful regions, ``fail`` gives up.
        save_confidence: video or folder for the confidence of every pixel, in grey; None saves none.
        save_frames: folder or pattern for the frames as images besides the video; None saves none.
        threads: at most this many; None is one per core.
        overwrite: replace what exists.
        allow_aspect: resample panoramas that are not 2:1.
        max_pixels: refuse panoramas, masks and depth files with more pixels, before they are decoded.
        allow_outside: accept depth and masks that the pose file names outside of its folder.
        baseline: metres between neighbours whose poses are found in the pictures; None takes 1 and says so.
        refine: correct rotations and directions of the given poses where the pictures fit better then.
        adaptive: draw flat surfaces with fewer triangles, see :class:`omnisyn_cli.segments.SynthesisOptions`.
    """

    images: tuple[Path, ...]
    poses: Path
    output: Path
    frames: int | None = None
    duration: float | None = None
    fps: float = 30.0
    size: tuple[int, int] | None = None
    method: str = OMNISYN
    preset: str = DEFAULT_PRESET
    depth: str = "auto"
    model: str | None = None
    device: str = "auto"
    renderer: str = "auto"
    cut: Cut | None = None
    fusion: str = "auto"
    ease: Ease = "linear"
    heading: Heading = "panoramas"
    codec: str | None = None
    crf: float | None = None
    encoder_preset: str | None = None
    save_depth: Path | None = None
    masks: tuple[Path, ...] = ()
    nadir: float = 0.0
    fallback: str = "none"
    save_confidence: Path | None = None
    save_frames: Path | None = None
    threads: int | None = None
    overwrite: bool = False
    allow_aspect: bool = False
    max_pixels: int = MAX_PIXELS
    allow_outside: bool = False
    baseline: float | None = None
    refine: bool = False
    adaptive: bool = False


def targets(job: InterpolationJob) -> list[tuple[Path, str | None]]:
    """Path and codec of everything that takes frames.

    The video comes last, so that it is finished first: if that fails, no images are kept either.
    """
    images: list[tuple[Path, str | None]] = [] if job.save_frames is None else [(job.save_frames, None)]
    return [*images, (job.output, job.codec)]


def sample_types(job: InterpolationJob) -> list[str]:
    """The type of the samples that each of :func:`targets` takes."""
    return [sample_type(path, codec) for path, codec in targets(job)]


def is_rounded(job: InterpolationJob) -> bool:
    """Whether frames are wanted as samples of 8 bits and in no other way."""
    return set(sample_types(job)) == {"uint8"}


def depth_name(images: Sequence[Path], pair: int, index: int) -> str:
    """File name of the depth of panorama ``index`` as one of a pair; inside a chain it has one for each pair.

    Where only their endings tell the pair's panoramas apart, those are part of it.
    """
    first, second = images[pair : pair + 2]
    return f"{pair:04d}_{images[index].name if first.stem == second.stem else images[index].stem}_depth.exr"


def depth_files(job: InterpolationJob) -> Iterator[Path]:
    """Where the depth of every panorama of every pair is saved, if it is."""
    if job.save_depth is not None:
        for pair in range(len(job.images) - 1):
            for index in (pair, pair + 1):
                yield job.save_depth / depth_name(job.images, pair, index)
