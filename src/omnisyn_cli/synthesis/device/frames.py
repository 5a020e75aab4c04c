"""Frames of a pair, made on a GPU: what is uploaded once, the memory of a frame, and the order of its kernels.

Meshes and photographs go to the device once per pair. A frame is drawn, shaded, blended, filled and rounded there; only
the coarse grid in which ghosts are looked for, and a fusion network, are the processor's: it gets the colours of some
pixels and gives back the strength by cell, or the weights of candidates. Two frames are made at once, each by a thread
with a stream and memory of its own, so one is copied and looked at while the other is drawn.
"""

import threading
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, partial
from itertools import pairwise
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numba import cuda

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.errors import OmnisynError
from omnisyn_cli.fusion.blend_kernels import kernel_rule, quantization_for
from omnisyn_cli.fusion.blend_rule import BlendRule
from omnisyn_cli.fusion.confidence import TOLERANCES
from omnisyn_cli.fusion.exposure_curve import EXPOSURE_TABLE_ENTRIES
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.fusion.ghosts import GhostSuppression
from omnisyn_cli.fusion.photometry import ExposureMatcher, clipped_weight_loss
from omnisyn_cli.fusion.residual import ResidualFuser, source_samplers
from omnisyn_cli.fusion.supersampling import FIRST_LAYER_EDGE, MIN_SUPERSAMPLING_SHARE, SECOND_LAYER_EDGE
from omnisyn_cli.fusion.warp_candidates import sampled_weights
from omnisyn_cli.geometry.perspective import PerspectiveSize, pixels_per_radian
from omnisyn_cli.geometry.pose import Pose, at_same_position
from omnisyn_cli.render.rasterize import rows_of, target_of, view_of
from omnisyn_cli.render.renderer import MeshRenderer
from omnisyn_cli.render.texture import CHANNELS
from omnisyn_cli.synthesis.device import cuda_draw_kernels, cuda_fuse_kernels
from omnisyn_cli.synthesis.device.cuda_device import allocate, download, launch, to_host, upload
from omnisyn_cli.synthesis.device.cuda_draw_kernels import DeviceQuads, DeviceTarget
from omnisyn_cli.synthesis.device.cuda_fuse_kernels import DeviceFrame
from omnisyn_cli.synthesis.device.cuda_shade_kernels import DeviceLayer, Photograph
from omnisyn_cli.synthesis.frame import FrameMaker, FusedFrame, Samples, finish_frame
from omnisyn_cli.synthesis.prepared_pair import PreparedPair, SynthesisOptions
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import Layer

FRAMES_AT_ONCE = 2
EDGE_MARKS = (FIRST_LAYER_EDGE, SECOND_LAYER_EDGE)


class DeviceView(NamedTuple):
    """One view of a pair on the device."""

    quads: DeviceQuads
    photograph: Photograph
    texels_per_pixel: np.float32


def upload_view(renderer: MeshRenderer, size: tuple[int, int]) -> DeviceView:
    """A renderer's mesh and texture, for targets of a size."""
    blocks, texture, confidence = renderer.quads, renderer.texture, renderer.confidence_map
    layout, texels = texture.layout, texture.texels.reshape(-1, CHANNELS)
    scales = layout[:, 2:6:2] / layout[0, 2:6:2]
    factors = np.stack([scales, layout[:, 3:6:2] - layout[0, 3:6:2] * scales], axis=-1).reshape(-1, 4)
    quads = DeviceQuads(
        upload(blocks.points), upload(blocks.corners.astype(np.int32)), upload(blocks.codes.reshape(-1)),
        upload(blocks.gaps), allocate(blocks.codes.size, np.int32), allocate(1, np.int32),
    )  # fmt: skip
    photograph = Photograph(
        upload(texels.view(np.uint32)[:, 0] if texels.dtype == np.uint8 else texels),
        upload((layout[:, :2] / CHANNELS).astype(np.int32)), upload(factors.astype(np.float32)),
        tuple(map(np.float32, layout[0, 2:6])), np.float32(layout[0, 6]), upload(confidence.values),
        upload(confidence.layout),
    )  # fmt: skip
    return DeviceView(quads, photograph, np.float32(pixels_per_radian(texture.size) / pixels_per_radian(size)))


class DeviceFrames:
    """Makes frames of one size on a GPU; ``fuser`` is asked for what the processor does for a frame."""

    def __init__(self, options: SynthesisOptions, fuser: GeometricFuser) -> None:
        self._size, self._lock, self.frames_at_once = options.size, threading.Lock(), FRAMES_AT_ONCE
        self.failure: str | None = None  # why the processor makes frames in place of the GPU, in a line
        threads = max(1, (options.threads or 2 * FRAMES_AT_ONCE) // FRAMES_AT_ONCE)
        self._makers = [_PairFrames(options, fuser.twin(threads)) for _ in range(FRAMES_AT_ONCE)]

    def of_pair(self, prepared: PreparedPair, processor: FrameMaker) -> list[FrameMaker]:
        """What makes frames of a pair, several at once; the processor does when the GPU has failed, for good."""
        uploaded: dict[_PairFrames, list[DeviceView]] = {}

        def made_by(maker: _PairFrames, waypoint: Waypoint, samples: Samples | None, clock: Stopwatch) -> FusedFrame:
            if self.failure is None:
                try:
                    with self._lock:
                        views = uploaded.get(maker) or self._upload(prepared, next(iter(uploaded.values()), None))
                        uploaded[maker] = views
                    return maker(prepared, views, waypoint, samples, clock)
                except OmnisynError:  # of a network
                    raise
                except Exception as error:  # noqa: BLE001 - whatever a driver says, the frame is made
                    self.failure = f"{type(error).__name__}: {error}".splitlines()[0]
            with self._lock:  # in memory of its own, as the other thread overwrites what this one was made in
                made = processor(waypoint, samples, clock)
                image, nearest = made.frame.image if samples is not None else made.frame.image.copy(), made.nearest()
                return replace(made, frame=replace(made.frame, image=image), nearest=lambda: nearest)

        return [partial(made_by, maker) for maker in self._makers]

    def _upload(self, prepared: PreparedPair, others: list[DeviceView] | None) -> list[DeviceView]:
        """Both views; what ``others`` have is shared, but for the lists, as two threads draw the same quads."""
        if others is None:
            return [upload_view(each, self._size) for each in prepared.renderers if isinstance(each, MeshRenderer)]
        return [
            view._replace(
                quads=view.quads._replace(
                    listed=allocate(view.quads.listed.shape, np.int32), count=allocate(1, np.int32)
                )
            )
            for view in others
        ]


class _PairFrames:
    """Makes one frame after the other."""

    def __init__(self, options: SynthesisOptions, fuser: GeometricFuser) -> None:
        self._options, self._fuser, self._size = options, fuser, options.size
        self._supersamples = fuser.supersamples and not isinstance(options.size, PerspectiveSize)
        self._pixels = prod(options.size)
        self._images: dict[str, tuple[Any, np.ndarray]] = {}  # by type, on the device and for the processor

    @cached_property
    def _stream(self) -> Any:
        return cuda.stream()

    @cached_property
    def _targets(self) -> list[DeviceTarget]:
        """The picture, and one of twice its size for samples; what is drawn to follows."""
        size, none = self._size, allocate(0, np.uint8)
        perspective = view_of(size) if isinstance(size, PerspectiveSize) else (np.float32(0.0),) * 3
        targets = []
        for each in (size, (2 * size[0], 2 * size[1])) if self._supersamples else (size,):
            made = target_of(each, np.empty(0, np.float32))
            targets.append(DeviceTarget(
                none, upload(made.rows), upload(made.cols), upload(made.exact_rows), upload(made.exact_cols),
                made.scale, perspective, made.height, made.width, none, 0,
            ))  # fmt: skip
        return targets

    @cached_property
    def _memory(self) -> dict[str, Any]:
        """Memory on the device that does not depend on the pair; ``small`` is also there for the processor."""
        ghosts, edges, sizes = self._fuser.ghosts, self._pixels if self._supersamples else 0, [self._size]
        while max(sizes[-1]) > 1:
            sizes.append((-(-sizes[-1][0] // 2), -(-sizes[-1][1] // 2)))
        small = [(2, *ghosts.downsampled_size), (2, *ghosts.downsampled_size, CHANNELS)]
        judged = self._size if self._options.confidence or self._options.faded_below > 0.0 else (0, 0)
        return {
            "depths": [allocate(self._pixels, np.int32) for _ in range(2)],
            "samples": [allocate(4 * edges, np.int32) for _ in range(2)], "marks": allocate(edges, np.uint8),
            "tables": [allocate((3, EXPOSURE_TABLE_ENTRIES), np.float32) for _ in range(2)],
            # zeros, because colours without weight are not written, and not a number would spread
            "pyramid": [(upload(np.zeros((*each, 3), np.float32)), allocate(each, np.float32)) for each in sizes[1:]],
            "seen": allocate(self._size, np.uint8), "confidence": allocate(judged, np.float32),
            "grid": (upload(ghosts.rows.astype(np.int32)), upload(ghosts.cols.astype(np.int32))),
            "small": [(allocate(shape, np.float32), cuda.pinned_array(shape, np.float32)) for shape in small],
            "strength": allocate(ghosts.grid, np.float32), "nothing": allocate(0, np.int32),
            "no strength": allocate((0, 1), np.float32), "no confidence": allocate((0, 1), np.float32),
        }  # fmt: skip

    def __call__(
        self, prepared: PreparedPair, views: Sequence[DeviceView], waypoint: Waypoint, samples: Samples | None,
        clock: Stopwatch,
    ) -> FusedFrame:  # fmt: skip
        """The frame at a waypoint, see :func:`omnisyn_cli.synthesis.frame.fuse_frame`."""
        poses = [waypoint.pose.inverse() @ pose for pose in prepared.poses]
        rule = BlendRule.at(waypoint.t)
        is_judged = self._options.confidence or prepared.cross_fade is not None
        confidence = np.empty(self._size, np.float32) if is_judged else None
        with clock("render"):
            image, pinned = self._image_of("float32" if samples is None else "uint8")
            frame = self._frame(prepared, views, poses, rule, image, confidence)
            for k in range(2):
                self._draw(views[k].quads, poses[k], self._targets[0]._replace(nearest=self._memory["depths"][k]))
        with clock("fuse"):
            small, suppression = None, None
            if rule_applies := not at_same_position(*poses):
                small = self._small_layers(frame, poses)
                suppression = self._fuser.ghosts.detect(*small, rule)
            if suppression is not None:
                strength = upload(suppression.signed_strength, self._stream, self._memory["strength"])
                frame = frame._replace(strength=strength, cell_size=suppression.cell_size)
            self._blend(frame)
            if frame.share >= MIN_SUPERSAMPLING_SHARE and self._supersamples and not at_same_position(*poses):
                self._supersample(frame, views, poses)
            if rule_applies and small is not None:
                self._correct(prepared, frame, small, suppression, rule)
            download(frame.image, self._stream, pinned)
            if confidence is not None:
                download(frame.confidence, self._stream, confidence)
            self._stream.synchronize()
            if samples is not None:
                samples[...] = pinned
            finished = finish_frame(prepared, pinned if samples is None else samples, confidence, waypoint)
        return FusedFrame(finished, self._nearest, pixels_per_radian(self._size))

    def _nearest(self) -> float:
        """The greatest inverse depth in the last frame."""
        return max(float(to_host(depths).view(np.float32).max()) for depths in self._memory["depths"])

    def _run(self, made: Any, count: int, group: Any) -> None:
        launch(made, count, self._stream, count, group)

    def _image_of(self, dtype: str) -> tuple[Any, np.ndarray]:
        """The picture on the device, and memory of the processor that it is copied to."""
        if dtype not in self._images:
            shape = (*self._size, 3)
            self._images[dtype] = allocate(shape, np.dtype(dtype)), cuda.pinned_array(shape, np.dtype(dtype))
        return self._images[dtype]

    def _frame(
        self, prepared: PreparedPair, views: Sequence[DeviceView], poses: Sequence[Pose], rule: BlendRule, image: Any,
        confidence: np.ndarray | None,
    ) -> DeviceFrame:  # fmt: skip
        """What the kernels of one frame take."""
        memory, curve, layers = self._memory, prepared.cross_check.curve, []
        for k, (view, pose) in enumerate(zip(views, poses, strict=True)):
            table, loss = memory["tables"][k], np.float32(-1.0)
            if not curve.is_identity and rule.t != k:
                values = curve.table(rule.t, of_second=k == 1)
                table, loss = upload(values, self._stream, table), clipped_weight_loss(values)
            layers.append(DeviceLayer(
                view.photograph, rows_of(pose), view.texels_per_pixel, table, loss,
                memory["depths"][k].view(np.float32), memory["samples"][k].view(np.float32), EDGE_MARKS[k],
            ))  # fmt: skip
        target, double, (colours, weights) = self._targets[0], self._targets[-1], memory["pyramid"][0]
        return DeviceFrame(
            layers[0], layers[1], target.rows, target.cols, double.rows, double.cols, kernel_rule(rule),
            quantization_for(np.empty(0, image.dtype)), np.float32(rule.occlusion_strength), memory["no strength"], 1,
            image, memory["seen"], memory["no confidence" if confidence is None else "confidence"], TOLERANCES,
            colours, weights, memory["marks"],
        )  # fmt: skip

    def _draw(self, quads: DeviceQuads, pose: Pose, target: DeviceTarget, *, is_clear: bool = False) -> None:
        cleared = self._memory["nothing"] if is_clear else target.nearest
        self._run(cuda_draw_kernels.clear, max(len(cleared), 1), (cleared, quads.count))
        launch(cuda_draw_kernels.draw, len(quads.codes), self._stream, quads, rows_of(pose), target)
        launch(cuda_draw_kernels.draw_listed, None, self._stream, quads, rows_of(pose), target)

    def _small_layers(self, frame: DeviceFrame, poses: Sequence[Pose]) -> tuple[Layer, Layer]:
        """What ghosts are looked for in, and a network sees, on the processor."""
        small, (rows, cols) = self._memory["small"], self._memory["grid"]
        self._run(
            cuda_fuse_kernels.shade_grid, len(rows) * len(cols), (frame, rows, cols, *(each for each, _ in small))
        )
        for on_device, pinned in small:
            download(on_device, self._stream, pinned)
        self._stream.synchronize()
        (_, depths), (_, colours) = small
        first, second = (Layer.from_arrays(depths[k], colours[k], poses[k]) for k in range(2))
        return first, second

    def _blend(self, frame: DeviceFrame) -> None:
        """The picture by the rule, its holes filled."""
        pyramid, exactly = self._memory["pyramid"], quantization_for(np.empty(0, np.float32))
        self._run(cuda_fuse_kernels.blend, prod(pyramid[0][1].shape), frame)
        for finer, coarser in pairwise(pyramid):
            self._run(cuda_fuse_kernels.pull, prod(coarser[1].shape), (*finer, *coarser))
        for coarser, finer in pairwise(pyramid[::-1]):
            self._run(cuda_fuse_kernels.fill, prod(finer[1].shape), (*coarser, *finer, False, exactly))
        self._run(
            cuda_fuse_kernels.fill, self._pixels, (*pyramid[0], frame.image, frame.seen, True, frame.quantization)
        )

    def _supersample(self, frame: DeviceFrame, views: Sequence[DeviceView], poses: Sequence[Pose]) -> None:
        """Pixels at edges become the mean of their samples."""
        self._run(cuda_fuse_kernels.mark_edges, self._pixels, frame)
        for view, pose, samples, mark in zip(views, poses, self._memory["samples"], EDGE_MARKS, strict=True):
            target = self._targets[1]._replace(nearest=samples, marks=frame.marks, mark=mark)
            self._draw(view.quads, pose, target, is_clear=True)
        self._run(cuda_fuse_kernels.supersample, self._pixels, frame)

    def _correct(
        self, prepared: PreparedPair, frame: DeviceFrame, small: tuple[Layer, Layer],
        suppression: GhostSuppression | None, rule: BlendRule,
    ) -> None:  # fmt: skip
        """Ask the fusion network, if there is one, while the device blends, and mix in what it chooses."""
        if not isinstance(self._fuser, ResidualFuser) or not self._fuser.is_corrected(rule):
            return
        sampled = [
            replace(layer, source_sampler=renderer.source_sampler(layer.target_from_source))
            for layer, renderer in zip(small, prepared.renderers, strict=True)
            if isinstance(renderer, MeshRenderer)
        ]
        samplers = source_samplers(*ExposureMatcher(prepared.cross_check.curve)(sampled[0], sampled[1], rule.t))
        inputs = self._fuser.inputs(small, suppression, rule, samplers)
        if inputs is not None:
            channels, candidates, strength = inputs
            weights = upload(sampled_weights(strength * self._fuser.network(channels)), self._stream)
            group = (frame, weights, upload(candidates.hypotheses, self._stream))
            self._run(cuda_fuse_kernels.mix_candidates, self._pixels, group)
