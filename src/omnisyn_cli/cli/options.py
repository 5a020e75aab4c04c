"""Options that several commands have, and what their values mean together."""

from collections.abc import Callable, Mapping
from functools import reduce
from typing import Any

import click

from omnisyn_cli.cli.parameters import DegreeRange, FilePath, FiniteRange, NadirRange, WholeRange
from omnisyn_cli.errors import InputError
from omnisyn_cli.pipeline.config import DEVICES
from omnisyn_cli.pipeline.depth_sources import DEPTH_SOURCES
from omnisyn_cli.pipeline.presets import DEFAULT_PRESET, PRESETS


def all_of(*options: Callable[..., Any]) -> Callable[..., Any]:
    """Several options as one decorator, in the order in which they are listed."""
    return lambda command: reduce(lambda decorated, option: option(decorated), reversed(options), command)


def defaulted(name: str, default: Any, what: str, **more: Any) -> Callable[..., Any]:
    """An option whose default is shown."""
    return click.option(name, default=default, help=what, **more)


def whole_option(name: str, default: int, least: int, what: str) -> Callable[..., Any]:
    """A whole number from ``least`` on."""
    return defaulted(name, default, what, type=WholeRange(least))


def listed(registry: Mapping[str, Any]) -> str:
    """What each strategy of a registry is."""
    return "; ".join(f"{name}: {strategy.help}" for name, strategy in registry.items())


def device_option(what: str) -> Callable[[Any], Any]:
    """Where networks, or what is said, run."""
    return click.option("--device", type=click.Choice(DEVICES), default="auto", help=what)


def json_option(what: str) -> Callable[[Any], Any]:
    """Whether what is said is printed as JSON."""
    return click.option("--json", "as_json", is_flag=True, help=f"Print {what} as JSON on stdout.")


def report_option(what: str) -> Callable[[Any], Any]:
    """The folder of a run that can be gone on with."""
    return click.option(
        "--report", metavar="DIR", type=FilePath(), help=f"Keep {what} here. An interrupted run resumes from them."
    )


threads_option = click.option(
    "--threads", type=WholeRange(1), help="At most this many threads.  [default: one per core]"
)

quiet_option = click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")

outside_option = click.option(
    "--allow-outside", is_flag=True, help="Accept depth and masks outside the folder of the pose file."
)

masks_option = click.option(
    "--mask", "masks", metavar="FILE", multiple=True, type=FilePath(),
    help="Image, black where a panorama must not be used; one per panorama.",
)  # fmt: skip

scale_options = all_of(  # what poses that are found in the pictures get their metres from
    click.option(
        "--baseline", metavar="METRES", type=FiniteRange(0, min_open=True),
        help="Mean distance between neighbours, for estimated poses.  [default: 1]",
    ),
    click.option(
        "--camera-height", metavar="METRES", type=FiniteRange(0, min_open=True),
        help="Camera height above the floor, for estimated poses, instead of --baseline.",
    ),
)  # fmt: skip

# Which panoramas, in walking order, and where they were taken; :func:`named` says what is meant.
tour_options = all_of(
    click.argument("images", metavar="FOLDER | A B [C ...]", nargs=-1, required=True, type=FilePath()),
    click.option(
        "--poses", type=FilePath(),
        help="JSON file with the camera poses; auto: estimate them from the pictures (see --baseline).  [default: "
        "poses.json beside the pictures]",
    ),
    scale_options,
    click.option("--refine", is_flag=True, help="Correct the poses where the pictures allow it."),
)  # fmt: skip

part_options = all_of(  # what of the sphere parts of it show, where their tags do not say it
    click.option(
        "--hfov", metavar="DEGREES", type=DegreeRange(0, 360, min_open=True),
        help="Horizontal angle of panoramas that are only part of the sphere, unless tags give it.",
    ),
    click.option(
        "--vfov", metavar="DEGREES", type=DegreeRange(0, 180, min_open=True),
        help="Vertical angle of such panoramas.  [default: follows from --hfov]",
    ),
    click.option(
        "--horizon", metavar="SHARE", type=FiniteRange(0, 1), default=0.5,
        help="Height of their horizon, from 0 (top) to 1 (bottom).",
    ),
)  # fmt: skip

reading_options = all_of(  # what of the sphere pictures show, where their files do not say it
    click.option(
        "--upper-half", is_flag=True, help="Use the upper half of every panorama: one eye of top-bottom stereo."
    ),
    part_options,
)

picture_options = all_of(  # how pictures are read whose poses are found or checked
    masks_option,
    click.option(
        "--nadir", metavar="DEGREES", type=DegreeRange(0, 90, max_open=True), default=0.0, show_default=False,
        help="Mask a cap of this radius around straight down, such as a tripod or a car roof.",
    ),
    threads_option,
    click.option("--allow-aspect", is_flag=True, help="Accept panoramas that are not 2:1."),
    reading_options,
)  # fmt: skip

preset_option = click.option(
    "--preset", type=click.Choice(list(PRESETS)), default=DEFAULT_PRESET, show_default=False,
    help="Speed against accuracy: seconds of one slow core for 90 frames of 1024x512, and their WS-PSNR.\n\n\b\n"
    + "\n".join(f"{name:9} {preset.summary}" for name, preset in PRESETS.items()),
)  # fmt: skip

surface_options = all_of(  # how the surfaces of panoramas are found
    preset_option,
    # where depth comes from
    click.option(
        "--depth", type=click.Choice(["auto", *DEPTH_SOURCES]), default="auto",
        help=f"Source of depth. {listed(DEPTH_SOURCES)}; auto: files if every panorama has one, else the preset's.",
    ),
    click.option(
        "--model", metavar="NAME|PATH", help="Network for the depth, see `omnisyn models`.  [default: the preset's]"
    ),
    click.option(
        "--depth-prior", metavar="FILE|NAME|none",
        help="Your own depth network, asked where matching leaves much open (docs/depth-prior.md): an ONNX file or one "
        "of `omnisyn models`.  [default: the preset's]",
    ),
    click.option(
        "--depth-prior-kind", metavar="WORDS", default="", show_default=False,
        help="What its file does not say, such as perspective,inverse-depth.",
    ),
    # where surfaces are cut; one of them
    click.option(
        "--cut", type=FiniteRange(0, 1, min_open=True),
        help="Cut the mesh where inverse depth changes by more than this share between pixels.  [default: 0.05; "
        "none for paper]",
    ),
    click.option(
        "--cut-metres", type=FiniteRange(0, min_open=True),
        help="Cut at depth steps of this size instead, as the paper does.  [default: 2 for paper]",
    ),
    masks_option,
    # who is made unrecognizable; the files of the panoramas stay
    click.option(
        "--blur", metavar="FILE|auto-faces", multiple=True, type=FilePath(),
        help="Image, black where a panorama is blurred for good; one per panorama. auto-faces: all faces.",
    ),
    click.option(
        "--face-model", metavar="FILE", type=FilePath(),
        help="OpenCV's face detector YuNet, from github.com/opencv/opencv_zoo: face_detection_yunet_2023mar.onnx.  "
        "[default: OMNISYN_FACE_MODEL in the environment]",
    ),
    click.option(
        "--nadir", metavar="DEGREES|auto", type=NadirRange(0, 90, max_open=True), default="auto",
        help="Mask a cap of this radius around straight down; auto finds caps, tripods and operators; 0 masks nothing.",
    ),
    threads_option,
    # what of unusual panoramas is accepted
    click.option("--allow-aspect", is_flag=True, help="Accept panoramas that are not 2:1 and resample them."),
    reading_options,
    click.option(
        "--view-transform/--no-view-transform", default=True, show_default=False,
        help="Tone-map linear light of EXR and HDR files for screens, or keep its numbers.  [default: tone-map]",
    ),
    click.option(
        "--max-pixels", type=WholeRange(1), default=2 * 16384 * 8192,
        help="Refuse panoramas, masks and depth files with more pixels, before decoding.",
    ),
    outside_option,
)  # fmt: skip

output_options = all_of(  # what becomes of an old output, and what is said of the new one
    click.option(
        "--overwrite", is_flag=True, help="Replace the output if it exists; in a folder, the files of the old output."
    ),
    click.option("--dry-run", is_flag=True, help="Check the input, print the plan, and make nothing."),
    json_option("the summary"),
    quiet_option,
)


def named(options: Mapping[str, Any], ending: Callable[[], str]) -> dict[str, Any]:
    """Options in which the panoramas of a folder, the pose file and the output are named, whoever named them.

    An output that nobody named has this ending, see :meth:`omnisyn_cli.interpolation.inputs.NamedTour.output`.
    """
    from omnisyn_cli.interpolation.inputs import along_path, named_tour
    from omnisyn_cli.interpolation.job import POSES_FROM_PICTURES
    from omnisyn_cli.poses.file import POSES_NAME

    images, poses, output = options["images"], options["poses"], options["output"]
    path = options.get("path")
    lacking = ""
    if len(images) == 1 and not images[0].is_dir():
        lacking = f"{images[0]}: expected two or more panoramas or a folder of them, got one; name another"
    elif poses is None and not (images[0].is_dir() or (images[0].parent / POSES_NAME).is_file()):
        lacking = (
            f"expected --poses, or a poses.json beside {images[0]}, got neither; have poses found in the pictures "
            "(--poses auto), or name the pose file (--poses FILE)"
        )
    if lacking:
        for image in images:
            if not image.exists():
                raise InputError(f"{image}: expected a panorama, got no such file; check the name")
        raise InputError(lacking)
    tour = named_tour(images, poses, allow_outside=options["allow_outside"])
    if path is not None:
        tour = along_path(tour, path, allow_outside=options["allow_outside"])
    finds_order = tour.poses == POSES_FROM_PICTURES and images[0].is_dir()
    output = output or tour.output(ending())
    return {
        **{key: value for key, value in options.items() if key != "path"},
        "images": tour.images, "poses": tour.poses, "output": output, "finds_order": finds_order,
        "tour": tour.tour, "is_chain": tour.is_chain,
    }  # fmt: skip


def check_one_cut(options: Mapping[str, Any]) -> None:
    """Refuse both rules for where surfaces are cut."""
    if options["cut"] is not None and options["cut_metres"] is not None:
        raise click.UsageError("expected --cut or --cut-metres, got both; leave one of them out")
