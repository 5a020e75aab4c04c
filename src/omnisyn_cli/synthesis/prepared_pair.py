"""What the frames between two neighbouring views are made from: their depth and their surfaces."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, UInt8

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.compute.threads import both, limited_threads
from omnisyn_cli.fusion.confidence import MIN_PAIR_SCORE
from omnisyn_cli.fusion.fill import HoleFiller
from omnisyn_cli.geometry.pose import Pose, at_same_position
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.render.renderer import MeshRenderer, Renderer, RendererClass, RendererInputs
from omnisyn_cli.synthesis.chain_depth import ChainDepth
from omnisyn_cli.synthesis.consistency import CrossCheck, cross_check
from omnisyn_cli.synthesis.fallback import CrossFade, MaskedFade
from omnisyn_cli.synthesis.ground import continue_ground
from omnisyn_cli.synthesis.soft_surface import UNCUT, soft_depths
from omnisyn_cli.types import DepthEstimate, View


@dataclass(frozen=True)
class SynthesisOptions:
    """How frames are made."""

    size: tuple[int, int]  # height and width of the frames
    renderer: RendererClass = MeshRenderer  # draws the surfaces
    cut: Cut = field(default_factory=Cut)  # where meshes are cut
    threads: int | None = None  # at most this many; None is one per core
    cross_fade: bool = False  # show the photographs, cross-faded, in the doubtful regions of pairs that score low
    # give pairs under a ceiling that score low a smooth surface where the photographs do not confirm depth
    soften: bool = False
    confidence: bool = False  # give every frame a map of its confidence
    # draw flat surfaces with fewer triangles (``mesh`` only): nothing is seen more than an eighth of a pixel aside
    adaptive: bool = False


@dataclass(frozen=True)
class PreparedPair:
    """Two neighbouring views with their depth, ready to be rendered."""

    index: int  # of the first view
    # of both views
    poses: tuple[Pose, Pose]
    depths: tuple[DepthEstimate, DepthEstimate]
    renderers: tuple[Renderer, Renderer]
    cross_check: CrossCheck  # how differently they are exposed, and how far what is made of them can be relied on
    cross_fade: CrossFade | None = None  # what doubtful regions are filled with; None where nothing is to be replaced
    masked_fade: MaskedFade | None = None  # fades what is masked at the ends; None where nothing masked is shown
    # how many of both meshes are drawn, and how many they have; None if ``renderers`` draw none
    triangles: tuple[int, int] | None = None
    # where surfaces are uncut and dissolve into each other (:mod:`omnisyn_cli.synthesis.soft_surface`): their depth
    soft_depths: tuple[DepthEstimate, DepthEstimate] | None = None

    @property
    def is_soft(self) -> bool:
        """Whether surfaces are soft."""
        return self.soft_depths is not None


def measure_pair(
    index: int, chain: ChainDepth, options: SynthesisOptions, clock: Stopwatch
) -> tuple[tuple[DepthEstimate, DepthEstimate], CrossCheck]:
    """The depth of both views of a pair, and what they say of each other, unless both stand at one place."""
    first, second = (chain.views[view] for view in chain.links[index])
    if at_same_position(first.pose, second.pose):
        with clock("depth"):
            depths = _depths_in_place(first, second, options)
    else:
        depths = chain(index)
    with clock("check"):
        return depths, cross_check((first, second), depths, options.cut, options.threads)


def prepare_pair(index: int, chain: ChainDepth, options: SynthesisOptions, clock: Stopwatch) -> PreparedPair:
    """Depth and surfaces of a pair, see :func:`measure_pair`; the surfaces keep the photographs' own exposure."""
    depths, check = measure_pair(index, chain, options, clock)
    first_view, second_view = chain.links[index]
    whole = chain.views[first_view], chain.views[second_view]
    with clock("mesh"):
        softened = soft_depths(whole, depths, check) if options.soften else None
        (first, second), drawn_depths, cut = drawn_surfaces(
            whole, softened or depths, options.cut, is_soft=softened is not None
        )
        options = replace(options, cut=cut)
    masked_fade = None
    if any(view.shows_masked and view.mask is not None for view in whole):
        masked_fade = MaskedFade(whole, options.size, options.threads)
    poses = (first.pose, second.pose)
    with clock("mesh"), limited_threads(options.threads):
        renderers = both(
            lambda: _renderer(first, second, drawn_depths[0], options),
            lambda: _renderer(second, first, drawn_depths[1], options),
        )
    cross_fade = None
    if options.cross_fade and check.confidence.score < MIN_PAIR_SCORE:
        images = [usable_image(view, options) for view in (first, second)]
        cross_fade = CrossFade(images, poses, options.size, options.threads)
    drawn = [renderer.triangles for renderer in renderers if isinstance(renderer, MeshRenderer)]
    counts = (sum(kept for kept, _ in drawn), sum(every for _, every in drawn)) if drawn else None
    return PreparedPair(index, poses, depths, renderers, check, cross_fade, masked_fade, counts, softened)


def drawn_surfaces(
    views: tuple[View, View], depths: tuple[DepthEstimate, DepthEstimate], cut: Cut, *, is_soft: bool
) -> tuple[tuple[View, View], tuple[DepthEstimate, DepthEstimate], Cut]:
    """What surfaces are made of: the ground is continued below masks; soft ones are not cut, others by ``cut``."""
    return *continue_ground(views, depths), UNCUT if is_soft else cut


def _renderer(view: View, other: View, depth: DepthEstimate, options: SynthesisOptions) -> Renderer:
    """Of the first of two neighbouring views."""
    way = None
    if options.adaptive and not at_same_position(view.pose, other.pose):  # all frames lie between the two views
        way = np.asarray(view.pose.rotation.T @ (other.pose.position - view.pose.position))
    return options.renderer(
        RendererInputs(
            usable_image(view, options), view.mask, depth.inverse_depth, depth.confidence, options.size, options.cut,
            options.threads, way,
        )
    )  # fmt: skip


def usable_image(
    view: View, options: SynthesisOptions
) -> Float[np.ndarray, "height width 3"] | UInt8[np.ndarray, "height width 3"]:
    """The picture with masked pixels painted over from around them, because interpolation reads beyond a mask.

    Samples of 8 bits where they do as well: they take a quarter of the memory.
    """
    if view.mask is None or view.mask.all():
        return view.image_uint8 if view.image_uint8 is not None and options.renderer.shades_on_demand else view.image
    fill = HoleFiller(view.mask.shape, options.threads)
    image = fill(np.array(view.image, np.float32), view.mask.astype(np.float32))
    if view.image_uint8 is None or not options.renderer.shades_on_demand:
        return image
    return np.where(view.mask[..., None], view.image_uint8, np.rint(255.0 * image).astype(np.uint8))


def _depths_in_place(first: View, second: View, options: SynthesisOptions) -> tuple[DepthEstimate, DepthEstimate]:
    """What is known of both, else spheres of infinite radius; the exact mesh makes those of a few large quads."""
    if first.known_depth is not None and second.known_depth is not None:
        return first.known_depth, second.known_depth
    height, width = (16, 32) if options.renderer.shades_on_demand else first.image.shape[:2]
    far = DepthEstimate(np.zeros((height, width), np.float32), np.ones((height, width), np.float32))
    return far, far
