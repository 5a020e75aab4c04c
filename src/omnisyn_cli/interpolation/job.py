"""What a user asks for, and what follows from that alone."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from annotated_types import Ge, Gt, Interval

from omnisyn_cli.io import MAX_PIXELS, sample_type
from omnisyn_cli.io.placement import Reading
from omnisyn_cli.pipeline.config import DEVICES, FALLBACKS
from omnisyn_cli.pipeline.depth_sources import DEPTH_SOURCES
from omnisyn_cli.pipeline.fusions import FUSIONS
from omnisyn_cli.pipeline.methods import METHODS, OMNISYN
from omnisyn_cli.pipeline.presets import DEFAULT_PRESET, PRESETS
from omnisyn_cli.pipeline.renderers import RENDERERS
from omnisyn_cli.synthesis.trajectory import EASES, HEADINGS, Ease, Heading

if TYPE_CHECKING:
    from omnisyn_cli.poses.estimation import PictureOptions

Positive = Annotated[float, Gt(0)]

# Fields of a job that name what is written, as in a manifest.
OUTPUTS = ("output", "save_depth", "save_frames", "save_confidence", "view")
# Fields of a job that name a file that is read, besides panoramas and poses, and those that name several.
INPUT_FILES, INPUT_LISTS = ("audio", "face_model"), ("masks", "blur")
FACES = Path("auto-faces")  # stands for mask pictures of what to blur: faces that a detector finds
FACE_MODEL_VARIABLE = "OMNISYN_FACE_MODEL"  # of the environment: the detector's file
POSES_FROM_PICTURES = Path("auto")  # stands for a pose file where there is none
# Names that fields of a job take.
CHOICES: Mapping[str, tuple[str, ...]] = {
    "method": tuple(name for name, method in METHODS.items() if method.is_offered), "preset": tuple(PRESETS),
    "depth": ("auto", *DEPTH_SOURCES), "renderer": ("auto", *RENDERERS), "fusion": ("auto", *FUSIONS), "ease": EASES,
    "heading": HEADINGS, "device": DEVICES, "fallback": tuple(FALLBACKS), "projection": ("equirectangular", "flat"),
    "stereo": ("mono", "top-bottom"),
}  # fmt: skip


@dataclass(frozen=True)
class TourJob:
    """What a user asks for, whatever is made of it: panoramas, and how their surfaces are found.

    Attributes:
        images: two or more panoramas, in walking order.
        poses: pose file that names them all, or :data:`POSES_FROM_PICTURES` to find them in the pictures.
        output: what is written.
        preset: one of :data:`omnisyn_cli.pipeline.presets.PRESETS`, for what is left open.
        depth: one of :data:`omnisyn_cli.pipeline.depth_sources.DEPTH_SOURCES`, or ``auto``: files where every panorama
            has one, else what the preset says.
        model: the network of the depth: an ONNX file, or a name in the manifest; None is the preset's.
        depth_prior: the monocular depth network of a panorama, an ONNX file or the name of an added one, that says what
            to expect where matching leaves much open, in place of the preset's; ``none`` for none.
        depth_prior_kind: what its file does not say, see :mod:`omnisyn_cli.runtime.monocular_session`.
        device: what makes frames and runs networks: ``auto``, ``cpu`` or ``cuda``. All else is the processor's.
        cut, cut_metres: where surfaces are cut, see :class:`omnisyn_cli.pipeline.config.RunConfig`; at most one of
            them, neither is the preset's.
        masks: an image for every panorama, black where it must not be used, besides those of the pose file; or none.
        blur: an image for every panorama, black where it is made unrecognizable, or :data:`FACES` alone; or none.
        face_model: the detector of faces, an ONNX file; None is what :data:`FACE_MODEL_VARIABLE` names.
        nadir: radians around every panorama's own straight down (its last row) that are not used: tripod, car roof.
            None finds by itself what moves with the camera, see :mod:`omnisyn_cli.synthesis.camera_fixed`.
        nadir_fill: continue the ground over what is not used at the ends of the way as well, where the photograph is
            shown otherwise.
        fallback: one of :data:`omnisyn_cli.pipeline.config.FALLBACKS`; it changes videos and walks.
        threads: at most this many; None is one per core.
        overwrite: replace what exists.
        allow_aspect: resample panoramas that are not 2:1.
        upper_half: of every panorama only the upper half is used, as of top-bottom stereo.
        hfov, vfov: radians that panoramas span, for parts of the sphere without tags; one follows from the other.
        horizon: where the horizon of such a part is, as a share of its height from the top.
        view_transform: show linear light of OpenEXR and HDR files as screens do, unless frames are written as EXR.
        max_pixels: refuse panoramas, masks and depth files with more pixels, before they are decoded.
        allow_outside: accept depth and masks that the pose file names outside of its folder.
        baseline: mean metres between neighbours whose poses are found in the pictures; None takes 1 and says so.
        camera_height: metres of the cameras above the floor, instead of a baseline.
        finds_order: the images are in no order; it is found with the poses, and those without a pose are left out.
        refine: correct rotations and directions of the given poses where the pictures fit better then.
        tour: file with titles, links, hotspots and a floor plan, see :mod:`omnisyn_cli.poses.tour_file`; or None.
        is_chain: pages and sites lead from every panorama to the next one. Otherwise they follow links: those of the
            tour file or of the pose file, else those that follow from the positions.
    """

    images: tuple[Path, ...]
    poses: Path
    output: Path
    preset: str = DEFAULT_PRESET
    depth: str = "auto"
    model: str | None = None
    depth_prior: str | None = None
    depth_prior_kind: str = ""
    device: str = "auto"
    cut: Annotated[float, Interval(gt=0, le=1)] | None = None
    cut_metres: Positive | None = None
    masks: tuple[Path, ...] = ()
    blur: tuple[Path, ...] = ()
    face_model: Path | None = None
    nadir: float | None = None
    nadir_fill: bool = False
    fallback: str = "none"
    threads: int | None = None
    overwrite: bool = False
    allow_aspect: bool = False
    upper_half: bool = False
    hfov: Annotated[float, Interval(gt=0, le=radians(360))] | None = None
    vfov: Annotated[float, Interval(gt=0, le=radians(180))] | None = None
    horizon: Annotated[float, Interval(ge=0, le=1)] = 0.5
    view_transform: bool = True
    max_pixels: Annotated[int, Ge(1)] = MAX_PIXELS
    allow_outside: bool = False
    baseline: Positive | None = None
    camera_height: Positive | None = None
    finds_order: bool = False
    refine: bool = False
    tour: Path | None = None
    is_chain: bool = True

    @property
    def follows_links(self) -> bool:
        """Whether what is made leads along links, where the panoramas are no chain."""
        return False


@dataclass(frozen=True)
class InterpolationJob(TourJob):
    """What a user asks for of a video.

    Attributes:
        output: video file, folder or file name pattern.
        fallback: as of every job.
        frames: number of frames; None follows from ``duration`` and ``fps``.
        duration: seconds; None means three per pair.
        fps: frames per second.
        size: (height, width) of the video; None means that of the largest panorama, or what players of the codec show.
        method: one of :data:`omnisyn_cli.pipeline.methods.METHODS`; baselines leave nothing to choose about depth,
            surfaces and fusion.
        renderer: one of :data:`omnisyn_cli.pipeline.renderers.RENDERERS`, or ``auto``: what the preset says.
        fusion: one of :data:`omnisyn_cli.pipeline.fusions.FUSIONS`, or ``auto``: what the preset says where depth is
            found as it says, else ``geometric``.
        projection: of the video: ``equirectangular``, or ``flat`` for an ordinary one.
        fov: radians that the width of a flat video spans; None takes 90 degrees.
        look: which way a flat video looks, see :func:`omnisyn_cli.interpolation.look.look_along`; None is ahead.
        stereo: ``mono``, or ``top-bottom`` for both eyes one above the other.
        ease, heading: see :func:`omnisyn_cli.synthesis.trajectory.plan_path`.
        codec, crf, encoder_preset: see :func:`omnisyn_cli.io.open_video`.
        save_depth: folder for the depth of every panorama, as EXR; None saves none.
        save_confidence: video or folder for the confidence of every pixel, in grey; None saves none.
        save_frames: folder or pattern for the frames as images besides the video; None saves none.
        adaptive: draw flat surfaces with fewer triangles; None does where there are frames enough to save time by it.
        view: page to walk through besides the video, made of the same depth; None makes none.
        audio: file whose sound the video gets, cut or padded with silence to its length; None leaves it silent.
    """

    fallback: str = "auto"
    frames: Annotated[int, Ge(2)] | None = None
    duration: Positive | None = None
    fps: Annotated[float, Interval(gt=0, le=1000)] = 30.0
    size: tuple[int, int] | None = None
    method: str = OMNISYN
    renderer: str = "auto"
    fusion: str = "auto"
    projection: str = "equirectangular"
    fov: Annotated[float, Interval(gt=0, lt=radians(180))] | None = None
    look: str | None = None
    stereo: str = "mono"
    ease: Ease = "linear"
    heading: Heading = "panoramas"
    codec: str | None = None
    crf: float | None = None
    encoder_preset: str | None = None
    save_depth: Path | None = None
    save_confidence: Path | None = None
    save_frames: Path | None = None
    adaptive: bool | None = None
    view: Path | None = None
    audio: Path | None = None


def input_files(job: TourJob) -> tuple[Path, ...]:
    """What is read besides panoramas, their poses and what these name."""
    named = [file for name in INPUT_FILES if (file := getattr(job, name, None)) is not None]
    return (*named, *(file for name in INPUT_LISTS for file in getattr(job, name) if file != FACES))


def of_panoramas(job: TourJob, indices: Sequence[int]) -> dict[str, Any]:
    """The fields that have a file for each panorama, of some panoramas in this order."""
    lists = {name: getattr(job, name) for name in ("images", *INPUT_LISTS)}
    return {
        name: files if FACES in files else tuple(files[k] for k in indices if files) for name, files in lists.items()
    }


def picture_options(job: TourJob) -> "PictureOptions":
    """How the panoramas of a job are read where poses are found or checked."""
    from omnisyn_cli.poses.estimation import PictureOptions  # OpenCV takes a while to import

    nadir = job.nadir or 0.0
    return PictureOptions(job.allow_aspect, job.threads, job.max_pixels, job.masks, nadir, reading_of(job))


def reading_of(job: TourJob) -> Reading:
    """How the panoramas of a job are read."""
    is_shown = not isinstance(job, InterpolationJob) or "float32" not in sample_types(job)
    return Reading(job.upper_half, job.hfov, job.vfov, job.horizon, job.view_transform and is_shown)


def targets(job: InterpolationJob) -> dict[Path, dict[str, Any]]:
    """Everything that takes frames, with what :func:`omnisyn_cli.io.open_video` is told about it.

    The video comes last, so that it is finished first: if that fails, no images are kept either.
    """
    places: dict[Path, dict[str, Any]] = {}
    if job.save_frames is not None:
        places[job.save_frames] = {"fps": job.fps, "dtype": sample_type(job.save_frames)}
    places[job.output] = {
        "fps": job.fps, "codec": job.codec, "crf": job.crf, "preset": job.encoder_preset,
        "dtype": sample_type(job.output, job.codec), "stereo_mode": stereo_mode(job),
    }  # fmt: skip
    return places


def stereo_mode(job: InterpolationJob) -> str | None:
    """What players are told of its video, see :class:`omnisyn_cli.io.video.Encoding`."""
    return None if job.projection == "flat" else job.stereo


def sample_types(job: InterpolationJob) -> list[str]:
    """The type of the samples that each of :func:`targets` takes."""
    return [encoding["dtype"] for encoding in targets(job).values()]


def is_rounded(job: InterpolationJob) -> bool:
    """Whether frames are wanted as samples of 8 bits and in no other way."""
    return set(sample_types(job)) == {"uint8"}


def depth_name(images: Sequence[Path], pair: int, index: int) -> str:
    """File name of the depth of panorama ``index`` as one of a pair; inside a chain it has one for each pair.

    Where only their endings or folders tell the pair's panoramas apart, those are part of it.
    """
    first, second = images[pair : pair + 2]
    name = images[index].name if first.stem == second.stem else images[index].stem
    folder = f"{images[index].parent.name}_" if first.name == second.name and first != second else ""
    return f"{pair:04d}_{folder}{name}_depth.exr"


def depth_files(job: InterpolationJob) -> Iterator[Path]:
    """Where the depth of every panorama of every pair is saved, if it is."""
    if job.save_depth is not None:
        for pair in range(len(job.images) - 1):
            for index in (pair, pair + 1):
                yield job.save_depth / depth_name(job.images, pair, index)
