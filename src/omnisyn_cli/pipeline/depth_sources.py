"""Where depth comes from: the registry of sources, each with its estimator, its sizes and the memory that it takes.

A new source is its estimator's module and a row of :data:`DEPTH_SOURCES`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omnisyn_cli.pipeline.choices import by_name, chosen

if TYPE_CHECKING:
    from omnisyn_cli.stereo.expected_depth import PairPrior
    from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator
    from omnisyn_cli.types import DepthEstimate, DepthEstimator, View

Size = tuple[int, int]
EstimatorMaker = Callable[["DepthSource", Callable[..., Any], "int | None"], "DepthEstimator"]

SYNSIN_DEPTH = "synsin-depth"  # name in the manifest of the network that finds depth in one panorama
# Of the interpreter, its libraries and kernels; measured as peak memory of runs on small pictures.
PROGRAM_BYTES = 345e6
# Of the network that says what to expect, whose input has one size; measured likewise.
PRIOR_BYTES = 110e6


@dataclass(frozen=True)
class DepthSource:
    """Where depth comes from."""

    kind: str = "file"  # one of :data:`DEPTH_SOURCES`
    # that it is looked for at; refined estimates have half of them, those of matching alone as many, but not more than
    # it is good at, see :mod:`omnisyn_cli.stereo.depth_sizes`; a network alone answers in a size of its own
    rows: int = 512
    # name in the manifest or path of an ONNX file, for sources with a network; for ``refined`` None leaves the network
    # out, to compare with
    model: str | None = None
    # likewise of the network that says what depth to expect, for ``refined``; None leaves it out. A file may be a
    # monocular network of the user's, see :mod:`omnisyn_cli.runtime.monocular_session`.
    prior: str | None = None
    prior_kind: str = ""  # what the user says of that, in words
    descriptors: str | None = None  # likewise of the network that matching compares pixels by, for ``refined``

    @property
    def strategy(self) -> DepthStrategy:
        """What its kind can do; ValueError for an unknown one."""
        return chosen(DEPTH_SOURCES, self.kind, "depth source")

    @property
    def networks(self) -> tuple[str, ...]:
        """Those that have a part in it."""
        return tuple(name for name in (self.model, self.prior, self.descriptors) if name is not None)

    @property
    def has_own_prior(self) -> bool:
        """Whether what to expect is said by a network of the user's."""
        return self.prior is not None and self.prior.endswith(".onnx")

    def bytes_of_program(self, grids: Sequence[Size]) -> float:
        """Memory of the program and its networks but the user's, given the sizes of surfaces from coarse to fine."""
        (height, width), strategy = grids[0], self.strategy
        network = strategy.network_bytes * height * width
        return strategy.program_bytes + network + (0.0 if self.prior is None or self.has_own_prior else PRIOR_BYTES)


def _matching_size(source: DepthSource, picture_rows: int, files: Sequence[Path]) -> list[Size]:
    """A network alone is taken to answer in the size of matching."""
    from omnisyn_cli.stereo.depth_sizes import matching_rows

    rows = matching_rows(source.rows)
    return [(rows, 2 * rows)]


@dataclass(frozen=True)
class DepthStrategy:
    """A source of depth."""

    name: str
    help: str  # for that of ``--depth``
    # makes the estimator of its settings, a function that opens a network by name, and the number of threads
    make: EstimatorMaker
    # height and width of surfaces, from coarse to fine: of settings, rows of the larger picture, and the depth files of
    # the panoramas
    grid_sizes: Callable[[DepthSource, int, Sequence[Path]], list[Size]] = _matching_size
    reads_files: bool = False  # whether depth comes with the panoramas and is not estimated
    role: str | None = None  # of the network that takes part, as the manifest of models calls it; None if none does
    model_is_optional: bool = False  # whether depth is estimated without the network as well, and at rows of any number
    model: str | None = None  # name in the manifest of its network where no preset names one
    program_bytes: float = PROGRAM_BYTES  # memory of the program, before pictures
    network_bytes: float = 0.0  # memory of the network for each pixel of the coarsest surface
    estimation_bytes: float = 110e6  # memory that is given back when depth was found and both surfaces were made
    refining_bytes: float = 0.0  # memory for each pixel of the finest surface while depth is refined from size to size

    def refines(self, grids: Sequence[Size]) -> bool:
        """Whether depth comes to its size step by step."""
        return self.refining_bytes > 0.0 and len(grids) > 1

    def bytes_of_estimation(self, grids: Sequence[Size]) -> float:
        """Memory that is given back when depth was found."""
        vertices = max(height * width for height, width in grids)
        return self.estimation_bytes + (self.refining_bytes * vertices if self.refines(grids) else 0.0)


def _file_sizes(source: DepthSource, picture_rows: int, files: Sequence[Path]) -> list[Size]:
    from omnisyn_cli.io.decode import read_header
    from omnisyn_cli.io.depth_files import depth_size

    return [depth_size(read_header(file)) for file in files]


def _refined_sizes(source: DepthSource, picture_rows: int, files: Sequence[Path]) -> list[Size]:
    from omnisyn_cli.stereo.depth_sizes import refinement_sizes

    return list(refinement_sizes(source.rows, picture_rows))


def _make_files(source: DepthSource, network: Callable[..., Any], threads: int | None) -> DepthEstimator:
    from omnisyn_cli.types import KnownDepth

    return KnownDepth()


def _make_matching(source: DepthSource, network: Callable[..., Any], threads: int | None) -> MatchingDepthEstimator:
    from omnisyn_cli.stereo.depth_sizes import matching_rows
    from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator, MatchingOptions

    rows = matching_rows(source.rows)
    return MatchingDepthEstimator(MatchingOptions(size=(rows, 2 * rows)), threads)


def _make_refined(source: DepthSource, network: Callable[..., Any], threads: int | None) -> DepthEstimator:
    from omnisyn_cli.render.mesh import Cut
    from omnisyn_cli.runtime.image_networks import CompletionSession, DescriptorSession
    from omnisyn_cli.stereo.refined_estimator import RefinedDepthEstimator
    from omnisyn_cli.synthesis.consistency import cross_check

    refinement = None if source.model is None else CompletionSession(network(source.model))
    prior = None if source.prior is None else _prior(source, partial(network, source.prior, keeps_memory=False))
    name = source.descriptors
    descriptors = None if name is None else DescriptorSession(network(name, keeps_memory=False))
    matching = replace(_make_matching(source, network, threads), prior=prior, descriptors=descriptors)

    def score(views: tuple[View, View], depths: tuple[DepthEstimate, DepthEstimate]) -> float:
        return cross_check(views, depths, Cut(), threads).confidence.score

    return RefinedDepthEstimator(matching, refinement, source.rows, score)


def _prior(source: DepthSource, open_session: Callable[[], Any]) -> PairPrior:
    """The bundled network, which is opened when a pair needs it; or one of the user's, which is looked at now."""
    from omnisyn_cli.runtime.image_networks import GuidedDepthSession
    from omnisyn_cli.runtime.monocular_session import MonocularSession, NetworkKind
    from omnisyn_cli.stereo.expected_depth import with_guided_priors
    from omnisyn_cli.stereo.monocular_answer import MonocularModel
    from omnisyn_cli.stereo.monocular_prior import with_monocular_priors

    if not source.has_own_prior:
        return partial(with_guided_priors, model=GuidedDepthSession(open_session))
    network = MonocularSession(open_session(), Path(str(source.prior)), NetworkKind.from_words(source.prior_kind))
    return partial(with_monocular_priors, model=MonocularModel(network))


def _make_network(source: DepthSource, network: Callable[..., Any], threads: int | None) -> DepthEstimator:
    from omnisyn_cli.baselines.learned_depth import LearnedDepthEstimator

    return LearnedDepthEstimator(network(source.model))


def _make_monocular(source: DepthSource, network: Callable[..., Any], threads: int | None) -> DepthEstimator:
    from omnisyn_cli.baselines.synsin import MonocularDepthEstimator

    return MonocularDepthEstimator(network(source.model))


# By name, in the order of the help. Memory was measured as the peak of runs that differ in nothing else.
DEPTH_SOURCES: Mapping[str, DepthStrategy] = by_name(
    DepthStrategy(
        "file", "depth files named in the poses", _make_files, _file_sizes, reads_files=True, program_bytes=275e6,
        estimation_bytes=0.0,
    ),
    DepthStrategy("matching", "stereo matching of the two panoramas", _make_matching),
    DepthStrategy(
        "refined", "matching completed by a network and refined", _make_refined, _refined_sizes, role="completion",
        model_is_optional=True, network_bytes=820, refining_bytes=400, estimation_bytes=170e6,
    ),
    DepthStrategy("network", "a stereo network alone", _make_network, role="depth", network_bytes=3200),
    DepthStrategy(
        "monocular", "a network that sees one panorama at a time", _make_monocular, role=SYNSIN_DEPTH,
        model=SYNSIN_DEPTH, program_bytes=370e6,
    ),
)  # fmt: skip


def make_estimator(source: DepthSource, *, device: str = "auto", threads: int | None = None) -> DepthEstimator:
    """Serves any pairs, networks on ``device``. ValueError: unknown source, no model; InputError: it does not load."""

    def open_network(name: str | None, *, keeps_memory: bool = True) -> Any:
        from omnisyn_cli.runtime.session import open_model

        if name is None:
            raise ValueError("expected the name or path of a model, got none")
        return open_model(name, device=device, threads=threads, keeps_memory=keeps_memory)

    return source.strategy.make(source, open_network, threads)
