"""SynSin as a method that is compared, see :class:`omnisyn_cli.evaluation.synthesizers.Synthesizer`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from omnisyn_cli.evaluation.synthesizers import Picture
from omnisyn_cli.runtime.synsin import SynSinSessions
from omnisyn_cli.segments import Stopwatch, SynthesisOptions
from omnisyn_cli.synsin import SynSin
from omnisyn_cli.trajectory import Waypoint
from omnisyn_cli.types import DepthEstimate, View

__all__ = ["SynSinSynthesizer"]


class SynSinSynthesizer:
    """Pictures of points of one panorama or of both; never the panoramas themselves.

    Pictures have no depth: what a network paints lies nowhere.

    Args:
        networks: the three of SynSin.
        views: the pair.
        sources: panoramas that a picture is made of, 1 or 2.
        threads: at most this many; None is one per core.
    """

    def __init__(
        self, networks: SynSinSessions, views: tuple[View, View], sources: int, threads: int | None = None
    ) -> None:
        self._networks, self._views, self._sources, self._threads = networks, views, sources, threads
        self._depths: tuple[DepthEstimate, DepthEstimate] | None = None

    @property
    def depths(self) -> tuple[DepthEstimate, DepthEstimate] | None:
        """Each panorama's depth as its network sees it, once a picture was made."""
        return self._depths

    def pictures(self, path: Sequence[Waypoint], size: tuple[int, int], clock: Stopwatch) -> Iterator[Picture]:
        """A picture of ``size`` for every waypoint, in order; ``clock`` collects seconds by stage."""
        made = SynSin(self._networks, self._views, self._sources, SynthesisOptions(size, threads=self._threads), clock)
        for waypoint in path:
            picture = Picture(made.picture(waypoint))
            if self._depths is None:
                self._depths = self._networks.estimator(*self._views)
            yield picture
