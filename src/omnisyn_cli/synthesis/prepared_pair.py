"""What the frames between two neighbouring views are made from: their depth and their surfaces."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Float32, Shaped, UInt8

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.compute.threads import both, limited_threads, run_ranges
from omnisyn_cli.fusion.blend_kernels import quantization_for
from omnisyn_cli.fusion.confidence import low_confidence_regions
from omnisyn_cli.fusion.fill import HoleFiller
from omnisyn_cli.fusion.layer_pair import TILE_ROWS
from omnisyn_cli.geometry.pose import Pose, at_same_position
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.render.renderer import MeshRenderer, Renderer, RendererClass, RendererInputs
from omnisyn_cli.render.shade import Shader
from omnisyn_cli.render.texture import Texture, make_texture
from omnisyn_cli.synthesis.chain_depth import ChainDepth
from omnisyn_cli.synthesis.consistency import CrossCheck, cross_check
from omnisyn_cli.synthesis.ground import continue_ground
from omnisyn_cli.types import DepthEstimate, View

FADE_SHARE = 0.05  # share of the way in which what is masked fades: four frames of ninety. Set by hand.


@dataclass(frozen=True)
class SynthesisOptions:
    """How frames are made."""

    size: tuple[int, int]  # height and width of the frames
    renderer: RendererClass = MeshRenderer  # draws the surfaces
    cut: Cut = field(default_factory=Cut)  # where meshes are cut
    threads: int | None = None  # at most this many; None is one per core
    faded_below: float = 0.0  # pairs of fewer dB (``scored_db``) show the photographs, cross-faded, in doubtful regions
    confidence: bool = False  # give every frame a map of its confidence
    # draw flat surfaces with fewer triangles (``mesh`` only): nothing is seen more than an eighth of a pixel aside
    adaptive: bool = False


class _Photographs:
    """Photographs of a pair, turned but not moved, that are shown in parts of frames. Not shared by threads."""

    def __init__(self, poses: Sequence[Pose], size: tuple[int, int], threads: int | None) -> None:
        self._poses, self._shader, self._threads = poses, Shader(size, threads), threads

    def _turned(self, number: int, texture: Texture, pose: Pose, rows: slice) -> Float32[np.ndarray, "rows width 4"]:
        """Some rows of a photograph as a camera sees it; of its pose only the orientation matters."""
        turn = Pose(pose.rotation.T @ self._poses[number].rotation, np.zeros(3))
        return self._shader.rows_at_infinity(texture, turn, rows.start, rows.stop)

    def _change(
        self, image: Shaped[np.ndarray, "height width 3"], mixed: Callable[[slice, np.ndarray], np.ndarray | None]
    ) -> None:
        """Replace rows of a frame, numbers or samples, by what they become as numbers; None leaves them."""
        quantization = quantization_for(image)

        def band(begin: int, end: int) -> None:
            for top in range(begin, end, TILE_ROWS):
                rows = slice(top, min(top + TILE_ROWS, end))
                if (colours := mixed(rows, image[rows] / quantization.scale)) is not None:
                    colours = np.clip(colours, 0.0, quantization.max_colour)
                    image[rows] = colours * quantization.scale + quantization.rounding

        run_ranges(band, len(image), self._threads)


class MaskedFade(_Photographs):
    """What is masked in two photographs, where they show it: seen at the ends of the way and faded in a few frames."""

    def __init__(self, views: Sequence[View], size: tuple[int, int], threads: int | None = None) -> None:
        super().__init__([view.pose for view in views], size, threads)
        self._textures = [
            make_texture(view.image if view.image_uint8 is None else view.image_uint8, ~view.mask)
            if view.shows_masked and view.mask is not None and not view.mask.all()
            else None
            for view in views
        ]

    def __call__(self, image: Shaped[np.ndarray, "height width 3"], pose: Pose, t: float) -> None:
        """Show the masked pixels of the photograph at the nearer end, in place, if that is near enough."""
        nearer, share = int(t > 0.5), 1.0 - min(t, 1.0 - t) / FADE_SHARE
        texture = self._textures[nearer]
        if texture is None or share <= 0.0:
            return

        def mixed(rows: slice, colours: np.ndarray) -> np.ndarray | None:
            photograph = self._turned(nearer, texture, pose, rows)
            weight = np.float32(share) * np.clip(photograph[..., 3:], 0.0, 1.0)
            return (1.0 - weight) * colours + weight * photograph[..., :3] if weight.any() else None

        self._change(image, mixed)


class CrossFade(_Photographs):
    """What is shown where a frame cannot be relied on: both photographs, cross-faded, which is wrong but honest."""

    def __init__(
        self, images: Sequence[np.ndarray], poses: Sequence[Pose], size: tuple[int, int], threads: int | None = None
    ) -> None:
        super().__init__(poses, size, threads)
        self._textures = [make_texture(image) for image in images]

    def __call__(
        self, image: Shaped[np.ndarray, "height width 3"], confidence: Float32[np.ndarray, "height width"], pose: Pose,
        t: float,
    ) -> None:  # fmt: skip
        """Replace the doubtful regions of a frame, in place, by its confidence in [0, 1].

        ``t`` is the share of the second photograph; what is masked in them was painted over.
        """
        weight = low_confidence_regions(confidence)

        def mixed(rows: slice, colours: np.ndarray) -> np.ndarray | None:
            here = weight[rows, :, None]
            if not here.any():
                return None
            colours *= 1.0 - here
            for number, (texture, share) in enumerate(zip(self._textures, (1.0 - t, t), strict=True)):
                photograph = self._turned(number, texture, pose, rows)
                colours += np.float32(share) * here * np.maximum(photograph[..., :3], 0.0)
            return colours

        self._change(image, mixed)


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
        (first, second), drawn_depths = continue_ground(whole, depths)
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
    if check.confidence.scored_db < options.faded_below:
        images = [usable_image(view, options) for view in (first, second)]
        cross_fade = CrossFade(images, poses, options.size, options.threads)
    drawn = [renderer.triangles for renderer in renderers if isinstance(renderer, MeshRenderer)]
    counts = (sum(kept for kept, _ in drawn), sum(every for _, every in drawn)) if drawn else None
    return PreparedPair(index, poses, depths, renderers, check, cross_fade, masked_fade, counts)


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
