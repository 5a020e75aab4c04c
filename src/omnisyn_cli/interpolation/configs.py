"""What frames are made with: where a job leaves it open, its preset and the pose file decide."""

from collections.abc import Sequence
from dataclasses import replace

from omnisyn_cli.errors import InputError, PoseError
from omnisyn_cli.interpolation.job import InterpolationJob, TourJob
from omnisyn_cli.pipeline.config import DepthSource, RunConfig
from omnisyn_cli.pipeline.depth_sources import DEPTH_SOURCES, SYNSIN_DEPTH
from omnisyn_cli.pipeline.methods import METHODS
from omnisyn_cli.pipeline.presets import PRESETS, REPRODUCTIONS
from omnisyn_cli.poses.file import PosedPanorama
from omnisyn_cli.runtime.models import find_prior
from omnisyn_cli.runtime.monocular_session import NetworkKind
from omnisyn_cli.runtime.session import providers
from omnisyn_cli.synthesis.device import has_device

# Between two panoramas, from which on fewer triangles save more time than it takes to find them: 0.5 s of one core for
# a mesh of 1024×512, and 0.02 s less for each frame of 1024×512 or 2048×1024 then.
MIN_FRAMES_TO_SIMPLIFY = 32


def surface_config(job: TourJob, entries: Sequence[PosedPanorama]) -> RunConfig:
    """What the surfaces of a job are made with, given its panoramas' entries: what it says, else its preset.

    Raises PoseError: depth is to come from files, and the pose file does not name one for every panorama;
    InputError: a network where none has a part, or none where one has.
    """
    defaults = PRESETS[job.preset].config
    kind = _depth_kind(job, entries, defaults)
    has_default_cut = job.cut is None and job.cut_metres is None
    descriptors = defaults.depth.descriptors if kind == defaults.depth.kind else None
    is_as_published = job.fallback == "auto" and job.preset in REPRODUCTIONS  # which show what they make
    return RunConfig(
        DepthSource(kind, defaults.depth.rows, _model(job, kind, defaults), *_prior(job, kind, defaults), descriptors),
        cut=defaults.cut if has_default_cut else job.cut,
        cut_metres=defaults.cut_metres if has_default_cut else job.cut_metres,
        fallback="none" if is_as_published else job.fallback, device=job.device,
    )  # fmt: skip


def page_config(job: TourJob, entries: Sequence[PosedPanorama]) -> RunConfig:
    """What a walk is made with: surfaces, and the fusion of their video where that is a rule with a correction."""
    defaults, surfaces = PRESETS[job.preset].config, surface_config(job, entries)
    is_corrected = defaults.fusion == "network" and surfaces.depth.kind == defaults.depth.kind
    fusion = defaults.fusion if is_corrected else surfaces.fusion
    return replace(surfaces, fusion=fusion, fusion_rows=defaults.fusion_rows)


def video_config(job: InterpolationJob, entries: Sequence[PosedPanorama]) -> RunConfig:
    """What the frames of a job are made with, likewise."""
    if not METHODS[job.method].draws_surfaces:
        return RunConfig(DepthSource("monocular", model=SYNSIN_DEPTH), job.method, device=job.device)
    defaults, surfaces = PRESETS[job.preset].config, surface_config(job, entries)
    # the preset's fusion only where depth is found as it says: no network saw renderings of other depth
    fusion = defaults.fusion if surfaces.depth.kind == defaults.depth.kind else "geometric"
    config = replace(
        surfaces,
        renderer=defaults.renderer if job.renderer == "auto" else job.renderer,
        adaptive=defaults.adaptive if job.adaptive is None else job.adaptive,
        fusion=fusion if job.fusion == "auto" else job.fusion, fusion_rows=defaults.fusion_rows, edges=defaults.edges,
        confidence=job.save_confidence is not None,
    )  # fmt: skip
    if job.projection == "flat":  # networks and edge pixels know panoramas alone
        config = replace(config, renderer="mesh", fusion="geometric", edges=False)
    return config


def for_frames(config: RunConfig, job: InterpolationJob, frames: int) -> RunConfig:
    """The config for so many frames: with fewer triangles, if nobody says otherwise, where that saves time."""
    is_worth_it = frames > MIN_FRAMES_TO_SIMPLIFY * (len(job.images) - 1)
    return config if is_worth_it or job.adaptive is not None else replace(config, adaptive=False)


def _depth_kind(job: TourJob, entries: Sequence[PosedPanorama], defaults: RunConfig) -> str:
    without = [image.name for image, entry in zip(job.images, entries, strict=True) if entry.depth is None]
    if job.depth == "auto":
        asks_for_network = job.model is not None or job.depth_prior is not None
        return defaults.depth.kind if without or asks_for_network else "file"
    if DEPTH_SOURCES[job.depth].reads_files and without:
        raise PoseError(
            f"{job.poses}: expected a 'depth' file for every panorama, got none for {', '.join(without)}; "
            "name one or choose another depth method"
        )
    return job.depth


def _model(job: TourJob, kind: str, defaults: RunConfig) -> str | None:
    """The network that finds or refines depth, if one does."""
    source = DEPTH_SOURCES[kind]
    if source.role is None:
        if job.model is not None:
            networked = " or ".join(name for name, each in DEPTH_SOURCES.items() if each.role)
            raise InputError(
                f"expected a model only for depth {networked}, got depth {kind!r} and model {job.model!r}; "
                "leave one of them out"
            )
        return None
    model = job.model or (defaults.depth.model if kind == defaults.depth.kind else source.model)
    if model is None:
        raise InputError(f"expected a model for depth {kind!r}, got none; name one (--model)")
    return model


def _prior(job: TourJob, kind: str, defaults: RunConfig) -> tuple[str | None, str]:
    """The network that says what depth to expect, and of what kind it is: what the job says, else the preset's."""
    if job.depth_prior is None:
        if job.depth_prior_kind:
            raise InputError("expected --depth-prior with --depth-prior-kind, got none; name the network's file")
        return defaults.depth.prior if kind == defaults.depth.kind else None, ""
    if not DEPTH_SOURCES[kind].model_is_optional:
        raise InputError(f"expected --depth-prior with refined depth only, got depth {kind!r}; leave one of them out")
    NetworkKind.from_words(job.depth_prior_kind)
    return (None, "") if job.depth_prior == "none" else find_prior(job.depth_prior, job.depth_prior_kind)


def check_device(config: RunConfig, *, makes_frames: bool = False) -> tuple[str, ...]:
    """Refuse (InputError) a device that this machine does not have; a plan alone may be for another one.

    It returns what a user who asked for CUDA should know: what runs on the processor all the same.
    """
    if config.device != "cuda":
        return ()
    notes = []
    if not (makes_frames and config.draws_surfaces):
        if config.networks:
            providers(config.device)
    elif not config.frames_on_gpu:
        notes.append("frames are made on the processor: a GPU makes them with --renderer mesh, without painting")
    else:
        has_device(config.device)
        if config.networks and len(providers("auto")) == 1:
            notes.append("networks run on the processor: this ONNX Runtime has no CUDA; onnxruntime-gpu has it")
    return tuple(notes)
