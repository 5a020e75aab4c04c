"""A job that has been checked: its poses and path, where its depth comes from, what there is to say about it."""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.perspective import PerspectiveSize, equivalent_rows
from omnisyn_cli.geometry.pose import at_same_position
from omnisyn_cli.interpolation import checks
from omnisyn_cli.interpolation import job as jobs
from omnisyn_cli.interpolation.configs import for_frames, surface_config, video_config
from omnisyn_cli.interpolation.job import InterpolationJob, TourJob
from omnisyn_cli.interpolation.look import LOOK_AHEAD, look_along
from omnisyn_cli.interpolation.planning.memory import Footprint, MemoryEstimate, PriorCost
from omnisyn_cli.io import read_header
from omnisyn_cli.io.decode import check_is_file
from omnisyn_cli.io.documents import listed
from omnisyn_cli.io.encode import image_sequence, is_sequence
from omnisyn_cli.io.encoders import CODECS, Soundtrack, as_fraction
from omnisyn_cli.io.ffmpeg_process import read_soundtrack
from omnisyn_cli.io.images import is_squeezed
from omnisyn_cli.io.placement import placement_of
from omnisyn_cli.pipeline.config import RunConfig
from omnisyn_cli.poses.file import PosedPanorama, PoseFile, check_names_tell_apart, notes_of_place, read_poses
from omnisyn_cli.poses.tour import Tour
from omnisyn_cli.poses.tour_file import read_tour
from omnisyn_cli.runtime.models import find_model
from omnisyn_cli.synthesis.trajectory import Heading, Waypoint, path_length, plan_path

SECONDS_PER_PAIR = 3.0  # length of the video between two panoramas unless the user says otherwise
# Of a flat video, unless the user says otherwise: height and width, and the angle that its width spans.
FLAT_SIZE, DEFAULT_FOV = (1080, 1920), math.radians(90.0)
MAX_PLAUSIBLE_BASELINE_METRES = 100.0  # farther apart, panoramas have nothing in common: more is worth a note
# Height and width that outputs are checked for before those of the video are known: any codec takes them.
LIKELY_SIZE = (512, 1024)
MAX_FRAMES = 1_000_000  # nine hours; more is taken for a mistake

# Rows of a panorama for each row of a frame that are read, as a frame near a surface magnifies it. Rows to which they
# are reduced at the most: depth of more is not more accurate. Factor below which a panorama is read as it is.
READING_SHARE, MIN_READING_ROWS, MIN_REDUCTION = 2, 2048, 1.25
MAX_KEPT_NEIGHBOURS = 3  # of a panorama at a crossing, besides the pair at work; others are read again
CODEC_NAMES = {"h264": "H.264", "h265": "H.265", "av1": "AV1", "prores": "ProRes"}  # as people write them


@dataclass(frozen=True)
class TourPlan:
    """What has been checked of a job, whatever is made of it: its panoramas, their poses, how depth is found."""

    job: TourJob  # what was asked for
    entries: tuple[PosedPanorama, ...]  # the pose file's entry of every panorama
    source_sizes: tuple[tuple[int, int], ...]  # (height, width) at which every panorama is read
    config: RunConfig  # what surfaces and frames are made with
    notes: tuple[str, ...]  # what the user should know
    tour: Tour  # titles, links and more; its panoramas are those of the job, but each once
    prior_cost: PriorCost = field(default=PriorCost(), kw_only=True)  # of a depth network of the user's

    @property
    def is_chain(self) -> bool:
        """Whether every panorama leads to the next one; otherwise links say where they lead."""
        return self.job.is_chain or not self.job.follows_links

    @cached_property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Indices of the two panoramas of every pair: neighbours in the chain, or the ends of every link."""
        if self.is_chain:
            return tuple(pairwise(range(len(self.entries))))
        place = {panorama.name: k for k, panorama in enumerate(self.tour.panoramas)}
        return tuple((place[first], place[second]) for first, second in self.tour.links)

    @property
    def looks_ahead(self) -> bool:
        """Whether depth of a panorama comes from all its neighbours, for which other pairs are compared as well."""
        return self.config.estimates_depth and len(self.entries) > 2

    @property
    def views_at_once(self) -> int:
        """How many panoramas are kept: those of the pair at work, and their neighbours where depth is fused."""
        degrees = Counter(view for pair in self.pairs for view in pair)
        return 2 + self.looks_ahead * min(max(degrees.values(), default=1) - 1, MAX_KEPT_NEIGHBOURS)

    @property
    def fused_depths(self) -> int:
        """How many panoramas have their depth from several neighbours that stand apart from them."""
        poses = [entry.pose for entry in self.entries]
        apart = [pair for pair in self.pairs if not at_same_position(poses[pair[0]], poses[pair[1]])]
        counts = Counter(view for pair in apart for view in pair)
        return sum(count > 1 for count in counts.values()) if self.looks_ahead else 0

    @property
    def length(self) -> float:
        """Metres from the first panorama to the last, in the order of the job."""
        return path_length([entry.pose for entry in self.entries])

    @property
    def memory_estimate(self) -> MemoryEstimate:
        """What memory is estimated from."""
        files = [entry.depth for entry in self.entries if entry.depth is not None]
        depth, rows = self.config.depth, max(height for height, _ in self.source_sizes)
        surfaces = depth.strategy.grid_sizes(depth, rows, files)
        return MemoryEstimate(self.job, self.config, self.source_sizes, surfaces, self.looks_ahead, self.prior_cost)

    def pairs_at_one_place(self) -> Iterator[tuple[str, bool]]:
        """For neighbours without a way between them words that say so, and whether they are turned to each other."""
        for a, b in self.pairs:
            first, second = self.entries[a].pose, self.entries[b].pose
            if at_same_position(first, second):
                names = f"{self.job.images[a].name} and {self.job.images[b].name}"
                yield f"{names} have the same position", not second.almost_equals(first)

    def what(self) -> str:
        """What is made, in a few words."""
        return f"{self.job.output.name} of {len(self.entries)} panoramas"

    def in_words(self, values: Mapping[str, Any]) -> str:
        """The values of :meth:`describe`, with ``expected_words`` where the time is known, in one line for people."""
        memory = f"{values['memory_mib'] * 2**20 / 1e9:.1f} GB of memory"
        return ", ".join(filter(None, (self.what(), values.get("expected_words"), memory, values["depth_prior_words"])))

    def details(self) -> tuple[dict[str, Any], dict[str, Any], int]:
        """What :meth:`describe` says of the thing that is made: before how depth is found, after it, and its memory."""
        return {}, {}, self.memory_estimate.of_surfaces(Footprint())

    def describe(self) -> dict[str, Any]:
        """The plan as plain values, for people and for JSON."""
        config, (before, after, memory) = self.config, self.details()
        is_own = config.draws_surfaces
        return {
            "inputs": [str(image) for image in self.job.images], "output": str(self.job.output), **before,
            "preset": self.job.preset if is_own else "", "depth": config.depth.kind,
            "model": (config.depth.model or "") if is_own else ", ".join(config.networks),
            "depth_prior": self.job.depth_prior or "", "depth_prior_seconds": self.prior_cost.seconds,
            "depth_prior_words": self.prior_cost.words, "joined_depths": self.fused_depths, **after,
            "memory_mib": round(memory / 2**20), "notes": list(self.notes),
        }  # fmt: skip


@dataclass(frozen=True)
class InterpolationPlan(TourPlan):
    """A job that has been checked, with the video that it asks for."""

    job: InterpolationJob
    size: tuple[int, int]  # (height, width) of the video, or of what one eye sees
    path: tuple[Waypoint, ...]  # a waypoint for every frame
    soundtrack: Soundtrack | None = None  # of the video

    @property
    def frame_size(self) -> tuple[int, int]:
        """(height, width) of the frames that are written: both eyes, if there are two."""
        return (2 * self.size[0], self.size[1]) if self.job.stereo == "top-bottom" else self.size

    def what(self) -> str:
        """The video, or the images, in a few words."""
        (height, width), frames = self.frame_size, len(self.path)
        if is_sequence(self.job.output):
            return f"{frames} {_encoder(self.job)} of {width}x{height}"
        codec = CODEC_NAMES[self.job.codec or "h264"]
        return f"{frames / self.job.fps:.3g} s of {width}x{height} {codec}, {frames} frames"

    @cached_property
    def memory(self) -> int:
        """Bytes that the pictures and buffers will take, estimated."""
        return self.memory_estimate.of_frames(self.job, self.size)

    def details(self) -> tuple[dict[str, Any], dict[str, Any], int]:
        """See :meth:`TourPlan.details`."""
        (height, width), config, job = self.frame_size, self.config, self.job
        is_own = config.draws_surfaces
        video = {
            "frames": len(self.path), "fps": job.fps, "seconds_of_video": round(len(self.path) / job.fps, 3),
            "size": f"{width}x{height}", "encoder": _encoder(job), "method": config.method,
        }  # fmt: skip
        drawn = {
            "renderer": config.renderer if is_own else config.method_strategy.renderer_label,
            "fusion": config.fusion if is_own else "",
            "view": "" if job.view is None else str(job.view),
            "audio": "" if self.soundtrack is None else str(self.soundtrack.path), "path_metres": round(self.length, 4),
        }  # fmt: skip
        return video, drawn, self.memory


def plan_interpolation(job: InterpolationJob) -> InterpolationPlan:
    """Check a job without writing anything; pictures are decoded only to find or to refine poses.

    Raises InputError: a file is missing, poses do not fit, the output exists, a size or count makes no sense.
    """
    checks.check_choices(job)
    checks.check_method(job)
    checks.check_view(job)
    if job.refine or job.poses == jobs.POSES_FROM_PICTURES:  # that takes a while: what can be refused is refused before
        checks.check_outputs(job, job.size or LIKELY_SIZE)
        frame_count(job)
    seconds = float(frame_count(job) / as_fraction(job.fps))
    soundtrack = None if job.audio is None else read_soundtrack(job.audio, seconds)
    tour = plan_tour(job, video_config)
    job = replace(job, **jobs.of_panoramas(tour.job, range(len(tour.entries))))  # in the order that was found
    entries, frames = tour.entries, frame_count(job)
    size = job.size or default_size(job, tour.source_sizes)
    if job.projection == "flat":
        size = PerspectiveSize(*size, DEFAULT_FOV if job.fov is None else job.fov)
    rows = max(READING_SHARE * equivalent_rows(size), MIN_READING_ROWS)  # no detail of more is seen in the frames
    sources = tuple((rows, 2 * rows) if source[0] > MIN_REDUCTION * rows else source for source in tour.source_sizes)
    checks.check_outputs(job, size)
    checks.check_inputs_survive(job, entries)
    poses = [entry.pose for entry in entries]
    config = for_frames(tour.config, job, frames)
    heading: Heading = "travel" if job.projection == "flat" else job.heading
    path = tuple(plan_path(poses, frames, ease=job.ease, heading=heading))
    if job.projection == "flat":
        path = look_along(path, poses[0], job.look or LOOK_AHEAD)
    heard = () if soundtrack is None else (soundtrack.in_words(job.output),)
    return InterpolationPlan(
        job, entries, sources, config,
        (*tour.notes, *_notes_about_video(tour, config, job, sources), *heard),
        tour.tour, size, path, soundtrack,
    )  # fmt: skip


def default_size(job: InterpolationJob, sources: Sequence[tuple[int, int]]) -> tuple[int, int]:
    """Height and width of the video: those of the largest panorama, even, as far as players show them."""
    if job.projection == "flat":
        return FLAT_SIZE
    rows = max(sources)[0]
    codec = CODECS.get(job.codec or "h264")  # none for images, which check_outputs refuses for a video
    limit = None if is_sequence(job.output) or codec is None else codec.player_rows
    if job.stereo != "mono" and limit is not None:  # both eyes have the pixels of one
        limit = limit * 45 // 64
    rows = rows + rows % 2 if limit is None else min(rows + rows % 2, limit)
    return rows, 2 * rows


def plan_tour(
    job: TourJob, config_of: Callable[[Any, Sequence[PosedPanorama]], RunConfig] = surface_config
) -> TourPlan:
    """Check what does not depend on what is made of the panoramas; the output's name is looked at, but not its place.

    ``config_of`` says what they are made with, given the pose file's entry of every panorama. InputError: a file is
    missing, poses do not fit, an option makes no sense.
    """
    if len(job.images) < 2:
        raise InputError(f"expected two or more panoramas, got {len(job.images)}; name at least a first and a last one")
    checks.check_names(job)
    checks.check_choices(job)
    for image in job.images:  # before a pose file is asked about their names
        check_is_file(image)
    if job.blur:
        from omnisyn_cli.interpolation.blurring import check_blur  # OpenCV takes a while to import

        check_blur(job)
    job, pose_file, remarks = _posed(job)
    check_names_tell_apart(job.images, pose_file)
    entries = tuple(pose_file.of(image) for image in job.images)
    source_sizes = tuple(checks.source_size(job, image) for image in job.images)
    config = _installed(config_of(job, entries))
    checks.check_companions(job, entries, source_sizes, config)
    title = f"{job.images[0].stem} – {job.images[-1].stem}"
    tour = read_tour(job.tour, job.images, pose_file, title, is_chain=job.is_chain, allow_outside=job.allow_outside)
    for picture in (*tour.hotspot_pictures, *([] if tour.plan is None else [tour.plan.image])):
        read_header(picture)  # before depth is found, which takes long
    plan = TourPlan(job, entries, source_sizes, config, (), tour)
    return replace(plan, notes=(*remarks, *_notes_about_pictures(job), *_notes_about_places_and_depth(plan)))


def with_preset(plan: InterpolationPlan, preset: str) -> InterpolationPlan:
    """The plan with another preset, whose networks are there (InputError); its poses are not looked for again."""
    job = replace(plan.job, preset=preset)
    return replace(plan, job=job, config=for_frames(_installed(video_config(job, plan.entries)), job, len(plan.path)))


def _installed(config: RunConfig) -> RunConfig:
    """The same; its networks are there, and that of depth is one for depth."""
    if config.depth.model is not None:
        find_model(config.depth.model, role=config.depth.strategy.role)
    for network in config.networks:
        find_model(network)
    return config


def _posed(job: TourJob) -> tuple[TourJob, PoseFile, tuple[str, ...]]:
    """The job in its order; the poses, read, refined or found, and what there is to say about them."""
    checks.check_pose_options(job)
    is_found = job.poses == jobs.POSES_FROM_PICTURES
    if not (is_found or job.refine):
        return job, read_poses(job.poses, allow_outside=job.allow_outside), notes_of_place(job.images, job.poses)
    # OpenCV takes a while to import and is needed for poses from pictures only.
    from omnisyn_cli.poses.estimation import estimate_poses, refine_poses

    options = jobs.picture_options(job)
    if not is_found:
        given = read_poses(job.poses, allow_outside=job.allow_outside)
        refined = refine_poses(job.images, given, options)
        notes = (*notes_of_place(job.images, job.poses), *refined.notes)
        return job, replace(given, panoramas=refined.panoramas), notes
    found = estimate_poses(
        job.images, () if job.baseline is None else (job.baseline,), options,
        camera_height=job.camera_height, must_place_all=not job.finds_order, finds_order=job.finds_order,
    )  # fmt: skip
    is_metric = job.baseline is not None or job.camera_height is not None
    posed = PoseFile(job.poses, found.panoramas, found.links, is_metric=is_metric)
    order = [job.images.index(image) for image in found.order]
    return replace(job, **jobs.of_panoramas(job, order)), posed, found.notes


def frame_count(job: InterpolationJob) -> int:
    """Frames of the video. InputError: fewer than there are panoramas, more than anybody wants, or said twice."""
    if job.frames is not None and job.duration is not None:
        raise InputError(
            f"expected either frames or a duration, got {job.frames} frames and {job.duration:g} s; name one, and the "
            "frames per second"
        )
    seconds = job.duration if job.duration is not None else SECONDS_PER_PAIR * (len(job.images) - 1)
    count = job.frames if job.frames is not None else seconds * job.fps
    if not count <= MAX_FRAMES:
        shown = min(count, 10**300) if isinstance(count, int) else count  # no larger integer becomes a float
        raise InputError(f"expected at most {MAX_FRAMES:,} frames, got {shown:g}; ask for fewer")
    if round(count) < len(job.images):
        raise InputError(
            f"expected at least {len(job.images)} frames, one for each panorama, got {round(count)}; "
            "ask for more frames or a longer duration"
        )
    return round(count)


def _encoder(job: InterpolationJob) -> str:
    """The codec and its settings in a few words."""
    if is_sequence(job.output):
        sequence = image_sequence(job.output, f".{job.codec or 'png'}")
        return f"{Path(sequence.after).suffix.lstrip('.') or sequence.after.lstrip('.')} images"
    codec = CODECS[job.codec or "h264"]
    crf = codec.crf if job.crf is None else job.crf
    quality = "" if crf is None else f" crf {crf:g}"
    return f"{job.codec or 'h264'}{quality} preset {job.encoder_preset or codec.preset}"


def _notes_about_pictures(job: TourJob) -> Iterator[str]:
    headers, reading = [read_header(image) for image in job.images], jobs.reading_of(job)
    if squeezed := [h.path.name for h in headers if not job.allow_aspect and is_squeezed(placement_of(h, reading))]:
        yield f"{listed(squeezed)}: 16:9, taken for squeezed frames of a 360° video and stretched to 2:1"
    if linear := [h.path.name for h in headers if h.is_linear and reading.view_transform]:
        yield f"{listed(linear)}: linear light, shown as on a screen (--no-view-transform takes its numbers)"
    if several := [h.path.name for h in headers if h.has_more_pictures]:
        yield f"{listed(several)}: holds several pictures or is animated; the first picture is taken"


def _notes_about_places_and_depth(plan: TourPlan) -> Iterator[str]:
    images, entries = plan.job.images, plan.entries
    for a, b in plan.pairs:
        metres = math.dist(entries[a].pose.position, entries[b].pose.position)
        if metres > MAX_PLAUSIBLE_BASELINE_METRES:
            names = f"{images[a].name} and {images[b].name}"
            yield f"{names} are {metres:,.0f} m apart; are the positions in metres, and in this order?"
    named = [image.name for image, entry in zip(images, entries, strict=True) if entry.depth is not None]
    if plan.config.estimates_depth and plan.job.depth == "auto" and named:
        why = f"has it for {', '.join(named)} only" if len(named) < len(entries) else "goes unused with --model"
        yield f"{plan.job.poses.name} names depth, but {why}: depth of all is estimated from the pictures"


def _notes_about_video(
    tour: TourPlan, config: RunConfig, job: InterpolationJob, sources: Sequence[tuple[int, int]]
) -> Iterator[str]:
    if note := config.method_strategy.note:
        yield f"{config.method} {note}"
    for where, is_turned in tour.pairs_at_one_place():
        how = "turns in place and cross-fades" if is_turned else "cross-fades"
        yield f"{where}: there is no parallax to follow, the video {how}"
    (rows, columns), (height, width) = max(tour.source_sizes), default_size(job, tour.source_sizes)
    if job.size is None and job.projection != "flat" and height < rows:
        codec = CODEC_NAMES[job.codec or "h264"]
        more = " or --codec h265" if codec == "H.264" else ""
        yield (
            f"the video is {width}x{height}, the panoramas are {columns}x{rows}: few players show larger {codec}; ask "
            f"for more with --size{more}"
        )
    read = zip(job.images, tour.source_sizes, sources, strict=True)
    if reduced := [(image, size) for image, old, size in read if size != old]:
        (image, (height, width)), more = reduced[0], f" and {len(reduced) - 1} more" if len(reduced) > 1 else ""
        yield f"{image.name}{more}: read at {width}x{height}, frames of this size show no more"
